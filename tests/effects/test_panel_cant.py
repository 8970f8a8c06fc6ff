"""A wing that leans towards its axis: cosines in closed form, and both wings the same way."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import RANGE_KM, flux, seen_from, still, tilted
from tests.effects.passes import BODY, MATERIALS, orbiting, rows
from tests.effects.test_panel_offset import LAMBERT, wing
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve


@pytest.mark.parametrize(("axis", "sense"), [("[0, 1, 0]", 1.0), ("[0, -1, 0]", -1.0)])
@pytest.mark.parametrize("deg", [-10.0, 3.0])
def test_cosines_of_the_tilted_normal(tmp_path, axis, sense, deg):
    """With the Sun at +Z the front p = Z turns about p x axis, from Z towards the axis."""
    scene = still(wing(axis), LAMBERT)
    towards_y = np.arange(-60.0, 61.0, 20.0)
    recording = seen_from(scene, tmp_path, [0, 0, 1], tilted(towards_y, 90.0))
    leaning = np.radians(sense * deg)
    cosines = np.cos(leaning) * np.cos(np.radians(towards_y) - leaning)
    expected = 0.6 / np.pi * 6.0 * cosines / (1e3 * RANGE_KM) ** 2
    np.testing.assert_allclose(
        flux(scene, recording, ["panel_cant"], panel_cant__deg=deg), expected, rtol=1e-12
    )


def test_the_hinge_follows_the_turn_to_the_sun(tmp_path):
    """Sun at 50 deg from Z towards X: n = cos c s + sin c y, whatever the hinge's place."""
    scene = still(wing("[0, 1, 0]"), LAMBERT)
    to_sun, to_observer = tilted(50.0), tilted([15.0, 40.0], [30.0, 80.0])
    c = np.radians(6.0)
    normal = np.cos(c) * to_sun + np.sin(c) * np.array([0.0, 1.0, 0.0])
    found = flux(scene, seen_from(scene, tmp_path, to_sun, to_observer), ["panel_cant"], panel_cant__deg=6.0)
    expected = 0.6 / np.pi * 6.0 * (normal @ to_sun) * (to_observer @ normal) / (1e3 * RANGE_KM) ** 2
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_it_does_not_mind_an_offset_of_the_drive(tmp_path):
    """The offset turns hinge and front together: normal = Ry(offset) of the canted one."""
    scene = still(wing("[0, 1, 0]"), LAMBERT)
    to_observer = tilted([15.0, 40.0], [30.0, 80.0])
    recording = seen_from(scene, tmp_path, [0, 0, 1], to_observer)
    found = flux(scene, recording, ["panel_offset", "panel_cant"], panel_offset__deg=9.0, panel_cant__deg=6.0)
    c, d = np.radians(6.0), np.radians(9.0)
    normal = np.array([np.cos(c) * np.sin(d), np.sin(c), np.cos(c) * np.cos(d)])
    expected = 0.6 / np.pi * 6.0 * normal[2] * (to_observer @ normal) / (1e3 * RANGE_KM) ** 2
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_nothing_tracks():
    scene = orbiting(components=BODY, materials=MATERIALS)
    context = LightCurve(scene, rows(scene), effects=[]).assembly.context
    assert registry()["panel_cant"]().missing(context) == "no part tracks the Sun"
