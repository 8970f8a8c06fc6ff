"""The draws of a chain, and whether they are enough and agree."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from torch import Tensor

from torchlc.digits import number_of
from torchlc.files.libraries import arviz_library

LONG_ENOUGH = 50
"""A chain is long enough when it holds this many autocorrelation times."""
LEAST_DRAWS = 4
"""Draws of a walker below which ArviZ's diagnostics are not defined: each half needs two."""
GOOD_RHAT = 1.03
"""What R-hat of every parameter must not exceed. For walkers of N draws that are a stationary chain with
autocorrelation time tau, the halves' means alone make it sqrt(1 + 2 tau / N): 1.02 at LONG_ENOUGH. The usual 1.01 is
for a few long chains, and would ask each of some forty walkers for the length of one."""


@dataclass(frozen=True)
class Posterior:
    """Draws after burn-in and thinning, theta (W walkers, N draws, P) natural, with log_prob (W, N).

    ``tau`` (P,) autocorrelation times in steps, ``acceptance`` the mean fraction, ``steps`` run in all,
    ``burn`` and ``thin`` applied.

    R-hat and the effective number of draws are ArviZ's (rank-normalised and split; Vehtari et al. 2021,
    eqs. 4, 13, 14), with a walker as a chain, of the very draws that posterior.nc holds. Walkers are not independent
    chains: each step moves one towards or along others. What they share falls as 1 / W once the ensemble is
    stationary, but an ensemble that is in the wrong place as a whole, as one that has not found a second mode, shows
    in neither number. Walkers that have not yet mixed show in both.
    """

    names: list[str]
    theta: Tensor
    log_prob: Tensor
    tau: np.ndarray
    acceptance: float
    steps: int
    burn: int
    thin: int
    note: str = ""
    """How the densities were worked out, where not exactly at every step, and what ended the chain."""
    out_of_time: bool = False
    """Whether a budget ended the chain."""

    @property
    def flat(self) -> Tensor:
        """Draws of all walkers, (W N, P)."""
        return self.theta.reshape(-1, self.theta.shape[-1])

    @cached_property
    def rhat(self) -> np.ndarray:
        """Rank-normalised split R-hat of each parameter, (P,); NaN of fewer than four draws a walker."""
        return _by_parameter("rhat", self.theta)

    @cached_property
    def ess(self) -> np.ndarray:
        """Effective number of draws of each parameter in the bulk of its posterior, (P,); NaN as above."""
        return _by_parameter("ess", self.theta)

    @property
    def lengths(self) -> float:
        """Autocorrelation times, of the slowest parameter, that were kept."""
        return (self.steps - self.burn) / float(np.max(self.tau))

    @property
    def converged(self) -> bool:
        """Whether the chain is long enough and its walkers agree."""
        return self.lengths >= LONG_ENOUGH * 0.9 and bool((self.rhat <= GOOD_RHAT).all())

    @property
    def reason(self) -> str:
        """Why the chain is trusted, or not."""
        said = (
            f"{number_of(self.steps, 'step')}, {number_of(self.lengths, 'autocorrelation time')} of {number_of(np.max(self.tau), 'step')} "
            "after burn-in"
        )
        worst, least = float(np.max(self.rhat)), float(np.min(self.ess))
        if math.isfinite(worst):
            said += f"; R-hat up to {worst:.3f}, at least {number_of(least, 'effective draw')}"
        else:
            said += "; too few draws to say whether the walkers agree (R-hat)"
        said += self.note
        if self.converged:
            return said
        return f"{said}; wanted are {LONG_ENOUGH} autocorrelation times and an R-hat of at most {GOOD_RHAT}"


def _by_parameter(name: str, theta: Tensor) -> np.ndarray:
    """A diagnostic of ArviZ by its name, of each parameter (P,) of draws (W, N, P); NaN of fewer draws than it takes."""
    if theta.shape[1] < LEAST_DRAWS:
        return np.full(theta.shape[-1], np.nan)  # as ArviZ gives, which logs a line for each as well
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ArviZ's next version, and of walkers without enough draws
        diagnostic = getattr(arviz_library(), name)
        return np.array([float(diagnostic(draws)) for draws in theta.numpy().transpose(2, 0, 1)])
