"""Rows that err independently, by the quoted errors and what a noise model adds to them.

A measured row counts by the height of its law, an upper limit by the probability that noise is fainter than it. In
curves whose errors follow the measured flux (:mod:`torchlc.noise.error_law`) and that have no upper limits, a row counts
given that its flux is above 0, without which it had no magnitude.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchlc.noise.rows import Residuals, Rows
from torchlc.stages.noise import Noise
from torchlc.tensors.normal_tail import HALF_LOG_2PI


def log_density(rows: Rows, residuals: Residuals, noise: Noise) -> Tensor:
    """Log density (...) of residuals at the quoted errors."""
    sigma = noise.sigma(residuals.sigma, residuals.scale)
    u = residuals.delta / sigma
    if noise.normal and not rows.censored and rows.selected is None:
        return (-torch.log(sigma) - HALF_LOG_2PI).sum(-1) - 0.5 * u.square().sum(-1)
    total = row_densities(rows, u, sigma, noise)
    if rows.selected is not None:
        above = noise.law.log_below(rows.above_zero(residuals, sigma))
        total = total - torch.where(rows.selected, above, 0.0)
    return total.sum(-1)


def row_densities(rows: Rows, u: Tensor, sigma: Tensor, noise: Noise) -> Tensor:
    """Log density (..., T) of residuals u over standard deviations ``sigma``: of a measured row its height, of an upper
    limit its probability."""
    height = noise.law.log_mixed(u, sigma)
    if not rows.censored:
        return height
    fainter = rows.fainter * torch.where(rows.limit, u, 0.0)
    return torch.where(rows.limit, noise.law.log_below(fainter), height)
