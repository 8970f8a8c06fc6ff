"""A cylinder that turns once in 20 s, seen for two minutes, and where it points."""

from __future__ import annotations

import numpy as np
import torch

from tests.effects.passes import model_with
from torchlc.readers import Recording
from torchlc.scene import Scene

POLE = (40.0, 25.0)
PERIOD_S = 20.0
STAGE = """
    [[components]]
    name = "stage"
    shape = "cylinder"
    radius = 1.5
    length = 9.0
    axis = [1, 0, 0]
    centre = [0, 0, 0]
    material = "skin"
    [materials.skin]
    n = 20.0
    r_spec = 0.3
    r_diff = 0.4
"""
SPIN_POLE = (
    f'mode = "spin-pole"\npole = [{POLE[0]}, {POLE[1]}]\nphase = 10.0\nperiod = {PERIOD_S / 3600!r}\n'
    'epoch = "2021-03-20T12:00:00"\n'
)
INERTIAL = (
    f'mode = "inertial"\nx_angle = 20.0\nspin_axis = [0.3, 0.8, 0.5]\nspin_phase = 5.0\nspin_rate = {3600 / PERIOD_S}\n'
    'spin_epoch = "2021-03-20T12:00:00"\n'
)


def turning(attitude: str, components: str = STAGE) -> Scene:
    return Scene.from_toml(
        'format = "torchlc-scene/1"\nname = "turning"\n[orbit]\nvectors = "icrs"\n[attitude]\n'
        + attitude + components + "\n[model]\neffects = []\n[model.parameters]\nband_sun_magnitude = -26.7\n"
    )  # fmt: skip


def rotations(scene: Scene, recording: Recording, *effects: str, **values: float) -> np.ndarray:
    """Body to GCRS, (T, 3, 3)."""
    model, theta = model_with(scene, recording, *effects, **values)
    with torch.no_grad():
        found = model.view(model.values(theta)).rotation[0]
    return found.expand(len(recording), 3, 3).numpy()
