"""Free geometry by an expansion, on which an ensemble moves fast, and the weights that make its draws exact."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from torchlc.inference.budget import Budget
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit
from torchlc.inference.posterior_draws import Posterior
from torchlc.lightcurve.evaluators.expansion import UnsuitableError

LEAST_LEFT = 0.5
"""Share of the draws that have to count after they are weighted; with less an exact run of the ensemble is as cheap as one
that is longer by as much."""
MOST_WEIGHED = 2000
"""Draws that are weighed: more than the 1,200 effective ones of 32 walkers that are just long enough. With all default
effects an exact density costs some 15 ms."""
FEW_WEIGHED = 192
"""The same under a budget: 3 s."""
AT_ONCE = 64
"""Draws whose exact densities are worked out at once."""


def expanded(fit: Fit) -> Likelihood:
    """The likelihood by an expansion of its free geometry about the best mode, with the posterior's covariance there; the
    likelihood itself where there is no such expansion."""
    likelihood, mode = fit.likelihood, fit.modes[0]
    model = likelihood.model
    if not model.geometry_free or mode.covariance.numel() == 0:
        return likelihood
    parameters = model.parameter_set
    y = parameters.to_flat(mode.theta)
    slope = torch.func.jacrev(parameters.from_flat)(y)
    covariance = slope @ mode.covariance @ slope.mT
    try:
        return likelihood.expanded(mode.theta, covariance)
    except UnsuitableError:
        return likelihood


def reweighted(
    posterior: Posterior, moving: Likelihood, likelihood: Likelihood, budget: Budget
) -> Posterior | None:
    """Draws of the posterior of ``moving``, drawn again by what the exact densities over its own weigh (systematic
    resampling, in their order); None where fewer than LEAST_LEFT of them count and the ``budget`` allows to start again.

    An error of d mag in rows of error s shifts a log density by about d / s times the root of the rows' number: at 1e-4, 0.02
    and 400 rows by 0.1, which leaves 0.99 of the draws.
    """
    step = -(-posterior.log_prob.numel() // (FEW_WEIGHED if budget.bounded else MOST_WEIGHED))
    posterior = replace(
        posterior,
        theta=posterior.theta[:, ::step],
        log_prob=posterior.log_prob[:, ::step],
        thin=posterior.thin * step,
    )
    draws = posterior.flat
    with torch.no_grad():
        exact, approximate = (
            torch.cat([target.log_prob(piece) for piece in draws.split(AT_ONCE)])
            for target in (likelihood, moving)
        )
    log_weight = torch.where(torch.isfinite(exact), exact, -math.inf) - approximate
    weight = torch.softmax(log_weight, 0)
    left = float(1 / (len(draws) * weight.square().sum()))
    if not left >= LEAST_LEFT and (budget.left() or not math.isfinite(left)):
        return None
    share = (torch.arange(len(draws), dtype=weight.dtype) + 0.5) / len(draws)
    chosen = torch.searchsorted(weight.cumsum(0), share).clamp(max=len(draws) - 1)
    return replace(
        posterior,
        theta=draws[chosen].reshape(posterior.theta.shape),
        log_prob=exact[chosen].reshape(posterior.log_prob.shape),
        note=f"{posterior.note}; drawn with approximate light, then weighted by the exact light, by which {left:.0%} of the draws count",
    )
