"""Likelihood, Adam, Levenberg-Marquardt and whole fits, against scipy, numpy and torch.optim."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import integrate, optimize, stats

import torchlc
from tests.good_input import SCENE
from torchlc.inference.ensemble import log_density
from torchlc.inference.likelihood import Likelihood, magnitude_difference
from torchlc.inference.optimiser import adam, fit_map
from torchlc.inference.polish import laplace, polish
from torchlc.noise.outliers import Mixture
from torchlc.noise.red_noise import Matern32
from torchlc.stages.noise import Noise
from torchlc.tensors.least_squares import differences, minimise

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "examples" / "paper"))

import setting  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func's own
DEMO = ROOT / "torchlc" / "demo"
PANEL = {"body": setting.TABLE_3[1]["body"], "panel": setting.FREE}
NIGHT = {"start": "2020-10-17T14:00:00", "hours": 7.0}


def observed(truth, scene, path, noise=0.02, cadence=900.0, seed=1, use=None, **night):
    """A recording of ``truth`` read back for ``scene``."""
    curve = torchlc.simulate(truth, **(NIGHT | night), cadence=cadence, noise=noise, seed=seed)
    curve.write(path / "curve.ecsv")
    return torchlc.load(scene, path / "curve.ecsv", use=use)[1]


@pytest.fixture(scope="module")
def panel_night(tmp_path_factory):
    """Object 1 with the body known: panel.n, r_spec and r_diff are to be found."""
    scene = setting.object_1(PANEL)
    return scene, observed(setting.object_1(), scene, tmp_path_factory.mktemp("night"))


@pytest.fixture(scope="module")
def demo():
    return Likelihood(torchlc.LightCurve(*torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")))


# ------------------------------------------------------------------ one module for Adam and emcee


def test_the_sampler_calls_the_module_that_adam_trains(demo):
    """Batched and without gradients, emcee's log-probability is -chi2/2 + log prior of the gradient path.

    The constant between them, - sum ln(sigma sqrt(2 pi)), is that of normal errors.
    """
    model = demo.model
    parameters = model.parameter_set
    theta = parameters.sample_prior(32, torch.Generator().manual_seed(3))
    batched = log_density(demo)(parameters.to_straight(theta).numpy())
    sigma = torch.as_tensor(model.recording.error)
    constant = -torch.log(sigma * math.sqrt(2 * math.pi)).sum()
    for row, value in zip(theta, batched, strict=True):
        x = parameters.to_straight(row).requires_grad_(True)
        natural, log_det = parameters.from_straight(x)
        residual = demo.residuals(natural).delta / sigma
        one = -0.5 * residual.square().sum() + parameters.log_prior(natural) + log_det + constant
        (slope,) = torch.autograd.grad(one, x)
        assert torch.isfinite(slope).all()
        assert float(value) == pytest.approx(float(one.detach()), rel=1e-12)


def test_straight_coordinates_carry_their_jacobian(demo):
    """log |d theta / d x| against the determinant of the Jacobian by torch.func; there and back again."""
    parameters = demo.model.parameter_set
    for row in parameters.sample_prior(8, torch.Generator().manual_seed(4)):
        x = parameters.to_straight(row)
        natural, log_det = parameters.from_straight(x)
        torch.testing.assert_close(natural, row, rtol=1e-12, atol=1e-14)
        jacobian = torch.func.jacfwd(lambda point: parameters.from_straight(point)[0])(x)
        assert float(log_det) == pytest.approx(float(torch.linalg.slogdet(jacobian)[1]), rel=1e-10)


def test_a_fit_keeps_the_module_it_was_given(panel_night):
    likelihood = Likelihood(torchlc.LightCurve(*panel_night))
    assert fit_map(likelihood, starts=2, adam_steps=2).model is likelihood.model


# ------------------------------------------------------------------ likelihood


def test_magnitude_likelihood_is_normal(panel_night):
    likelihood = Likelihood(torchlc.LightCurve(*panel_night))
    theta = likelihood.model.parameter_set.start()
    model = likelihood.model(theta).numpy()
    recording = likelihood.model.recording
    expected = stats.norm.logpdf(recording.observed, model, recording.error).sum()
    assert float(likelihood.log_likelihood(theta)) == pytest.approx(expected, rel=1e-12)
    chi2 = (((recording.observed - model) / recording.error) ** 2).sum()
    assert float(likelihood.chi2(theta)) == pytest.approx(chi2, rel=1e-12)


def test_jitter_is_added_in_quadrature(panel_night):
    likelihood = Likelihood(torchlc.LightCurve(*panel_night))
    theta = likelihood.model.parameter_set.start()
    recording = likelihood.model.recording
    noise = Noise().wider(torch.tensor([0.05], dtype=torch.float64))
    width = np.hypot(recording.error, 0.05)
    expected = stats.norm.logpdf(recording.observed, likelihood.model(theta).numpy(), width).sum()
    assert float(likelihood.log_likelihood(theta, noise)) == pytest.approx(expected, rel=1e-12)


def test_red_noise_is_a_gaussian_process(panel_night):
    likelihood = Likelihood(torchlc.LightCurve(*panel_night))
    theta = likelihood.model.parameter_set.start()
    recording = likelihood.model.recording
    red, tau = (torch.tensor([value], dtype=torch.float64) for value in (0.04, 35.0))
    gap = np.abs(recording.seconds[:, None] - recording.seconds) / 60.0 * math.sqrt(3) / 35.0
    covariance = 0.04**2 * (1 + gap) * np.exp(-gap) + np.diag(recording.error**2)
    expected = stats.multivariate_normal.logpdf(
        recording.observed, likelihood.model(theta).numpy(), covariance
    )
    process = Matern32(red, tau, likelihood.model.assembly.context.seconds)
    found = likelihood.log_likelihood(theta, Noise().with_process(process))
    assert float(found) == pytest.approx(expected, rel=1e-9)


def test_outliers_are_a_mixture(panel_night):
    likelihood = Likelihood(torchlc.LightCurve(*panel_night))
    theta = likelihood.model.parameter_set.start()
    recording, model = likelihood.model.recording, likelihood.model(theta).numpy()
    share, width = (torch.tensor([value], dtype=torch.float64) for value in (0.1, 8.0))
    narrow = stats.norm.pdf(recording.observed, model, recording.error)
    wide = stats.norm.pdf(recording.observed, model, 8.0 * recording.error)
    safe = np.isfinite(np.log(0.9 * narrow + 0.1 * wide))
    rows = Likelihood(torchlc.LightCurve(panel_night[0], recording.keep(safe, "underflow of the check")))
    expected = np.log(0.9 * narrow + 0.1 * wide)[safe].sum()
    found = rows.log_likelihood(theta, Noise().with_law(Mixture(share, width)))
    assert float(found) == pytest.approx(expected, rel=1e-10)


def test_an_upper_limit_counts_as_a_probability(panel_night):
    scene, recording = panel_night
    limits = np.zeros(len(recording), dtype=bool)
    limits[::3] = True
    likelihood = Likelihood(torchlc.LightCurve(scene, replace(recording, upper_limit=limits)))
    theta = likelihood.model.parameter_set.start()
    model = likelihood.model(theta).numpy()
    seen = stats.norm.logpdf(recording.observed, model, recording.error)[~limits].sum()
    unseen = stats.norm.logsf(recording.observed, model, recording.error)[
        limits
    ].sum()  # fainter than the limit
    assert float(likelihood.log_likelihood(theta)) == pytest.approx(seen + unseen, rel=1e-9)


def test_the_gain_of_relative_flux_is_a_weighted_least_square(tmp_path):
    scene = setting.object_1(PANEL)
    recording = observed(setting.object_1(), scene, tmp_path, use="flux")
    half = np.arange(len(recording)) % 2
    recording = replace(
        recording, curve=half, curve_ids=("a", "b"), observed=recording.observed * np.where(half, 7.0, 2.0)
    )
    likelihood = Likelihood(torchlc.LightCurve(scene, recording))
    theta = likelihood.model.parameter_set.start()
    found = likelihood.residuals(theta)
    flux = likelihood.model(theta).numpy()
    assert found.gain is not None and likelihood.degrees_of_freedom == len(recording) - 3 - 2
    for one in (0, 1):
        rows = half == one
        weight = 1 / recording.error[rows]
        gain, rest, *_ = np.linalg.lstsq(
            (flux[rows] * weight)[:, None], recording.observed[rows] * weight, rcond=None
        )
        assert float(found.gain[one]) == pytest.approx(gain[0], rel=1e-10)
        chi2 = float(((found.delta / found.sigma)[torch.as_tensor(rows)] ** 2).sum())
        assert chi2 == pytest.approx(rest[0], rel=1e-8)


def test_an_unknown_noise_level_is_integrated_out(panel_night):
    """The log-uniform level of a curve without errors: against quadrature over its logarithm."""
    scene, recording = panel_night
    likelihood = Likelihood(torchlc.LightCurve(scene, replace(recording, error=None)))
    at = torch.tensor(
        [[154.0, 0.0325, 0.0172], [160.0, 0.032, 0.018], [150.0, 0.033, 0.025]], dtype=torch.float64
    )
    found = likelihood.log_likelihood(at).numpy()
    floor = len(recording) * (1e-3 * float(likelihood.noise_level[0])) ** 2
    expected = []
    for row in at:
        squares = float(((recording.observed - likelihood.model(row).numpy()) ** 2).sum()) + floor
        count, centre = len(recording), 0.5 * math.log(squares / len(recording))

        def density(log_level, squares=squares, count=count, centre=centre):
            shift = count * centre + 0.5 * count
            return math.exp(-count * log_level - 0.5 * squares / math.exp(2 * log_level) + shift)

        value, _ = integrate.quad(density, centre - 3, centre + 3, epsabs=0, epsrel=1e-12)
        expected.append(math.log(value) - count * centre - 0.5 * count - 0.5 * count * math.log(2 * math.pi))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_dark_model_is_finite_and_continuous():
    """Below a hundredth of the datum the magnitude continues along its tangent."""
    ratio = torch.tensor(
        [0.0, 0.01 * (1 - 1e-9), 0.01 * (1 + 1e-9), 1.0, 2.0], dtype=torch.float64, requires_grad=True
    )
    value = magnitude_difference(ratio)
    (slope,) = torch.autograd.grad(value.sum(), ratio)
    assert torch.isfinite(value).all() and torch.isfinite(slope).all()
    value, slope = value.detach(), slope.detach()
    assert float(value[1] - value[2]) == pytest.approx(0.0, abs=1e-7)
    assert float(slope[1] / slope[2]) == pytest.approx(1.0, rel=1e-8)
    np.testing.assert_allclose(value[3:].numpy(), -2.5 * np.log10([1.0, 2.0]), atol=1e-15)


# ------------------------------------------------------------------ optimisers


def test_adam_is_that_of_torch(panel_night):
    likelihood = Likelihood(torchlc.LightCurve(*panel_night))
    parameters = likelihood.model.parameter_set
    start = parameters.sample_prior(4, torch.Generator().manual_seed(2))
    steps, rate = 30, 0.08
    found, history = adam(likelihood, start, steps, rate=rate)
    leaf = torch.nn.Parameter(parameters.to_unconstrained(start).clone())
    optimizer = torch.optim.Adam([leaf], lr=rate, eps=1e-12)
    best = []
    for step in range(1, steps + 1):
        optimizer.param_groups[0]["lr"] = rate * (0.55 + 0.45 * math.cos(math.pi * step / steps))
        optimizer.zero_grad()
        chi2 = likelihood.chi2(parameters.to_natural(leaf))
        (0.5 * chi2.sum()).backward()
        optimizer.step()
        best.append(float(chi2.detach().min()))
    np.testing.assert_allclose(history, best, rtol=1e-9)
    torch.testing.assert_close(found, parameters.to_natural(leaf.detach()), rtol=1e-8, atol=1e-12)


def test_levenberg_marquardt_against_scipy():
    """Rosenbrock's valley in a box that cuts its minimum off, and a fit of three exponentials."""
    box = (torch.tensor([-2.0, -1.0], dtype=torch.float64), torch.tensor([0.7, 2.0], dtype=torch.float64))
    start = torch.tensor([[-1.2, 1.0], [0.0, 0.0], [0.5, 1.9]], dtype=torch.float64)

    def valley(y):
        return torch.stack([10 * (y[..., 1] - y[..., 0] ** 2), 1 - y[..., 0]], -1)

    found = minimise(valley, start, *box, iterations=200)
    expected = optimize.least_squares(
        lambda y: valley(torch.as_tensor(y)).numpy(), [0.0, 0.0], bounds=([-2, -1], [0.7, 2])
    )
    np.testing.assert_allclose(found.y.numpy(), np.tile(expected.x, (3, 1)), atol=1e-4)
    assert bool(found.converged.all())

    t = torch.linspace(0, 4, 40, dtype=torch.float64)
    data = 2.0 * torch.exp(-1.3 * t) + 0.3 + 0.02 * torch.sin(40 * t)

    def decay(y):
        return y[..., :1] * torch.exp(-y[..., 1:2] * t) + y[..., 2:3] - data

    free = torch.full((3,), torch.inf, dtype=torch.float64)
    found = minimise(decay, torch.tensor([[1.0, 1.0, 0.0]], dtype=torch.float64), -free, free)
    expected = optimize.least_squares(lambda y: decay(torch.as_tensor(y)).numpy(), [1.0, 1.0, 0.0])
    np.testing.assert_allclose(found.y[0].numpy(), expected.x, rtol=1e-5)
    np.testing.assert_allclose(found.cost[0].numpy(), 2 * expected.cost, rtol=1e-10)


