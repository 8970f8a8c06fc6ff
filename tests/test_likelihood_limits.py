"""Upper limits and errors that are fitted: what they cost, what they say, and what is told."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats

from tests.effects.cases import PLATE, material, seen_from, still, tilted
from tests.noisy_rows import (
    FREE,
    KNOWN,
    MAG_PER_LN,
    NOISE,
    RED,
    TAU,
    listed,
    noise_of,
    recorded,
)
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.lightcurve.model import LightCurve
from torchlc.scene import Scene
from torchlc.stages.noise import Noise

GLOSSY = (
    '[materials.white]\nn = {value = 30.0, low = 1.0, high = 1e4, prior = "loguniform"}\n'
    "r_spec = {value = 0.3, low = 0.0, high = 1.0}\nr_diff = {value = 0.3, low = 0.0, high = 1.0}\n"
    '[materials.black]\nmodel = "lambert"\nalbedo = 0.0\n'
)


@pytest.mark.parametrize("noise", [*NOISE, "fitted"])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_a_looser_limit_never_costs_more(seven, kind, noise):
    """From far fainter than the model to far brighter; a hopelessly loose one costs nothing."""
    likelihood, _, theta = recorded(seven, kind, [6], fitted=noise == "fitted")
    found = likelihood.residuals(theta)
    used = Noise() if noise == "fitted" else noise_of(noise, likelihood)
    unit = found.sigma[6] if found.sigma.ndim else found.sigma
    looser = torch.linspace(-30, 200, 116, dtype=torch.float64)[:, None] * unit * likelihood.fainter
    delta = found.delta.repeat(116, 1)
    delta[:, 6] = looser[:, 0]
    log_p = likelihood.density(replace(found, delta=delta), used)
    assert (torch.diff(log_p) >= -1e-9).all()
    without, _, _ = recorded(seven, kind, [6], fitted=noise == "fitted")
    kept = without.model.recording.keep(np.arange(7) != 6, "for a test")
    rest = Likelihood(LightCurve(without.model.scene, kept)).log_likelihood(theta, used)
    assert float(log_p[-1]) == pytest.approx(float(rest), abs=1e-6)


@pytest.mark.parametrize("measured", [1, 2, 12], ids="{} measured".format)
@pytest.mark.parametrize("rows", [1, 2, 12], ids="{} rows".format)
@pytest.mark.parametrize("fitted", [False, True], ids=["quoted", "fitted"])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_corners_of_the_priors_have_a_density_and_slopes(tmp_path, kind, fitted, rows, measured):
    """A plate of dark rows, whose glint, limits and reflectances at their bounds put residuals up to 1e10 errors out; and a model
    that goes through every row. Under every noise there is a finite number with finite slopes, and three of one theta
    have it."""
    scene = still(PLATE + 'back_material = "black"\n', GLOSSY)
    recording = seen_from(scene, tmp_path, tilted(np.linspace(0, 170, 12)), tilted(10, 180))
    recording = recording.keep(np.arange(12) < rows, "cut")
    light = LightCurve(scene, recording).brightness().flux.detach().numpy()
    light = light / light.max()
    recording = replace(
        recording,
        kind=kind,
        observed=light if kind == "flux" else -2.5 * np.log10(np.maximum(light, 1e-3)),
        error=None if fitted else np.full(rows, 0.03),
        upper_limit=np.arange(rows) >= measured,
    )
    for effects in (
        [],
        ["jitter"],
        ["outliers"],
        ["red_noise"],
        ["outliers", "jitter"],
        ["red_noise", "jitter"],
    ):
        if fitted and "jitter" in effects:
            continue  # the level is fitted
        likelihood = Likelihood(LightCurve(scene, recording, effects=effects))
        free = likelihood.model.parameter_set.free
        start = likelihood.model.theta().detach()
        dull = start.clone()
        dull[[k for k, one in enumerate(free) if "r_" in one.name]] = 0.0
        ends = [[one.prior.low for one in free], [min(one.prior.high, 1e9) for one in free]]
        for theta in (start, dull, *torch.tensor(ends, dtype=torch.float64)):
            leaf = theta.clone().requires_grad_()
            value = likelihood.log_likelihood(leaf)
            (slope,) = torch.autograd.grad(value, leaf)
            assert torch.isfinite(value) and torch.isfinite(slope).all(), (effects, theta, slope)
            batch = likelihood.log_likelihood(theta.repeat(3, 1))
            torch.testing.assert_close(batch, value.detach().expand(3), rtol=1e-10, atol=1e-9)


def test_the_gain_is_that_of_the_measured_rows(seven):
    """Whatever limits say, and a curve of nothing but limits says nothing."""
    scene, rows = seven
    light = 10 ** (-0.4 * LightCurve(scene, rows)().detach().numpy())
    light = light / light[0]
    values = []
    for limit in (0.36, 0.5, 1.0, 3.0):
        observed = np.where(np.arange(7) == 6, limit, 2.0 * light)
        recording = replace(
            rows, kind="flux", observed=observed, error=np.full(7, 0.02), upper_limit=np.arange(7) == 6
        )
        likelihood = Likelihood(LightCurve(scene, recording))
        theta = likelihood.model.theta().detach()
        assert likelihood.residuals(theta).gain.item() == pytest.approx(
            2.0 * float(1 / likelihood.model.brightness(theta).flux[0]), rel=1e-9
        )
        expected = 6 * stats.norm.logpdf(0, scale=0.02) + stats.norm.logcdf((limit - 2 * light[6]) / 0.02)
        assert float(likelihood.log_likelihood(theta)) == pytest.approx(expected, rel=1e-9)
        values.append(float(likelihood.log_likelihood(theta)))
        alone = replace(recording, upper_limit=np.ones(7, dtype=bool))
        mute = Likelihood(LightCurve(scene, alone))
        # P(0 < limit) of every row, whatever the model's light
        expected = stats.norm.logcdf(observed / 0.02).sum()
        assert float(mute.log_likelihood(theta)) == pytest.approx(expected, abs=1e-12)
        assert mute.gains == 0 and any("say nothing" in text for text in mute.remarks(theta))
    assert values == sorted(values)


def lobe(folder: Path, kind: str, seed: int, error: str = "quoted"):
    """A plate's lobe of n = 40 in sixty rows, of which the 36 faintest are only known to be fainter than a limit."""
    scene = still(
        PLATE,
        '[materials.white]\nn = {value = 150.0, low = 1.0, high = 1e4, prior = "loguniform"}\nr_spec = 0.3\nr_diff = 0.01\n',
    )
    truth = still(PLATE, material("white", 40.0, 0.3, 0.01))
    across = np.linspace(-60, 60, 60) + 20
    rows = seen_from(
        scene, folder, np.tile(tilted(20), (60, 1)), tilted(np.abs(across), np.where(across < 0, 0, 180))
    )
    mag = LightCurve(truth, rows)().detach().numpy()
    generator = np.random.default_rng(seed)
    if kind == "mag":
        observed, sigma = mag + 0.05 * generator.normal(size=60), np.full(60, 0.05)
        edge = np.sort(observed)[24]
        limit = observed >= edge
    else:
        flux = 10 ** (-0.4 * (mag - mag.min()))
        observed, sigma = flux + 0.02 * generator.normal(size=60), np.full(60, 0.02)
        edge = np.sort(observed)[-25]
        limit = observed <= edge
    recording = replace(
        rows,
        kind=kind,
        observed=np.where(limit, edge, observed),
        error=sigma if error == "quoted" else None,
        upper_limit=limit,
    )
    assert limit.sum() == 36
    return Likelihood(LightCurve(scene, recording))


