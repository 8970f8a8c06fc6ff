"""Moves that draw the reflectances anew: they leave prior and posterior as they are, and know their own density."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import emcee
import numpy as np
import pytest
import torch
from scipy import stats

import torchlc
from torchlc.inference.ensemble import log_density
from torchlc.inference.evolution_move import CarriedEvolution
from torchlc.inference.exchange_move import CutNormal, Redraw
from torchlc.inference.likelihood import Likelihood

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "paper"))

import setting

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func's own
NIGHT = {"start": "2020-10-17T14:00:00", "hours": 7.0, "cadence": 2400.0}
PARAMETERS = "[model.parameters]\nzero_point = { value = 0.0, sigma = 0.3 }"


def problem(kind: str, noise: float, *, lobes: str | float = setting.FREE["n"]) -> Likelihood:
    """Object 1, zero point and both materials free (with ``lobes`` as n), jitter in the model; eleven rows."""
    material = {**setting.FREE, "n": lobes}
    scene = setting.object_1({"body": material, "panel": material}, effects='["jitter"]')
    scene = torchlc.Scene.from_toml(scene.to_toml().replace("[model.parameters]", PARAMETERS))
    seen = torchlc.simulate(scene, **NIGHT)
    deviate = np.random.default_rng(1).normal(size=len(seen.recording))
    scatter = min(noise, 1.5) * deviate
    if kind == "mag":
        observed, error = seen.mag + scatter, np.full(len(deviate), noise)
    else:
        flux = np.asarray(seen.columns["flux"]) / np.mean(seen.columns["flux"])
        observed, error = flux * (1 + scatter), noise * flux
    recording = replace(seen.recording, kind=kind, observed=observed, error=error)
    return Likelihood(torchlc.LightCurve(scene, recording))


def after_moves(
    likelihood: Likelihood, theta: torch.Tensor, steps: int, way: str
) -> tuple[np.ndarray, float]:
    """Where draws theta (W, P) are after some of these moves alone, natural values, and the acceptance."""
    parameters = likelihood.model.parameter_set
    redraw = Redraw(likelihood, theta[0])
    move = {
        "exchange": lambda: emcee.moves.MHMove(redraw),
        "evolution": lambda: CarriedEvolution(redraw),
        "jump": lambda: CarriedEvolution(redraw, whole=True),
    }[way]()
    density, x = log_density(likelihood), parameters.to_straight(theta).numpy()
    x = x[np.isfinite(density(x))]  # all but those that rounding has put over the edge
    assert len(x) > 0.99 * len(theta)
    sampler = emcee.EnsembleSampler(*x.shape, density, moves=move, vectorize=True)
    start = emcee.State(x, random_state=np.random.RandomState(3).get_state())
    end = sampler.run_mcmc(start, steps, skip_initial_state_check=True)
    assert end is not None
    moved = parameters.from_straight(torch.as_tensor(end.coords))[0].numpy()
    return moved, float(sampler.acceptance_fraction.mean())


@pytest.mark.parametrize(
    ("kind", "way"), [("mag", "exchange"), ("flux", "exchange"), ("mag", "evolution"), ("mag", "jump")]
)
def test_the_prior_stays_where_data_say_nothing(kind, way):
    """Independent draws of the prior, moved forty times, are still draws of the prior."""
    likelihood = problem(kind, 1e3)
    draws = likelihood.model.parameter_set.sample_prior(3000, torch.Generator().manual_seed(2))
    moved, acceptance = after_moves(likelihood, draws, 40, way)
    assert acceptance > (
        0.3 if way == "exchange" else 0.1
    )  # differences within a prior often lead beyond its bounds
    columns = dict(zip(likelihood.model.names, moved.T, strict=True))
    for material in ("body", "panel"):
        assert stats.kstest(np.log10(columns[f"{material}.n"]), stats.uniform(0, 6).cdf).pvalue > 1e-3
        for short in ("r_spec", "r_diff"):
            assert stats.kstest(columns[f"{material}.{short}"], stats.beta(1, 2).cdf).pvalue > 1e-3
    assert stats.kstest(columns["zero_point"], stats.norm(0, 0.3).cdf).pvalue > 1e-3


@pytest.mark.parametrize(
    ("kind", "way"), [("mag", "exchange"), ("flux", "exchange"), ("mag", "evolution"), ("flux", "jump")]
)
def test_a_posterior_stays(kind, way):
    """Exact draws, by rejection from the prior, are still draws of the same posterior after thirty moves."""
    likelihood = problem(kind, {"mag": 1.5, "flux": 0.8}[kind])
    generator = torch.Generator().manual_seed(4)
    prior = likelihood.model.parameter_set.sample_prior(400_000, generator)
    with torch.no_grad():
        log = torch.cat([likelihood.log_likelihood(part) for part in prior.split(50_000)])
    kept = prior[torch.rand(len(prior), generator=generator, dtype=log.dtype) < torch.exp(log - log.max())]
    assert len(kept) > 2000
    half = min(len(kept) // 2, 4000)
    moved, acceptance = after_moves(likelihood, kept[:half], 30, way)
    assert acceptance > (0.1 if way == "exchange" else 0.05)
    exact = kept[half:].numpy()
    for column, name in enumerate(likelihood.model.names):
        assert stats.ks_2samp(moved[:, column], exact[:, column]).pvalue > 1e-3, name
    sums = [draws[:, 1] + draws[:, 2] for draws in (moved, exact)]
    assert max(sums[0]) <= 1.0 and stats.ks_2samp(*sums).pvalue > 1e-3


def test_reflectances_alone_are_drawn_almost_from_their_posterior():
    """With nothing but reflectances to draw and 0.02 mag, more than two in five draws are accepted."""
    likelihood = problem("mag", 0.02, lobes=154.244)
    redraw = Redraw(likelihood, likelihood.model.parameter_set.start())
    redraw.others, redraw.alike = [], []
    x = likelihood.model.parameter_set.to_straight(likelihood.model.parameter_set.start()).repeat(200, 1)
    move = emcee.moves.MHMove(redraw)
    sampler = emcee.EnsembleSampler(*x.shape, log_density(likelihood), moves=move, vectorize=True)
    state = emcee.State(x.numpy(), random_state=np.random.RandomState(0).get_state())
    sampler.run_mcmc(state, 40, skip_initial_state_check=True)
    assert sampler.acceptance_fraction.mean() > 0.4


def test_the_density_of_a_draw_integrates_to_one():
    """The mean of 1 / density over draws is the volume they may lie in: 1/3 for each pair, whose second
    straight coordinate r_diff (1 - r_spec) runs to (1 - r_spec)^2.
    """
    likelihood = problem("mag", 0.5)
    redraw = Redraw(likelihood, likelihood.model.parameter_set.start())
    count, names = 100_000, likelihood.model.names
    assert [names[i] for i in redraw.linear] == ["body.r_spec", "body.r_diff", "panel.r_spec", "panel.r_diff"]
    generator = torch.Generator().manual_seed(5)
    x = torch.zeros(count, len(names), dtype=torch.float64)
    mean = torch.tensor([0.3, 0.2, 0.6, 0.1], dtype=torch.float64).expand(count, 4)
    mixing = torch.tensor(
        [[0.5, 0, 0, 0], [-0.2, 0.4, 0, 0], [0.1, 0.2, 0.5, 0], [0.1, -0.1, -0.3, 0.3]], dtype=torch.float64
    ).expand(count, 4, 4)
    uniform = torch.rand(count, 4, generator=generator, dtype=torch.float64)
    drawn, density = redraw.truncated(x, mean, mixing, uniform)
    again, same = redraw.truncated(drawn, mean, mixing)
    torch.testing.assert_close(again, drawn, rtol=0, atol=0)
    torch.testing.assert_close(same, density, rtol=1e-12, atol=1e-12)
    weight = torch.exp(-density)
    error = float(weight.std()) / math.sqrt(count)
    assert error < 0.005 and float(weight.mean()) == pytest.approx(1 / 9, abs=4 * error)


@pytest.mark.parametrize(
    ("a", "b"),
    [(-1.0, 2.0), (-0.001, 0.001), (-8.0, -7.0), (5.0, 30.0), (-40.0, -38.0), (20.0, 20.5), (-300.0, 200.0)],
)
def test_the_cut_normal_distribution_is_scipys(a, b):
    reference = stats.truncnorm(a, b)
    p = np.array([1e-9, 1e-3, 0.2, 0.5, 0.9, 1 - 1e-6])
    cut = CutNormal(*(torch.full((len(p),), one, dtype=torch.float64) for one in (a, b)))
    x = cut.quantile(torch.as_tensor(p)).numpy()
    assert np.all((x >= a) & (x <= b))
    np.testing.assert_allclose(x, reference.ppf(p), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(
        cut.log_density(torch.as_tensor(x)).numpy(), reference.logpdf(x), rtol=1e-9, atol=1e-9
    )


def test_a_regression_of_the_last_move_is_the_same_again():
    """Some walkers where the move found them, some where it left them, with other reflectances, some elsewhere."""
    likelihood = problem("mag", 0.1)
    parameters = likelihood.model.parameter_set
    generator = torch.Generator().manual_seed(7)
    old, new, third, other = (
        parameters.to_straight(parameters.sample_prior(30, generator)) for _ in range(4)
    )
    redraw = Redraw(likelihood, parameters.start())
    with torch.no_grad():
        redraw.regressions(old, new)
        old[10:20], old[20:] = new[10:20], other[20:]
        old[:, redraw.linear] *= 0.5
        known = redraw.regressions(old, third)
        for one, fresh in zip(known, redraw.regression(torch.cat([old, third])), strict=True):
            torch.testing.assert_close(one, fresh, rtol=1e-9, atol=1e-12)


def test_a_row_that_outweighs_all_others_leaves_a_distribution_to_draw_from():
    """One magnitude of 89.9 among ordinary ones: its weight in flux is 1e62 times theirs, beyond the digits of a number."""
    likelihood = problem("mag", 0.1)
    assert likelihood.observed_flux is not None
    flux = likelihood.observed_flux.clone()
    flux[0] *= 1e-31
    likelihood.observed_flux = flux
    parameters = likelihood.model.parameter_set
    redraw = Redraw(likelihood, parameters.start())
    x = parameters.to_straight(parameters.sample_prior(20, torch.Generator().manual_seed(7)))
    with torch.no_grad():
        mean, spread = redraw.regression(x)
    assert torch.isfinite(mean).all() and torch.isfinite(spread).all()
    assert (spread.diagonal(dim1=-2, dim2=-1) > 0).all()
