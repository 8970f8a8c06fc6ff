"""The process against SciPy's multivariate normal and Bessel functions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import gamma, kv
from scipy.stats import multivariate_normal

from tests.effects.passes import model_with, orbiting
from tests.effects.test_jitter import noisy_recording
from torchlc.inference.likelihood import Likelihood


def matern(gap: np.ndarray, tau: float, order: float) -> np.ndarray:
    """Rasmussen & Williams (2006), eq. 4.14."""
    x = np.sqrt(2 * order) * np.where(gap > 0, gap, 1.0) / tau
    return np.where(gap > 0, 2 ** (1 - order) / gamma(order) * x**order * kv(order, x), 1.0)


@pytest.mark.parametrize(("mag", "tau"), [(0.02, 15.0), (0.3, 60.0), (0.05, 1.0)])
def test_density_of_two_curves(mag, tau):
    scene = orbiting()
    recording, residual = noisy_recording(scene)
    curve = (np.arange(len(recording)) % 3 == 0).astype(np.int64)
    recording = replace(recording, curve=curve, curve_ids=("a", "b"))
    model, theta = model_with(scene, recording, "red_noise", red_noise__mag=mag, red_noise__tau_min=tau)
    expected = 0.0
    for one in (0, 1):
        mine = curve == one
        minutes = recording.seconds[mine] / 60
        covariance = mag**2 * matern(np.abs(minutes[:, None] - minutes), tau, 1.5)
        covariance += np.diag(recording.error[mine] ** 2)
        expected += multivariate_normal.logpdf(residual[mine], cov=covariance)
    assert float(Likelihood(model).log_likelihood(theta)) == pytest.approx(expected, rel=1e-10)


def test_jitter_joins_the_diagonal():
    scene = orbiting()
    recording, residual = noisy_recording(scene)
    model, theta = model_with(
        scene, recording, "red_noise", "jitter", red_noise__mag=0.1, red_noise__tau_min=20.0, jitter__mag=0.03
    )
    minutes = recording.seconds / 60
    covariance = 0.1**2 * matern(np.abs(minutes[:, None] - minutes), 20.0, 1.5)
    covariance += np.diag(recording.error**2 + 0.03**2)
    expected = multivariate_normal.logpdf(residual, cov=covariance)
    assert float(Likelihood(model).log_likelihood(theta)) == pytest.approx(expected, rel=1e-10)
