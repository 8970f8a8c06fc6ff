"""The camera adds a constant to each pixel that shows the lit object, or takes too much off."""

from __future__ import annotations

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.response import not_resolved, recorded
from torchlc.stages.showing import LABORATORY, TIME, Shown


class RadiancePedestal(Effect):
    """radiance + level of each piece that is lit and seen, over the radiance of one that faces the lamp: the curve of the lit area is
    mixed in, 0.05 mag for 5 % at phase 90 deg.

    Where the camera resolves the object. A constant of all pixels alike, object or not, is ``background``. Acts on materials of Lambert's law. Neglects
    that dark parts of the object may count too.
    """

    name = "radiance_pedestal"
    title = "a camera that adds a constant to pixels of the lit object"
    shown = Shown(LABORATORY, TIME, {"level": 0.1})
    stage = "surface"
    order = 3
    quantities = (
        Quantity(
            "level", "", -0.3, 1.0, "constant, over what is recorded of a surface that faces the lamp",
            off=0.0, typical=0.05, prior="normal", mean=0.0, sigma=0.1,
        ),
    )  # fmt: skip

    def missing(self, context):
        return not_resolved(context)

    def surface(self, patches, view, p, context):
        return recorded(patches, view, "pedestal", p["level"])
