"""Joint probabilities against closed forms, SciPy, and an integral in one dimension."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import integrate, optimize, stats

from torchlc.noise.orthant import log_orthant, log_quantile
from torchlc.tensors.normal_tail import hazard, hazard_fall, log_ndtr


def factor(covariance: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(np.linalg.cholesky(covariance))


def matern(minutes: np.ndarray, tau: float) -> np.ndarray:
    x = math.sqrt(3) * np.abs(minutes[:, None] - minutes) / tau
    return (1 + x) * np.exp(-x)


@pytest.mark.parametrize("correlation", [-0.9, -0.3, 0.0, 0.5, 0.99])
def test_a_quadrant(correlation):
    """1/4 + asin(rho) / 2 pi (Sheppard 1899); 1024 points err by some 1e-4."""
    found = log_orthant(
        factor(np.array([[1, correlation], [correlation, 1]])), torch.zeros(2, dtype=torch.float64)
    )
    expected = math.log(0.25 + math.asin(correlation) / (2 * math.pi))
    assert float(found) == pytest.approx(expected, abs=5e-4)


def test_one_variable_and_independent_ones():
    bound = torch.tensor([-40.0, -3.0, 0.0, 2.0, 9.0], dtype=torch.float64)
    one = torch.stack([log_orthant(torch.full((1, 1), 2.0, dtype=torch.float64), b[None]) for b in bound])
    np.testing.assert_allclose(one, stats.norm.logcdf(bound / 2), rtol=1e-9)
    many = log_orthant(torch.eye(5, dtype=torch.float64), bound)
    assert float(many) == pytest.approx(stats.norm.logcdf(bound).sum(), rel=1e-12)


@pytest.mark.parametrize("number", [3, 8])
def test_scipys_integral(number):
    """To 0.008 of ln P, the error that the module's docstring gives."""
    generator = np.random.default_rng(number)
    covariance = matern(np.arange(number) * 1.0, 4.0) + 0.1 * np.eye(number)
    for _ in range(3):
        bound = generator.normal(size=number)
        expected = stats.multivariate_normal.logcdf(
            bound, cov=covariance, rng=np.random.default_rng(0), maxpts=10**6
        )
        assert float(log_orthant(factor(covariance), torch.as_tensor(bound))) == pytest.approx(
            expected, abs=0.008
        )


@pytest.mark.parametrize("number", [36, 150])
@pytest.mark.parametrize("correlation", [0.3, 0.9])
@pytest.mark.parametrize("centre", [-20.0, -2.0, 0.0, 1.0])
def test_equal_correlations(number, correlation, centre):
    """Of variables that share one part, given which they are independent: an integral over it. The tolerance is what
    the module's docstring says."""
    bound = centre + 0.3 * np.random.default_rng(1).normal(size=number)
    covariance = np.full((number, number), correlation) + (1 - correlation) * np.eye(number)
    x = np.linspace(-60, 10, 70_001)
    height = stats.norm.logpdf(x)
    for edge in bound:
        height = height + stats.norm.logcdf((edge - math.sqrt(correlation) * x) / math.sqrt(1 - correlation))
    expected = height.max() + math.log(integrate.trapezoid(np.exp(height - height.max()), x))
    found = float(log_orthant(factor(covariance), torch.as_tensor(bound)))
    assert found == pytest.approx(expected, abs=0.008 if number == 36 else 0.03)


def test_slopes_and_batches():
    """Slopes by central differences, of the bounds and of what the factor depends on; a batch is its members."""
    minutes = np.arange(12.0)
    generator = torch.Generator().manual_seed(1)
    bounds = torch.randn(3, 12, generator=generator, dtype=torch.float64)
    root = factor(matern(minutes, 5.0) + 0.2 * np.eye(12))
    whole = log_orthant(root, bounds)
    torch.testing.assert_close(
        whole, torch.stack([log_orthant(root, one) for one in bounds]), rtol=1e-10, atol=1e-10
    )
    assert torch.autograd.gradcheck(lambda scale, b: log_orthant(root * scale, b), (
        torch.tensor(1.3, dtype=torch.float64, requires_grad=True), bounds[0].clone().requires_grad_(True),
    ), eps=1e-6, atol=1e-6, rtol=1e-5)  # fmt: skip


