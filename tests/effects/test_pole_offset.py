"""The pole is moved by an arc on the sky, as astropy measures arcs; the body turns about it as before."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from scipy.spatial.transform import Rotation

from tests.effects.cases import seen_from, unit
from tests.effects.turning import INERTIAL, SPIN_POLE, rotations, turning
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve

NORTHERN = SPIN_POLE.replace("25.0", "90.0")


def sky(direction: np.ndarray) -> SkyCoord:
    x, y, z = direction
    return SkyCoord(np.arctan2(y, x) * u.rad, np.arcsin(z) * u.rad)


@pytest.mark.parametrize("attitude", [SPIN_POLE, INERTIAL])
@pytest.mark.parametrize(("east", "north"), [(5.0, 0.0), (0.0, -4.0), (-20.0, 33.0)])
def test_the_pole_as_astropy_moves_it(tmp_path, attitude, east, north):
    scene = turning(attitude)
    recording = seen_from(scene, tmp_path, *np.repeat([[[1.0, 0, 0]], [[0, 1.0, 0]]], 8, 1))
    steady = rotations(scene, recording)
    moved = rotations(scene, recording, "pole_offset", pole_offset__east=east, pole_offset__north=north)
    before, after = (
        Rotation.from_matrix(one[1:] @ np.swapaxes(one[:-1], 1, 2)).as_rotvec() for one in (steady, moved)
    )
    np.testing.assert_allclose(np.linalg.norm(after, axis=-1), np.linalg.norm(before, axis=-1), atol=1e-12)
    expected = sky(unit(before[0])).directional_offset_by(
        np.degrees(np.arctan2(east, north)) * u.deg, np.hypot(east, north) * u.deg
    )
    np.testing.assert_allclose(unit(after[0]), expected.cartesian.xyz.value, atol=1e-10)


def test_a_pole_at_the_frame_s_own_moves_as_far(tmp_path):
    scene = turning(NORTHERN)
    recording = seen_from(scene, tmp_path, *np.repeat([[[1.0, 0, 0]], [[0, 1.0, 0]]], 3, 1))
    moved = rotations(scene, recording, "pole_offset", pole_offset__east=3.0, pole_offset__north=-4.0)
    np.testing.assert_allclose(moved[:, 2, 2], np.cos(np.radians(5.0)), atol=1e-12)


def test_an_axis_that_follows_the_earth_has_no_direction_in_space(tmp_path):
    scene = turning('mode = "sun"\nspin_axis = [0, 0, 1]\nspin_rate = 3.0\n')
    recording = seen_from(scene, tmp_path, [[1.0, 0, 0]] * 2, [[0, 1.0, 0]] * 2)
    context = LightCurve(scene, recording, effects=[]).assembly.context
    assert registry()["pole_offset"]().missing(context) == "no axis of spin keeps its direction in space"
