"""Figure 7: the cube of orbit 1 with other lobes and reflectances."""

from __future__ import annotations

from matplotlib.figure import Figure
from measure import night
from publish import Made, publish
from setting import cube

EXPONENTS = (100.0, 1000.0, 12_000.0)
"""The paper's own are in its figure only."""
REFLECTANCES = ((0.2, 0.8, "-", "#c0392b"), (0.5, 0.5, "-.", "#3f9b5c"), (0.8, 0.2, ":", "#2a5fb8"))
"""R_spec, R_diff, and the lines of the paper."""


def make() -> Made:
    numbers = {}
    figure = Figure(figsize=(7.6, 3.6), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    for axes, n in zip(panels, EXPONENTS, strict=True):
        row = {}
        for r_spec, r_diff, line, colour in REFLECTANCES:
            bare = night(cube(n=n, r_spec=r_spec, r_diff=r_diff))
            begin, end = bare.half_flux
            label = f"$R_{{spec}}$ = {r_spec}, $R_{{diff}}$ = {r_diff}"
            axes.plot(bare.hour, bare.mag, line, color=colour, lw=1.4, label=label)
            row[f"r_spec_{r_spec}"] = {
                "peak_mag": bare.peak[1],
                "rise_mag": float(bare.mag.max() - bare.peak[1]),
                "half_flux_min": 60 * (end - begin),
            }
        numbers[f"n_{n:.0f}"] = row
        axes.set_title(f"n = {n:,.0f}", fontsize=9.5)
    panels[0].set(xlim=(12, 20), ylim=(15.0, 3.5), ylabel="magnitude")
    panels[1].set(xlabel="hours UT, 10 October 2020")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8.5)
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
