"""Faint recordings: unbiased albedos, the scale on which rows are compared, and chi-square."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import integrate, interpolate, optimize, stats

from tests.effects.cases import PLATE, seen_from, still, tilted
from tests.noisy_rows import (
    FREE,
    KNOWN,
    MAG_PER_LN,
    NOISE,
    noise_of,
)
from torchlc.api import fit
from torchlc.diagnosis.gate import Battery, gate
from torchlc.diagnosis.hypotheses import Hypothesis
from torchlc.inference.density import Posterior
from torchlc.inference.likelihood import LEFT_WEAK_MAG, Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.inference.posterior import fitted_at
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.error_law import above_zero, error_powers, power_difference


def faint(folder: Path, ratio: float, rows: int, seed: int, spread: float = 0.0):
    """A white plate of albedo 0.5 whose flux has normal errors, of a size that differs from row to row by ``spread``;
    magnitudes and their errors are worked out from what was measured, if that is above 0."""
    scene = still(PLATE, FREE)
    recording = seen_from(scene, folder, np.tile(tilted(20), (rows, 1)), tilted(10, 180))
    flux = 10 ** (-0.4 * LightCurve(still(PLATE, KNOWN), recording)().detach().numpy())
    generator = np.random.default_rng(seed)
    sigma = flux / ratio * np.exp(spread * generator.normal(size=rows))
    measured = flux + sigma * generator.normal(size=rows)
    seen = measured > 0
    recording = recording.keep(seen, "without a magnitude")
    measured, sigma = measured[seen], sigma[seen]
    return (
        scene,
        replace(recording, observed=-2.5 * np.log10(measured), error=MAG_PER_LN * sigma / measured),
        measured,
        sigma,
    )


@pytest.mark.parametrize("spread", [0.0, 0.3])
@pytest.mark.parametrize("ratio", [2, 3, 5, 10, 50])
def test_albedo_at_low_signal_to_noise(tmp_path, ratio, spread):
    """Of 20,000 rows, whose mean is known to 1.0857 / ratio / 141 = 0.004 mag at 2; the bias of magnitudes is 0.31,
    0.16, 0.059, 0.015 mag."""
    scene, recording, _, _ = faint(tmp_path, ratio, 20_000, 3, spread)
    found = fit_map(Likelihood(LightCurve(scene, recording)), starts=2, adam_steps=20)
    assert 2.5 * math.log10(float(found.theta) / 0.5) == pytest.approx(0.0, abs=0.01)
    assert 1e-4 < found.p_value < 1 - 1e-4


@pytest.mark.long
def test_short_curves_with_errors_that_also_scatter(tmp_path):
    """200 curves of 20 rows at a signal-to-noise ratio of 3, errors scattered by 0.3 from row to row: the most probable albedo
    is on average within 0.01 mag of the mean of the fluxes by their known errors, the best there is (0.006 +- 0.002).
    Magnitudes are 0.13 mag off; where one curve in nine misses its law, 0.018."""
    albedos = torch.linspace(0.25, 0.85, 61, dtype=torch.float64)[:, None]
    off = []
    for seed in range(200):
        scene, recording, measured, sigma = faint(tmp_path, 3, 20, 1000 + seed, 0.3)
        likelihood = Likelihood(LightCurve(scene, recording))
        with torch.no_grad():
            spline = interpolate.CubicSpline(albedos[:, 0], -likelihood.log_likelihood(albedos))
        found = optimize.minimize_scalar(spline, bounds=(0.25, 0.85), method="bounded").x
        full = 10 ** (-0.4 * float(LightCurve(still(PLATE, KNOWN), recording)()[0].detach())) / 0.5
        known = np.sum(measured / sigma**2) / np.sum(1 / sigma**2) / full
        off.append(2.5 * math.log10(found / known))
    assert abs(np.mean(off)) < 0.01


@pytest.mark.parametrize(
    ("ratio", "sky", "fading", "within"),
    [
        *((3, sky, fading, 0.01) for sky in (0.0, 0.3, 1.0, 5.0) for fading in (0, 60)),
        (5, 0.0, 0, 0.01),
        (5, 1.0, 60, 0.01),
        (10, 0.0, 0, 0.01),
        *((2, sky, fading, LEFT_WEAK_MAG) for sky in (0.0, 0.3, 1.0) for fading in (0, 60)),
    ],
)
def test_albedo_of_counted_photons(tmp_path, ratio, sky, fading, within):
    """Poisson's counts of object and ``sky`` (over the object's), less the sky, with the root of what was counted for
    error, of a still plate and of one that turns by ``fading`` deg, to where it is half as bright. Albedo to 0.01 mag, of which
    0.004 are chance at 3; roots without their shift are 0.032 mag off at 3, 0.011 at 5, magnitudes 0.15 and 0.046, one power
    for all rows 0.016 (still) and 0.032 (turning) with a sky of 0.3. At 2 what the warning says."""
    scene = still(PLATE, FREE)
    angles = tilted(20 + fading * np.linspace(-1, 1, 20_000) ** 2)
    recording = seen_from(scene, tmp_path, angles, tilted(10, 180))
    mag = LightCurve(still(PLATE, KNOWN), recording)().detach().numpy()
    light = 10 ** (-0.4 * (mag - mag.min()))
    counts = ratio**2 * (1 + sky)
    counted = np.random.default_rng(2).poisson(counts * (light + sky))
    flux, error = (counted - sky * counts) / counts, np.sqrt(counted) / counts
    seen = flux > 0
    recording = replace(
        recording,
        observed=mag.min() - 2.5 * np.log10(np.where(seen, flux, 1.0)),
        error=MAG_PER_LN * np.where(seen, error, 1.0) / np.where(seen, flux, 1.0),
    ).keep(seen, "without a magnitude")
    found = fit_map(Likelihood(LightCurve(scene, recording)), starts=2, adam_steps=20)
    assert 2.5 * math.log10(float(found.theta) / 0.5) == pytest.approx(0.0, abs=within)


def test_the_scale_of_photons_beside_a_sky():
    """Differences are SciPy's integrals of dF / sigma(F) over the variance a + b F, in units of the slope at the datum; the
    height above a flux of 0 is the integral from there, and errors of the same curve give the same law back."""
    generator = np.random.default_rng(1)
    for sky, photons in ((1.0, 0.3), (1.0, 5.0), (0.02, 1.0)):
        flux = generator.uniform(0.05, 3.0, 60)
        error = MAG_PER_LN * np.sqrt(sky + photons * flux) / flux
        power = error_powers(flux, error, np.zeros(60, dtype=int), np.ones(60, dtype=bool))
        np.testing.assert_allclose(2 * (1 - power), photons * flux / (sky + photons * flux), rtol=1e-4)
        ratio = generator.uniform(0.02, 4.0, 60)
        delta, worth = power_difference(torch.as_tensor(ratio), torch.as_tensor(power))
        height = above_zero(worth, torch.as_tensor(power))
        for k, datum in enumerate(flux):

            def slope(f, datum=datum, sky=sky, photons=photons):
                return MAG_PER_LN / datum * math.sqrt((sky + photons * datum) / (sky + photons * f))

            assert float(delta[k]) == pytest.approx(
                integrate.quad(slope, datum, ratio[k] * datum)[0], rel=1e-4
            )
            assert float(height[k]) == pytest.approx(integrate.quad(slope, 0, ratio[k] * datum)[0], rel=1e-4)
            assert float(worth[k]) == pytest.approx(
                slope(ratio[k] * datum) * ratio[k] * datum / MAG_PER_LN, rel=1e-4
            )


@pytest.mark.parametrize(("ratio", "told"), [(2, True), (20, False)])
def test_a_chi_square_cut_by_limits_is_told(tmp_path, ratio, told):
    """Limits at three errors. The albedo is right to four of its errors, but of a ratio of 2 chi-square's p is below 1e-6."""
    rows = 2000
    scene = still(PLATE, FREE)
    recording = seen_from(scene, tmp_path, np.tile(tilted(20), (rows, 1)), tilted(10, 180))
    mag = LightCurve(still(PLATE, KNOWN), recording)().detach().numpy()
    measured = 1 + np.random.default_rng(4).normal(size=rows) / ratio
    faint_rows = measured < 3 / ratio
    faint_rows[0] = True
    shown = np.where(faint_rows, 3 / ratio, measured)
    shown[0] = 2.0  # a limit that says nothing, for every ratio has one
    recording = replace(
        recording,
        observed=mag - 2.5 * np.log10(shown),
        error=MAG_PER_LN / ratio / shown,
        upper_limit=faint_rows,
    )
    found = fit_map(Likelihood(LightCurve(scene, recording)), starts=2, adam_steps=20)
    assert 2.5 * math.log10(float(found.theta) / 0.5) == pytest.approx(
        0, abs=4 * MAG_PER_LN / ratio / math.sqrt(rows) * 2
    )
    assert (found.p_value < 1e-6) == told
    assert any("bright part of the noise" in text for text in found.likelihood.remarks(found.theta)) == told


