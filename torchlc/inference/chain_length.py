"""How long a chain has to be, against its own autocorrelation time, and what is kept of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torchlc.inference.likelihood import Likelihood
from torchlc.inference.posterior_draws import LONG_ENOUGH, Posterior

if TYPE_CHECKING:
    import emcee  # loads scipy.stats, for 0.5 s, which only a chain is worth


BLOCK = 20
"""Steps between looks at the clock."""
FIRST_CHECK = 500
"""Steps after which a chain is first judged; then each time it has grown by a tenth."""


class Goal:
    """How far a chain has to go: ``steps`` of them, or until it is long enough and its walkers agree, at most ``longest``.
    ``share`` is how much of the latter the chain had when it was last judged."""

    def __init__(self, likelihood: Likelihood, steps: int | None, longest: int) -> None:
        self.likelihood = likelihood
        self.fixed = steps is not None
        self.limit = longest if steps is None else steps
        self.share = 0.0
        self._due: int | None = None

    def reached(self, chain: emcee.backends.Backend) -> bool:
        """Whether the chain need not go on. Its autocorrelation is looked at only at the lengths of :func:`_next_check`."""
        length = chain.iteration
        if not self.fixed:
            due = _next_check(length) if self._due is None else self._due
            if length >= due:
                self.share = _progress(self.likelihood, chain)
                due = _next_check(length + 1)
            self._due = due
        return length >= self.limit or self.share >= 1


def _next_check(iteration: int) -> int:
    """The first length from ``iteration`` on at which a chain is judged; resumed runs have the same."""
    due = FIRST_CHECK
    while due < iteration:
        due += BLOCK * max(1, due // (10 * BLOCK))
    return due


def _tau(backend: emcee.backends.Backend) -> np.ndarray:
    import emcee

    chain = backend.get_chain(discard=backend.iteration // 4)
    with np.errstate(invalid="ignore"):  # a walker that has not moved has no autocorrelation
        tau = emcee.autocorr.integrated_time(chain, tol=0, quiet=True)
    return np.nan_to_num(tau, nan=float(backend.iteration))


def _progress(likelihood: Likelihood, backend: emcee.backends.Backend) -> float:
    """Share of the wanted length that the chain has after burn-in; below 1 while its walkers do not agree.

    R-hat, which takes longer than the autocorrelation time, is worked out for chains of that length only.
    """
    share = 0.75 * backend.iteration / (LONG_ENOUGH * float(np.max(_tau(backend))))
    if share > 1 and posterior_of(likelihood, backend).converged:
        return share
    return min(share, 0.99)


def posterior_of(likelihood: Likelihood, backend: Any) -> Posterior:
    tau = _tau(backend)
    longest = float(np.max(tau))
    burn = min(int(max(3 * longest, backend.iteration // 4)), backend.iteration // 2)
    thin = max(1, int(longest / 4))
    chain = torch.as_tensor(backend.get_chain(discard=burn, thin=thin).copy())
    log_prob = torch.as_tensor(backend.get_log_prob(discard=burn, thin=thin).copy())
    accepted = float(np.mean(backend.accepted / max(backend.iteration, 1)))
    with torch.no_grad():
        theta = likelihood.model.parameter_set.from_straight(chain)[0].transpose(0, 1).contiguous()
    return Posterior(likelihood.model.names, theta, log_prob.T, tau, accepted, backend.iteration, burn, thin)
