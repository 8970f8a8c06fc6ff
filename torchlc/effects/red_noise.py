"""Neighbouring rows err together."""

from __future__ import annotations

from dataclasses import replace

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect

MOST_LIMITS = 150
"""Upper limits in one curve whose joint probability is worked out: a tenth of a second for a single model."""
WITH_OUTLIERS = (
    "outliers are in the list, and among rows that err together every choice of bad ones has a density of its own. "
    "Leave out one of the two"
)


def too_many(limits: int) -> str | None:
    """Why so many upper limits in one curve are not taken, in words; None if they are."""
    if limits <= MOST_LIMITS:
        return None
    return (
        f"a curve has {limits} upper limits, and the joint probability of more than {MOST_LIMITS} that err together is "
        "not worked out. Take jitter, or leave out rows with upper_limit"
    )


class RedNoise(Effect):
    """A Gaussian process added to every curve, Matern-3/2 of standard deviation mag and time scale tau_min.

    It can hide any slow physics, which must therefore beat it on held-out rows. Neglects that curves may err
    together, and, where errors are fitted, how well the level of the steps between rows is known, which takes the
    place of the white noise.
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

    def missing(self, context):
        return too_many(context.limits)

    def beside(self, others):
        return WITH_OUTLIERS if "outliers" in others else None

    def noise(self, noise, p, context):
        return replace(noise, red=p["mag"], tau=p["tau_min"])