def test_large_errors_of_an_unclear_law_are_told(tmp_path):
    """Fifty rows at a ratio of 3 with a constant error: magnitudes, which the table of biases says are 0.16 mag too bright."""
    scene, recording, _, _ = faint(tmp_path, 3, 50, 2)
    constant = replace(recording, error=np.full(len(recording), 0.33))
    theta = LightCurve(scene, constant).theta().detach()
    told = Likelihood(LightCurve(scene, constant)).remarks(theta)
    assert any("compared in magnitudes, which is 0.15 mag too bright" in text for text in told)
    precise = replace(recording, error=np.full(len(recording), 0.05))
    assert Likelihood(LightCurve(scene, precise)).remarks(theta) == []


@pytest.mark.parametrize("ratio", [2, 3, 10])
def test_rows_with_errors_of_the_measured_flux_are_normal_in_flux(tmp_path, ratio):
    """SciPy's normal density cut off at a flux of 0, times |d flux / d mag|."""
    scene, recording, measured, sigma = faint(tmp_path, ratio, 300, 1)
    likelihood = Likelihood(LightCurve(scene, recording))
    for albedo in (0.3, 0.5, 0.6):
        flux = likelihood.model.brightness(torch.tensor([albedo], dtype=torch.float64)).flux.numpy() * 10 ** (
            0.4 * 26.7
        )
        rows = stats.truncnorm.logpdf(measured, -flux / sigma, np.inf, flux, sigma)
        expected = (rows + np.log(measured / MAG_PER_LN)).sum()
        found = float(likelihood.log_likelihood(torch.tensor([albedo], dtype=torch.float64)))
        assert found == pytest.approx(expected, rel=1e-9)


