"""A tilt changes which direction of the body the axis of spin goes through, and nothing of the spin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.effects.cases import seen_from, unit
from tests.effects.turning import INERTIAL, SPIN_POLE, rotations, turning


@pytest.mark.parametrize(("attitude", "axis"), [(SPIN_POLE, [0, 0, 1.0]), (INERTIAL, [0.3, 0.8, 0.5])])
@pytest.mark.parametrize("towards", [0.0, 130.0])
def test_the_spin_stays_and_goes_through_another_direction(tmp_path, attitude, axis, towards):
    scene = turning(attitude)
    recording = seen_from(scene, tmp_path, *np.repeat([[[1.0, 0, 0]], [[0, 1.0, 0]]], 8, 1))
    steady = rotations(scene, recording)
    tilted = rotations(scene, recording, "axis_tilt", axis_tilt__deg=12.0, axis_tilt__towards_deg=towards)
    before, after = (Rotation.from_matrix(one[1:] @ np.swapaxes(one[:-1], 1, 2)) for one in (steady, tilted))
    np.testing.assert_allclose(after.as_rotvec(), before.as_rotvec(), atol=1e-12)  # from row to row, in space
    fixed = np.einsum("tji,j->ti", tilted, unit(before[0].as_rotvec()))
    np.testing.assert_allclose(fixed @ unit(axis), np.cos(np.radians(12.0)), atol=1e-12)
    constant = Rotation.from_matrix(np.swapaxes(steady, 1, 2) @ tilted).as_rotvec(degrees=True)
    np.testing.assert_allclose(constant, constant[:1].repeat(8, 0), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(constant[0]), 12.0, atol=1e-9)


def test_about_plus_z_the_direction_counts_from_x_to_y(tmp_path):
    scene = turning(SPIN_POLE)
    recording = seen_from(scene, tmp_path, [[1.0, 0, 0]] * 2, [[0, 1.0, 0]] * 2)
    tilted = rotations(scene, recording, "axis_tilt", axis_tilt__deg=10.0, axis_tilt__towards_deg=30.0)
    turn = Rotation.from_matrix(rotations(scene, recording)[0].T @ tilted[0]).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn, 10 * np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0]), atol=1e-9)
