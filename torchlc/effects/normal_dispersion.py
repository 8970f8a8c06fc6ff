"""The facet is wrinkled: its normals scatter about the mean one."""

from __future__ import annotations

import torch

from torchlc.brdf.base import Brdf
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown


class NormalDispersion(Effect):
    """Gaussian tilts of ``deg`` about each in-plane axis widen the lobe: 1/n grows by the variance, light
    is conserved.

    Inseparable from n but by a prior on one of them. Neglected: what the tilts do to the diffuse part, of
    relative size variance x (cos(phase) / (mu0 mu) - 2): 0.005 mag at 4 deg and normal incidence, 0.05 mag
    where both cosines are 0.3; and the lumps that few wrinkles leave.
    """

    name = "normal_dispersion"
    title = "surfaces that are not quite flat"
    shown = Shown(NIGHT, PANEL_GLINT, {"deg": 3.0}, "panel")
    stage = "material"
    order = 1
    per = "material"
    unable = "the material has no lobe to widen"
    quantities = (
        Quantity(
            "deg", "deg", 0.0, 20.0, "standard deviation of the facet normals about each axis",
            off=0.0, typical=3.0,
        ),
    )  # fmt: skip

    @classmethod
    def targets(cls, context):
        return [name for name in context.materials if has_lobe(context.models[name])]

    def material(self, reflect, surface, values, p):
        variance = torch.deg2rad(p["deg"][..., 0]) ** 2
        return lambda material: reflect(surface.model.broadened(material, variance))


def has_lobe(model: type[Brdf]) -> bool:
    """Whether a reflection model can be broadened."""
    return model.broadened is not Brdf.broadened
