"""Rows that err together: one normal distribution a curve.

Upper limits count by their joint probability given the measured rows (:mod:`torchlc.noise.orthant`). Where errors are
fitted their level is that of the steps between rows, not integrated. Letters: T rows, n rows of one curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.errors import InputError
from torchlc.noise.orthant import log_orthant
from torchlc.noise.rows import Residuals, Rows
from torchlc.stages.noise import HALF_LOG_2PI, Noise

MOST_LIMITS = 150
"""Upper limits in one curve whose joint probability is worked out: a tenth of a second for a single model."""


def too_many(limits: int) -> str | None:
    """Why so many upper limits in one curve are not taken, in words; None if they are."""
    if limits <= MOST_LIMITS:
        return None
    return (
        f"a curve has {limits} upper limits, and the joint probability of more than {MOST_LIMITS} that err together is "
        "not worked out. Take jitter, or leave out rows with upper_limit"
    )


def why_not_beside(laws: Sequence[str]) -> str:
    """Why effects that give errors another law than the normal one cannot be applied to rows that err together."""
    return (
        f"{', '.join(laws)} are in the list, and among rows that err together every choice of bad ones has a density of "
        "its own. Leave out one of the two"
    )


@dataclass(frozen=True)
class CorrelatedRows:
    """Rows (n,) of one curve, of which the first ``count`` are measured and the others upper limits, with the lower
    Cholesky factor (..., n, n) of their noise's covariance."""

    rows: Tensor
    count: int
    factor: Tensor

    @property
    def measured(self) -> Tensor:
        """Factor of the measured rows' covariance."""
        return self.factor[..., : self.count, : self.count]

    @property
    def limits(self) -> Tensor:
        """Factor of the upper limits' covariance, given the measured rows."""
        return self.factor[..., self.count :, self.count :]

    def whitened(self, delta: Tensor) -> tuple[Tensor, Tensor]:
        """Of residuals (..., T) the measured rows' with unit variance, and the upper limits' less what the measured
        rows say of them."""
        delta = delta[..., self.rows]
        white = torch.linalg.solve_triangular(self.measured, delta[..., : self.count, None], upper=False)
        expected = self.factor[..., self.count :, : self.count] @ white
        return white[..., 0], delta[..., self.count :] - expected[..., 0]


def log_density(rows: Rows, found: Residuals, noise: Noise) -> Tensor:
    """Log density (...) of residuals."""
    problem = too_many(int(rows.by_curve(rows.limit.to(torch.long)).max()))
    if not noise.normal:
        problem = why_not_beside([noise.law.name])
    if problem is not None:
        names = " and ".join(process.name for process in noise.processes)
        raise InputError(rows.source, None, f"{names} cannot be applied: {problem}")
    total = torch.zeros_like(found.delta[..., 0])
    for part in correlated_parts(rows, found, white_sigma(rows, found, noise), noise):
        white, left = part.whitened(found.delta)
        log_det = torch.log(torch.diagonal(part.measured, dim1=-2, dim2=-1)).sum(-1)
        total = total - 0.5 * white.square().sum(-1) - log_det - HALF_LOG_2PI * white.shape[-1]
        if left.shape[-1]:
            total = total + log_orthant(part.limits, rows.fainter * left)
    return total


def white_sigma(rows: Rows, found: Residuals, noise: Noise) -> Tensor:
    """Standard deviation (..., T) of the errors that a row has for itself; the level of errors that are fitted is that
    of the steps between rows, in which any added variance is contained."""
    if rows.fitted_errors:
        return rows.white_levels(found.delta)[..., rows.curve]
    return noise.sigma(found.sigma, found.scale)


def correlated_parts(rows: Rows, found: Residuals, sigma: Tensor, noise: Noise) -> list[CorrelatedRows]:
    """Each curve's rows with the processes of the noise, independent between curves, beside white noise sigma (..., T)."""
    sigma = sigma.expand(found.delta.shape)
    parts = []
    for one in torch.unique(rows.curve).tolist():
        index = torch.nonzero(rows.curve == one)[:, 0]
        index = torch.cat([index[rows.measured[index]], index[rows.limit[index]]])
        covariance = torch.diag_embed(sigma[..., index] ** 2)
        for process in noise.processes:
            sd = process.sd * found.scale
            covariance = process.correlation(index) * sd[..., index, None] * sd[..., None, index] + covariance
        parts.append(
            CorrelatedRows(index, int(rows.measured[index].sum()), torch.linalg.cholesky(covariance))
        )
    return parts
