"""Figure 13: the light curve of Object 1 on 17 October 2020, its parts, and what occlusion does to the peak."""

from __future__ import annotations

import numpy as np
from inversion import inverted
from matplotlib.figure import Figure
from measure import Night, closest, glint_angles, night, span
from publish import Made, publish
from setting import object_1

from torchlc.figures.style import DATA, INK, PALETTE

DAY, FIRST, LAST = "2020-10-17", 14.0, 21.0
SHADOWED = '["self_shadowing"]'
SHOWN_MAG = 2.5
"""Parts are drawn to this much below the faintest of the whole."""


def draw_parts(figure: Figure, bare: Night, number: int) -> None:
    """The recording that was inverted, the fitted model, and the light of body and panels, to magnitudes."""
    axes = figure.subplots()
    result = inverted(number)
    hour = bare.hour[0] + result.recording.seconds / 3600
    axes.plot(hour, result.recording.observed, ".", ms=3, color=DATA, label="simulated recording")
    axes.plot(hour, result.prediction, color=INK, lw=1.3, label="model fitted to it")
    body = bare.curve.shares["body"]
    for share, name, colour in ((body, "body", PALETTE[0]), (1 - body, "panels", PALETTE[1])):
        with np.errstate(divide="ignore"):
            axes.plot(bare.hour, bare.mag - 2.5 * np.log10(share), "--", color=colour, lw=1.4, label=name)
    faint, bright = bare.mag.max() + SHOWN_MAG, bare.mag.min() - 0.4
    axes.set(xlim=(bare.hour[0], bare.hour[-1]), ylim=(faint, bright), ylabel="magnitude")
    axes.legend(fontsize=8.5)


def occlusion(gap: float | None, bare: Night) -> dict[str, float]:
    """What shadowing takes within the half-flux interval: most, and by how much it varies, mag."""
    scene = object_1(effects=SHADOWED) if gap is None else object_1(effects=SHADOWED, gap=gap)
    loss = night(scene, DAY, FIRST, LAST).mag - bare.mag
    begin, end = bare.half_flux
    within = loss[(bare.hour >= begin) & (bare.hour <= end)]
    return {"most_mag": float(within.max()), "variation_mag": float(np.ptp(within))}


def make() -> Made:
    scene = object_1()
    bare = night(scene, DAY, FIRST, LAST)
    phase, angles = bare.known("phase_angle_deg"), glint_angles(scene, bare)
    body = bare.curve.shares["body"]
    k = int(np.argmin(phase))
    numbers = {
        "least_phase_deg": float(phase[k]),
        "least_phase_hour": float(bare.hour[k]),
        "panel_glint": closest({name: one for name, one in angles.items() if "panel" in name}, bare.hour),
        "nadir_glint": closest({"body/+Z": angles["body/+Z"]}, bare.hour),
        "peak_hour": bare.peak[0],
        "peak_mag": bare.peak[1],
        "half_flux_hours": bare.half_flux,
        "airmass": (bare.known("airmass").min(), bare.known("airmass").max()),
        "range_km": (bare.known("range_km").min(), bare.known("range_km").max()),
        "eclipsed_hours": span(bare.hour, bare.known("eclipse_fraction") > 0),
        "body_share_at_peak": float(np.interp(bare.peak[0], bare.hour, body)),
        "greatest_body_share": float(body.max()),
        "occlusion_with_gap": occlusion(None, bare),
        "occlusion_wings_touching": occlusion(0.0, bare),
    }
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    draw_parts(figure, bare, 1)
    figure.axes[0].set(xlabel="hours UT, 17 October 2020")
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
