"""Every walker's way after burn-in."""

from __future__ import annotations

from torchlc.figures.draws import draw_traces, traces_size
from torchlc.report.figures.contract import ReportFigure

MOST_TRACES = 24
"""Parameters that are drawn: a page of 12 bands still prints."""


class Traces(ReportFigure):
    """Every walker's way after burn-in, a panel a parameter."""

    name = "traces"
    section = "chain"

    def applies(self, result):
        return result.posterior is not None

    def size(self, result):
        return traces_size(min(len(result.names), MOST_TRACES))

    def draw(self, result, figure):
        draw_traces(result.draws(result.names[:MOST_TRACES]), result.chain_steps, figure)

    def alt(self, result):
        return "Traces of all walkers after burn-in, one panel a parameter."

    def caption(self, result):
        return "Every walker after burn-in."
