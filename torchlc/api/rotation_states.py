"""The verb rotation."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from torchlc.api.inputs import Columns, Progress, read_scene, usable
from torchlc.api.outputs import held, input_files, provenance, steps_of
from torchlc.errors import InputError
from torchlc.files.writing import ROTATION_FILES, STEPS_FILE
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.tensors.moving import on_cpu

if TYPE_CHECKING:
    from torchlc.results.rotation_result import RotationResult


@on_cpu
def rotation(
    scene: str | Path | Scene,
    *recordings: str | Path | Recording,
    shortest: float | None = None,
    longest: float | None = None,
    seed: int = 0,
    budget: float | None = None,
    out: str | Path | None = None,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> RotationResult:
    """Rotation states of a body from one or more recordings: pole, period, phase, with all modes that fit.

    The scene gives shape, materials and, as bounds of its ``period``, where to look, unless ``shortest`` and ``longest``
    (s) do. ``budget`` is in CPU seconds, after which no further stage is begun and the verdict says what was left out. With
    ``out`` rotation.json, scene.toml of the best mode and figures are written there, and a run that was killed goes on from the
    last stage that it had finished. ``columns`` says which column is what in every recording.
    """
    from torchlc.inference.rotation.search import search_rotation
    from torchlc.readers.joining import joined
    from torchlc.results.rotation_result import RotationResult

    began = time.monotonic()
    scene = read_scene(scene, trust)
    if not recordings:
        raise InputError(None, None, "no recording", "one or more")
    each = [usable(scene, recording, use=use, columns=columns) for recording in recordings]
    rows = usable(scene, joined(each))
    with ExitStack() as stack:
        files = (Path(recording) for recording in recordings if not isinstance(recording, Recording))
        directory = held(stack, out, ROTATION_FILES, [*input_files(scene), *files])
        kept = steps_of(directory, scene, rows, repr((shortest, longest)))
        search = search_rotation(
            scene,
            rows,
            shortest_s=shortest,
            longest_s=longest,
            progress=progress,
            steps=kept,
            budget_s=budget,
        )
        made = provenance(scene, rows, seed, command)
        made["inputs"] |= {
            f"recording {number}": provenance(scene, recording, seed)["inputs"]["recording"]
            for number, recording in enumerate(each[1:], 2)
            if recording.source is not None and recording.sha256 is not None
        }
        result = RotationResult(search, seed, time.monotonic() - began, made)
        if directory is not None:
            result.write(directory)
            directory.clear([STEPS_FILE])
    return result
