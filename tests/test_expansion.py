"""A free geometry expanded to second order, against the exact geometry, and draws that move on it against draws that do
not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.effects.passes import BODY, CELLS, TUMBLING, WINGS, orbiting, rows
from tests.test_gradients import FREE_FOIL, SIZED, check, tumbling
from torchlc.inference.budget import Budget
from torchlc.inference.exact_weights import reweighted
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit, fit_map
from torchlc.inference.sampler import sample
from torchlc.lightcurve.evaluators.expansion import MOST_MAG, UnsuitableError
from torchlc.lightcurve.model import LightCurve

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func's own
SPREAD = {
    "deg": 0.1,
    "x": 0.1,
    "y": 0.1,
    "z": 0.1,
    "s": 1.0,
    "size_x": 0.02,
    "n": 1.0,
    "r_spec": 0.01,
    "r_diff": 0.01,
}
"""Standard deviations of a posterior, in the numbers' own units."""
WOBBLE = {
    "wobble.deg": (1.0, 0.15),
    "wobble.period_min": (30.0, 0.15),
    "wobble.phase_deg": (90.0, 4.5),
    "wobble.axis_lon": (60.0, 3.0),
    "wobble.axis_lat": (10.0, 3.0),
}
"""Value and standard deviation of a wobble, of which a second order reaches less far than draws lie."""
ALL = ("light_time", "sun_distance", "finite_sun", "self_shadowing", "earth_shadow")
CASES = {
    "a panel": (BODY + WINGS, ("panel_offset", *ALL)),
    "an attitude": (BODY + WINGS, ("attitude_offset", *ALL)),
    "a clock": (BODY + WINGS, ("time_offset", "earth_shadow", "finite_sun")),
    "a size with shadows": (SIZED + WINGS, ("self_shadowing",)),
    "a wobble": (BODY + WINGS, ("wobble", "finite_sun")),
    "a panel of scattered normals": (BODY + WINGS, ("panel_offset", "normal_dispersion", "finite_sun")),
    "a size and a panel": (SIZED + WINGS, ("panel_offset", "finite_sun", "exposure_smearing")),
}


def model(name: str, count: int = 40) -> LightCurve:
    components, effects = CASES[name]
    scene = orbiting(TUMBLING, components, FREE_FOIL + CELLS)
    recording = tumbling(scene, count)
    if "exposure_smearing" in effects:
        recording = replace(recording, exptime=np.full(count, 2.0))
    return LightCurve(scene, replace(recording, kind="flux"), effects=list(effects))


def expanded(curve: LightCurve) -> tuple[LightCurve, torch.Tensor, torch.Tensor]:
    """The expansion about the start, which is put off every bound, with the reference and the standard deviations."""
    theta = curve.parameter_set.start().clone()
    free = curve.parameter_set.free
    sd = torch.tensor([SPREAD.get(one.origin.quantity, 1.0) for one in free], dtype=theta.dtype)
    for name, (value, deviation) in WOBBLE.items():
        if name in curve.names:
            theta[curve.names.index(name)], sd[curve.names.index(name)] = value, deviation
    return curve.expanded(theta, torch.diag(sd**2)), theta, sd


@pytest.mark.parametrize("name", CASES)
def test_the_stated_error_holds_at_other_geometries(name):
    """40 draws of the posterior, none of which the expansion has seen; those within its reach are off by no more than
    it states, and all others by nothing."""
    curve = model(name)
    other, theta, sd = expanded(curve)
    evaluator = other.evaluator
    assert (max(map(len, evaluator.powers)) == 3) is (name == "a wobble")
    assert 0 < evaluator.own_error_mag <= evaluator.error_mag <= MOST_MAG
    draws = theta + sd * torch.randn(
        40, len(theta), generator=torch.Generator().manual_seed(5), dtype=theta.dtype
    )
    draws[-1] = theta + 30 * sd * torch.tensor(["r_" not in n and not n.endswith(".n") for n in curve.names])
    with torch.no_grad():
        found, expected = other.brightness(draws).flux, curve.brightness(draws).flux
        served = evaluator.served(draws)
    assert served[:-1].double().mean() > 0.5
    assert not served[-1]
    torch.testing.assert_close(found[~served], expected[~served], rtol=1e-13, atol=0)
    lit = (expected > 1e-6 * expected.max()) & served[:, None]
    error = (2.5 * torch.log10(found[lit] / expected[lit])).abs().max()
    assert 0 < float(error) <= evaluator.error_mag


