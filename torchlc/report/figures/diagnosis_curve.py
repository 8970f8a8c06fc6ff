"""Recording beside the model before and after the diagnosis."""

from __future__ import annotations

from torchlc.figures.curves import curve_size, draw_curves
from torchlc.report.figures.contract import ReportFigure


class DiagnosisCurve(ReportFigure):
    """Recording, the scene's model refitted, and the model with what it lacked."""

    name = "curve"
    page = "diagnosis"
    section = "missing"
    order = 0

    def size(self, result):
        return curve_size(result.recording)

    def draw(self, result, figure):
        draw_curves(result.comparison, figure)

    def alt(self, result):
        stretches = len((result.content["where"] or {"intervals": ()})["intervals"])
        return f"Light curve with the model before and after; {stretches} stretches where they differ are marked."

    def caption(self, result):
        return (
            "Dots: recording. Dashed: the model as the scene gives it, refitted. Line: with what it lacked. "
            "Below, what each leaves; rows where they differ are marked."
        )
