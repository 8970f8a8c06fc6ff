"""The verb diagnose."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from torchlc.api.inputs import Columns, Progress, Rows, read_scene, usable
from torchlc.api.outputs import held, input_files, provenance, steps_of
from torchlc.files.steps import EVERY_S
from torchlc.files.writing import DIAGNOSIS_FILES, STEPS_FILE
from torchlc.lightcurve.assembly import assemble
from torchlc.scene import Scene
from torchlc.stages.entry import Entry
from torchlc.tensors.moving import on_cpu

if TYPE_CHECKING:
    from torchlc.diagnosis.result import Diagnosis


@on_cpu
def diagnose(
    scene: str | Path | Scene,
    recording: Rows,
    *,
    quick: bool = False,
    effects: str | Sequence[str] | None = None,
    seed: int = 0,
    budget: float | None = None,
    out: str | Path | None = None,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> Diagnosis:
    """Say whether physics is missing from the scene's model, which, where, and what that changes.

    ``effects`` limits the candidates (noise is always among them); ``budget`` is in CPU seconds, after which the verdict
    says what was not examined; ``quick`` is a budget of 20 s. With ``out`` diagnosis.json, figures and report.html are
    written there, and a run that was killed goes on from what it had finished.
    """
    from torchlc.diagnosis.candidates import check_candidates
    from torchlc.diagnosis.run import diagnose as run

    scene = read_scene(scene, trust)
    rows = usable(scene, recording, use=use, columns=columns)
    effects = Entry.split(effects) if isinstance(effects, str) else effects
    check_candidates(effects, assemble(scene, rows))
    with ExitStack() as stack:
        directory = held(stack, out, DIAGNOSIS_FILES, input_files(scene, rows))
        steps = steps_of(directory, scene, rows, repr((effects, seed)), EVERY_S)
        result = run(
            scene,
            rows,
            quick=quick,
            effects=effects,
            seed=seed,
            budget=budget,
            progress=progress,
            steps=steps,
        )
        if directory is not None:
            from torchlc.report.diagnosis_page import write_diagnosis

            write_diagnosis(result, provenance(scene, rows, seed, command), directory)
            directory.clear([STEPS_FILE])
    return result
