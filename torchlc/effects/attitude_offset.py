"""The body is turned by a small constant angle from where its attitude mode puts it."""

from __future__ import annotations

import torch

from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect, Parameters
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown


def turn_about_axes(p: Parameters) -> torch.Tensor:
    """Turns x, y and z about the body axes as one vector (..., T or 1, 3), in their own unit."""
    return torch.stack(torch.broadcast_tensors(p["x"], p["y"], p["z"]), -1)


def _angle(name: str, turn: str) -> Quantity:
    return Quantity(
        name, "deg", -15.0, 15.0, f"turn about body {turn}",
        off=0.0, typical=0.5, prior="normal", mean=0.0, sigma=1.0,
    )  # fmt: skip


class AttitudeOffset(Effect):
    """R = R0 Rot(w) with a constant rotation vector w in body axes: up to 0.34 mag for 1 deg at GEO.

    Tracking parts are solved after the turn. Neglects a drift of the offset.
    """

    name = "attitude_offset"
    title = "an attitude that is turned by a constant angle"
    shown = Shown(NIGHT, PANEL_GLINT, {"x": 1.0, "y": 0.0, "z": 1.0})
    stage = "attitude"
    quantities = (_angle("x", "X"), _angle("y", "Y"), _angle("z", "Z"))

    def attitude(self, rotation, state, p, context):
        return rotation @ rotation_of(torch.deg2rad(turn_about_axes(p)))
