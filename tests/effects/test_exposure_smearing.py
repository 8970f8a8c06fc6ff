"""A mean over the exposure: sinusoids fade by sinc, narrow lobes as under a thousand instants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.effects.passes import BODY, model_with, orbiting, rows
from torchlc.effects import registry
from torchlc.effects.exposure_smearing import ExposureSmearing
from torchlc.model import LightCurve

TILTED = """
    [[components]]
    name = "mirror"
    shape = "plate"
    size = [1.0, 1.0]
    centre = [0, 0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    rotation = [20.0, 0, 0]
    material = "foil"
"""
LAMBERT = '[materials.foil]\nmodel = "lambert"\nalbedo = 0.6\n'


def lobe(n: float) -> str:
    return f"[materials.foil]\nn = {n}\nr_spec = 0.3\nr_diff = 0.3\n"


def spinner(rate: float, components: str, materials: str, phase: float = 0.0):
    spin = f'mode = "sun"\nspin_axis = [0, 0, 1]\nspin_rate = {rate}\nspin_phase = {phase}'
    return orbiting(spin, components, materials)


@pytest.mark.parametrize("turns", [0.01, 0.2, 0.75, 2.3])
def test_a_sinusoid_fades_by_sinc(turns):
    """A plate 20 deg from the axis, along which the Sun is: n.s is constant, n.o a constant and a
    sinusoid, and both follow from two curves at opposite phases.
    """
    rate, exptime = 3600.0, turns
    scene, opposite = spinner(rate, TILTED, LAMBERT), spinner(rate, TILTED, LAMBERT, 180.0)
    recording = replace(rows(scene, "2020-10-17T15:00:00", 0.3, 50.13), kind="flux")
    one, other = (LightCurve(either, recording)().detach().numpy() for either in (scene, opposite))
    assert one.min() > 0
    assert other.min() > 0
    sharp, mean = 0.5 * (one - other), 0.5 * (one + other)
    assert np.abs(sharp).max() > 0.05 * mean.max()
    smeared = replace(recording, exptime=np.full(len(recording), exptime))
    found = LightCurve(scene, smeared, effects=["exposure_smearing"])().detach().numpy()
    # the observer goes round the axis as well, by 1e-5 of a turn
    np.testing.assert_allclose(found, mean + sharp * np.sinc(turns), rtol=1e-5)


def test_unknown_exposure_is_the_same_light():
    scene = spinner(60.0, TILTED, LAMBERT)
    recording = replace(rows(scene, "2020-10-17T15:00:00", 0.3, 50.0), kind="flux")
    free, theta = model_with(scene, recording, "exposure_smearing", exposure_smearing__s=12.0)
    known = LightCurve(
        scene, replace(recording, exptime=np.full(len(recording), 12.0)), effects=["exposure_smearing"]
    )
    np.testing.assert_allclose(free(theta).detach().numpy(), known().detach().numpy(), rtol=1e-6)


@pytest.mark.parametrize("n", [30.0, 1e3, 1e4])
@pytest.mark.parametrize("exptime", [1.0, 10.0, 30.0, 100.0, 500.0, 1500.0])
def test_against_a_thousand_instants(n, exptime):
    """A box that turns at 1 rev/h: up to 150 deg in an exposure, over glints 1.4 deg wide at half maximum.

    The thousand are even instants, each a clock that is wrong by so much.
    """
    scene = orbiting('mode = "nadir"\nspin_axis = [0, 1, 0]\nspin_rate = 1.0', BODY, lobe(n))
    recording = rows(scene, "2020-10-17T14:00:00", 1.0, 30.0, exptime=exptime)
    late = LightCurve(scene, recording, effects=["time_offset"])
    instants = ((torch.arange(1000, dtype=torch.float64) + 0.5) / 1000 - 0.5) * exptime
    with torch.no_grad():
        mean = torch.cat([late.brightness(piece).flux for piece in instants[:, None].split(100)]).mean(0)
        found = LightCurve(scene, recording, effects=["exposure_smearing"])()
    assert (found + 26.7 + 2.5 * torch.log10(mean)).abs().max() < 2e-3


@pytest.mark.parametrize("n", [100.0, 1e4])
def test_a_batch_of_exposures_interpolates_what_single_ones_work_out(n):
    """Turns of up to 18 deg in an exposure."""
    scene = orbiting('mode = "nadir"\nspin_axis = [0, 1, 0]\nspin_rate = 3.0', BODY, lobe(n))
    model = LightCurve(scene, rows(scene, "2020-10-17T14:00:00", 0.5, 60.0), effects=["exposure_smearing"])
    exposures = torch.linspace(0.5, 59.5, 11, dtype=torch.float64)[:, None]
    single = torch.stack([model(one) for one in exposures])
    assert (model(exposures) - single).abs().max() < 3e-4
    slope = torch.autograd.functional.jacobian(lambda s: model(s).sum(), exposures)[:, 0]
    moved = model(exposures + 1e-3).sum(-1) - model(exposures - 1e-3).sum(-1)
    torch.testing.assert_close(slope, moved.detach() / 2e-3, rtol=1e-4, atol=1e-4)


def test_few_instants_where_little_moves():
    still = orbiting()
    effect = ExposureSmearing()
    context = LightCurve(still, rows(still, exptime=2.0), effects=[]).assembly.context
    assert effect.prepared(context).nodes == 1
    fast = orbiting('mode = "nadir"\nspin_axis = [0, 1, 0]\nspin_rate = 6.0', BODY, lobe(1e4))
    context = LightCurve(fast, rows(fast, exptime=30.0), effects=[]).assembly.context
    assert 20 < effect.prepared(context).nodes < 61


def test_parameter_only_without_a_column():
    scene = orbiting()
    effect = registry()["exposure_smearing"]
    known, unknown = rows(scene, exptime=5.0), rows(scene)
    assert LightCurve(scene, known, effects=["exposure_smearing"]).names == []
    model = LightCurve(scene, unknown, effects=["exposure_smearing"])
    assert model.names == ["exposure_smearing.s"]
    assert model.parameter_set.free[0].prior.high == 600.0
    contexts = [LightCurve(scene, one, effects=[]).assembly.context for one in (known, unknown)]
    assert [effect().standard(context) for context in contexts] == [True, False]
    assert "zero length" in (effect().missing(replace(contexts[0], exptime=torch.zeros(37))) or "")
