"""Magnitudes of a simulated curve along time."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from torchlc.figures.style import component_colour, plain, style
from torchlc.readers import Recording, iso_times

SIZE = (9.0, 3.6)
"""Inches."""


def draw_magnitudes(recording: Recording, mag: np.ndarray, axes: Axes) -> Axes:
    """Magnitudes (T,) at the rows of ``recording``, a line a station; rows without light are gaps."""
    with matplotlib.rc_context(style()):
        hours = recording.seconds / 3600
        for k, station in enumerate(np.unique(recording.station)):
            rows = recording.station == station
            axes.plot(
                hours[rows],
                np.where(np.isfinite(mag), mag, np.nan)[rows],
                ".-",
                ms=2,
                lw=0.8,
                color=component_colour(k),
                label=plain(recording.station_ids[station]),
            )
        axes.invert_yaxis()
        axes.set(
            xlabel=f"hours after {iso_times(recording)[0][:16]} {recording.time.scale.upper()}",
            ylabel="magnitude",
        )
        axes.grid(visible=True)
        axes.legend(fontsize=8)
    return axes
