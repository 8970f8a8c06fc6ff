"""The zero point jumps once."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, TIME, Shown

WIDTH_IN_CADENCES = 0.1
"""The step is smooth so that its time has a slope; rows are a cadence apart, so that but one can be within."""


class ZeroPointStep(Effect):
    """Adds mag to the rows later than ``time`` hours after the first row, as when a camera was restarted.

    The step is a logistic curve a tenth of the cadence wide, so that its time has a slope to be found by.
    Neglects further steps.
    """

    name = "zero_point_step"
    title = "a zero point that jumps at one moment"
    shown = Shown(NIGHT, TIME, {"mag": 0.1, "time": 5.0})
    stage = "detector"
    timed_by_rows = True
    order = 2
    scanned = "time"
    quantities = (
        Quantity(
            "mag", "mag", -2.0, 2.0, "added after the step",
            off=0.0, typical=0.05, prior="normal", mean=0.0, sigma=0.05,
        ),
        Quantity("time", "h", 0.0, 24.0, "from the first row to the step, at most to the last", typical=1.0),
    )  # fmt: skip

    def missing(self, context):
        return None if context.cadence > 0 else "all rows have one time"

    def prepared(self, context):
        mag, time = type(self).quantities
        span = float(context.seconds[-1]) / 3600
        self.quantities = (mag, replace(time, high=span, typical=0.5 * span))
        return self

    def detector(self, brightness, p, context):
        later = context.seconds.to(brightness.flux) - 3600 * p["time"]
        after = torch.sigmoid(later / (WIDTH_IN_CADENCES * context.cadence))
        return replace(brightness, flux=brightness.flux * 10 ** (-0.4 * p["mag"] * after))
