"""Figure 6: why the cube turning about Y flashes: a face's normal passes the bisector of Sun and observer."""

from __future__ import annotations

import numpy as np
from figure_5 import flashes
from matplotlib.figure import Figure
from measure import glint_angles, night
from publish import Made, publish
from setting import cube

from torchlc.figures.style import MODEL, PALETTE


def make() -> Made:
    scene = cube(attitude=1)
    bare = night(scene)
    angles = glint_angles(scene, bare)
    nearest = np.fmin.reduce(list(angles.values()))
    sharp = flashes(bare.hour, bare.mag)
    at_flash = [float(np.interp(hour, bare.hour, nearest)) for hour, _ in sharp]
    flat = np.abs(bare.hour[:, None] - [hour for hour, _ in sharp]).min(1) > 2 / 60
    figure = Figure(figsize=(7.6, 4.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot(bare.hour, bare.mag, color=MODEL, lw=1.2)
    upper.set(ylabel="magnitude", ylim=(15.0, 3.5), xlim=(15, 18))
    turning = [face for face in angles if not face.endswith("Y")]
    for number, face in enumerate(turning):
        lower.plot(bare.hour, angles[face], color=PALETTE[number], lw=1.3, label=face.removeprefix("cube/"))
    lower.set(ylabel="bisector to normal, deg", xlabel="hours UT, 10 October 2020", ylim=(0, 60))
    figure.legend(*lower.get_legend_handles_labels(), loc="outside upper right", ncols=4, fontsize=8.5)
    numbers = {
        "flashes": len(sharp),
        "least_angle_at_flash_deg": min(at_flash),
        "greatest_angle_at_flash_deg": max(at_flash),
        "least_angle_off_flash_deg": float(np.nanmin(nearest[flat])),
        "phase_at_brightest_deg": float(np.interp(bare.peak[0], bare.hour, bare.known("phase_angle_deg"))),
    }
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
