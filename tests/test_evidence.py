"""The held-out density of outliers: a density, and the right one, by integrals over data and parameter."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import integrate, stats

from torchlc.diagnosis.evidence import filtered_log_density
from torchlc.noise.outliers import Mixture
from torchlc.stages.noise import Law


def mixture(share: float, width: float) -> Mixture:
    return Mixture(*(torch.tensor([value], dtype=torch.float64) for value in (share, width)))


LAW = mixture(0.1, 8.0)
SLOPES, SIGMA = np.array([1.0, -0.7, 0.4]), np.array([0.5, 0.8, 0.6])


def filtered(delta: np.ndarray, mean: float, variance: float, law: Law = LAW) -> np.ndarray:
    """Log density (N,) of N sequences of rows delta (N, n) with one parameter."""
    number, rows = delta.shape
    return filtered_log_density(
        torch.full((number, 1), mean, dtype=torch.float64),
        torch.full((number, 1, 1), variance, dtype=torch.float64),
        torch.as_tensor(delta),
        torch.as_tensor(SLOPES[:rows, None]).expand(number, rows, 1),
        torch.as_tensor(SIGMA[:rows]).expand(number, rows),
        torch.ones(number, rows, dtype=torch.bool),
        law,
    ).numpy()


def test_it_integrates_to_one():
    """Over both data of two rows, by Simpson's rule to 80 standard deviations; what lies beyond is below 1e-6."""
    x, y = np.linspace(-60, 60, 1601), np.linspace(-60, 60, 1601)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    height = np.exp(filtered(grid, 0.3, 2.0)).reshape(len(x), len(y))
    assert integrate.simpson(integrate.simpson(height, x=y), x=x) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(
    ("delta", "tolerance"),
    [([0.4, -0.1, 0.2], 0.02), ([0.4, 6.0, 0.2], 0.1), ([5.0, -3.0, 9.0], 0.5), ([30.0, -30.0, 30.0], 1.0)],
)
def test_it_is_near_the_mixture_integrated_over_the_parameter(delta, tolerance):
    """ln of the integral over x of the product of the rows' mixtures, of a parameter known as well as it is once seven
    eighths of the rows are; the tolerance is what a normal kept between rows costs."""

    def height(x: float) -> float:
        u = np.array(delta) - SLOPES * x
        rows = 0.9 * stats.norm.pdf(u, scale=SIGMA) + 0.1 * stats.norm.pdf(u, scale=8 * SIGMA)
        return float(rows.prod() * stats.norm.pdf(x, 0.1, 0.3))

    expected = math.log(integrate.quad(height, -4, 4, points=[0.1], epsabs=0)[0])
    assert filtered(np.array([delta]), 0.1, 0.09)[0] == pytest.approx(expected, abs=tolerance)


def test_without_outliers_it_is_the_joint_normal_density():
    delta = np.array([[0.4, -2.0, 0.2], [3.0, 1.0, -1.0]])
    covariance = 2.0 * np.outer(SLOPES, SLOPES) + np.diag(SIGMA**2)
    expected = stats.multivariate_normal.logpdf(delta, 0.3 * SLOPES, covariance)
    none = mixture(1e-300, 8.0)
    np.testing.assert_allclose(filtered(delta, 0.3, 2.0, none), expected, rtol=1e-9)


def test_rows_that_are_not_there_count_nothing():
    delta = np.array([[0.4, -2.0, 0.2]])
    full = filtered(delta[:, :2], 0.3, 2.0)[0]
    cut = filtered_log_density(
        torch.full((1, 1), 0.3, dtype=torch.float64),
        torch.full((1, 1, 1), 2.0, dtype=torch.float64),
        torch.as_tensor(delta),
        torch.as_tensor(SLOPES[None, :, None]),
        torch.as_tensor(SIGMA[None]),
        torch.tensor([[True, True, False]]),
        LAW,
    )
    assert float(cut[0]) == pytest.approx(full, rel=1e-12)
