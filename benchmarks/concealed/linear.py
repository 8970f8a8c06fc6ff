"""What several methods share: p-values from draws, and densities of unseen rows of a normal distribution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from benchmarks.concealed.case import Array, Case, blocks

HALF_LOG_2PI = 0.5 * np.log(2 * np.pi)
LARGE = 2.0
"""Whitened change of a row at which it counts as one where something is missing."""


def p_of_draws(value: float, null: Array) -> float:
    """Share of null draws (N,) at least as large, the value counted as one of them."""
    return float((1 + (null >= value).sum()) / (1 + len(null)))


def log_density(u: Array, mean: Array, covariance: Array) -> float:
    """ln N(u; mean, covariance), u (T,)."""
    factor = cho_factor(covariance, lower=True)
    off = u - mean
    half = np.log(np.diag(factor[0])).sum()
    return float(-0.5 * off @ cho_solve(factor, off) - half - HALF_LOG_2PI * len(u))


def conditional(u: Array, mean: Array, covariance: Array, known: Array, asked: Array) -> float:
    """ln of the density of the rows ``asked`` given the rows ``known``."""
    cross = covariance[np.ix_(asked, known)]
    factor = cho_factor(covariance[np.ix_(known, known)], lower=True)
    centre = mean[asked] + cross @ cho_solve(factor, u[known] - mean[known])
    spread = covariance[np.ix_(asked, asked)] - cross @ cho_solve(factor, cross.T)
    return log_density(u[asked], centre, 0.5 * (spread + spread.T))


def gain_unseen(case: Case, extra: Callable[[Array], Array]) -> float:
    """What a method gains over the nominal model in log density of unseen rows: ``extra(known)`` gives the covariance (T, T)
    that it adds, chosen by the known rows alone."""
    mean, covariance = case.marginal()
    u = case.residual[: case.rows]
    total = 0.0
    for rows, gone in blocks(case):
        known = np.setdiff1d(np.arange(case.rows), gone)
        total += conditional(u, mean, covariance + extra(known), known, rows)
        total -= conditional(u, mean, covariance, known, rows)
    return total
