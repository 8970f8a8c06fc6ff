"""What a fit knows of each free parameter and of each level of noise that it fitted, by name, as in fit.json."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.inference.identifiability import Insight
from torchlc.inference.optimiser import Fit
from torchlc.inference.posterior_draws import Posterior

NOISE_DRAWS = 400
"""Of each noise level: its standard deviation is right to 4 %."""


def parameter_values(fit: Fit, posterior: Posterior, insight: Insight) -> dict[str, dict[str, Any]]:
    """Everything known of each free parameter."""
    values: dict[str, dict[str, Any]] = {}
    draws = posterior.flat
    quantiles = torch.quantile(thinned(draws, 100_000), draws.new_tensor([0.05, 0.5, 0.95]), dim=0)
    rhat, ess = posterior.rhat, posterior.ess
    for i, entry in enumerate(fit.model.parameter_set.free):
        values[entry.name] = {
            "map": float(fit.theta[i]),
            "median": float(quantiles[1, i]),
            "sd": float(draws[:, i].std()),
            "q05": float(quantiles[0, i]),
            "q95": float(quantiles[2, i]),
            "rhat": float(rhat[i]),
            "ess": float(ess[i]),
            "unit": entry.unit,
            "informed": insight.informed[entry.name],
        }
    return values


def noise_levels(fit: Fit, posterior: Posterior | None, seed: int) -> dict[str, dict[str, Any]]:
    """Of curves without errors: given the residuals of a draw, N s^2 / S of each curve follows the
    inverse chi-square.
    """
    likelihood = fit.likelihood
    if not likelihood.fitted_errors:
        return {}
    with torch.no_grad():
        best = likelihood.fitted_levels(likelihood.residuals(fit.theta).delta)
        theta = fit.theta[None] if posterior is None else posterior.flat
        theta = (
            thinned(theta, NOISE_DRAWS).expand(NOISE_DRAWS, -1)
            if len(theta) < 2
            else thinned(theta, NOISE_DRAWS)
        )
        squares = likelihood.squares(likelihood.residuals(theta).delta)
    freedom = (likelihood.count - (1 if likelihood.gains else 0)).clamp(min=1.0)
    generator = np.random.default_rng(seed)
    drawn = np.sqrt(squares.numpy() / generator.chisquare(freedom.numpy(), squares.shape))
    unit = "mag" if likelihood.kind == "mag" else ""
    return {
        f"noise[{curve}]": {
            "map": float(best[i]),
            "median": float(np.median(drawn[:, i])),
            "sd": float(drawn[:, i].std()),
            "q05": float(np.quantile(drawn[:, i], 0.05)),
            "q95": float(np.quantile(drawn[:, i], 0.95)),
            "rhat": None,
            "ess": None,
            "unit": unit,
            "informed": True,
        }
        for i, curve in enumerate(fit.model.recording.curve_ids)
    }


def thinned(draws: Tensor, most: int) -> Tensor:
    """At most that many of the draws (N, P), evenly spaced."""
    return draws[:: max(1, math.ceil(len(draws) / most))]
