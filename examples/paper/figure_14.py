"""Figure 14: the light curve of Object 2 on 25 February 2019, its parts, and how little it knows of the lobes."""

from __future__ import annotations

import numpy as np
from figure_13 import draw_parts
from matplotlib.figure import Figure
from measure import closest, glint_angles, night
from publish import Made, publish
from setting import TABLE_3, object_2

DAY, FIRST, LAST = "2019-02-25", 14.0, 19.0
SMALL_N = 150.0


def make() -> Made:
    scene = object_2()
    bare = night(scene, DAY, FIRST, LAST)
    phase, angles = bare.known("phase_angle_deg"), glint_angles(scene, bare)
    body = bare.curve.shares["body"]
    broad = {**TABLE_3[2], "body": {**TABLE_3[2]["body"], "n": SMALL_N}}
    change = bare.curve.flux / night(object_2(broad), DAY, FIRST, LAST).curve.flux - 1
    k = int(np.argmin(phase))
    numbers = {
        "least_phase_deg": float(phase[k]),
        "least_phase_hour": float(bare.hour[k]),
        "nearest_face": closest(angles, bare.hour),
        "panel_glint": closest({name: one for name, one in angles.items() if "panel" in name}, bare.hour),
        "peak_hour": bare.peak[0],
        "peak_mag": bare.peak[1],
        "least_body_share": float(body.min()),
        "greatest_body_share": float(body.max()),
        "airmass": (bare.known("airmass").min(), bare.known("airmass").max()),
        "greatest_change_n_150": float(np.abs(change).max()),
    }
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    draw_parts(figure, bare, 2)
    figure.axes[0].set(xlabel="hours UT, 25 February 2019")
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