def test_quantiles_far_out():
    p = torch.tensor([-1e5, -700.0, -50.0, -15.1, -14.9, -1.0, -1e-9], dtype=torch.float64)
    np.testing.assert_allclose(torch.special.log_ndtr(log_quantile(p))[:-1], p[:-1], rtol=1e-12)
    assert float(log_quantile(p)[-1]) == pytest.approx(stats.norm.isf(1e-9), rel=1e-6)


def mills(x: float) -> float:
    """(1 - Phi(x)) / phi(x) by Laplace's continued fraction, x > 1."""
    ratio = x
    for k in range(400, 0, -1):
        ratio = x + k / ratio
    return 1 / ratio


@pytest.mark.parametrize("x", [1.5, 6.0, 37.0, 1e3, 1.7e4, 1e6, 1.6e10])
def test_slopes_far_below_the_centre(x):
    """Value, slope and curvature by Laplace's continued fraction; the usual form of the slope is 3e-8 off at 1e4, 0 or infinite
    from 1e8."""
    low = torch.tensor([-x], dtype=torch.float64, requires_grad=True)
    value = log_ndtr(low)
    (slope,) = torch.autograd.grad(value.sum(), low, create_graph=True)
    (bend,) = torch.autograd.grad(slope.sum(), low)
    expected = math.log(mills(x)) - 0.5 * x * x - 0.5 * math.log(2 * math.pi)
    assert float(value.detach()) == pytest.approx(expected, rel=1e-14)
    assert float(slope.detach()) == pytest.approx(1 / mills(x), rel=1e-13)
    assert float(hazard(low).detach()) == pytest.approx(1 / mills(x), rel=1e-13)
    fall = (1 / mills(x)) * (1 / mills(x) - x) if x < 100 else 1 - 1 / x**2
    assert float(hazard_fall(low).detach()) == pytest.approx(fall, rel=1e-8)
    if x < 1e6:  # beyond, no slope of a slope is asked for
        assert float(bend) == pytest.approx(-fall, rel=1e-5)


def test_above_the_centre():
    x = torch.linspace(-3, 45, 97, dtype=torch.float64)
    np.testing.assert_allclose(log_ndtr(x), stats.norm.logcdf(x), rtol=1e-13, atol=1e-300)
    np.testing.assert_allclose(
        hazard(x)[:80], np.exp(stats.norm.logpdf(x) - stats.norm.logcdf(x))[:80], rtol=1e-12
    )


@pytest.mark.parametrize("number", [4, 11, 36])
@pytest.mark.parametrize("minutes", [3.0, 30.0])
def test_bounds_that_are_very_far_out(number, minutes):
    """ln P tends to minus half the square of the nearest point (Laplace's principle), which is a problem of least squares under
    bounds; what is left is some ln of the distance for each variable, 4e-5 of it at most here. A batch of the same holds the same, and slopes are those
    of central differences."""
    covariance = matern(np.arange(number) * 1.0, minutes) + 0.1 * np.eye(number)
    chol = factor(covariance)
    shape = 1 + 0.5 * np.sin(1.3 * np.arange(number))
    dual = np.vstack([-chol.numpy().T, shape[None]])
    for distance in (3e3, 1e4):
        point = (
            optimize.nnls(dual, np.eye(number + 1)[-1], maxiter=10**5)[0] @ dual.T - np.eye(number + 1)[-1]
        )
        nearest = 0.5 * distance**2 * float(np.sum((point[:-1] / point[-1]) ** 2))
        bound = torch.as_tensor(-distance * shape)
        leaf = bound.clone().requires_grad_()
        found = log_orthant(chol, leaf)
        assert float(found.detach()) == pytest.approx(-nearest, rel=1e-4)
        batch = log_orthant(chol.expand(3, number, number), bound.expand(3, number))
        np.testing.assert_allclose(batch, float(found.detach()), rtol=1e-12)
        (slope,) = torch.autograd.grad(found, leaf)
        along = torch.as_tensor(shape)
        up, down = (float(log_orthant(chol, bound + step * along)) for step in (0.01, -0.01))
        assert float(slope @ along) == pytest.approx((up - down) / 0.02, rel=1e-5)
