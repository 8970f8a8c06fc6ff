"""A white body before a lamp, seen by cameras a kilometre away: no orbit, nothing on the Earth."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests.effects.cases import seen_from, still, tilted, unit
from torchlc.readers import Recording
from torchlc.scene import Scene

WHITE = '[materials.white]\nmodel = "lambert"\nalbedo = 0.8\n'
BOX = """
    [[components]]
    name = "block"
    shape = "box"
    size = [1.0, 2.0, 3.0]
    centre = [0.2, -0.1, 0.3]
    material = "white"
"""
BALL = """
    [[components]]
    name = "ball"
    shape = "sphere"
    radius = 1.0
    centre = [0, 0, 0]
    material = "white"
"""


def turned(scene: Scene, rows: int = 24) -> Recording:
    """One turn before a lamp and a camera that stand 50 deg apart, the camera higher."""
    azimuth = np.linspace(0, 360, rows, endpoint=False) + 7.0
    with TemporaryDirectory() as folder:
        return seen_from(scene, Path(folder), tilted(85.0, azimuth), tilted(60.0, azimuth + 50.0))


def anywhere(scene: Scene, folder: Path, rows: int = 30, seed: int = 1):
    """A recording of lamp and camera in any direction, and the directions."""
    to_lamp, to_camera = unit(np.random.default_rng(seed).normal(size=(2, rows, 3)))
    return seen_from(scene, folder, to_lamp, to_camera), to_lamp, to_camera


BLOCK = still(BOX, WHITE)
