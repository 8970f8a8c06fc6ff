"""The object turns faster or slower than the scene says."""

from __future__ import annotations

from torchlc.geometry.rotation.spin import faster
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import SPIN, TIME, Shown


class SpinRateOffset(Effect):
    """rate = the scene's + rev_per_hour: out of step after 1/(2 rev_per_hour) h.

    The phase is pinned at spin_epoch (``epoch`` for a spin pole). Neglects a change of the rate during the
    recording.
    """

    name = "spin_rate_offset"
    title = "a rate of spin that differs from the scene's"
    shown = Shown(SPIN, TIME, {"rev_per_hour": 0.3})
    stage = "spin"
    quantities = (
        Quantity(
            "rev_per_hour", "rev/h", -0.5, 0.5, "true less assumed rate of spin",
            off=0.0, typical=0.01, prior="normal", mean=0.0, sigma=0.02,
        ),
    )  # fmt: skip

    def missing(self, context):
        return None if context.attitude.spins else "the attitude has no spin"

    def spin(self, values, p, context):
        return faster(values, p["rev_per_hour"])
