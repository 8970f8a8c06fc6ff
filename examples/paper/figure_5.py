"""Figure 5: the cube of orbit 1 in four attitudes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from measure import Array, night
from publish import Made, publish
from setting import cube

from torchlc.figures.style import PALETTE

TITLES = (
    "1: nadir, 1 rev/h about Y",
    "2: inertial",
    "3: to the Sun, 1 rev/h about it",
    "4: nadir",
)
FLASH_MAG = 1.0
"""A peak this much brighter than the minutes about it is a flash."""


def flashes(hour: Array, mag: Array) -> list[tuple[float, float]]:
    """Hour and magnitude of every local maximum that stands out by FLASH_MAG from within 7.5 min."""
    near = round(0.125 / (hour[1] - hour[0]))
    found = []
    for k in range(1, len(mag) - 1):
        around = mag[max(0, k - near) : k + near + 1]
        if mag[k] == around.min() and np.nanmax(around) - mag[k] > FLASH_MAG:
            found.append((float(hour[k]), float(mag[k])))
    return found


def make() -> Made:
    numbers = {}
    figure = Figure(figsize=(7.6, 5.2), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for attitude, (axes, title) in enumerate(zip(panels.flat, TITLES, strict=True), 1):
        bare = night(cube(attitude=attitude))
        sharp = flashes(bare.hour, bare.mag)
        gaps = 60 * np.diff([hour for hour, _ in sharp])
        numbers[f"attitude_{attitude}"] = {
            "peak_hour": bare.peak[0],
            "peak_mag": bare.peak[1],
            "faintest_mag": float(bare.mag.max()),
            "flashes": len(sharp),
            "least_gap_min": float(gaps.min()) if len(gaps) else None,
            "greatest_gap_min": float(gaps.max()) if len(gaps) else None,
        }
        axes.plot(bare.hour, bare.mag, color=PALETTE[attitude - 1], lw=1.2)
        axes.set_title(title, fontsize=9.5)
    panels[0, 0].set(xlim=(12, 20), ylim=(15.0, 1.0))
    figure.supxlabel("hours UT, 10 October 2020", fontsize=9.5)
    figure.supylabel("magnitude", fontsize=9.5)
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
