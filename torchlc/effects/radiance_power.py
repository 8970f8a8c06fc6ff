"""The camera records a power of the radiance of each part of its picture."""

from __future__ import annotations

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.response import not_resolved, recorded
from torchlc.stages.showing import LABORATORY, TIME, Shown


class RadiancePower(Effect):
    """Each piece of the surface counts by its radiance to a power, over that of one that faces the lamp: pictures kept with a gamma of
    1/2.2 are 0.3 mag off at a quarter of the light.

    Where the camera resolves the object, and its pixels are added up after a table of tones (sRGB, film) was applied. Acts on materials of Lambert's law; neglects
    what it does to lobes, to edges within a pixel and to light from parts on parts.
    """

    name = "radiance_power"
    title = "a camera whose pixels record a power of the light"
    shown = Shown(LABORATORY, TIME, {"power": 0.6})
    stage = "surface"
    order = 3
    quantities = (
        Quantity(
            "power", "", 0.2, 4.0, "exponent of the radiance", off=1.0, typical=0.6, prior="lognormal", mean=1.0,
            sigma=0.4,
        ),
    )  # fmt: skip

    def missing(self, context):
        return not_resolved(context)

    def surface(self, patches, view, p, context):
        return recorded(patches, view, "power", p["power"])
