"""A ball before the camera, with the lamp behind it: closed forms of what is recorded."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import flux, seen_from, still
from tests.effects.laboratory import BALL, BLOCK, WHITE, anywhere, turned

SCENE = BLOCK
RECORDING = turned(SCENE)


@pytest.mark.parametrize("level", [-0.1, 0.2, 1.0])
def test_a_full_ball(tmp_path, level):
    """The lit disc counts by its area: the integral of cos over the half sphere is pi, of cos^2 2 pi / 3."""
    ball = still(BALL, WHITE)
    recording = seen_from(ball, tmp_path, [[0.0, 0, 1.0]] * 2, [[0.0, 0, 1.0]] * 2)
    found = flux(ball, recording, ["radiance_pedestal"], radiance_pedestal__level=level)
    # facets of 3 deg: 1e-3 of disc and light
    np.testing.assert_allclose(found / flux(ball, recording), 1 + 1.5 * level, rtol=3e-3)


def test_each_face_of_a_block_that_is_lit(tmp_path):
    recording, to_lamp, to_camera = anywhere(BLOCK, tmp_path)
    found = flux(BLOCK, recording, ["radiance_pedestal"], radiance_pedestal__level=0.3)
    area = np.tile([6.0, 3.0, 2.0], 2)
    cosine = np.concatenate([to_lamp, -to_lamp], 1)
    lit = np.where(cosine > 0, cosine + 0.3, 0)
    seen = np.clip(np.concatenate([to_camera, -to_camera], 1), 0, None)
    np.testing.assert_allclose(found, 0.8 / np.pi * (lit * seen * area).sum(1) / 1e12, rtol=1e-10, atol=1e-24)