def test_errors_that_do_not_follow_the_flux_are_of_magnitudes(tmp_path):
    """A constant error of 0.36 mag, and errors that vary by chance: normal in magnitudes to rounding."""
    scene, recording, _, _ = faint(tmp_path, 3, 300, 2)
    generator = np.random.default_rng(3)
    for error in (np.full(len(recording), 0.36), 0.3 * generator.uniform(0.5, 1.5, len(recording))):
        likelihood = Likelihood(LightCurve(scene, replace(recording, error=error)))
        theta = likelihood.model.theta().detach()
        model = likelihood.model(theta).numpy()
        expected = stats.norm.logpdf(recording.observed, model, error).sum()
        assert likelihood.power is None
        assert float(likelihood.log_likelihood(theta)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("noise", NOISE)
def test_slopes_at_low_signal_to_noise(tmp_path, noise):
    """No jump and no kink: the slope is that of central differences from a dark model to one ten times too bright."""
    scene, recording, _, _ = faint(tmp_path, 3, 40, 5)
    likelihood = Likelihood(LightCurve(scene, recording))
    assert likelihood.power is not None
    for albedo in (0.05 + 1e-3, 0.3, 0.5, 0.99):
        leaf = torch.tensor([albedo], dtype=torch.float64, requires_grad=True)
        (slope,) = torch.autograd.grad(likelihood.log_likelihood(leaf, noise_of(noise, likelihood)), leaf)
        up, down = (
            float(likelihood.log_likelihood(leaf.detach() + step, noise_of(noise, likelihood)))
            for step in (1e-6, -1e-6)
        )
        assert float(slope) == pytest.approx((up - down) / 2e-6, rel=1e-5, abs=1e-5)
    dark = torch.zeros(len(recording), dtype=torch.float64, requires_grad=True)
    for power in (0.0, 0.3, 0.5, 0.7, 1.0):
        delta, scale = power_difference(dark, torch.full_like(dark, power))
        (slope,) = torch.autograd.grad((delta + scale).sum(), dark)
        assert torch.isfinite(slope).all() and torch.isfinite(delta).all()


@pytest.mark.parametrize("ratio", [3, 50])
def test_chi_square_of_clean_recordings_is_uniform(tmp_path, ratio):
    """p of 60 recordings by Kolmogorov and Smirnov."""
    p = []
    for seed in range(60):
        scene, recording, _, _ = faint(tmp_path, ratio, 150, 100 + seed)
        p.append(fit_map(Likelihood(LightCurve(scene, recording)), starts=2, adam_steps=10).p_value)
    assert stats.kstest(p, "uniform").pvalue > 0.01


@pytest.mark.parametrize("ratio", [3, 50])
def test_the_gate_of_clean_recordings_is_uniform(tmp_path, ratio):
    """Its global p of 50 recordings by Kolmogorov and Smirnov."""
    p = []
    for seed in range(50):
        scene, recording, _, _ = faint(tmp_path, ratio, 100, 300 + seed)
        likelihood = Likelihood(LightCurve(scene, recording))
        posterior = Posterior(likelihood, scaled=False)
        found = fit_map(likelihood, starts=2, adam_steps=10).theta
        best = fitted_at(Hypothesis(), posterior, posterior.coordinates(found))
        seconds = likelihood.model.assembly.context.seconds
        battery = Battery(seconds, likelihood.curve, {"time": seconds}, {}, with_chi2=True)
        p.append(gate(best, battery, seed, draws=400).global_p)
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_a_fit_says_on_what_scale_rows_are_compared(tmp_path):
    scene, recording, _, _ = faint(tmp_path, 3, 100, 1)
    result = fit(scene, recording, steps=50)
    assert any("errors follow the measured flux in curve" in text for text in result.all_warnings)
    np.testing.assert_allclose(result.prediction, result.model(result.fit.theta).detach().numpy(), rtol=1e-12)
    np.testing.assert_allclose(result.delta, recording.observed - result.prediction, rtol=0, atol=1e-12)