@pytest.mark.parametrize("error", ["quoted", "fitted"])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_a_lobe_of_which_most_rows_are_limits(tmp_path, kind, error):
    """n of six recordings: each within 4 of its standard deviations of 40, their mean within 3 of its own."""
    off = []
    for seed in range(6):
        found = fit_map(lobe(tmp_path, kind, seed, error), starts=8, adam_steps=60)
        sd = math.sqrt(float(found.modes[0].covariance[0, 0]))  # of ln n
        off.append((math.log(float(found.theta)) - math.log(40.0)) / sd)
        assert found.dof == 24 - 1 - (kind == "flux")
    assert np.max(np.abs(off)) < 4 and abs(np.mean(off)) < 3 / math.sqrt(6)


def test_limits_that_the_model_breaks_are_told(seven):
    likelihood, _, theta = recorded(seven, "mag", [3])
    assert likelihood.remarks(theta) == []
    bright = replace(likelihood.model.recording, observed=likelihood.model.recording.observed + 1.0)
    told = Likelihood(LightCurve(seven[0], bright)).remarks(theta)
    assert told == ["the model is brighter than 1 of 1 upper limits allow"]


def test_no_error_column_and_limits(tmp_path):
    """Albedo 0.5 of a plate of which half the rows are limits two magnitudes brighter than it: as without them."""
    scene = still(PLATE, FREE)
    rows = seen_from(scene, tmp_path, np.tile(tilted(20), (200, 1)), tilted(10, 180))
    mag = LightCurve(still(PLATE, KNOWN), rows)().detach().numpy()
    observed = mag + 0.1 * np.random.default_rng(0).normal(size=200)
    limit = np.arange(200) % 2 == 1
    recording = replace(rows, observed=np.where(limit, mag - 2.0, observed), error=None, upper_limit=limit)
    found = fit_map(Likelihood(LightCurve(scene, recording)), starts=4, adam_steps=30)
    best = 0.5 * 10 ** (-0.4 * (observed - mag)[~limit].mean())
    assert float(found.theta) == pytest.approx(best, rel=1e-4)
    level = found.likelihood.fitted_levels(found.likelihood.residuals(found.theta).delta)
    assert float(level) == pytest.approx((observed - mag)[~limit].std(ddof=1), rel=1e-3)


