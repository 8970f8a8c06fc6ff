"""Object 1 on one night, on three, and from two stations: what more recordings bring.

One night of one station cannot tell a panel that points 1 deg beside the Sun from one that reflects otherwise:
the light that the panels lack is given to +Z, whose glint passes 14 minutes earlier.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from astropy.table import vstack
from matplotlib.figure import Figure
from publish import Made, publish
from setting import HEIGHT, LATITUDE, LONGITUDE, TABLE_3, free_materials, object_1

import torchlc
from torchlc.figures.style import DATA, MODEL, OBSERVER
from torchlc.inference.optimiser import Fit, fit_map

NIGHTS = ("2020-10-16", "2020-10-17", "2020-10-18")
STATIONS = {"weihai": (LATITUDE, LONGITUDE, HEIGHT), "lijiang": (26.70, 100.03, 3200.0)}
HERE = ("weihai",)
BOTH = tuple(STATIONS)
CASES = {
    "one night": (HERE, NIGHTS[1:2]),
    "three nights": (HERE, NIGHTS),
    "two stations": (BOTH, NIGHTS[1:2]),
    "two stations, three nights": (BOTH, NIGHTS),
}
SAMPLED = ("one night", "two stations, three nights")
NOISE_MAG = 0.02
CADENCE_S = 300.0
STEPS = 1500
OFFSET_DEG = 1.0


def recorded(
    stations: Sequence[str], nights: Sequence[str], *, offset_deg: float = 0.0, noise: bool = True
) -> tuple[torchlc.Scene, torchlc.Recording]:
    """Object 1 with free materials, and recordings of it with its panels turned by ``offset_deg``, 14 to 21 h UT;
    errors of NOISE_MAG are quoted with and without ``noise``.
    """
    places = {name: STATIONS[name] for name in stations}
    turned = object_1(stations=places, effects='["panel_offset"]')
    values = {**turned.model.parameters, "panel_offset.deg": offset_deg}
    turned = turned.model_copy(update={"model": turned.model.model_copy(update={"parameters": values})})
    tables = []
    for seed, night in enumerate(nights):
        curve = torchlc.simulate(
            turned,
            start=f"{night}T14:00:00",
            hours=7.0,
            cadence=CADENCE_S,
            noise=NOISE_MAG if noise else None,
            seed=seed,
        )
        table = curve.to_table()
        table["mag_err"] = NOISE_MAG
        tables.append(table["time", "station", "mag", "mag_err"])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.ecsv"
        vstack(tables, metadata_conflicts="silent").write(path, format="ascii.ecsv")
        return torchlc.load(object_1(free_materials(), stations=places), path)


def absorbed(stations: Sequence[str], nights: Sequence[str]) -> tuple[Fit, float, float]:
    """The fit of straight panels to panels OFFSET_DEG off, without noise: its rms, mag, and the relative error
    of panel.r_spec.
    """
    scene, recording = recorded(stations, nights, offset_deg=OFFSET_DEG, noise=False)
    found = fit_map(torchlc.Likelihood(torchlc.LightCurve(scene, recording)))
    r_spec = float(found.theta[found.model.names.index("panel.r_spec")])
    rms = NOISE_MAG * float(np.sqrt(found.chi2 / len(recording)))
    return found, rms, r_spec / TABLE_3[1]["panel"]["r_spec"] - 1


def interval(stations: Sequence[str], nights: Sequence[str], steps: int = STEPS) -> float:
    """Width of the 90 % interval of panel.r_spec, from a noisy recording of straight panels."""
    row = torchlc.fit(*recorded(stations, nights), steps=steps).parameters()["panel.r_spec"]
    return row["q95"] - row["q05"]


def make() -> Made:
    numbers: dict[str, dict[str, float]] = {}
    figure = Figure(figsize=(7.6, 3.8), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for name, (stations, nights) in CASES.items():
        found, rms, error = absorbed(stations, nights)
        numbers[name] = {"rms_mag": rms, "error_of_panel_r_spec": error}
        if len(nights) == 1:
            axes = panels[len(stations) - 1]
            recording = found.model.recording
            left = found.likelihood.residuals(found.theta).delta.numpy()
            for k, colour in zip(range(len(stations)), (MODEL, OBSERVER), strict=False):
                rows = recording.station == k
                hour = 14 + recording.seconds[rows] / 3600
                axes.plot(hour, left[rows], ".-", ms=3, lw=1.0, color=colour, label=recording.station_ids[k])
            axes.axhline(0.0, color=DATA, lw=0.8)
            axes.set_title(f"{name}: rms {rms:.3f} mag", fontsize=9.5)
            axes.set(xlabel="hours UT, 17 October 2020", xlim=(14, 21))
            axes.legend(fontsize=8.5)
    panels[0].set(ylabel="recorded − fitted, mag", ylim=(0.55, -0.55))
    for name in SAMPLED:
        numbers[name]["interval_of_panel_r_spec"] = interval(*CASES[name])
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
