"""Gaussian-process discrepancy (Kennedy & O'Hagan 2001, J. R. Stat. Soc. B 63, 425) in time, beside the nominal model whose
parameters are integrated out to first order. Matern kernel of 3/2 from scikit-learn; its amplitude and length are chosen by
marginal likelihood on a grid. The p-value is that of the gain in log likelihood among null draws. It cannot name.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from benchmarks.concealed.answer import SURE, Answer
from benchmarks.concealed.case import Array, Case
from benchmarks.concealed.linear import LARGE, gain_unseen, p_of_draws

TITLE = "Gaussian-process discrepancy"
NEEDS: Sequence[str] = ("sklearn",)
NAMES = False
SHARES: Sequence[str] = ("nominal",)
DRAWS = 999
LENGTHS = (0.01, 0.03, 0.1, 0.3)
"""Of the recording's span."""
AMPLITUDES = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Of the discrepancy, in median quoted errors."""


def examine(case: Case, without: Collection[str], seed: int) -> Answer:
    mean, plain = case.marginal()
    u = case.residual[: case.rows]
    kernels = _kernels(case)
    z = np.random.default_rng(seed).standard_normal((case.rows, DRAWS))
    draws = np.linalg.cholesky(plain) @ z
    both = np.concatenate([(u - mean)[:, None], draws], 1)
    densities = np.stack([_densities(both, plain + kernel) for kernel in kernels])
    gained = densities.max(0) - densities[0]
    p = p_of_draws(float(gained[0]), gained[1:])
    best = kernels[int(densities[:, 0].argmax())]
    curve = best @ np.linalg.solve(plain + best, u - mean)
    return Answer(
        p,
        "missing" if p < SURE else "none",
        rows=np.abs(curve) > LARGE if p < SURE else None,
        gain=gain_unseen(case, lambda known: _chosen(kernels, plain, u - mean, known)),
    )


def _kernels(case: Case) -> list[Array]:
    """Covariances (T, T) in quoted errors; the first is none at all."""
    from sklearn.gaussian_process.kernels import Matern

    seconds = case.seconds[:, None]
    span = float(np.ptp(seconds))
    size = np.median(case.nominal.quoted.numpy()) / case.nominal.quoted.numpy()
    shapes = [Matern(length_scale=share * span, nu=1.5)(seconds) for share in LENGTHS]
    none = np.zeros((case.rows, case.rows))
    return [none, *(a * a * shape * np.outer(size, size) for a in AMPLITUDES[1:] for shape in shapes)]


def _densities(u: Array, covariance: Array) -> Array:
    """Log densities (N,) of columns u (T, N), up to a constant."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, u)
    return -0.5 * (white**2).sum(0) - np.log(np.diag(root)).sum()


def _chosen(kernels: Sequence[Array], plain: Array, u: Array, known: Array) -> Array:
    some = np.ix_(known, known)
    density = [float(_densities(u[known][:, None], (plain + kernel)[some])[0]) for kernel in kernels]
    return kernels[int(np.argmax(density))]
