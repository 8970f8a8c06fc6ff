"""Figure 2: the cube in four orbits; where the Earth's shadow lies, and what is below the horizon."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from measure import night, span
from publish import Made, publish
from setting import cube

from torchlc.figures.style import PALETTE

SHADOWED = '["earth_shadow"]'
FAINTEST = 21.0


def make() -> Made:
    numbers = {}
    figure = Figure(figsize=(7.6, 4.4), layout="constrained")
    axes = figure.subplots()
    for orbit in range(1, 5):
        bare, shadowed = (night(cube(orbit, effects=effects)) for effects in ("[]", SHADOWED))
        eclipse, up = bare.known("eclipse_fraction"), bare.known("elevation_deg") > 0
        hour, mag = bare.peak
        radius = bare.known("range_km")
        numbers[f"orbit_{orbit}"] = {
            "peak_hour": hour,
            "peak_mag": mag,
            "mag_at_14h": bare.at(14.0),
            "faintest_mag": float(bare.mag.max()),
            "eclipse_fraction_at_peak": float(np.interp(hour, bare.hour, eclipse)),
            "shadowed_mag_at_peak": shadowed.at(hour),
            "penumbra_hours": span(bare.hour, eclipse > 0),
            "umbra_hours": span(bare.hour, eclipse >= 1),
            "elevation_deg": (bare.known("elevation_deg").min(), bare.known("elevation_deg").max()),
            "range_km": (radius.min(), radius.max()),
            "rows_above_horizon": float(up.mean()),
        }
        colour = PALETTE[orbit - 1]
        axes.plot(bare.hour, np.where(up, np.nan, bare.mag), ":", color=colour, lw=1.2)
        axes.plot(bare.hour, np.where(up, bare.mag, np.nan), color=colour, lw=1.5, label=f"orbit {orbit}")
        if (eclipse > 0).any():
            axes.plot(bare.hour, np.where(eclipse > 0, shadowed.mag, np.nan), "--", color=colour, lw=1.1)
            axes.axvspan(*span(bare.hour, eclipse >= 1), color=colour, alpha=0.16, lw=0)
    axes.plot([], [], ":", color="0.4", label="below the horizon")
    axes.plot([], [], "--", color="0.4", label="with the Earth's shadow")
    axes.set(ylim=(FAINTEST, 2.0), xlim=(12, 20), xlabel="hours UT, 10 October 2020", ylabel="magnitude")
    axes.legend(fontsize=8.5, loc="upper left")
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
