"""Rows that err together: one normal distribution a curve, an object, or whatever else shares an error.

Where processes have several groups, such as curves and objects, rows are together that a chain of these links.

Upper limits count by their joint probability given the measured rows (:mod:`torchlc.noise.orthant`). Where errors are
fitted their level is that of the steps between rows, not integrated. Letters: T rows, n rows
that err together, M such sets of equal n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchlc.errors import InputError
from torchlc.noise.orthant import log_orthant
from torchlc.noise.rows import Residuals, Rows
from torchlc.stages.noise import Noise, Process
from torchlc.tensors.normal_tail import HALF_LOG_2PI

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
    """M sets of n rows that err together, (M, n), of which the first ``count`` are measured and the others upper limits,
    with the lower Cholesky factor (..., M, n, n) of each one's covariance."""

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
        """Of residuals (..., T) the measured rows' with unit variance, (..., M, count), and the upper limits' less what the
        measured rows say of them, (..., M, n - count)."""
        delta = delta[..., self.rows]
        white = torch.linalg.solve_triangular(self.measured, delta[..., : self.count, None], upper=False)
        expected = self.factor[..., self.count :, : self.count] @ white
        return white[..., 0], delta[..., self.count :] - expected[..., 0]


def log_density(rows: Rows, residuals: Residuals, noise: Noise) -> Tensor:
    """Log density (...) of residuals."""
    together = sets(rows, noise)
    limits = torch.bincount(together, weights=rows.limit.to(torch.float64))
    problem = too_many(int(limits.max()))
    if not noise.normal:
        problem = why_not_beside([noise.law.name])
    if problem is not None:
        names = " and ".join(process.name for process in noise.processes)
        raise InputError(rows.source, None, f"{names} cannot be applied: {problem}")
    total = torch.zeros_like(residuals.delta[..., 0])
    for part in correlated_parts(rows, residuals, white_sigma(rows, residuals, noise), noise):
        white, left = part.whitened(residuals.delta)
        log_det = torch.log(torch.diagonal(part.measured, dim1=-2, dim2=-1)).sum((-1, -2))
        total = total - 0.5 * white.square().sum((-1, -2)) - log_det
        total = total - HALF_LOG_2PI * white.shape[-1] * white.shape[-2]
        if left.shape[-1]:
            total = total + log_orthant(part.limits, rows.fainter * left).sum(-1)
    return total


def white_sigma(rows: Rows, residuals: Residuals, noise: Noise) -> Tensor:
    """Standard deviation (..., T) of the errors that a row has for itself; the level of errors that are fitted is that
    of the steps between rows, in which any added variance is contained."""
    if rows.fitted_errors:
        return white_levels(rows, residuals.delta, noise)[..., rows.curve]
    return noise.sigma(residuals.sigma, residuals.scale)


def white_levels(rows: Rows, delta: Tensor, noise: Noise) -> Tensor:
    """Noise level of each curve, (..., C), from the steps between successive rows of residuals delta (..., T) that share
    all errors."""
    return rows.white_levels(delta, _numbered([rows.curve, *_groups(rows, noise)]))


def _groups(rows: Rows, noise: Noise) -> list[Tensor]:
    """What the processes number, (T,) each, none twice."""
    if (
        rows.curve.is_meta
    ):  # how large the sets are decides which operations follow: they have no shapes without it
        names = " and ".join(process.name for process in noise.processes)
        raise InputError(
            rows.source,
            None,
            f"{names} on the device meta: numbers say which rows err together, and that device holds none",
            "a model on a device with numbers",
            f"Leave out {names} to look at shapes, or keep the model on the CPU",
        )
    distinct = {id(group): group for group in (process.members(rows.curve) for process in noise.processes)}
    return list(distinct.values())


def _numbered(groups: Sequence[Tensor]) -> Tensor:
    """A number (T,) for each combination of members."""
    if len(groups) == 1:
        return groups[0]
    return torch.unique(torch.stack(list(groups)), dim=1, return_inverse=True)[1]


def sets(rows: Rows, noise: Noise) -> Tensor:
    """The set of rows that err together, as a number (T,), that each row is in."""
    groups = _groups(rows, noise)
    if len(groups) == 1:
        return groups[0]
    from scipy.sparse import coo_matrix  # load for 0.15 s: only where rows err together in several ways
    from scipy.sparse.csgraph import connected_components

    count = rows.rows
    links = np.concatenate([(group + count * (k + 1)).cpu().numpy() for k, group in enumerate(groups)])
    row = np.tile(np.arange(count), len(groups))
    size = int(links.max()) + 1
    graph = coo_matrix((np.ones(len(row)), (row, links)), shape=(size, size))
    return torch.as_tensor(connected_components(graph, directed=False)[1][:count]).to(groups[0])


def correlated_parts(rows: Rows, residuals: Residuals, sigma: Tensor, noise: Noise) -> list[CorrelatedRows]:
    """Each set of rows with the processes of the noise, beside white noise sigma (..., T). Sets of as many rows are one
    part where every process numbers its members, which tell them apart."""
    sigma = sigma.expand(residuals.delta.shape)
    alike = all(process.group is not None for process in noise.processes)
    stacks: dict[tuple[int, int, int], list[Tensor]] = {}
    for number, index in enumerate(_split(sets(rows, noise))):
        index = torch.cat([index[rows.measured[index]], index[rows.limit[index]]])
        limits = int(rows.limit[index].sum())
        stacks.setdefault((len(index), limits, 0 if alike else number), []).append(index)
    parts = []
    for (size, limits, _), several in stacks.items():
        index = torch.stack(several)
        covariance = torch.diag_embed(sigma[..., index] ** 2)
        for process in noise.processes:
            sd = (process.sd * residuals.scale)[..., index]
            correlation = process.correlation(index if alike else index[0])
            if not alike:
                correlation = _within(process, rows, index[0], correlation)[..., None, :, :]
            covariance = correlation * sd[..., :, None] * sd[..., None, :] + covariance
        parts.append(CorrelatedRows(index, size - limits, torch.linalg.cholesky(covariance)))
    return parts


def _within(process: Process, rows: Rows, index: Tensor, correlation: Tensor) -> Tensor:
    """A correlation (..., n, n), 0 between rows of different members."""
    member = process.members(rows.curve)[index]
    return torch.where(member[:, None] == member, correlation, 0.0)


def _split(numbers: Tensor) -> list[Tensor]:
    """Rows of each number, in order."""
    order = torch.argsort(numbers, stable=True)
    counts = torch.unique_consecutive(numbers[order], return_counts=True)[1]
    return list(order.split(counts.tolist()))
