"""Seen later than it was: a fast spinner's phase lags by rate times range over c."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.effects.passes import BODY, MATERIALS, magnitudes, orbiting, rows
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve

C_KM_S = 299_792.458


def spinner(phase_deg: float):
    spin = f'mode = "inertial"\nspin_axis = [0.2, 0.9, 0.1]\nspin_rate = 3600.0\nspin_phase = {phase_deg!r}'
    return orbiting(spin, components=BODY, materials=MATERIALS)


def test_phase_lags_by_the_light_time():
    """One turn a second at GEO: 45 deg of lag. Each row alone, for the range changes; the object's own way in
    0.13 s, 0.4 km, is 1e-5 mag."""
    scene = spinner(0.0)
    recording = rows(scene, hours=1.0)
    found = magnitudes(scene, recording, "light_time")
    light_s = LightCurve(scene, recording, effects=[]).assembly.track.range_km.numpy() / C_KM_S
    for row, seconds in enumerate(light_s):
        lagging = magnitudes(spinner(-360.0 * float(seconds)), recording)[row]
        assert found[row] == pytest.approx(lagging, abs=2e-4)
    assert np.abs(found - magnitudes(scene, recording)).max() > 0.3


def test_the_second_iteration_is_small():
    """Against the delay from where the light left, solved by 20 iterations."""
    scene = spinner(0.0)
    recording = rows(scene, hours=1.0)
    model = LightCurve(scene, recording, effects=["light_time"])
    track = model.assembly.track
    delay = track.range_km.new_zeros(1, len(recording))
    for _ in range(20):
        delay = track.at(0.0, -delay, 0.0).observer.norm(dim=-1) / C_KM_S
    error_s = model.view(model.values()).state.time - (track.seconds - delay)
    assert float(error_s.abs().max()) < 1e-6


def test_times_at_the_object():
    scene = spinner(0.0)
    recording = replace(rows(scene), light_time_corrected=True)
    context = LightCurve(scene, recording, effects=[]).assembly.context
    assert "already" in (registry()["light_time"]().missing(context) or "")
