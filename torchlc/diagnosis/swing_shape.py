"""The shape of what is missing where an angle swings that the library takes as constant."""

from __future__ import annotations

import torch

from torchlc.diagnosis.discrepancy import REPEATING, Discrepancy
from torchlc.diagnosis.hypotheses import Hypothesis, effect_columns
from torchlc.effects import effect_class
from torchlc.inference.density import Fitted

DRAWS = 64
"""For the band of a curve: its errors are known to a tenth."""


def shape_of(at: Fitted, beside: Hypothesis, log_gain: float, log_odds: float) -> Discrepancy:
    """What the swings of a fit add to the light, in mag, over the same model without them, as a discrepancy beside what else its hypothesis
    holds; ``log_gain`` and ``log_odds`` are those over that."""
    parameters = at.model.parameter_set
    amplitudes = [effect_columns(parameters, entry)[0] for entry in at.hypothesis.unlisted]

    def curve(theta: torch.Tensor) -> torch.Tensor:
        """(..., T) of theta (..., P)."""
        still = theta.index_fill(-1, torch.tensor(amplitudes), 0.0)
        flux, bare = (at.model.brightness(values).flux.clamp(min=1e-300) for values in (theta, still))
        return -2.5 * torch.log10(flux / bare)

    with torch.no_grad():
        best = curve(at.theta)
        band = curve(at.draws(DRAWS, at.hypothesis.seed)).std(0)
    first = at.hypothesis.unlisted[0]
    deg, minutes, _ = (float(at.theta[column]) for column in effect_columns(parameters, first))
    words = f"is that of {effect_class(first).title} by {deg:.2g} deg every {minutes:.3g} min"
    every = torch.ones_like(best, dtype=torch.bool)
    log_z = at.log_z - log_gain
    return Discrepancy(
        beside, log_z, REPEATING, log_gain, log_odds, best, band, every, 60 * minutes, at, words
    )
