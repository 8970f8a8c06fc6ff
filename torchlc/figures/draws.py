"""Draws of a posterior: every pair of parameters, and every walker's way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from torchlc.figures.style import PALETTE, plain, style

MOST_DRAWN = 20_000
"""Draws beyond which a corner plot takes every second, third, ...: its contours no longer change."""
WIDE = 4.0
"""Ratio of largest to smallest draw from which a parameter of a logarithmic prior is drawn logarithmically."""


@dataclass(frozen=True)
class Draws:
    """A parameter's name and unit, its draws (walkers, steps), and whether its prior is logarithmic."""

    name: str
    unit: str
    values: np.ndarray
    logarithmic_prior: bool

    @property
    def logarithmic(self) -> bool:
        """Whether a logarithmic axis shows the draws better."""
        return self.logarithmic_prior and float(self.values.max() / self.values.min()) > WIDE


def corner_size(parameters: int) -> tuple[float, float]:
    """Inches of a corner plot."""
    side = 1.2 + 1.35 * parameters
    return side, side


def draw_corner(parameters: Sequence[Draws], figure: Figure) -> Figure:
    """Posterior of every pair of parameters."""
    import corner

    columns = [(np.log10(p.values) if p.logarithmic else p.values).ravel() for p in parameters]
    labels = [
        plain(f"log10 {p.name}" if p.logarithmic else p.name) + (f"\n({p.unit})" if p.unit else "")
        for p in parameters
    ]
    data = np.stack(columns, -1)
    data = data[:: max(1, len(data) // MOST_DRAWN)]
    span = [(a, b) if a < b else (a - 1e-6, b + 1e-6) for a, b in zip(data.min(0), data.max(0), strict=True)]
    with matplotlib.rc_context(style(8)):
        corner.corner(
            data, labels=labels, fig=figure, color=PALETTE[0], range=span, plot_datapoints=False,
            fill_contours=False, plot_density=False, levels=(0.393, 0.865), smooth=1.0, bins=24,
            max_n_ticks=3, labelpad=0.05, quiet=True,
            hist_kwargs={"lw": 1.2}, contour_kwargs={"linewidths": 1.1},
        )  # fmt: skip
    return figure


def traces_size(parameters: int) -> tuple[float, float]:
    """Inches of the traces."""
    return 8.2, 0.6 + 1.2 * -(-parameters // 2)


def draw_traces(parameters: Sequence[Draws], steps: np.ndarray, figure: Figure) -> Figure:
    """Every walker's way at the given steps of the chain, a panel a parameter."""
    columns = 2 if len(parameters) > 1 else 1
    bands = -(-len(parameters) // columns)
    with matplotlib.rc_context(style(8)):
        grid = figure.subplots(bands, columns, squeeze=False, sharex=True)
        for axes, parameter in zip(grid.flat, parameters, strict=False):
            axes.plot(steps, parameter.values.T, lw=0.4, alpha=0.35, color=PALETTE[0], rasterized=True)
            axes.set_title(plain(parameter.name), fontsize=8, loc="left", pad=2)
            if parameter.logarithmic:
                axes.set_yscale("log")
        for axes in grid.flat[len(parameters) :]:
            axes.set_visible(False)
        for axes in grid[-1]:
            axes.set_xlabel("step")
        figure.subplots_adjust(hspace=0.55, wspace=0.22)
    return figure
