"""The camera's pixels below a threshold do not count, and the threshold is taken off the others."""

from __future__ import annotations

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.response import not_resolved, recorded
from torchlc.stages.showing import LABORATORY, TIME, Shown


class RadianceThreshold(Effect):
    """max(radiance - threshold, 0) of each piece of the surface, over the radiance of one that faces the lamp: 5 % is 0.1 mag at phase 90
    deg.

    Where the camera resolves the object and a level was taken off its pixels. Acts on materials of Lambert's law, after ``radiance_power``. Neglects noise of
    pixels, edges within a pixel, and pixels that are cut but keep their value.
    """

    name = "radiance_threshold"
    title = "a camera whose faint pixels do not count"
    shown = Shown(LABORATORY, TIME, {"level": 0.1})
    stage = "surface"
    order = 3
    quantities = (
        Quantity(
            "level", "", 0.0, 0.9, "threshold, over what is recorded of a surface that faces the lamp",
            off=0.0, typical=0.1, prior="halfnormal", sigma=0.1,
        ),
    )  # fmt: skip

    def missing(self, context):
        return not_resolved(context)

    def surface(self, patches, view, p, context):
        return recorded(patches, view, "threshold", p["level"])
