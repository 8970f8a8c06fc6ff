"""Distortion-driven tests in the mode that learns signal to noise: for every additive distortion its amplitude is regressed on
simulations, linearly, and t_i is its square in standard errors. The detection is the smaller of the global p-values of the
largest t_i and of their sum, twice that. The network is linear and solved by least squares: for additive distortions in normal
noise the best one is. It gives no probabilities."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from benchmarks.concealed.answer import SURE, Answer
from benchmarks.concealed.case import Array, Case
from benchmarks.concealed.distortions import Basis, basis
from benchmarks.concealed.linear import p_of_draws

TITLE = "distortions, SNR"
NEEDS: Sequence[str] = ()
NAMES = True
SHARES: Sequence[str] = ("nominal", "menu")
SIMULATIONS, DRAWS = 4000, 2000
AMPLITUDE = 5.0
"""Standard deviation of the distortions in training, in standard errors."""


def examine(case: Case, without: Collection[str], seed: int) -> Answer:
    found = basis(case, without)
    weights = trained(found.patterns, case.null_residuals(SIMULATIONS, seed))
    null = case.null_residuals(DRAWS, seed + 1)
    t = statistics(weights, null, case.residual[None, : case.rows])
    p = global_p(t[1][0], t[0])
    ranked = by_name(found, t[1][0])
    verdict = "none" if p >= SURE or not ranked else "named"
    return Answer(p, verdict, [(one,) for one in ranked], [tuple(ranked[:1])] if ranked else ())


def trained(patterns: Array, null: Array) -> Array:
    """Weights (K, T) of the regression of each distortion's amplitude on x = null + amplitude * pattern: with C the
    simulations' covariance and a the amplitudes' standard deviation, a^2 C^-1 n / (1 + a^2 n' C^-1 n)."""
    covariance = null.T @ null / len(null) + 1e-3 * np.eye(null.shape[1])
    solved = np.linalg.solve(covariance, patterns.T).T
    power = (solved * patterns).sum(1, keepdims=True)
    return AMPLITUDE**2 * solved / (1 + AMPLITUDE**2 * power)


def statistics(weights: Array, null: Array, x: Array) -> tuple[Array, Array]:
    """t_i of null draws (N, K) and of x (M, K): squared estimates over their variance among the null draws."""
    estimates = null @ weights.T
    variance = (estimates**2).mean(0)
    return estimates**2 / variance, (x @ weights.T) ** 2 / variance


def global_p(t: Array, null: Array) -> float:
    """Twice the smaller p-value of the largest t_i and of their sum, t (K,) against null draws (N, K)."""
    return min(1.0, 2 * min(p_of_draws(t.max(), null.max(1)), p_of_draws(t.sum(), null.sum(1))))


def by_name(found: Basis, t: Array) -> list[str]:
    """Names of the menu, the largest t_i first."""
    best = {name: t[found.owner == i].max(initial=-1.0) for i, name in enumerate(found.names)}
    return sorted((name for name in best if best[name] >= 0), key=lambda name: -best[name])
