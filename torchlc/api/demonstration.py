"""The example that comes with the package, diagnosed and fitted."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from torchlc.api.diagnosis import diagnose
from torchlc.api.fitting import fit
from torchlc.api.inputs import Progress
from torchlc.files.disk import resources
from torchlc.files.writing import DIAGNOSIS_FILES, FIT_FILES, OutputDirectory
from torchlc.results.fit_result import FitResult

if TYPE_CHECKING:
    from torchlc.diagnosis.result import Diagnosis

DEMO_STEPS = 1000
"""The demo took 66 CPU seconds with these, on a machine that had other work; a chain until it has converged took 13,200 and 282."""


def demo(
    out: str | Path, *, seed: int = 0, progress: Progress | None = None, command: str | None = None
) -> tuple[Diagnosis, FitResult]:
    """Diagnose the example that comes with the package, then fit it with what was named in the model; one
    report tells both.

    Its two files are put beside the results. The chain has ``DEMO_STEPS`` steps.
    """
    from torchlc.report import fit_page as report
    from torchlc.report.diagnosis_page import context

    source = Path(__file__).parents[1] / "demo"
    files = source / "scene.toml", source / "recording.ecsv"
    copies = (file.name for file in files)
    with (
        OutputDirectory(out, {*FIT_FILES, *DIAGNOSIS_FILES, *copies}, files) as directory,
        resources(directory.path),
    ):
        diagnosis = diagnose(*files, quick=True, seed=seed, progress=progress)
        result = fit(
            diagnosis.completed, files[1], steps=DEMO_STEPS, seed=seed, progress=progress, command=command
        )
        for file in files:
            directory.write(file.name, lambda partial, file=file: shutil.copyfile(file, partial))
        made = {"provenance": dict(result.provenance)}
        directory.write_json("diagnosis.json", diagnosis.to_json() | made)
        report.write_fit(result, directory, progress, context(diagnosis))
    return diagnosis, result
