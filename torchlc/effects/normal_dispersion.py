"""The facet is wrinkled: its normals scatter about the mean one."""

from __future__ import annotations

import math

import torch

from torchlc.brdf.base import Brdf
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown

TOLD_MAG = 0.03
"""Error of the diffuse light from which on it is told: three times that of a good row."""


class NormalDispersion(Effect):
    """Gaussian tilts of ``deg`` about each in-plane axis widen the lobe: 1/n grows by the variance, light
    is conserved.

    Inseparable from n but by a prior on one of them. Neglected: what the tilts do to the diffuse part, of
    relative size variance x (cos(phase) / (mu0 mu) - 3), so that it is too bright: 0.02 mag at 5 deg, 0.08 at 10, 0.17 at 15 near
    the glint at a phase angle of 10 deg, 0.03 to 0.28 at 80; and how cosines and Fresnel's factor vary over the lobe, which is 0.02, 0.05 and
    0.09 mag too bright in its middle and as much too faint at a standard deviation and a half (against the mean of tilted plates). No
    lumps are left, such as few wrinkles make.
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

    def limits(self, p, context):
        deg = float(p["deg"].max())
        # E[mu0' mu'] = mu0 mu (1 - 3 v) + v cos(phase), with both cosines near 1
        bright = -2.5 * math.log10(1 - 2 * math.radians(deg) ** 2)
        if bright < TOLD_MAG:
            return ()
        return (
            f"normal_dispersion: diffuse light stays that of flat surfaces, which is up to {bright:.2g} mag brighter than of surfaces that scatter by "
            f"{deg:.3g} deg; r_diff and what adds light, as a background does, may make up for it",
        )

    def material(self, reflect, surface, values, p):
        variance = torch.deg2rad(p["deg"][..., 0]) ** 2
        return lambda material: reflect(surface.model.broadened(material, variance))


def has_lobe(model: type[Brdf]) -> bool:
    """Whether a reflection model can be broadened."""
    return model.broadened is not Brdf.broadened
