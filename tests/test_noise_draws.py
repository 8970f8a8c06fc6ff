"""Draws of every kind of noise against what its density says of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import integrate, linalg, stats

from tests.effects.test_red_noise import matern
from tests.test_noise import CHANCE, DOUBLE, LAWS, ROWS, Exponential, number
from torchlc.noise.draw import draw
from torchlc.noise.red_noise import Matern32
from torchlc.stages.noise import Noise

CURVE = torch.zeros(ROWS, dtype=torch.long)
QUOTED = torch.linspace(0.01, 0.05, ROWS, dtype=DOUBLE)


def test_draws_of_white_noise_and_jitter() -> None:
    for mag in (0.0, 0.04):
        noise = Noise() if mag == 0 else Noise().wider(number(mag))
        delta = draw(noise, QUOTED, CURVE, np.random.default_rng(1)).numpy()
        white = delta / np.hypot(QUOTED.numpy(), mag)
        assert stats.kstest(white, "norm").pvalue > CHANCE


@pytest.mark.parametrize("name", LAWS)
def test_draws_of_a_law(name: str) -> None:
    """Against the numerical integral of its density, on nodes 0.01 apart about the centre."""
    noise = Noise().with_law(LAWS[name])
    u = (draw(noise, QUOTED, CURVE, np.random.default_rng(2)) / QUOTED).numpy()
    nodes = np.linspace(-80, 80, 16001)
    density = torch.exp(LAWS[name].log_density(torch.as_tensor(nodes))).numpy()
    below = integrate.cumulative_trapezoid(density, nodes, initial=0)
    assert stats.kstest(u, lambda x: np.interp(x, nodes, below)).pvalue > CHANCE
    assert stats.kstest(u, "norm").pvalue < 1e-6  # a draw of another law is told


@pytest.mark.parametrize("name", ["red_noise", "drifting_sky"])
def test_draws_of_a_process(name: str) -> None:
    """Whitened by SciPy's Cholesky factor of the covariance, Bessel functions or exponentials: standard normal, and
    neighbours uncorrelated. Two curves are independent."""
    rows, sd, tau = 1500, 0.1, 12.0
    seconds = torch.linspace(0, 4 * 3600, rows, dtype=DOUBLE)
    process = (Matern32 if name == "red_noise" else Exponential)(number(sd), number(tau), seconds)
    curve = (torch.arange(rows) >= rows // 2).long()
    delta = draw(Noise().with_process(process), QUOTED[:rows], curve, np.random.default_rng(3)).numpy()
    white = []
    for one in (0, 1):
        index = np.flatnonzero(curve.numpy() == one)
        minutes = seconds.numpy()[index] / 60
        gap = np.abs(minutes[:, None] - minutes)
        shape = matern(gap, tau, 1.5) if name == "red_noise" else np.exp(-gap / tau)
        factor = linalg.cholesky(sd**2 * shape + np.diag(QUOTED.numpy()[index] ** 2), lower=True)
        white.append(linalg.solve_triangular(factor, delta[index], lower=True))
    white = np.concatenate(white)
    assert stats.kstest(white, "norm").pvalue > CHANCE
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4 / math.sqrt(rows)
    assert abs(np.corrcoef(delta[1:], delta[:-1])[0, 1]) > 0.5  # which the draw itself is not
