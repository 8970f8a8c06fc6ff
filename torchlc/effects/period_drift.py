"""The period of rotation grows or falls steadily."""

from __future__ import annotations

from torchlc.geometry.rotation.attitude import MS_A_DAY
from torchlc.geometry.rotation.spin import slowing
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import STAGE_WEEK, TIME, Shown

FAST_MS_A_DAY = 10.0
"""Tumbling rocket bodies slow down by 0.1 to 5 ms a day."""
LEAST_TURNS = 1e-3
"""A turn of 0.4 deg: glints move by less than the width of their lobes, for n up to 20,000."""


class PeriodDrift(Effect):
    """P(t) = P + rate (t - epoch): a rocket body of 10 s whose period grows by 1 ms a day is a quarter of a turn off after 7 days,
    and 1 mag at its glints.

    Turns are ln(1 + rate t / P) / rate, right for any rate (Pravec et al. 2005 use the first term, rate t^2 / 2 P^2). A rate that the
    scene has itself is added to. Neglects a torque that changes, and one that turns the axis.
    """

    name = "period_drift"
    title = "a period of rotation that changes steadily"
    shown = Shown(STAGE_WEEK, TIME, {"ms_per_day": 0.3})
    stage = "spin"
    quantities = (
        Quantity(
            "ms_per_day", "ms/d", -1000.0, 1000.0, "growth of the period",
            off=0.0, typical=1.0, prior="normal", mean=0.0, sigma=3.0,
        ),
    )  # fmt: skip

    def missing(self, context):
        turns_a_second = abs(context.attitude.spin_rate_at_start) / 3600
        if not turns_a_second:
            return "the attitude has no spin"
        span = float(context.seconds[-1] - context.seconds[0])
        most = 0.5 * MS_A_DAY * FAST_MS_A_DAY * (turns_a_second * span) ** 2
        if most < LEAST_TURNS:
            return (
                f"{FAST_MS_A_DAY:g} ms a day change the turn by less than {LEAST_TURNS:g} in this recording"
            )
        return None

    def spin(self, values, p, context):
        return slowing(values, context.attitude.numbers, p["ms_per_day"])
