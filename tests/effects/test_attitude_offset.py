"""The body turned one way is the Sun and the observer turned the other way."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.effects.cases import flux, seen_from, still, unit
from tests.effects.passes import BODY, CELLS, MATERIALS, WINGS
from torchlc.geometry.rotation.matrices import rotation_of

BOX_WING = (BODY + WINGS, MATERIALS + CELLS)


@pytest.mark.parametrize("angles", [(3.0, 0.0, 0.0), (0.0, -12.0, 0.0), (4.0, -7.0, 15.0)])
def test_turning_sun_and_observer_the_other_way(tmp_path, angles):
    scene = still(*BOX_WING)
    to_sun, to_observer = unit(np.random.default_rng(5).normal(size=(2, 40, 3)))
    x, y, z = angles
    turned = flux(
        scene, seen_from(scene, tmp_path, to_sun, to_observer), ["attitude_offset"],
        attitude_offset__x=x, attitude_offset__y=y, attitude_offset__z=z,
    )  # fmt: skip
    back = Rotation.from_rotvec(angles, degrees=True).inv()
    expected = flux(scene, seen_from(scene, tmp_path, back.apply(to_sun), back.apply(to_observer)))
    np.testing.assert_allclose(turned, expected, rtol=1e-9, atol=1e-12 * expected.max())


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 0.00999, 0.01001, 1.0, 3.1])
def test_rotation_of_a_vector(size):
    """Both branches of the coefficients against SciPy, on either side of where they meet."""
    vectors = size * unit(np.random.default_rng(6).normal(size=(20, 3)))
    found = rotation_of(torch.from_numpy(vectors)).numpy()
    np.testing.assert_allclose(found, Rotation.from_rotvec(vectors).as_matrix(), atol=3e-16 + 1e-15 * size)


def test_slope_at_zero_is_the_cross_product():
    slope = torch.func.jacrev(rotation_of)(torch.zeros(3, dtype=torch.float64))
    generators = [Rotation.from_rotvec(1e-7 * axis).as_matrix() for axis in np.eye(3)]
    expected = np.stack([(g - g.T) / 2e-7 for g in generators], -1)
    np.testing.assert_allclose(slope.numpy(), expected, atol=1e-8)
