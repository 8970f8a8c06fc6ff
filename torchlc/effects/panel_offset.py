"""The parts that track the Sun stand at a constant angle to where they should."""

from __future__ import annotations

import torch

from torchlc.geometry.rotation.matrices import rotation_about
from torchlc.parameters import Quantity
from torchlc.shapes.part import like
from torchlc.stages.effect import Effect, turned_poses
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown


class PanelOffset(Effect):
    """Right-handed turn of all tracking parts about their axis: 0.34 mag for 1 deg beside a GEO glint.

    One angle for all wings; neglects a drive that lags or moves in steps (1 deg of stepping: 0.17 mag).
    """

    name = "panel_offset"
    title = "panels that point past the Sun"
    shown = Shown(NIGHT, PANEL_GLINT, {"deg": 2.0})
    stage = "pointing"
    swings = "deg"
    quantities = (
        Quantity(
            "deg", "deg", -15.0, 15.0, "turn of the tracking parts about their axis, right-handed",
            off=0.0, typical=1.0, prior="normal", mean=0.0, sigma=3.0,
        ),
    )  # fmt: skip

    def missing(self, context):
        tracking = any(part.tracks_axis is not None for part in context.parts)
        return None if tracking else "no part tracks the Sun"

    def pointing(self, poses, p, context):
        angle = torch.deg2rad(p["deg"])

        def turned(pose, part):
            axis = like(part.tracks_axis, angle).expand(*angle.shape, 3)
            return rotation_about(axis, angle) @ pose

        return turned_poses(poses, context.parts, turned)
