"""The body does not turn about a principal axis: its spin axis cones about the angular momentum."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import STAGE_TURNS, TIME, Shown

FASTEST = 1.1
"""Turns of the cone's direction in the body a turn of the body: for a slight cone (C - A) / A with the moment C about the axis and A
across it, 1 for a flat disc and -1 for a thin rod; the rest is for a scene whose period is not quite right."""


MOST_REV_PER_HOUR = 1e5
"""28 turns a second: the bounds of any scene, until its own rate of spin gives closer ones."""


class Nutation(Effect):
    """R = R0 Rot(cone e), where e turns in the body about the spin axis, at right angles to it: 2 deg leave 0.24 mag rms on a
    tumbling cylinder that no uniform spin takes away.

    The free rotation of a body with an axis of symmetry (Landau and Lifshitz, Mechanics, section 33): the scene's axis of spin is the
    direction of the angular momentum. The body's axis stays ``deg`` away from it, and goes round it once a turn plus the turns of e, which
    are steady. Neglects what three different moments add, cone^2 of the cone (the attitude mode rigid-body has it), and damping.
    """

    name = "nutation"
    title = "a spin axis that cones about the angular momentum"
    shown = Shown(STAGE_TURNS, TIME, {"deg": 2.0, "rev_per_hour": 72.0, "phase_deg": 90.0})
    stage = "attitude"
    quantities = (
        Quantity(
            "deg",
            "deg",
            0.0,
            60.0,
            "half-angle of the cone",
            off=0.0,
            typical=2.0,
            prior="halfnormal",
            sigma=5.0,
        ),
        Quantity(
            "rev_per_hour",
            "rev/h",
            -MOST_REV_PER_HOUR,
            MOST_REV_PER_HOUR,
            "turns of the cone's direction in the body",
            typical=1.0,
        ),
        Quantity(
            "phase_deg",
            "deg",
            0.0,
            360.0,
            "where it is at the first row, from body +X or the next axis",
            typical=90.0,
        ),
    )

    def missing(self, context):
        if context.mode == "rigid-body":
            return "the attitude mode rigid-body has nutation among its numbers"
        return None if context.attitude.spin_rate_at_start else "the attitude has no spin"

    def prepared(self, context):
        deg, rate, phase = type(self).quantities
        fastest = FASTEST * abs(context.attitude.spin_rate_at_start)
        self.quantities = (deg, replace(rate, low=-fastest, high=fastest, typical=0.4 * fastest), phase)
        return self

    def attitude(self, rotation, state, p, context):
        first, second, _ = context.attitude.about_spin_axis.to(rotation)
        turn = 2 * math.pi * p["rev_per_hour"] * state.time / 3600 + torch.deg2rad(p["phase_deg"])
        cone = torch.deg2rad(p["deg"])
        across = torch.cos(turn)[..., None] * first + torch.sin(turn)[..., None] * second
        return rotation @ rotation_of(cone[..., None] * across)
