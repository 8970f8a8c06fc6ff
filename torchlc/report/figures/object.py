"""The object at its brightest; a file beside the page, whose own view turns."""

from __future__ import annotations

from torchlc.figures.object_drawing import brightest, draw_object
from torchlc.report.figures.contract import ReportFigure


class Object(ReportFigure):
    """The object with the directions of Sun and observer."""

    name = "object"
    section = "object"

    def on_page(self, result):
        return False

    def size(self, result):
        return (5.6, 5.0)

    def draw(self, result, figure):
        row = brightest(result.recording, result.prediction)
        draw_object(result.model, result.view, row, figure.subplots())

    def alt(self, result):
        return "The object at its brightest."

    def caption(self, result):
        return "The object at its brightest row, with the directions of Sun and observer."
