"""The body turns by a small angle at one instant."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.effects.attitude_offset import turn_about_axes
from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, TIME, Shown

WIDTH_IN_CADENCES = 0.1
"""The turn is smooth so that its time has a slope; rows are a cadence apart, so that but one can be within."""


def _angle(name: str) -> Quantity:
    return Quantity(
        name, "deg", -15.0, 15.0, f"turn about body {name.upper()} from then on",
        off=0.0, typical=1.0, prior="normal", mean=0.0, sigma=2.0,
    )  # fmt: skip


class AttitudeJump(Effect):
    """R = R0 Rot(w) for the rows later than ``time`` hours after the first row, as after a manoeuvre or a change of
    attitude mode: up to 0.34 mag for 1 deg at GEO.

    The turn takes a tenth of the cadence, so that its time has a slope to be found by. Neglects a slew that lasts.
    """

    name = "attitude_jump"
    title = "an attitude that jumps at one moment"
    shown = Shown(NIGHT, TIME, {"x": 1.0, "y": 0.0, "z": 1.0, "time": 4.0})
    stage = "attitude"
    timed_by_rows = True
    prior_odds = 0.1
    # what happens once, within the hours of a recording, is rarer than an attitude that is off throughout: station keeping takes
    # place every week or two, so one night in ten has it
    order = 1
    scanned = "time"
    turning = "jump"
    quantities = (
        _angle("x"),
        _angle("y"),
        _angle("z"),
        Quantity("time", "h", 0.0, 24.0, "from the first row to the turn, at most to the last", typical=1.0),
    )

    def missing(self, context):
        return None if context.cadence > 0 else "all rows have one time"

    def prepared(self, context):
        *angles, time = type(self).quantities
        span = float(context.seconds[-1]) / 3600
        self.quantities = (*angles, replace(time, high=span, typical=0.5 * span))
        return self

    def attitude(self, rotation, state, p, context):
        after = torch.sigmoid((state.time - 3600 * p["time"]) / (WIDTH_IN_CADENCES * context.cadence))
        return rotation @ rotation_of(torch.deg2rad(after[..., None] * turn_about_axes(p)))
