"""The body turns about another of its directions than the scene says."""

from __future__ import annotations

import torch

from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import STAGE_TURNS, TIME, Shown


class AxisTilt(Effect):
    """R = R0 Rot(deg e) with a constant e at right angles to the axis of spin: 1.0 mag at the glints of a cylinder for 5 deg.

    The axis of spin stays where it is in space, and goes through another direction of the body. An example is a rocket body whose engine moves its
    principal axis off the middle of the tank. The turn about the axis itself is the phase of the spin. Neglects a motion of the
    axis in the body, which is ``nutation``.
    """

    name = "axis_tilt"
    title = "a spin about another direction of the body"
    shown = Shown(STAGE_TURNS, TIME, {"deg": 5.0, "towards_deg": 60.0})
    stage = "attitude"
    quantities = (
        Quantity("deg", "deg", 0.0, 90.0, "tilt", off=0.0, typical=5.0, prior="halfnormal", sigma=10.0),
        Quantity(
            "towards_deg", "deg", 0.0, 360.0, "direction of e about the axis of spin, from body +X or the next axis",
            typical=60.0,
        ),
    )  # fmt: skip

    def missing(self, context):
        return None if context.attitude.spins else "the attitude has no spin"

    def attitude(self, rotation, state, p, context):
        first, second, _ = context.attitude.about_spin_axis.to(rotation)
        towards, tilt = torch.deg2rad(p["towards_deg"]), torch.deg2rad(p["deg"])
        across = torch.cos(towards)[..., None] * first + torch.sin(towards)[..., None] * second
        return rotation @ rotation_of(tilt[..., None] * across)