def test_laplace_covariance_is_that_of_linear_regression():
    rng = np.random.default_rng(0)
    design = rng.normal(size=(50, 3))
    wide = torch.full((3,), torch.inf, dtype=torch.float64)
    covariance, held = laplace(torch.as_tensor(design), torch.zeros(3, dtype=torch.float64), -wide, wide)
    np.testing.assert_allclose(covariance.numpy(), np.linalg.inv(design.T @ design), rtol=1e-10)
    assert not held.any()


# ------------------------------------------------------------------ whole fits


def test_a_noiseless_recording_gives_its_truth_back(tmp_path):
    scene = setting.object_1(PANEL)
    recording = observed(setting.object_1(), scene, tmp_path, noise=0.02)
    clean = replace(recording, observed=torchlc.simulate(setting.object_1(), recording).mag)
    found = fit_map(Likelihood(torchlc.LightCurve(scene, clean)))
    assert found.converged and found.chi2 < 1e-6
    truth = [setting.TABLE_3[1]["panel"][name.split(".")[1]] for name in found.model.names]
    np.testing.assert_allclose(found.theta.numpy(), truth, rtol=1e-4)


@pytest.mark.parametrize("use", ["mag", "flux"])
def test_a_noisy_recording_gives_its_truth_back_within_the_errors(tmp_path, use):
    """chi-square of truth minus fit under the Laplace covariance: 3 degrees of freedom (magnitudes)."""
    scene = setting.object_1(PANEL)
    found = fit_map(
        Likelihood(torchlc.LightCurve(scene, observed(setting.object_1(), scene, tmp_path, use=use)))
    )
    assert found.converged and found.p_value > 1e-3
    truth = torch.tensor([setting.TABLE_3[1]["panel"][name.split(".")[1]] for name in found.model.names])
    parameters = found.model.parameter_set
    offset = parameters.to_flat(truth.double()) - parameters.to_flat(found.theta)
    mode = found.modes[0]
    distance = float(offset @ torch.linalg.solve(mode.covariance, offset))
    assert distance < stats.chi2.ppf(0.999, 3)


