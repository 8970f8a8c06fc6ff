"""The body swings about one of its axes."""

from __future__ import annotations

import math

import torch

from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, Shown


class Wobble(Effect):
    """R = R0 Rot(w), w = deg sin(2 pi t / period + phase) about one body axis: 0.16 mag for 0.5 deg at GEO.

    t runs from the first row. The axis has a longitude and a latitude in the body frame (+X at 0, +Y at 90,
    +Z at latitude 90), on one half of the sphere: its opposite is the same with the phase turned by 180
    deg. Neglects coning, which needs two axes a quarter of a period apart.
    """

    name = "wobble"
    title = "an attitude that swings periodically"
    shown = Shown(NIGHT, "cycle of the wobble", {"deg": 1.0, "period_min": 80.0})
    stage = "attitude"
    timed_by_rows = True
    turning = "swing"
    quantities = (
        Quantity("deg", "deg", 0.0, 5.0, "amplitude", off=0.0, typical=0.5, prior="halfnormal", sigma=1.0),
        Quantity("period_min", "min", 1.0, 720.0, "period", typical=10.0, prior="loguniform"),
        Quantity("phase_deg", "deg", 0.0, 360.0, "phase at the first row", typical=90.0),
        Quantity("axis_lon", "deg", -45.0, 135.0, "longitude of the axis from body +X to +Y", typical=90.0),
        Quantity(
            "axis_lat", "deg", -90.0, 90.0, "latitude of the axis towards body +Z", typical=0.0,
            prior="isotropic",
        ),
    )  # fmt: skip

    def attitude(self, rotation, state, p, context):
        lon, lat = map(torch.deg2rad, torch.broadcast_tensors(p["axis_lon"], p["axis_lat"]))
        across = torch.cos(lat)
        axis = torch.stack([across * torch.cos(lon), across * torch.sin(lon), torch.sin(lat)], -1)
        turn = 2 * math.pi * state.time / (60 * p["period_min"]) + torch.deg2rad(p["phase_deg"])
        angle = torch.deg2rad(p["deg"]) * torch.sin(turn)
        return rotation @ rotation_of(angle[..., None] * axis)
