"""The clock of the recording is wrong by a constant."""

from __future__ import annotations

from dataclasses import replace

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import PASS, PASS_GLINT, Shown

APART_S = 10.0
"""Of clocks of several observers: most are right to seconds, and some are off by minutes, or by an hour of a zone."""


class TimeOffset(Effect):
    """Object, Sun and station are all taken at stamp + s: 0.044 mag for 60 s near a GEO glint.

    A spinner is out by s/P of a turn. Neglects a drift of the clock within the recording.
    """

    name = "time_offset"
    title = "time stamps that are off by a constant"
    shown = Shown(PASS, PASS_GLINT, {"s": 2.0})
    stage = "clock"
    shifts_clock = True
    divisible = True
    quantities = (
        Quantity(
            "s", "s", -3600.0, 3600.0, "true time less stamped time",
            off=0.0, typical=10.0, prior="normal", mean=0.0, sigma=10.0, apart=APART_S,
        ),
    )  # fmt: skip

    def missing(self, context):
        if not context.track.supports("motion"):
            return "the recording gives no motion between its stamps"
        return None

    def clock(self, nodes, p, context):
        return replace(nodes, offset=nodes.offset + p["s"])
