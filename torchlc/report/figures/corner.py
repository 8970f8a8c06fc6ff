"""Posterior of every pair of parameters."""

from __future__ import annotations

from torchlc.figures.draws import corner_size, draw_corner
from torchlc.report.figures.contract import ReportFigure


class Corner(ReportFigure):
    """Corner plot of the parameters that the data inform best."""

    name = "corner"
    section = "posterior"
    square = True

    def applies(self, result):
        return result.posterior is not None

    def size(self, result):
        return corner_size(len(result.foremost()))

    def draw(self, result, figure):
        draw_corner(result.draws(result.foremost()), figure)

    def alt(self, result):
        return f"Corner plot of the posterior of {', '.join(result.foremost())}."

    def caption(self, result):
        drawn = len(result.foremost())
        more = (
            f" {drawn} of {len(result.names)} parameters, those that the data inform first."
            if drawn < len(result.names)
            else ""
        )
        return f"Contours hold 39 and 86 % of the posterior: 1 and 2 sigma in two dimensions.{more}"