@pytest.mark.parametrize("name", ["a panel", "a size and a panel"])
def test_slopes_are_those_of_finite_differences(name):
    """In the way of tests/test_gradients.py: by every number, alone and together, and under transforms."""
    other, theta, sd = expanded(model(name, 10))
    check(other, torch.stack([theta + 0.5 * sd, theta - 0.3 * sd]))


def test_the_reference_is_exact():
    """At the reference nothing is left but what the table over the exponent leaves, 1e-6 here, of tables that are made of all
    points of the Sun's disc."""
    curve = model("an attitude")
    other, theta, _ = expanded(curve)
    with torch.no_grad():
        values = curve.values(theta)
        expected = curve.shine(curve.make_tables(curve.view(values), False, compact=True), values).flux
        torch.testing.assert_close(other(theta), expected, rtol=1e-6, atol=1e-9 * float(expected.max()))


def test_what_cannot_be_expanded_is_refused():
    wide = model("a panel")
    start = wide.parameter_set.start()
    with pytest.raises(UnsuitableError, match="standard deviations away"):
        wide.expanded(start, torch.diag(torch.full_like(start, 30.0) ** 2))
    with pytest.raises(UnsuitableError, match="stands at a bound"):
        wide.expanded(start, torch.zeros(len(start), len(start), dtype=start.dtype))
    fixed = LightCurve(wide.scene, wide.recording, effects=[])
    start = fixed.parameter_set.start()
    with pytest.raises(UnsuitableError, match="no free number"):
        fixed.expanded(start, torch.eye(len(start), dtype=start.dtype))


# ------------------------------------------------------------------ the posterior


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A panel offset beside the reflectances of a box and two wings, errors of 0.02 mag."""
    foil = FREE_FOIL.replace("n = { value = 20.0, low = 1.0, high = 100.0 }", "n = 20.0")
    scene = orbiting(TUMBLING, BODY + WINGS, foil + CELLS)
    recording = rows(scene, hours=2.0, cadence_s=120.0)
    light = LightCurve(scene, recording, effects=["panel_offset"])
    theta = light.parameter_set.start().clone()
    theta[light.names.index("panel_offset.deg")] = 1.0
    with torch.no_grad():
        magnitude = light(theta).numpy()
    noise = 0.02 * np.random.default_rng(1).normal(size=len(magnitude))
    lit = np.isfinite(magnitude) & (magnitude < np.nanmin(magnitude) + 8)
    recording = replace(recording, observed=magnitude + noise, error=np.full(len(magnitude), 0.02))
    recording = recording.keep(lit, "dark")
    return fit_map(
        Likelihood(LightCurve(scene, recording, effects=["panel_offset"])), starts=4, adam_steps=30
    )


@pytest.mark.long
def test_draws_on_the_expansion_have_the_exact_posterior(fit):
    """Means and standard deviations of both chains agree within five standard errors of their effective draws."""
    quick, slow = sample(fit, steps=700, seed=1), sample(fit, steps=700, seed=2, exactly=True)
    assert "weighted by the exact light" in quick.reason
    assert "expansion" not in slow.reason
    with torch.no_grad():
        exact = fit.likelihood.log_prob(quick.flat[::50])
    torch.testing.assert_close(quick.log_prob.reshape(-1)[::50], exact, rtol=0, atol=1e-9)
    one, two = (draws.flat.numpy() for draws in (quick, slow))
    sd = two.std(0)
    error = sd * np.sqrt(1 / quick.ess + 1 / slow.ess)
    assert (np.abs(one.mean(0) - two.mean(0)) < 5 * error).all()
    assert (np.abs(one.std(0) / sd - 1) < 5 * np.sqrt(0.5 / quick.ess + 0.5 / slow.ess)).all()


def test_draws_that_do_not_count_are_not_kept(fit):
    """Densities of a likelihood whose errors are five times too small leave next to none of its draws."""
    posterior = sample(fit, steps=100, seed=3, exactly=True)
    recording = fit.model.recording
    narrow = replace(recording, error=0.2 * recording.error)
    other = Likelihood(LightCurve(fit.model.scene, narrow, effects=["panel_offset"]))
    assert reweighted(posterior, other, fit.likelihood, Budget()) is None
    kept = reweighted(posterior, fit.likelihood, fit.likelihood, Budget())
    assert kept is not None
    assert "100%" in kept.note
    every = kept.thin // posterior.thin  # no more are weighed than MOST_WEIGHED
    torch.testing.assert_close(kept.theta, posterior.theta[:, ::every], rtol=0, atol=0)
