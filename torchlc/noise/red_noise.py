"""Neighbouring rows err together."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.noise.kind import NoiseKind
from torchlc.parameters import Quantity
from torchlc.stages.noise import Process
from torchlc.stages.showing import NIGHT, Shown


@dataclass(frozen=True)
class Matern32(Process):
    """Correlation (1 + x) exp(-x), x = sqrt(3) gap / tau, of rows at ``seconds`` (T,) with ``tau_min`` (..., 1)."""

    sd: Tensor
    tau_min: Tensor
    seconds: Tensor
    name: str = "red_noise"

    def correlation(self, rows):
        times = self.seconds[rows]
        gap_min = (times[:, None] - times[None]).abs() / 60.0
        return matern32(gap_min, self.tau_min[..., None] if self.tau_min.ndim else self.tau_min)

    @property
    def key(self):
        return (self.name, float(self.tau_min)) if self.tau_min.numel() == 1 else None


def matern32(gap_min: Tensor, tau_min: Tensor) -> Tensor:
    """Correlation (1 + x) exp(-x), x = sqrt(3) gap / tau."""
    x = math.sqrt(3.0) * gap_min / tau_min
    return (1 + x) * torch.exp(-x)


class RedNoise(NoiseKind):
    """A Gaussian process added to every curve, Matern-3/2 of standard deviation mag and time scale tau_min.

    It can hide any slow physics, which must therefore beat it on held-out rows. Neglects that curves may err
    together, and, where errors are fitted, how well the level of the white noise is known: that of the steps between rows
    takes its place, at which ln of the density is up to 0.5 below that of the best level (60 rows).
    """

    name = "red_noise"
    title = "noise that is correlated in time"
    shown = Shown(NIGHT, "lag, min", {"mag": 0.05, "tau_min": 20.0})
    correlates = True
    prior_odds = 0.3  # a night whose rows err together is rarer than one with a bad row
    quantities = (
        Quantity(
            "mag", "mag", 0.0, 2.0, "standard deviation of the process",
            off=0.0, typical=0.02, prior="halfnormal", sigma=0.05,
        ),
        Quantity(
            "tau_min", "min", 1.0, 120.0, "time over which rows err together",
            typical=15.0, prior="loguniform",
        ),
    )  # fmt: skip

    def noise(self, noise, p, context):
        return noise.with_process(Matern32(p["mag"], p["tau_min"], context.seconds))

    def trials(self, facts):
        spread = max(facts.spread, 0.3 * facts.sigma)
        return [{"mag": spread * factor, "tau_min": tau} for tau in facts.taus for factor in (0.25, 0.7, 1.3)]

    def closer(self, best, facts):
        return [{**best, "mag": best["mag"] * factor} for factor in (0.6, 0.8, 1.0, 1.25, 1.6)]
