"""Recording beside the model before and after the diagnosis."""

from __future__ import annotations

from torchlc.report.figures.curve import Curve


class DiagnosisCurve(Curve):
    """Recording, the scene's model refitted, and the model with what it lacked."""

    name = "curve"
    page = "diagnosis"
    section = "missing"

    def alt(self, result):
        stretches = len((result.content["where"] or {"intervals": ()})["intervals"])
        return f"Light curve with the model before and after; {stretches} stretches where they differ are marked."

    def caption(self, result):
        return (
            "Dots: recording. Dashed: the model as the scene gives it, refitted. Line: with what it lacked. "
            "Below, what each leaves; rows where they differ are marked."
        )