def test_polish_finds_what_scipy_finds(panel_night):
    likelihood = Likelihood(torchlc.LightCurve(*panel_night))
    parameters = likelihood.model.parameter_set
    low, high = (bound.numpy() for bound in parameters.flat_bounds())

    def residual(y):
        with torch.no_grad():
            return likelihood.normalised(
                likelihood.residuals(parameters.from_flat(torch.as_tensor(y)))
            ).numpy()

    start = parameters.to_flat(parameters.start())
    found = polish(likelihood, parameters.start()[None], None)
    expected = optimize.least_squares(residual, start.numpy(), bounds=(low, high), xtol=1e-12, ftol=1e-12)
    assert float(found.cost[0]) == pytest.approx(2 * expected.cost, rel=1e-6)
    np.testing.assert_allclose(found.y[0].numpy(), expected.x, rtol=1e-4)


def test_polish_where_parts_shade_each_other(tmp_path):
    """A panel in front of the body, its size and an attitude offset free. Slopes along them are followed on the way; at the
    end the minimum is one from which scipy, which takes differences of its own, goes no further, and the slopes are central
    differences there. (There are two minima, 0.03 apart in chi-square and by 1 in the offset.)
    """
    size = "[{ value = 1.7, sigma = 0.2, prior = 'normal' }, 6.6]"
    moved = SCENE.replace("[0, 5.75, 0]", "[0, 0, 2.5]").replace("[1.7, 6.6]", size)
    lines = '"attitude_offset.x" = { value = 0.0, sigma = 1.0, prior = "normal" }'
    scene = torchlc.Scene.from_toml(
        moved.replace('"self_shadowing"', '"self_shadowing", "attitude_offset"').replace(
            "zero_point = {", f"{lines}\nzero_point = {{"
        )
    )
    truth = torchlc.Scene.from_toml(moved.replace("value = 1.7", "value = 2.0"))
    recording = observed(truth, scene, tmp_path, cadence=1800.0)
    bare = torchlc.Scene.from_toml(moved.replace('"self_shadowing"', ""))
    dimmed = torchlc.simulate(truth, recording).mag - torchlc.simulate(bare, recording).mag
    assert float(np.nanmax(dimmed)) > 0.05
    likelihood = Likelihood(torchlc.LightCurve(scene, recording))
    parameters = likelihood.model.parameter_set
    assert likelihood.model.assembly.geometry_columns and likelihood.model.assembly.parts_meet
    low, high = (bound.numpy() for bound in parameters.flat_bounds())

    def residual(y):
        with torch.no_grad():
            natural = parameters.from_flat(torch.as_tensor(y))
            rows = likelihood.normalised(likelihood.residuals(natural))
            return torch.cat([rows, parameters.prior_residuals(natural)]).numpy()

    found = polish(likelihood, parameters.start()[None], None)
    start = parameters.to_flat(parameters.start()).numpy()
    at = found.y[0].numpy()
    onward = optimize.least_squares(residual, at, bounds=(low, high), xtol=1e-10, ftol=1e-10)
    # the polish ends where a step gains 1e-7 of the cost and 1
    assert float(found.cost[0]) == pytest.approx(2 * onward.cost, rel=1e-5)
    afresh = optimize.least_squares(residual, start, bounds=(low, high), xtol=1e-10, ftol=1e-10)
    assert float(found.cost[0]) == pytest.approx(2 * afresh.cost, abs=0.05)
    step = 1e-4 * np.eye(len(start))
    slopes = np.stack([(residual(at + one) - residual(at - one)) / 2e-4 for one in step], -1)
    # one-sided differences by 1e-6 are good to 1e-6 of the curvature; followed slopes would be some per cent off
    free = (at > low + 1e-3) & (at < high - 1e-3)
    near = np.abs(found.jacobian[0].numpy() - slopes)[:, free].max(0)
    assert (near < 2e-3 * np.abs(slopes[:, free]).max(0)).all()


