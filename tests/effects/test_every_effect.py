"""The contract of an effect, on every one that the package holds.

Each is put on a tumbling box-wing that crosses the sky in a low orbit and into the Earth's shadow, or on the
SCENE and RECORDING of its own test module where that has them.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.effects.passes import LOW_PASS, TUMBLING, orbiting, rows
from tests.paper_orbits import LOW
from tests.test_moving import all_tensors
from torchlc.effects import STAGES, Effect, registry
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve

NAMES = [name for name, cls in registry().items() if cls.__module__.startswith("torchlc.")]
NOISE = [name for name in NAMES if registry()[name].stage == "noise"]
PHYSICS = [name for name in NAMES if name not in NOISE]
PARAMETRIC = [name for name in PHYSICS if registry()[name].quantities]
DEFAULT_SCENE = orbiting(TUMBLING, tle=LOW)
DEFAULT_RECORDING = replace(rows(DEFAULT_SCENE, LOW_PASS, 0.16, 24.0, exptime=8.0), kind="flux")


def setting(name: str):
    """Scene and recording for one effect; the recording is of flux, so that a dark row is a number."""
    known = importlib.util.find_spec(f"tests.effects.test_{name}") is not None
    module = importlib.import_module(f"tests.effects.test_{name}") if known else None
    scene = getattr(module, "SCENE", DEFAULT_SCENE)
    recording = getattr(module, "RECORDING", DEFAULT_RECORDING)
    if name == "exposure_smearing":
        recording = replace(recording, exptime=None)  # else it has no parameter
    return scene, replace(recording, kind="flux")


def with_effect(name: str) -> LightCurve:
    return LightCurve(*setting(name), effects=[name])


def without_effects(name: str) -> LightCurve:
    return LightCurve(*setting(name), effects=[])


def at(model: LightCurve, attribute: str) -> torch.Tensor:
    """theta with each quantity of the effect at its off, typical, low or high; where None, at its start. Quantities
    that are fixed unless a scene sets them may be absent."""
    theta = model.theta().detach().clone()
    for effect in model.effects:
        for quantity in effect.quantities:
            value, name = getattr(quantity, attribute), effect.full_name(quantity.name)
            if value is not None and (quantity.unless_set is None or name in model.names):
                theta[model.names.index(name)] = value
    return theta


def relative(model: LightCurve):
    """The light curve as a function of theta, over the brightest row at its start."""
    scale = model().max().detach()
    return lambda theta: model(theta) / scale


@pytest.mark.parametrize("name", NAMES)
def test_it_is_described_and_tested(name: str) -> None:
    cls = registry()[name]
    assert cls.stage in STAGES
    assert Path(importlib.import_module(cls.__module__).__file__ or "").stem == name
    assert (Path(__file__).parent / f"test_{name}.py").exists()
    text = cls.__doc__ or ""
    assert cls.__doc__ is not Effect.__doc__
    assert text.partition("\n\n")[0].rstrip().endswith("."), "the first paragraph is one sentence"
    assert "neglect" in text.lower(), "the docstring says what is neglected"
    for quantity in cls.quantities:
        assert quantity.low < quantity.high
        assert np.isfinite([quantity.low, quantity.high]).all()
        assert quantity.meaning
        assert quantity.typical is not None
        assert quantity.low <= quantity.typical <= quantity.high
        bounded = quantity.off is not None and math.isfinite(quantity.off)
        assert not bounded or quantity.low <= quantity.off <= quantity.high
        assert quantity.prior != "loguniform" or quantity.low > 0
        assert quantity.prior not in ("normal", "halfnormal", "lognormal") or quantity.sigma is not None


@pytest.mark.parametrize("name", PHYSICS)
def test_it_matters_and_at_off_it_does_not(name: str) -> None:
    bare, model = without_effects(name), with_effect(name)
    with torch.no_grad():
        before, scale = bare(), bare().max()
        after = model(at(model, "typical"))
        assert float((after - before).abs().max() / scale) > 1e-7, "the scene does not show the effect"
        if any(quantity.off is not None for effect in model.effects for quantity in effect.quantities):
            torch.testing.assert_close(model(at(model, "off")) / scale, before / scale, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", NOISE)
def test_noise_at_off_is_no_noise(name: str) -> None:
    scene, recording = setting(name)
    wave = np.sin(np.arange(len(recording)))
    with torch.no_grad():
        level = LightCurve(scene, recording, effects=[])().median().item()
        recording = replace(
            recording, observed=level * (1 + 0.1 * wave), error=np.full(len(wave), 0.05 * level)
        )
        bare = Likelihood(LightCurve(scene, recording, effects=[]))
        noisy = Likelihood(LightCurve(scene, recording, effects=[name]))
        expected = bare.log_likelihood(bare.model.theta())
        torch.testing.assert_close(
            noisy.log_likelihood(at(noisy.model, "off")), expected, rtol=1e-12, atol=1e-10
        )
        assert (noisy.log_likelihood(at(noisy.model, "typical")) - expected).abs() > 1e-3
    for place in ("off", "typical", "low", "high"):
        slope = torch.func.jacrev(noisy.log_likelihood)(at(noisy.model, place))
        assert torch.isfinite(slope).all(), place


@pytest.mark.parametrize("name", PARAMETRIC)
def test_slopes_are_finite_and_those_of_central_differences(name: str) -> None:
    model = with_effect(name)
    curve = relative(model)
    slopes = {}
    for place in ("off", "low", "high", "typical"):
        theta = at(model, place)
        slopes[place] = torch.autograd.functional.jacobian(curve, theta)
        assert torch.isfinite(curve(theta)).all(), place
        assert torch.isfinite(slopes[place]).all(), place
    theta = at(model, "typical")
    for index, entry in enumerate(model.parameter_set.free):
        # small, for a facet that rises or slides behind another within the step spoils the difference
        step = 1e-6 * min(entry.prior.high - entry.prior.low, 10.0)
        moved = theta.repeat(2, 1)
        moved[0, index] += step
        moved[1, index] -= step
        with torch.no_grad():
            up, down = curve(moved[0]), curve(moved[1])
        central = (up - down) / (2 * step)
        slope = slopes["typical"][:, index]
        torch.testing.assert_close(
            slope, central, rtol=1e-5, atol=1e-5 * float(slope.abs().max()) + 2e-15 / step
        )


@pytest.mark.parametrize("name", PARAMETRIC)
def test_a_batch_is_its_members(name: str) -> None:
    model = with_effect(name)
    members = torch.stack([at(model, place) for place in ("off", "typical", "low", "high")])
    curve = relative(model)
    with torch.no_grad():
        alone = torch.stack([curve(theta) for theta in members])
        torch.testing.assert_close(curve(members), alone, rtol=1e-12, atol=1e-13)
        torch.testing.assert_close(torch.vmap(curve)(members), alone, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", PHYSICS)
def test_the_order_of_the_list_does_not_matter(name: str) -> None:
    others = ["sun_distance", "time_offset", "attitude_offset", "background", "zero_point_drift"]
    scene, recording = setting(name)
    listed = [*(other for other in others if other != name), name]
    one = LightCurve(scene, recording, effects=listed)
    other = LightCurve(scene, recording, effects=listed[::-1])
    assert one.names == other.names
    with torch.no_grad():
        torch.testing.assert_close(one(at(one, "typical")), other(at(other, "typical")), rtol=0, atol=0)


@pytest.mark.parametrize("name", NAMES)
def test_it_moves_to_single_precision_and_to_a_device_without_numbers(name: str) -> None:
    """The device "meta" has shapes and no numbers: what is left on the CPU, or read as a number, is an error there."""
    model = with_effect(name)
    theta = torch.stack([at(model, "typical"), model.theta().detach()])
    single = LightCurve(*setting(name), assembly=model.assembly).to(torch.float32)
    with torch.no_grad():
        expected, found = model(theta), single(theta.float())
    hours = float(np.ptp(model.recording.seconds)) / 3600
    turns = abs(model.assembly.context.attitude.spin_rate_at_start) * hours
    # 6e-8 of a number, some ten times over; of an angle that is whole turns, of all of it
    within = 2e-6 + 2 * 6e-8 * 2 * math.pi * turns
    np.testing.assert_allclose(found.double(), expected, rtol=0, atol=within * float(expected.abs().max()))
    assert found.dtype == torch.float32 and not any(one.dtype == torch.float64 for one in all_tensors(single))
    model.to("meta")
    assert all(one.is_meta for one in all_tensors(model))
    rows, empty = len(model.recording), theta.to("meta")
    with torch.no_grad():
        seen, noise = model.brightness(empty, shares=True), model.noise(empty)
        assert model().shape == (rows,) and model(empty).shape == (2, rows)
    assert seen.flux.is_meta and seen.shares is not None and seen.shares.is_meta
    assert noise.variance is None or noise.variance.is_meta
