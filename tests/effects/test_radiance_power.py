"""A ball before the camera, with the lamp behind it: closed forms of what is recorded."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import flux, seen_from, still
from tests.effects.laboratory import BALL, BLOCK, WHITE, anywhere, turned

SCENE = BLOCK
RECORDING = turned(SCENE)


@pytest.mark.parametrize("power", [0.4, 1.0, 2.2])
def test_a_full_ball(tmp_path, power):
    """The integral of cos^power cos over the half sphere is 2 pi / (power + 2): 3 / (power + 2) of the linear one."""
    ball = still(BALL, WHITE)
    recording = seen_from(ball, tmp_path, [[0.0, 0, 1.0]] * 2, [[0.0, 0, 1.0]] * 2)
    found = flux(ball, recording, ["radiance_power"], radiance_power__power=power)
    # a facet of the ball is 3 deg wide: 1e-3, more for a power whose slope is steep at the limb
    np.testing.assert_allclose(found / flux(ball, recording), 3 / (power + 2), rtol=4e-3)


def test_each_face_of_a_block(tmp_path):
    recording, to_lamp, to_camera = anywhere(BLOCK, tmp_path)
    found = flux(BLOCK, recording, ["radiance_power"], radiance_power__power=0.5)
    area = np.array([6.0, 3.0, 2.0])
    lit = np.clip(np.concatenate([to_lamp, -to_lamp], 1), 0, None) ** 0.5
    seen = np.clip(np.concatenate([to_camera, -to_camera], 1), 0, None)
    expected = 0.8 / np.pi * (lit * seen * np.tile(area, 2)).sum(1) / 1e12
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-24)
