"""The page of a result in a file of its own."""

from __future__ import annotations

from pathlib import Path

from torchlc.diagnosis.result import Diagnosis
from torchlc.errors import InputError
from torchlc.files.writing import write_whole
from torchlc.report.diagnosis_page import render_diagnosis
from torchlc.report.fit_page import render_fit
from torchlc.results.fit_result import FitResult


def write_report(result: FitResult | Diagnosis, path: str | Path) -> Path:
    """The page of a fit or a diagnosis as one HTML file that needs no network; its path."""
    if not isinstance(result, (FitResult, Diagnosis)):
        raise InputError(None, "result", type(result).__name__, "what fit or diagnose returns")
    page = render_fit(result) if isinstance(result, FitResult) else render_diagnosis(result, {})
    return write_whole(Path(path), lambda partial: partial.write_text(page, encoding="utf-8"))
