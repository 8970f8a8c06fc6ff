"""Which component gives how much of the light."""

from __future__ import annotations

from torchlc.figures.shares import SIZE, draw_shares
from torchlc.report.figures.contract import ReportFigure


class Shares(ReportFigure):
    """Share of each component in the modelled light."""

    name = "shares"
    heading = "Who shines when"
    section = "curve"
    order = 10

    def on_page(self, result):
        return len(result.model.assembly.components) > 1

    def size(self, result):
        return SIZE

    def draw(self, result, figure):
        draw_shares(result.recording, result.model.assembly.components, result.shares, axes=figure.subplots())

    def alt(self, result):
        means = ", ".join(
            f"{name} {100 * row['mean_share']:.0f} %" for name, row in result.mean_shares().items()
        )
        return f"Shares of the light along the recording; on average {means}."

    def caption(self, result):
        return "Share of each component in the modelled light."
