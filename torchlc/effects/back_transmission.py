"""Some sunlight gets through a panel."""

from __future__ import annotations

import math

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect, Scatter
from torchlc.stages.showing import PASS, Shown


class BackTransmission(Effect):
    """A share ``t_d`` of the light on one side of a plate leaves the other side by Lambert's law: t_d A
    |mu0 mu| / (pi range^2).

    At t_d = 0.02 two wings of 11 m2 reach magnitude 13.3 at GEO. Neglected: light that passes straight
    through, and what shadows and hides the plate: the share of its area that other parts cover.
    """

    name = "back_transmission"
    title = "light that shines through a panel from behind"
    shown = Shown(PASS, "phase_angle_deg", {"t_d": 0.02}, "panel")
    stage = "scatter"
    per = "component"
    unable = "the component is no two-sided plate"
    quantities = (
        Quantity(
            "t_d", "", 0.0, 0.2, "diffuse transmittance of the plate", off=0.0, typical=0.02,
            prior="halfnormal", sigma=0.02,
        ),
    )  # fmt: skip

    @classmethod
    def targets(cls, context):
        return [part.name for part in context.parts if part.thin]

    def scatter(self, view, context):
        number = next(i for i, part in enumerate(context.parts) if part.name == self.target)
        facets, pose = view.facets[number], view.poses[number]
        normal = facets.normal if pose is None else torch.einsum("...ij,fj->...fi", pose, facets.normal)
        sun, observer = (
            torch.einsum("...fi,...i->...f", normal, direction)
            for direction in (view.to_sun, view.to_observer)
        )
        through = (sun * -observer).where((sun > 0) & (observer < 0), 0.0) @ facets.area
        irradiance = sum(light.irradiance.sum(0) for light in view.lights if light.primary)
        flux = (view.nodes.weight * irradiance * through / (math.pi * view.range_m**2)).sum(0)
        return Scatter(lambda reflect, p: {context.parts[number].name: p["t_d"] * flux})
