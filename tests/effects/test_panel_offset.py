"""A wing that stands beside the Sun: cosines in closed form, and the sense of the turn."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import AU_KM, RANGE_KM, flux, seen_from, still, tilted
from tests.effects.passes import BODY, MATERIALS, orbiting, rows
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve

LAMBERT = '[materials.white]\nmodel = "lambert"\nalbedo = 0.6\n'


def wing(axis: str) -> str:
    """6 m2 at rest in the plane x-y, free to turn about y."""
    return f"""
    [[components]]
    name = "wing"
    shape = "plate"
    size = [2.0, 3.0]
    centre = [0, 0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    tracks = {{ target = "sun", axis = {axis} }}
    material = "white"
    """


@pytest.mark.parametrize(("axis", "sense"), [("[0, 1, 0]", 1.0), ("[0, -1, 0]", -1.0)])
@pytest.mark.parametrize("deg", [-12.0, 2.5, 15.0])
def test_cosines_of_the_turned_normal(tmp_path, axis, sense, deg):
    """A right-handed turn about +Y takes the normal from the Sun at +Z towards +X."""
    scene = still(wing(axis), LAMBERT)
    towards_x = np.arange(-60.0, 61.0, 20.0)
    recording = seen_from(scene, tmp_path, [0, 0, 1], tilted(towards_x))
    turned = np.radians(sense * deg)
    cosines = np.cos(turned) * np.cos(np.radians(towards_x) - turned)
    expected = 0.6 / np.pi * 6.0 * cosines / (1e3 * RANGE_KM) ** 2
    np.testing.assert_allclose(
        flux(scene, recording, ["panel_offset"], panel_offset__deg=deg), expected, rtol=1e-12
    )


def test_a_sun_that_leads_by_the_offset(tmp_path):
    """The wing stands as if the Sun were elsewhere, so only n.s, which that Sun would raise to 1, differs."""
    scene = still(wing("[0, 1, 0]"), LAMBERT)
    to_observer = tilted([10.0, 40.0, 70.0], 25.0)
    offset = flux(
        scene, seen_from(scene, tmp_path, tilted(20.0), to_observer), ["panel_offset"], panel_offset__deg=8.0
    )
    leading = flux(scene, seen_from(scene, tmp_path, tilted(28.0), to_observer, sun_km=AU_KM))
    np.testing.assert_allclose(offset, leading * np.cos(np.radians(8.0)), rtol=1e-12)


def test_nothing_tracks():
    scene = orbiting(components=BODY, materials=MATERIALS)
    context = LightCurve(scene, rows(scene), effects=[]).assembly.context
    assert registry()["panel_offset"]().missing(context) == "no part tracks the Sun"
