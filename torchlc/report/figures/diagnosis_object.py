"""The object of a diagnosis at its brightest; a file beside the page, whose own view turns."""

from __future__ import annotations

from torchlc.report.figures.object import Object


class DiagnosisObject(Object):
    """The object with the directions of Sun and observer."""

    name = "object"
    page = "diagnosis"
