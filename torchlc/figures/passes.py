"""Predicted magnitudes of passes, a panel each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from torchlc.figures.saving import drawn, save
from torchlc.figures.style import DATA, MARK, MODEL, plain, style

COLUMNS = 3
"""Of panels, across a page."""
PNG_DPI = 130


@dataclass(frozen=True)
class Panel:
    """One pass: ``minutes`` (R,) after ``start``, ``mag`` (5, R), the ends of the 95 and 68 % intervals about the median, not
    a number where there is no light, ``elevation`` (R,), deg, and minutes of ``glints``."""

    title: str
    start: str
    minutes: np.ndarray
    mag: np.ndarray
    elevation: np.ndarray
    glints: Sequence[float] = ()


def passes_size(panels: int) -> tuple[float, float]:
    """Inches."""
    columns = min(max(panels, 1), COLUMNS)
    return 3.4 * columns + 0.6, 2.6 * -(-max(panels, 1) // columns) + 0.4


def draw_passes(panels: Sequence[Panel], figure: Figure) -> Figure:
    """Fill a figure with the panels, brightest first."""
    with matplotlib.rc_context(style(8.5)):
        if not panels:
            figure.text(0.5, 0.5, "nothing to be seen", ha="center")
            return figure
        columns = min(len(panels), COLUMNS)
        grid = figure.subplots(-(-len(panels) // columns), columns, squeeze=False)
        for axes, panel in zip(grid.flat, panels, strict=False):
            axes.fill_between(
                panel.minutes, panel.mag[0], panel.mag[4], color=MODEL, alpha=0.15, lw=0, label="95 %"
            )
            axes.fill_between(
                panel.minutes, panel.mag[1], panel.mag[3], color=MODEL, alpha=0.3, lw=0, label="68 %"
            )
            axes.plot(panel.minutes, panel.mag[2], color=MODEL, lw=1.4, label="median")
            for at in panel.glints:
                axes.axvline(at, color=MARK, lw=1.2, label="glint")
            axes.invert_yaxis()
            axes.set_title(plain(panel.title), fontsize=8.5)
            axes.set(xlabel=f"minutes after {panel.start}", ylabel="magnitude")
            axes.grid(visible=True)
            height = axes.twinx()
            height.plot(panel.minutes, panel.elevation, color=DATA, lw=0.9, ls=":")
            height.set_ylim(0, 90)
            height.set_ylabel("elevation, deg", color=DATA)
            height.spines["right"].set_visible(True)
        for axes in grid.flat[len(panels) :]:
            axes.set_axis_off()
        drawn_as = {
            label: handle
            for axes in grid.flat
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        grid.flat[0].legend(drawn_as.values(), drawn_as.keys(), fontsize=7)
        figure.tight_layout()
    return figure


def save_passes(panels: Sequence[Panel], path: Path) -> None:
    """The panels as a PNG file."""
    size = passes_size(len(panels))
    figure = drawn(lambda: draw_passes(panels, Figure(figsize=size)), size)
    save(figure, path, format="png", dpi=PNG_DPI, facecolor="white")
