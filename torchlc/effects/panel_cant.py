"""The wings are tilted out of the axis about which they follow the Sun."""

from __future__ import annotations

import torch

from torchlc.geometry.rotation.matrices import rotation_about
from torchlc.parameters import Quantity
from torchlc.shapes.part import like
from torchlc.stages.effect import Effect, turned_poses
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown
from torchlc.tensors.vectors import unit


class PanelCant(Effect):
    """Tilt of every tracking part's front p about p x axis: 0.15 mag for 1 deg at a GEO peak.

    Towards the axis where positive, so that wings on both sides of the body with one axis lean the same way.
    Neglects bending along a wing.
    """

    name = "panel_cant"
    title = "panels that are tilted out of their axis"
    shown = Shown(NIGHT, PANEL_GLINT, {"deg": 2.0})
    stage = "pointing"
    swings = "deg"
    quantities = (
        Quantity(
            "deg", "deg", -10.0, 10.0, "tilt of the tracking parts' front towards their axis",
            off=0.0, typical=1.0, prior="normal", mean=0.0, sigma=2.0,
        ),
    )  # fmt: skip

    def missing(self, context):
        tracking = any(part.tracks_axis is not None for part in context.parts)
        return None if tracking else "no part tracks the Sun"

    def pointing(self, poses, p, context):
        angle = torch.deg2rad(p["deg"])

        def tilted(pose, part):
            axis, front = like(part.tracks_axis, pose), pose @ like(part.front, pose)
            hinge = unit(torch.linalg.cross(front, axis.expand(front.shape)))
            return rotation_about(hinge, angle) @ pose

        return turned_poses(poses, context.parts, tilted)
