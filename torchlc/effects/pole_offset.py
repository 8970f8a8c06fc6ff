"""The axis of spin points elsewhere in space than the scene says."""

from __future__ import annotations

from torchlc.geometry.rotation.matrices import rotation_towards
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import STAGE_TURNS, TIME, Shown


def _angle(name: str, where: str) -> Quantity:
    return Quantity(
        name, "deg", -60.0, 60.0, f"how far {where} the axis is of where the scene has it",
        off=0.0, typical=3.0, prior="normal", mean=0.0, sigma=5.0,
    )  # fmt: skip


class PoleOffset(Effect):
    """The axis of spin is moved by ``east`` and ``north``, along the great circle of that direction (in GCRS): up to 1 mag for 3 deg where a
    glint is missed.

    The body is carried along without a turn about the axis. Neglects a motion of the axis in space.
    """

    name = "pole_offset"
    title = "an axis of spin that points elsewhere"
    shown = Shown(STAGE_TURNS, TIME, {"east": 3.0, "north": 3.0})
    stage = "attitude"
    quantities = (_angle("east", "east"), _angle("north", "north"))

    def missing(self, context):
        steady = context.attitude.spins and context.mode not in ("nadir", "yaw-steering", "sun")
        return None if steady else "no axis of spin keeps its direction in space"

    def attitude(self, rotation, state, p, context):
        pole = rotation @ context.attitude.about_spin_axis[2].to(rotation)
        return rotation_towards(pole, p["east"], p["north"]) @ rotation
