"""A mean over the exposure: sinusoids fade by sinc, narrow lobes as under a thousand instants."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.effects.passes import BODY, LOW_PASS, TUMBLING, model_with, orbiting, rows
from tests.paper_orbits import LOW
from torchlc.effects import registry
from torchlc.inference.identifiability import limits
from torchlc.lightcurve.model import LightCurve

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


def evenly(scene, recording, effects, exptime, count=2000):
    """Flux (T,): the mean over so many even instants, each a clock that is wrong by so much, without exposures."""
    late = LightCurve(scene, recording, effects=[*effects, "time_offset"])
    column = late.names.index("time_offset.s")
    offsets = ((torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5) * exptime
    total = torch.zeros(len(recording), dtype=torch.float64)
    with torch.no_grad():
        for some in offsets.split(100):
            theta = late.theta().repeat(len(some), 1)
            theta[:, column] = some
            total += late.brightness(theta).flux.sum(0)
    return total / count


def shadowed(attitude: str, soft: str = ""):
    return orbiting(attitude, tle=LOW, parameters='"earth_shadow.h0" = 20.0\n' + soft)


@pytest.mark.parametrize("exptime", [5.0, 20.0, 60.0])
@pytest.mark.parametrize("attitude", ['mode = "nadir"', TUMBLING])
@pytest.mark.parametrize("soft", ["", '"earth_shadow.scale_height" = 8.0\n"earth_shadow.refraction" = 1.0\n'])
def test_into_the_shadow_in_a_low_orbit(exptime, attitude, soft):
    """Every row with a hundredth of the light or more; fainter ones, lit for a moment of the exposure, within 0.05 mag."""
    scene = shadowed(attitude, soft)
    recording = rows(scene, LOW_PASS, 0.16, max(6.0, exptime), exptime=exptime)
    expected = evenly(scene, recording, ["earth_shadow"], exptime)
    model = LightCurve(scene, recording, effects=["earth_shadow", "exposure_smearing"])
    found = model.brightness().flux.detach()
    share = expected / expected.max()
    assert ((share > 1e-4) & (share < 0.5)).sum() >= 1
    assert torch.equal(found > 1e-30, expected > 1e-30)
    change = 2.5 * torch.log10(found / expected.clamp(min=1e-36)).abs()
    assert change[share > 1e-2].max() < 2e-3
    assert change[share > 1e-4].max() < 5e-2
    told = [text for text in limits(model, model.theta()) if text.startswith("exposure_smearing")]
    usual = found[found > 0].median()
    faint = (found > 1e-4 * usual) & (found < 1e-2 * usual)
    for rows_told, words in (
        (found >= 1e-2 * usual, "exposures looked at"),
        (faint, "exposures with less than 1 %"),
    ):
        sentences = [text for text in told if words in text]
        largest = float(change[rows_told].max()) if bool(rows_told.any()) else 0.0
        assert bool(sentences) == (largest > 2e-3)
        # twice the instants leave less than what they change, but not nothing
        for text in sentences:
            assert float(re.search(r"up to ([\d.]+) mag", text)[1]) == pytest.approx(largest, rel=0.3)
    rows_that_change = 60
    assert (
        model.assembly.N - 4 * len(recording) < rows_that_change
    )  # where nothing changes fast nothing is paid


def test_the_shadow_follows_h0_in_the_exposures():
    """Instants are the same for all h0, and the light is that of even ones at each: the scene's is 20 km."""
    scene = orbiting(tle=LOW)
    recording = rows(scene, LOW_PASS, 0.16, 20.0, exptime=20.0)
    model = LightCurve(scene, recording, effects=["earth_shadow", "exposure_smearing"])
    assert model.names == ["earth_shadow.h0"]
    heights = torch.tensor([[0.0], [13.0], [47.0], [60.0]], dtype=torch.float64)
    found = model.brightness(heights).flux.detach()
    for h0, flux in zip(heights[:, 0].tolist(), found, strict=True):
        fixed = orbiting(tle=LOW, parameters=f'"earth_shadow.h0" = {h0}\n')
        expected = evenly(fixed, recording, ["earth_shadow"], 20.0)
        seen = expected > 1e-2 * expected.max()
        assert 2.5 * torch.log10(flux[seen] / expected[seen]).abs().max() < 2e-3
    slope = torch.func.jacfwd(lambda theta: model.brightness(theta).flux)(heights[1])[:, 0]
    step = model.brightness(heights[1] + 1e-4).flux - model.brightness(heights[1] - 1e-4).flux
    torch.testing.assert_close(slope, step.detach() / 2e-4, rtol=1e-5, atol=1e-5 * float(slope.abs().max()))


