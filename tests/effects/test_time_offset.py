"""A late clock is the curve at other stamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.effects.cases import PLATE, seen_from, still, tilted
from tests.effects.passes import HIGH, LOW_PASS, magnitudes, orbiting, rows
from tests.paper_orbits import LOW
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve

SPIN = 'mode = "nadir"\nspin_axis = [0.2, 0.9, 0.1]\nspin_rate = 9.0\nspin_epoch = "2006-06-27T13:00:00"'


@pytest.mark.parametrize("seconds", [-75.0, 40.0])
def test_equals_the_curve_at_shifted_stamps(seconds):
    """SGP4, Earth rotation and spin are those of the shifted stamps; a metre in low orbit is 1e-6 mag."""
    scene = orbiting(SPIN, tle=LOW)
    start = np.datetime64(LOW_PASS, "ms")
    shifted = start + np.timedelta64(int(1000 * seconds), "ms")
    found = magnitudes(scene, rows(scene, str(start), 0.1, 15.0), "time_offset", time_offset__s=seconds)
    expected = magnitudes(scene, rows(scene, str(shifted), 0.1, 15.0))
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert np.abs(found - magnitudes(scene, rows(scene, str(start), 0.1, 15.0))).max() > 0.3


def test_one_offset_a_station():
    scene = orbiting(
        SPIN, tle=LOW, parameters='"time_offset.s" = { value = 0.0, sigma = 10.0, per = "curve" }'
    )
    recording = rows(scene, LOW_PASS, 0.1, 15.0)
    half = (np.arange(len(recording)) >= 12).astype(np.int64)
    recording = replace(recording, curve=half, curve_ids=("a", "b"))
    model = LightCurve(scene, recording, effects=["time_offset"])
    assert model.names == ["time_offset.s[a]", "time_offset.s[b]"]
    found = model(model.theta().new_tensor([20.0, -30.0])).detach().numpy()
    one, other = (magnitudes(scene, recording, "time_offset", time_offset__s=s) for s in (20.0, -30.0))
    np.testing.assert_allclose(found, np.where(half == 0, one, other), atol=1e-12)


def test_a_large_mesh_is_interpolated_over_the_offset(tmp_path, monkeypatch):
    """A potato of a thousand facets, whose light at a turned clock goes through that at few: as good as the curve
    at the shifted stamps, for one value, for a batch and in its slope."""
    trimesh.creation.icosphere(subdivisions=3).apply_scale([3.0, 2.0, 1.4]).export(tmp_path / "potato.obj")
    monkeypatch.chdir(tmp_path)
    scene = orbiting(
        SPIN.replace("9.0", "0.9"),
        '[[components]]\nname = "potato"\nshape = "mesh"\nfile = "potato.obj"\ncentre = [0, 0, 0]\nmaterial = "dust"\n',
        '[materials.dust]\nmodel = "lommel-seeliger-lambert"\nweight = 0.2\n',
    )
    start = np.datetime64(HIGH, "ms")
    few = {"hours": 4.0, "cadence_s": 16.0}
    model = LightCurve(scene, rows(scene, **few), effects=["time_offset"])
    offsets = model.theta().new_tensor([[31.0], [-77.0]])
    found = model(offsets).detach()
    expected = [
        magnitudes(scene, rows(scene, str(start + np.timedelta64(1000 * int(s), "ms")), **few))
        for s in offsets
    ]
    np.testing.assert_allclose(found, np.stack(expected), atol=1e-3)
    assert np.abs(expected[0] - expected[1]).max() > 0.1
    one = offsets[0].clone().requires_grad_()
    value = model(one)
    np.testing.assert_allclose(value.detach(), found[0], atol=1e-12)
    value[::90].sum().backward()
    ahead, behind = (model(offsets[0] + step)[::90].sum() for step in (1e-3, -1e-3))
    assert one.grad is not None
    np.testing.assert_allclose(float(one.grad), float(ahead - behind) / 2e-3, rtol=1e-5)


def test_one_row_has_no_motion(tmp_path):
    scene = still(PLATE, '[materials.white]\nmodel = "lambert"\nalbedo = 0.6\n')
    recording = seen_from(scene, tmp_path, [0, 0, 1], tilted([10.0, 20.0]), position=[7000.0, 0.0, 0.0])
    recording = recording.keep(np.array([True, False]), "test")
    context = LightCurve(scene, recording, effects=[]).assembly.context
    assert "no motion" in (registry()["time_offset"]().missing(context) or "")
