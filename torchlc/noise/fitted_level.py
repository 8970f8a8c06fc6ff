"""The level of noise of a curve that quotes no errors: log-uniform, and integrated out.

In closed form for normal noise, by quadrature under another law, with upper limits, or where a noise model adds a
variance of its own. Letters: K nodes, T rows, C curves.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from torchlc.noise.rows import Residuals, Rows
from torchlc.noise.white import row_densities
from torchlc.stages.noise import Noise
from torchlc.tensors.normal_tail import HALF_LOG_2PI

NODES, LEVELS = 64, 4
"""Of the quadrature over the level of noise: each level looks closer at where the one before found the integrand."""
NEGLIGIBLE = 25.0
"""In ln, below the largest value of the integrand: 1e-11. The density of a single row falls only as 1 / s towards large levels:
nodes are then 0.45 apart, and the integral is right to 1e-4; it would be to 2e-3 if 4e-18 were kept."""
LEAST_SHARE = 1e-3
"""Of the starting level, that every level has at least, so that a perfect model has a finite density."""


def log_density(rows: Rows, residuals: Residuals, noise: Noise) -> Tensor:
    """A level s of each curve under d ln s, of N measured rows less the gain: Gamma(N/2) / 2 (pi S)^(-N/2) with S
    the sum of squares. A curve of limits alone says nothing."""
    soft = rows.count * (LEAST_SHARE * rows.noise_level) ** 2
    squares = rows.squares(residuals.delta) + soft
    freedom = (rows.count - (1 if rows.gains else 0)).clamp(min=1.0)
    if not noise.normal or rows.censored or noise.variance is not None:
        return _by_quadrature(rows, residuals, noise, squares, soft, freedom)
    half = 0.5 * freedom
    constant = torch.lgamma(half) - math.log(2.0) - half * math.log(math.pi)
    return (constant - half * torch.log(squares)).sum(-1)


def _by_quadrature(
    rows: Rows, residuals: Residuals, noise: Noise, squares: Tensor, soft: Tensor, freedom: Tensor
) -> Tensor:
    """ln of the integral over ln s of each curve, (...), by the rows' densities at every level."""
    delta = residuals.delta
    each = not noise.normal or noise.variance is not None
    counted = rows.limit | each  # rows that are not in the sum of squares
    lost = torch.where(rows.count > 0, rows.count - freedom, 0.0)

    def at(level: Tensor) -> Tensor:
        """ln of the density, (K, ..., C), at ln s (K, ..., C)."""
        sigma = noise.sigma(torch.exp(level[..., rows.curve]), residuals.scale)
        heights = row_densities(rows, delta / sigma, sigma, noise)
        total = rows.by_curve(torch.where(counted, heights, 0.0))
        smooth = -0.5 * (soft if each else squares) * torch.exp(-2 * level)
        normal = 0.0 if each else -rows.count * (level + HALF_LOG_2PI)
        return total + smooth + normal + lost * (level + HALF_LOG_2PI)

    with torch.no_grad():
        hidden = rows.by_curve(torch.where(rows.limit, delta, 0.0) ** 2)
        known = torch.where(rows.count > 0, squares, 1.0)
        lowest = 0.5 * torch.log(known / freedom) - (9 / torch.sqrt(2 * freedom)).clamp(max=2.3)
        lowest = lowest - torch.log(torch.as_tensor(noise.law.widest).to(lowest))
        if noise.variance is not None:  # which may be all there is: down to the least level
            lowest = torch.minimum(lowest, torch.log(LEAST_SHARE * rows.noise_level) - 2.3)
        highest = 0.5 * torch.log((known + hidden) / freedom) + 36 / freedom + 9 / torch.sqrt(2 * freedom)
    total = log_integral(at, lowest, highest)
    return torch.where(rows.count > 0, total, 0.0).sum(-1)


def log_integral(log_density: Callable[[Tensor], Tensor], low: Tensor, high: Tensor) -> Tensor:
    """ln of the integral (..., C) of a density that is negligible at ``low`` and ``high`` (..., C), given its
    logarithm at nodes (K, ..., C), by the trapezoidal rule; exact to rounding where the density is smooth between
    the last level's nodes."""
    with torch.no_grad():
        shape = np.broadcast_shapes(low.shape, high.shape)
        low, high = low.expand(shape), high.expand(shape)
        share = torch.linspace(0, 1, NODES, dtype=low.dtype, device=low.device).reshape(-1, *[1] * low.ndim)
        for _ in range(LEVELS - 1):
            value = log_density(low + (high - low) * share)
            kept = (value > value.amax(0, keepdim=True) - NEGLIGIBLE).to(low.dtype)
            step = (high - low) / (NODES - 1)
            low = low + step * (kept.argmax(0) - 1)
            high = high - step * (kept.flip(0).argmax(0) - 1)
        nodes = low + (high - low) * share
    return torch.logsumexp(log_density(nodes), 0) + torch.log((high - low) / (NODES - 1))
