"""Recording beside model."""

from __future__ import annotations

import numpy as np

from torchlc.digits import number_of
from torchlc.figures.curves import MOST_PANELS, curve_size, draw_curves, stretches
from torchlc.report.figures.contract import ReportFigure


class Curve(ReportFigure):
    """Recording (dots) and model (line), residuals below."""

    name = "curve"
    section = "curve"
    order = 0

    def size(self, result):
        return curve_size(result.recording)

    def draw(self, result, figure):
        draw_curves(result.comparison, figure)

    def alt(self, result):
        recording = result.recording
        low, high = np.nanmin(recording.observed), np.nanmax(recording.observed)
        unit = "magnitudes" if recording.kind == "mag" else "relative fluxes"
        return f"Light curve: {number_of(len(recording), 'row')}, {unit} from {low:.4g} to {high:.4g}, the model over them, residuals below."

    def caption(self, result):
        total = len(stretches(result.recording))
        more = f" The first {MOST_PANELS} of {total} are drawn." if total > MOST_PANELS else ""
        band = " with the 90 % band of the posterior" if result.posterior is not None else ""
        return f"Recording (dots) and model (line){band}; below, what is left.{more}"
