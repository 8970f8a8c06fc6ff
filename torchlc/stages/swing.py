"""What no effect of the library describes, but may be looked for: an angle that an effect takes as constant, and that swings."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any, Self

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Context, Effect, Parameters

SWING = "_swing"
"""What the name of an effect whose angle swings ends with."""
DEG, PERIOD, PHASE = "deg", "period_min", "phase_deg"
"""Its numbers, by name."""
SHORTEST_MIN, TYPICAL_MIN, LONGEST_MIN = 1.0, 10.0, 720.0
CYCLES = 2
"""What comes again is seen twice at least."""
MOST_DEG = 15.0


@cache
def swinging(cls: type[Effect]) -> type[Effect]:
    """An effect of the stage "pointing" with its angle ``cls.swings`` = deg sin(2 pi t / period + phase), t from the first row:
    0.3 mag for 1 deg beside a glint. It is none of the library's effects: a diagnosis
    that finds it says that something is missing which the library does not hold, and what it looks like."""
    (steady,) = (quantity for quantity in cls.quantities if quantity.name == cls.swings)
    typical = steady.typical or 1.0

    class Swinging(cls):
        """The angle swings: deg sin(2 pi t / period + phase), t from the first row.

        Neglects a swing within an exposure, and one that dies out.
        """

        title = f"{cls.title}, by an angle that swings"
        timed_by_rows = True
        turning = "swing"
        swings = ""
        quantities = (
            Quantity(
                DEG, "deg", 0.0, MOST_DEG, "amplitude", off=0.0, typical=typical, prior="halfnormal", sigma=2 * typical,
            ),
            Quantity(PERIOD, "min", SHORTEST_MIN, LONGEST_MIN, "period", typical=TYPICAL_MIN, prior="loguniform"),
            Quantity(PHASE, "deg", 0.0, 360.0, "phase at the first row", typical=90.0),
        )  # fmt: skip

        def prepared(self, context: Context) -> Self:
            """With periods that the recording has CYCLES of: a slower swing is a drift."""
            super().prepared(context)
            minutes = float(context.seconds.max() - context.seconds.min()) / 60
            longest = min(max(minutes / CYCLES, 2 * SHORTEST_MIN), LONGEST_MIN)
            deg, period, phase = type(self).quantities
            period = replace(period, high=longest, typical=min(TYPICAL_MIN, longest / 2))
            self.quantities = (deg, period, phase)
            return self

        def pointing(self, poses: Any, p: Parameters, context: Context) -> Any:
            turn = 2 * math.pi * context.seconds / (60 * p[PERIOD]) + torch.deg2rad(p[PHASE])
            return super().pointing(poses, {steady.name: p[DEG] * torch.sin(turn)}, context)

    Swinging.name = cls.name + SWING
    return Swinging
