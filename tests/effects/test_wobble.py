"""A swing about one axis is an attitude offset that goes up and down."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.effects.cases import flux, seen_from, still, tilted, unit
from tests.effects.test_attitude_offset import BOX_WING


@pytest.mark.parametrize(("lon", "lat"), [(0.0, 0.0), (90.0, 0.0), (20.0, -35.0), (0.0, 90.0)])
def test_each_row_turned_by_scipy(tmp_path, lon, lat):
    scene = still(*BOX_WING)
    seconds = np.arange(90)  # one row a second
    to_sun, to_observer = unit(np.random.default_rng(7).normal(size=(2, len(seconds), 3)))
    angle = 4.0 * np.sin(2 * np.pi * seconds / 72.0 + np.radians(50.0))
    back = Rotation.from_rotvec(angle[:, None] * tilted(90.0 - lat, lon), degrees=True).inv()
    expected = flux(scene, seen_from(scene, tmp_path, back.apply(to_sun), back.apply(to_observer)))
    found = flux(
        scene, seen_from(scene, tmp_path, to_sun, to_observer), ["wobble"], wobble__deg=4.0,
        wobble__period_min=1.2, wobble__phase_deg=50.0, wobble__axis_lon=lon, wobble__axis_lat=lat,
    )  # fmt: skip
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-12 * expected.max())
