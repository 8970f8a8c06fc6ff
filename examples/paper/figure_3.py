"""Figure 3: phase angle, and how near the bisector of Sun and observer comes to a face of the cube."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from measure import closest, glint_angles, night
from publish import Made, publish
from setting import cube

from torchlc.figures.style import PALETTE


def make() -> Made:
    numbers = {}
    figure = Figure(figsize=(7.6, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    for orbit in range(1, 5):
        scene = cube(orbit)
        bare = night(scene)
        phase, angles = bare.known("phase_angle_deg"), glint_angles(scene, bare)
        up = np.where(bare.known("elevation_deg") > 0, 1.0, np.nan)
        k = int(np.argmin(phase))
        nadir = {"cube/+Z": angles["cube/+Z"]}
        numbers[f"orbit_{orbit}"] = {
            "least_phase_deg": float(phase[k]),
            "least_phase_hour": float(bare.hour[k]),
            "nearest_face": closest(angles, bare.hour),
            "nadir_face": closest(nadir, bare.hour),
        }
        nearest = np.fmin.reduce(list(angles.values()))
        for axes, values in ((left, phase), (right, nearest)):
            axes.plot(bare.hour, values * up, color=PALETTE[orbit - 1], lw=1.5, label=f"orbit {orbit}")
            axes.plot(
                bare.hour, np.where(np.isnan(up), values, np.nan), ":", color=PALETTE[orbit - 1], lw=1.2
            )
    left.set(ylabel="phase angle, deg", xlabel="hours UT, 10 October 2020", xlim=(12, 20), ylim=(0, None))
    right.set(ylabel="bisector to the nearest lit and seen face, deg", xlabel="hours UT", ylim=(0, None))
    right.plot([], [], ":", color="0.4", label="below the horizon")
    right.legend(fontsize=8.5)
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
