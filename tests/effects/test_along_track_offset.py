"""Ahead on the orbit: SGP4 of another mean anomaly, by Skyfield."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skyfield.api import EarthSatellite, load

from tests.effects.cases import PLATE, seen_from, still, tilted
from tests.effects.passes import HIGH, LOW_PASS, magnitudes, model_with, orbiting, rows
from tests.paper_orbits import LOW, ORBIT_1
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve


def further(tle: tuple[str, str], deg: float) -> tuple[str, str]:
    """The same elements with a mean anomaly ``deg`` further on, checksum made anew."""
    first, second = tle
    anomaly = (float(second[43:51]) + deg) % 360.0
    body = f"{second[:43]}{anomaly:8.4f}{second[51:68]}"
    total = sum(int(c) if c.isdigit() else c == "-" for c in body)
    return first, f"{body}{total % 10}"


@pytest.mark.parametrize(
    ("tle", "start", "km_per_deg"), [(ORBIT_1, HIGH, 0.6), (LOW, LOW_PASS, 0.12)], ids=["GEO", "LEO"]
)
@pytest.mark.parametrize("deg", [0.1, -2.0])
def test_position_of_skyfield(tle, start, km_per_deg, deg):
    """Our shift in time, of up to 33 s at 800 km and 480 s at GEO, also brings precession: the tolerance."""
    scene = orbiting(tle=tle)
    recording = rows(scene, start, 0.2, 60.0)
    model, theta = model_with(scene, recording, "along_track_offset", along_track_offset__deg=deg)
    position = model.view(model.values(theta)).state.position
    moment = load.timescale(builtin=True).from_astropy(recording.time)
    expected = EarthSatellite(*further(tle, deg)).at(moment).position.km.T
    assert position is not None
    error = np.linalg.norm(position[0].detach().numpy() - expected, axis=-1)
    assert error.max() < km_per_deg * abs(deg), error.max()


def test_sun_and_spin_stay():
    scene = orbiting('mode = "inertial"\nspin_axis = [0, 0, 1]\nspin_rate = 20.0')
    recording = rows(scene)
    model, theta = model_with(scene, recording, "along_track_offset", along_track_offset__deg=5.0)
    bare = LightCurve(scene, recording, effects=[])
    moved, before = model.view(model.values(theta)), bare.view(bare.values())
    torch.testing.assert_close(moved.rotation.expand_as(before.rotation), before.rotation)
    apart = np.asarray(
        (moved.state.sun + moved.state.position - before.state.sun - before.state.position).detach()
    )
    assert np.abs(apart).max() < 1e-6
    assert np.abs(magnitudes(scene, recording) - model(theta).detach().numpy()).max() > 0.01


def test_no_orbit(tmp_path):
    scene = still(PLATE, '[materials.white]\nmodel = "lambert"\nalbedo = 0.6\n')
    recording = seen_from(scene, tmp_path, [0, 0, 1], tilted([10.0, 20.0]))
    context = LightCurve(scene, recording, effects=[]).assembly.context
    assert "no orbit" in (registry()["along_track_offset"]().missing(context) or "")
