"""Share of each component in the light, along the rows."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from torchlc.figures.curves import stretches
from torchlc.figures.style import component_colour, plain, style
from torchlc.readers import Recording

SIZE = (8.2, 2.8)
"""Inches."""


def draw_shares(recording: Recording, components: Sequence[str], shares: np.ndarray, axes: Axes) -> Axes:
    """Shares (C, T) of the named components, stacked, along the rows in order of time."""
    panels = stretches(recording)
    with matplotlib.rc_context(style()):
        if len(panels) == 1:
            x, label = panels[0].elapsed, f"{panels[0].unit} after the first row"
        else:
            x, label = np.arange(len(recording)), "row, in order of time"
        order = np.argsort(x, kind="stable")
        axes.stackplot(
            x[order], shares[:, order], labels=[plain(name) for name in components],
            colors=[component_colour(k) for k in range(len(components))], alpha=0.9, lw=0,
        )  # fmt: skip
        axes.set(
            xlim=(x.min(), max(x.max(), x.min() + 1e-6)),
            ylim=(0, 1),
            xlabel=label,
            ylabel="share of the light",
        )
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.18), ncols=min(len(components), 6), fontsize=8)
    return axes