def test_a_zero_point_per_night_is_the_mean_residual(tmp_path):
    """Two nights, one offset by 0.3 mag, nothing else free: each zero point is a weighted mean."""
    scene = setting.object_1()
    text = scene.to_toml().replace(
        "[model.parameters]", '[model.parameters]\nzero_point = { value = 0.0, sigma = 50.0, per = "night" }'
    )
    scene = torchlc.Scene.from_toml(text)
    recording = observed(setting.object_1(), scene, tmp_path, hours=31.0, cadence=3600.0)
    shift = np.where(recording.night == 1, 0.3, 0.0)
    found = fit_map(
        Likelihood(torchlc.LightCurve(scene, replace(recording, observed=recording.observed + shift)))
    )
    assert (
        found.model.names == [f"zero_point[{one}]" for one in recording.night_ids]
        and len(recording.night_ids) == 2
    )
    clean = torchlc.simulate(setting.object_1(), recording).mag
    for index, value in enumerate(found.theta.tolist()):
        rows = recording.night == index
        residual = (recording.observed + shift - clean)[rows]
        assert value == pytest.approx(np.average(residual, weights=recording.error[rows] ** -2), abs=1e-6)


def test_errors_that_are_too_small_get_a_jitter(tmp_path):
    scene = setting.object_1(PANEL)
    recording = observed(setting.object_1(), scene, tmp_path, noise=0.03, cadence=450.0)
    quoted = replace(recording, error=recording.error / 3)
    result = torchlc.fit(scene, quoted, steps=400)
    jitter = result.parameters()["jitter.mag"]
    # 1 / sqrt(2 * 57 rows) is 9 %
    assert jitter["median"] == pytest.approx(0.03 * math.sqrt(1 - 1 / 9), rel=0.35)
    assert any("jitter was added" in warning for warning in result.all_warnings)


def test_nothing_free_is_evaluated_and_not_sampled(tmp_path):
    scene = setting.object_1()
    recording = observed(scene, scene, tmp_path)
    result = torchlc.fit(scene, recording)
    expected = (((recording.observed - torchlc.simulate(scene, recording).mag) / recording.error) ** 2).sum()
    assert result.posterior is None
    assert result.to_json()["chi2"] == pytest.approx(expected, rel=1e-10)
    assert result.to_json()["dof"] == len(recording)


def test_slopes_where_nothing_is_free() -> None:
    """A scene whose every number is known has residuals, and no slopes."""

    def residual(y: torch.Tensor) -> torch.Tensor:
        return torch.arange(4.0, dtype=torch.float64).expand(len(y), 4)

    none = torch.zeros(2, 0, dtype=torch.float64)
    assert differences(residual, none, none[0], none[0]).shape == (2, 4, 0)
