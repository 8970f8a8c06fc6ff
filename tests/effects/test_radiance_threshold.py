"""A ball before the camera, with the lamp behind it: closed forms of what is recorded."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import flux, seen_from, still
from tests.effects.laboratory import BALL, BLOCK, WHITE, anywhere, turned

SCENE = BLOCK
RECORDING = turned(SCENE)


@pytest.mark.parametrize("level", [0.05, 0.3, 0.8])
def test_a_full_ball(tmp_path, level):
    """The integral of (cos - t) cos over cos > t is 2 pi [(1 - t^3)/3 - t (1 - t^2)/2]; of cos^2 it is 2 pi / 3."""
    ball = still(BALL, WHITE)
    recording = seen_from(ball, tmp_path, [[0.0, 0, 1.0]] * 2, [[0.0, 0, 1.0]] * 2)
    found = flux(ball, recording, ["radiance_threshold"], radiance_threshold__level=level)
    expected = 3 * ((1 - level**3) / 3 - level * (1 - level**2) / 2)
    # facets of 3 deg: 1e-3 of the whole light
    np.testing.assert_allclose(found / flux(ball, recording), expected, rtol=2e-3, atol=1e-3)


def test_each_face_of_a_block(tmp_path):
    recording, to_lamp, to_camera = anywhere(BLOCK, tmp_path)
    found = flux(BLOCK, recording, ["radiance_threshold"], radiance_threshold__level=0.4)
    area = np.tile([6.0, 3.0, 2.0], 2)
    lit = np.clip(np.concatenate([to_lamp, -to_lamp], 1) - 0.4, 0, None)
    seen = np.clip(np.concatenate([to_camera, -to_camera], 1), 0, None)
    np.testing.assert_allclose(found, 0.8 / np.pi * (lit * seen * area).sum(1) / 1e12, rtol=1e-10, atol=1e-24)
