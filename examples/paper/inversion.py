"""Objects 1 and 2 inverted: recordings simulated on the paper's nights with its Table 3, and fitted with all six
material numbers free.
"""

from __future__ import annotations

import math
import tempfile
from functools import cache
from pathlib import Path

import corner
import numpy as np
from matplotlib.figure import Figure
from setting import NIGHT, TABLE_3, free_materials, object_1, object_2

import torchlc

NOISE_MAG = 0.02
CADENCE_S = 120.0
SEED = 1


@cache
def inverted(number: int) -> torchlc.FitResult:
    """The fit of Object 1 or 2 with its posterior."""
    made = {1: object_1, 2: object_2}[number]
    start, hours = NIGHT[number]
    noisy = torchlc.simulate(made(), start=start, hours=hours, cadence=CADENCE_S, noise=NOISE_MAG, seed=SEED)
    with tempfile.TemporaryDirectory() as folder:
        scene, recording = torchlc.load(made(free_materials()), noisy.write(Path(folder) / "recording.ecsv"))
    return torchlc.fit(scene, recording)


def truth(number: int) -> dict[str, float]:
    """What went into the recording, by parameter."""
    return {f"{part}.{key}": value for part, row in TABLE_3[number].items() for key, value in row.items()}


def posterior(number: int) -> dict[str, object]:
    """Truth, median, 90 % interval of every parameter, and whether the recording informs it."""
    rows = inverted(number).parameters()
    return {
        name: {"truth": value} | {key: rows[name][key] for key in ("median", "q05", "q95", "informed")}
        for name, value in truth(number).items()
    }


def corner_figure(number: int) -> Figure:
    """Posterior of every pair of parameters, the truth marked."""
    result = inverted(number)
    figure = result.plot_corner()
    values = truth(number)
    drawn = [
        math.log10(values[name]) if axes.get_xlabel().startswith("log10") else values[name]
        for name, axes in zip(result.names, np.reshape(figure.axes, (len(result.names), -1))[-1], strict=True)
    ]
    corner.overplot_lines(figure, drawn, color="#c2410c", lw=0.9)
    return figure
