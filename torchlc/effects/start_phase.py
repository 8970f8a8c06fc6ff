"""The rotation begins elsewhere than the scene says."""

from __future__ import annotations

from torchlc.geometry.rotation.spin import ahead
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import LABORATORY, TIME, Shown

APART_DEG = 0.3
"""Of curves that begin together but for a few: a frame of a camera that takes some hundred a turn."""


class StartPhase(Effect):
    """A constant turn about the axis of spin: of each curve or night for itself where a camera of a laboratory begins elsewhere, or where
    turns between nights are not counted.

    Sun and observer stay, which a wrong clock (``time_offset``) moves. Neglects a phase that drifts, which is ``spin_rate_offset``.
    """

    name = "start_phase"
    title = "a rotation that begins elsewhere"
    shown = Shown(LABORATORY, TIME, {"deg": 10.0})
    stage = "spin"
    divisible = True
    whole_turn = 360.0
    prior_odds = 0.1
    """What is recorded under the sky has its times, and a clock is more often wrong than the turn by as much."""
    quantities = (
        Quantity(
            "deg", "deg", -180.0, 180.0, "true less assumed phase of the spin",
            off=0.0, typical=5.0, prior="normal", mean=0.0, sigma=15.0, apart=APART_DEG,
        ),
    )  # fmt: skip

    def missing(self, context):
        return None if context.attitude.spins else "the attitude has no spin"

    def spin(self, values, p, context):
        return ahead(values, p["deg"])