@pytest.mark.parametrize("limits", [0.0, 0.3])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_red_noise_without_errors_takes_the_best_level_of_white_noise(tmp_path, kind, limits):
    """SciPy's normal density of the measured rows at 60 levels: at that of the steps it is within 0.5 of the largest (0.42 in 48
    draws), and limits far from the model neither change that nor count."""
    scene = still(PLATE, FREE)
    rows = seen_from(scene, tmp_path, np.tile(tilted(20), (60, 1)), tilted(10, 180))
    mag = LightCurve(still(PLATE, KNOWN), rows)().detach().numpy()
    gap = math.sqrt(3) * np.abs(rows.seconds[:, None] - rows.seconds) / 60 / TAU
    shared = (1 + gap) * np.exp(-gap) * RED**2
    for seed in range(6):
        random = np.random.default_rng(seed)
        off = random.multivariate_normal(np.zeros(60), shared + 0.05**2 * np.eye(60))
        limit = random.random(60) < limits
        observed = np.where(limit, mag - 0.6, mag + off)
        if kind == "flux":
            observed = np.where(limit, 6.0, 3 - 3 * off / MAG_PER_LN)
        recording = replace(rows, kind=kind, observed=observed, error=None, upper_limit=limit)
        likelihood = Likelihood(LightCurve(scene, recording))
        theta = torch.tensor([0.5], dtype=torch.float64)
        found = likelihood.residuals(theta)
        seen, unit = ~limit, found.scale.numpy()
        covariance = (shared * unit[:, None] * unit)[np.ix_(seen, seen)]
        levels = unit.mean() * np.geomspace(0.005, 0.3, 60)
        best = max(
            stats.multivariate_normal.logpdf(
                found.delta.numpy()[seen], cov=covariance + level**2 * np.eye(seen.sum())
            )
            for level in levels
        )
        value = float(likelihood.log_likelihood(theta, noise_of("red noise", likelihood)))
        assert value == pytest.approx(best, abs=0.5)


def test_a_level_that_is_not_fitted_is_told(seven):
    scene = Scene.from_toml(listed('["red_noise"]'), Path())
    _, rows = seven
    for error, count in ((None, 1), (np.full(7, 0.05), 0)):
        model = LightCurve(scene, replace(rows, error=error))
        told = Likelihood(model).remarks(model.theta())
        assert sum("the white noise beside red_noise" in text for text in told) == count
