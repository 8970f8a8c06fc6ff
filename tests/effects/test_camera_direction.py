"""An observer in another direction is the recording with that direction, as astropy moves directions."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from tests.effects.cases import flux, seen_from, still, unit
from tests.effects.passes import BODY, LOW_PASS, MATERIALS, orbiting, rows
from tests.effects.turning import SPIN_POLE, turning
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording

SCENE = turning(SPIN_POLE)


def _recording() -> Recording:
    to_sun, to_observer = unit(np.random.default_rng(8).normal(size=(2, 24, 3)))
    with TemporaryDirectory() as folder:
        return seen_from(SCENE, Path(folder), to_sun, to_observer)


RECORDING = _recording()
"""Of a body whose observer is not on the Earth: the pass over a station that other effects are held against has none."""


@pytest.mark.parametrize(("east", "north"), [(4.0, 0.0), (0.0, -9.0), (-12.0, 20.0)])
def test_the_observer_as_astropy_moves_it(tmp_path, east, north):
    scene = still(BODY, MATERIALS)
    to_sun, to_observer = unit(np.random.default_rng(7).normal(size=(2, 40, 3)))
    found = flux(
        scene, seen_from(scene, tmp_path, to_sun, to_observer), ["camera_direction"],
        camera_direction__east=east, camera_direction__north=north,
    )  # fmt: skip
    lon, lat = (
        np.degrees(np.arctan2(to_observer[:, 1], to_observer[:, 0])),
        np.degrees(np.arcsin(to_observer[:, 2])),
    )
    away = SkyCoord(lon * u.deg, lat * u.deg).directional_offset_by(
        np.degrees(np.arctan2(east, north)) * u.deg, np.hypot(east, north) * u.deg
    )
    expected = flux(scene, seen_from(scene, tmp_path, to_sun, away.cartesian.xyz.value.T))
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-11 * expected.max())


def test_an_observer_on_the_earth_or_an_ephemeris_is_not_in_doubt(tmp_path):
    scene = orbiting()
    context = LightCurve(scene, rows(scene, LOW_PASS), effects=[]).assembly.context
    assert registry()["camera_direction"]().missing(context) == "the observer's place on the Earth is known"
    far = seen_from(SCENE, tmp_path, [[1.0, 0, 0]] * 2, [[0, 1.0, 0]] * 2, range_km=2e8)
    context = LightCurve(SCENE, far, effects=[]).assembly.context
    assert registry()["camera_direction"]().missing(context) == "an ephemeris gives the direction"
