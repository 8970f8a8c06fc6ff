"""Errors added in quadrature: normal densities by SciPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import norm

from tests.effects.passes import magnitudes, model_with, orbiting, rows
from torchlc.effects import registry
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve


def noisy_recording(scene, seed=0, error=0.04):
    """The bare model with errors that are not all the same and residuals of 0.06 mag."""
    generator = np.random.default_rng(seed)
    recording = rows(scene)
    residual = 0.06 * generator.normal(size=len(recording))
    errors = error * generator.uniform(0.5, 1.5, len(recording))
    return replace(recording, observed=magnitudes(scene, recording) + residual, error=errors), residual


@pytest.mark.parametrize("mag", [0.0, 0.035, 0.5])
def test_density(mag):
    scene = orbiting()
    recording, residual = noisy_recording(scene)
    model, theta = model_with(scene, recording, "jitter", jitter__mag=mag)
    expected = norm.logpdf(residual, scale=np.hypot(recording.error, mag)).sum()
    assert float(Likelihood(model).log_likelihood(theta)) == pytest.approx(expected, rel=1e-12)


def test_in_flux_it_grows_with_the_light():
    """A small jitter of m mag is m ln(10)/2.5 of the light of a row well above the fainter rows' floor."""
    scene = orbiting()
    plain = replace(rows(scene), kind="flux")
    flux = LightCurve(scene, plain)().detach().numpy()
    recording = replace(plain, observed=flux, error=1e-3 * flux)
    model, theta = model_with(scene, recording, "jitter", jitter__mag=0.02)
    likelihood = Likelihood(model)
    found = likelihood.residuals(theta)
    bright = torch.from_numpy(flux > np.median(flux))
    share = (found.scale * 0.02)[bright].numpy() / flux[bright.numpy()]
    np.testing.assert_allclose(share, 1 - 10 ** (-0.4 * 0.02), rtol=0.01)


def test_fitted_errors_hold_it_already():
    scene = orbiting()
    recording = replace(rows(scene), error=None)
    context = LightCurve(scene, recording, effects=[]).assembly.context
    assert "fitted" in (registry()["jitter"]().missing(context) or "")