def test_a_glint_at_geo_with_the_sharpest_lobe():
    """The half vector passes a wing's normal: n = 1e6, 2.3 lobe widths a minute; only rows near it have more instants."""
    scene = orbiting(materials=lobe(40.0) + lobe(1e6).replace("foil", "cells"))
    recording = rows(scene, "2020-10-07T15:30:00", 2.0, 60.0, exptime=60.0)
    expected = evenly(scene, recording, [], 60.0)
    model = LightCurve(scene, recording, effects=["exposure_smearing"])
    found = model.brightness().flux.detach()
    assert 2.5 * torch.log10(found / expected).abs().max() < 2e-3
    assert len(recording) < model.assembly.N < 3 * len(recording)


@pytest.mark.parametrize("n", [40.0, 1e4])
def test_three_thousand_exposures_of_a_spinner(n):
    """4.7 s a turn, 3 s an exposure: up to 4 rad of the half vector, 400 lobe widths. 60 rows against even instants."""
    spin = f'mode = "inertial"\nspin_epoch = "2020-10-17T14:00:00"\nspin_axis = [1.0, 0.2, 0.1]\nspin_rate = {3600 / 4.7}'
    scene = orbiting(spin, BODY, lobe(n))
    recording = rows(scene, "2020-10-17T14:00:00", 3000 * 13 / 3600, 13.0, exptime=3.0)
    model = LightCurve(scene, recording, effects=["exposure_smearing"])
    found = model.brightness().flux.detach()
    some = np.zeros(len(recording), dtype=bool)
    some[::50] = True
    expected = evenly(scene, recording.keep(some, "not compared"), [], 3.0)
    assert 2.5 * torch.log10(found[torch.as_tensor(some)] / expected).abs().max() < 2e-3
    assert limits(model, model.theta()) == []


@pytest.mark.long
def test_instants_that_memory_does_not_allow_are_told_with_their_size():
    """A spinning stage of 672 facets: what the warning says is what even instants say, to a factor of two."""
    stage = """
    [[components]]
    name = "stage"
    shape = "cylinder"
    radius = 1.2
    length = 8.0
    axis = [0, 0, 1]
    centre = [0, 0, 0]
    material = "foil"
"""
    spin = f'mode = "inertial"\nspin_epoch = "2020-10-17T14:00:00"\nspin_axis = [1.0, 0.2, 0.1]\nspin_rate = {3600 / 4.7}'
    scene = orbiting(spin, stage, lobe(1e4))
    recording = rows(scene, "2020-10-17T14:00:00", 3000 * 13 / 3600, 13.0, exptime=3.0)
    model = LightCurve(scene, recording, effects=["exposure_smearing"])
    found = model.brightness(model.theta()[None]).flux[0]
    (text,) = limits(model, model.theta())
    told = float(re.search(r"\(([\d.]+) mag rms\)", text)[1])
    some = np.zeros(len(recording), dtype=bool)
    some[::150] = True
    expected = evenly(scene, recording.keep(some, "not compared"), [], 3.0, 600)
    rms = float((2.5 * torch.log10(found[torch.as_tensor(some)] / expected)).square().mean().sqrt())
    assert rms > 0.1
    assert 0.5 < told / rms < 2
    assert "memory allows" in text


def test_a_fit_that_leaves_the_scenes_values_is_told():
    """Instants are settled for the rate of the scene; where a free offset of it doubles the turns, that is said."""
    scene = orbiting('mode = "nadir"\nspin_axis = [0, 1, 0]\nspin_rate = 1.0', BODY, lobe(1e4))
    recording = rows(scene, "2020-10-17T14:00:00", 1.0, 30.0, exptime=30.0)
    model, theta = model_with(
        scene, recording, "exposure_smearing", "spin_rate_offset", spin_rate_offset__rev_per_hour=0.0
    )
    assert limits(model, theta) == []
    theta[0] = 8.0
    (text,) = limits(model, theta)
    assert "twice as many instants" in text


def test_few_instants_where_little_moves():
    still = orbiting()
    model = LightCurve(still, rows(still, exptime=2.0), effects=["exposure_smearing"])
    assert model.assembly.instants is None
    fast = orbiting('mode = "nadir"\nspin_axis = [0, 1, 0]\nspin_rate = 6.0', BODY, lobe(1e4))
    model = LightCurve(fast, rows(fast, cadence_s=187.0, exptime=30.0), effects=["exposure_smearing"])
    count = torch.bincount(model.assembly.instants.row)
    # 18 deg of the half vector, 31 lobe widths: only near a glint
    assert count.max() > 20
    assert count.double().mean() < 0.6 * count.max()


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
