"""Figure 9: stations at other latitudes see the peak at one time, but higher or lower."""

from __future__ import annotations

from matplotlib.figure import Figure
from measure import night
from publish import Made, publish
from setting import cube

from torchlc.figures.style import PALETTE

LATITUDES = (27.0, 32.0, 37.0, 42.0, 47.0)


def make() -> Made:
    numbers: dict[str, object] = {}
    hours = []
    figure = Figure(figsize=(7.0, 3.8), layout="constrained")
    axes = figure.subplots()
    for colour, latitude in zip(PALETTE, LATITUDES, strict=False):
        bare = night(cube(r_spec=0.2, r_diff=0.8, latitude=latitude))
        hour, mag = bare.peak
        hours.append(hour)
        numbers[f"latitude_{latitude:g}"] = {"peak_hour": hour, "peak_mag": mag}
        axes.plot(bare.hour, bare.mag, color=colour, lw=1.5, label=f"{latitude:g}° N")
    numbers["spread_of_peak_hours_min"] = 60 * (max(hours) - min(hours))
    axes.set(xlim=(15, 18), ylim=(10.5, 3.5), xlabel="hours UT, 10 October 2020", ylabel="magnitude")
    axes.legend(title="longitude 122.05° E")
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
