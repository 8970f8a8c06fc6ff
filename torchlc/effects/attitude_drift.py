"""The body turns steadily away from where its attitude mode puts it."""

from __future__ import annotations

import torch

from torchlc.effects.attitude_offset import turn_about_axes
from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown


def _rate(name: str) -> Quantity:
    return Quantity(
        name, "deg/h", -5.0, 5.0, f"rate about body {name.upper()}",
        off=0.0, typical=0.5, prior="normal", mean=0.0, sigma=0.5,
    )  # fmt: skip


class AttitudeDrift(Effect):
    """R = R0 Rot(w (t - t0)) with a constant rate w in body axes and t0 in the middle of the recording: up to 0.34 mag
    for 1 deg at GEO.

    Neglects an offset in the middle, which attitude_offset has.
    """

    name = "attitude_drift"
    title = "an attitude that drifts steadily"
    shown = Shown(NIGHT, PANEL_GLINT, {"x": 0.5, "y": 0.0, "z": 0.5})
    stage = "attitude"
    timed_by_rows = True
    prior_odds = 0.1
    # an attitude that is controlled does not drift, and one that is not turns by more than this: one recording in ten at most
    order = 1
    quantities = (_rate("x"), _rate("y"), _rate("z"))

    def attitude(self, rotation, state, p, context):
        hours = (state.time - 0.5 * (context.seconds.min() + context.seconds.max())) / 3600
        return rotation @ rotation_of(torch.deg2rad(hours[..., None] * turn_about_axes(p)))
