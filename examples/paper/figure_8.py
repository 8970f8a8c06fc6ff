"""Figure 8: stations 15 deg of longitude apart see the peak about 8 minutes apart."""

from __future__ import annotations

import itertools

from matplotlib.figure import Figure
from measure import night
from publish import Made, publish
from setting import LONGITUDE, cube

from torchlc.figures.style import PALETTE

LATITUDE = 37.0
LONGITUDES = (LONGITUDE - 15.0, LONGITUDE, LONGITUDE + 15.0)


def make() -> Made:
    numbers: dict[str, object] = {}
    peaks = []
    figure = Figure(figsize=(7.0, 3.8), layout="constrained")
    axes = figure.subplots()
    for colour, longitude in zip(PALETTE, LONGITUDES, strict=False):
        bare = night(cube(r_spec=0.2, r_diff=0.8, latitude=LATITUDE, longitude=longitude))
        hour, mag = bare.peak
        peaks.append(hour)
        numbers[f"longitude_{longitude:g}"] = {"peak_hour": hour, "peak_mag": mag}
        axes.plot(bare.hour, bare.mag, color=colour, lw=1.5, label=f"{longitude:g}° E")
    numbers["shift_min"] = [60 * (early - late) for early, late in itertools.pairwise(peaks)]
    axes.set(xlim=(15, 18), ylim=(10.5, 5.0), xlabel="hours UT, 10 October 2020", ylabel="magnitude")
    axes.legend(title=f"latitude {LATITUDE:g}° N")
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
