"""Neighbouring rows err together."""

from __future__ import annotations

from dataclasses import replace

from torchlc.effects.base import Effect
from torchlc.parameters import Quantity


class RedNoise(Effect):
    """A Gaussian process added to every curve, Matern-3/2 of standard deviation mag and time scale tau_min.

    It can hide any slow physics, which must therefore beat it on held-out rows. Neglects that curves may err
    together.
    """

    name = "red_noise"
    stage = "noise"
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
        return replace(noise, red=p["mag"], tau=p["tau_min"])
