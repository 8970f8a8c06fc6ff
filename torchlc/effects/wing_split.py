"""The wings point apart."""

from __future__ import annotations

import torch

from torchlc.geometry.rotation.matrices import rotation_about
from torchlc.parameters import Quantity
from torchlc.shapes.part import like
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown


class WingSplit(Effect):
    """Right-handed turn about their axis of every other part that tracks the Sun, and a turn the other way of those
    between: 0.23 mag for 2 deg at a GEO peak, and two glints from about 5 deg on.

    Neglects what the wings have in common, which panel_offset has.
    """

    name = "wing_split"
    title = "wings that point to either side of the Sun"
    shown = Shown(NIGHT, PANEL_GLINT, {"deg": 2.0})
    stage = "pointing"
    swings = "deg"
    order = 1
    quantities = (
        Quantity(
            "deg", "deg", 0.0, 15.0, "half of the angle between the wings",
            off=0.0, typical=2.0, prior="halfnormal", sigma=2.0,
        ),
    )  # fmt: skip
    unable = "fewer than two parts track the Sun"

    @classmethod
    def targets(cls, context):
        tracking = [part for part in context.parts if part.tracks_axis is not None]
        return [None] if len(tracking) > 1 else []

    def pointing(self, poses, p, context):
        angle, first, turned = torch.deg2rad(p["deg"]), None, []
        for pose, part in zip(poses, context.parts, strict=True):
            if pose is not None and part.tracks_axis is not None:
                first = part.tracks_axis if first is None else first
                axis = like(part.tracks_axis, angle) * (1.0 if part.tracks_axis @ first >= 0 else -1.0)
                pose = rotation_about(axis.expand(*angle.shape, 3), angle) @ pose
                angle = -angle
            turned.append(pose)
        return tuple(turned)
