"""Part of the surface is another material."""

from __future__ import annotations

from torchlc.brdf.ashikhmin_shirley import AshikhminShirley
from torchlc.parameters import EXPONENT, LOBE_REFLECTANCE, REFLECTANCE, SHARE, Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown


class SecondMaterial(Effect):
    """A share ``weight`` of each facet has its own Ashikhmin-Shirley values: cells between frames,
    radiators on foil.

    20 % with n = 2000 on a panel of n = 154 leave 0.3 mag at the peak. Neglected: any tilt between the two,
    and where on the facet each lies, which shadows then treat alike.
    """

    name = "second_material"
    title = "a second material on part of a surface"
    shown = Shown(NIGHT, PANEL_GLINT, {"weight": 0.2, "n": 3000.0, "r_spec": 0.05, "r_diff": 0.05}, "panel")
    stage = "material"
    order = 2
    per = "material"
    simplex = ("r_spec", "r_diff")
    coupled = True
    unable = "the material is not of Ashikhmin and Shirley's model"
    quantities = (
        Quantity(
            "weight",
            "",
            0.0,
            1.0,
            "share of the area that is the second material",
            off=0.0,
            typical=0.2,
            role=SHARE,
        ),
        Quantity(
            "n",
            "",
            1.0,
            1e6,
            "lobe exponent of the second material",
            typical=2000.0,
            prior="loguniform",
            role=EXPONENT,
        ),
        Quantity(
            "r_spec",
            "",
            0.0,
            1.0,
            "mirror-like reflectance of the second material",
            typical=0.3,
            role=LOBE_REFLECTANCE,
        ),
        Quantity(
            "r_diff",
            "",
            0.0,
            1.0,
            "diffuse reflectance of the second material",
            typical=0.2,
            role=REFLECTANCE,
        ),
    )

    @classmethod
    def targets(cls, context):
        return [name for name in context.materials if context.models[name] is AshikhminShirley]

    def material(self, reflect, surface, values, p):
        weight, n = p["weight"], p["n"][..., 0]
        second = {"n_u": n, "n_v": n, "r_spec": p["r_spec"][..., 0], "r_diff": p["r_diff"][..., 0]}

        def mixed(material):
            return tuple(
                (1 - weight) * first + weight * other
                for first, other in zip(reflect(material), reflect(second), strict=True)
            )

        return mixed
