"""Scenes under real orbits, and rows that look at them; the still ones are in ``cases``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from tests.paper_orbits import ORBIT_1
from torchlc.geometry.orbit.grid import observation_grid
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.scene import Scene

WEIHAI = """
    [[stations]]
    id = "weihai"
    latitude = 37.536
    longitude = 122.05
    height = 110.0
"""
BODY = """
    [[components]]
    name = "body"
    shape = "box"
    size = [2.0, 1.7, 2.2]
    centre = [0, 0, 0]
    material = "foil"
"""
WINGS = """
    [[components]]
    name = "wing +Y"
    shape = "plate"
    size = [1.7, 4.0]
    centre = [0, 3.0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    tracks = { target = "sun", axis = [0, 1, 0] }
    material = "cells"
    [[components]]
    name = "wing -Y"
    shape = "plate"
    size = [1.7, 4.0]
    centre = [0, -3.0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    tracks = { target = "sun", axis = [0, 1, 0] }
    material = "cells"
"""
MATERIALS = """
    [materials.foil]
    n = 40.0
    r_spec = 0.25
    r_diff = 0.35
"""
CELLS = """
    [materials.cells]
    n = 90.0
    r_spec = 0.1
    r_diff = 0.15
"""
TUMBLING = 'mode = "inertial"\nspin_axis = [0.3, 0.8, 0.5]\nspin_rate = 6.0\nx_angle = 20.0'
HIGH, LOW_PASS = "2020-10-17T14:00:00", "2006-06-27T13:22:00"
"""Starts of a night of the paper's first object, and of a low one's pass that ends in the Earth's shadow."""


def orbiting(
    attitude: str = 'mode = "nadir"',
    components: str = BODY + WINGS,
    materials: str = MATERIALS + CELLS,
    *,
    tle: tuple[str, str] = ORBIT_1,
    parameters: str = "",
) -> Scene:
    """A scene in orbit under weihai with nothing free and no effects."""
    first, second = tle
    return Scene.from_toml(
        f'format = "torchlc-scene/1"\nname = "pass"\n[orbit]\ntle = ["{first}", "{second}"]\n{WEIHAI}'
        f"[attitude]\n{attitude}\n{components}{materials}\n[model]\neffects = []\n"
        f"[model.parameters]\nband_sun_magnitude = -26.7\n{parameters}",
        Path(), "pass",
    )  # fmt: skip


def rows(
    scene: Scene, start: str = HIGH, hours: float = 6.0, cadence_s: float = 600.0, **fields: object
) -> Recording:
    """A regular recording of 10 mag, errors 0.05 mag; ``fields`` replace its own, ``exptime`` a number."""
    grid = observation_grid(scene, start, hours, cadence_s)
    full = {"observed": np.full(len(grid), 10.0), "error": np.full(len(grid), 0.05), **fields}
    if "exptime" in full and full["exptime"] is not None:
        full["exptime"] = np.full(len(grid), full["exptime"])
    return replace(grid, **full)


def model_with(
    scene: Scene, recording: Recording, *effects: str, **values: float
) -> tuple[LightCurve, torch.Tensor]:
    """A model with some effects, and its theta with values given as ``name__quantity`` (of every target)."""
    model = LightCurve(scene, recording, effects=list(effects))
    theta = model.theta().detach().clone()
    for key, value in values.items():
        found = [i for i, name in enumerate(model.names) if name.partition("[")[0] == key.replace("__", ".")]
        assert found, f"{key} is not among {model.names}"
        theta[found] = value
    return model, theta


def magnitudes(scene: Scene, recording: Recording, *effects: str, **values: float) -> np.ndarray:
    """Magnitudes (T,) with some effects at the values given."""
    model, theta = model_with(scene, recording, *effects, **values)
    return model(theta).detach().numpy()
