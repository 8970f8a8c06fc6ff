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
        if not result.content["named"]:
            return f"Light curve with the model; {stretches} stretches that stand out are marked."
        return f"Light curve with the model before and after; {stretches} stretches where they differ are marked."

    def caption(self, result):
        if not result.content["named"]:
            marked = "; rows that stand out are marked" if result.content["where"] else ""
            return f"Dots: recording. Line: the model with the materials refitted. Below, what it leaves{marked}."
        return (
            "Dots: recording. Dashed: the model as the scene gives it, refitted. Line: with what it lacked. "
            "Below, what each leaves; rows where they differ are marked."
        )
