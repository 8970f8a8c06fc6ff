"""The observer stands in another direction from the object than the recording says."""

from __future__ import annotations

from dataclasses import replace

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import LABORATORY, TIME, Shown


def _angle(name: str, where: str) -> Quantity:
    return Quantity(
        name, "deg", -30.0, 30.0, f"how far {where} the observer is of where the recording has it",
        off=0.0, typical=2.0, prior="normal", mean=0.0, sigma=3.0,
    )  # fmt: skip


FARTHEST_KM = 1e6
"""Distance beyond which an ephemeris gives the direction, to a thousandth of a degree."""


class CameraDirection(Effect):
    """The direction from the object to the observer is moved by ``east`` and ``north``, along the great circle of that direction in the
    frame of the geometry (GCRS): 0.03 mag for 1 deg on a box, 1 mag where a glint is missed.

    A camera of a laboratory that stands elsewhere, each curve's for itself; an asteroid's ephemeris; not an observer on the Earth, whose place is
    known. The Sun and the distance stay. Neglects that the observer sees another background.
    """

    name = "camera_direction"
    title = "an observer in another direction"
    shown = Shown(LABORATORY, TIME, {"east": 4.0, "north": 3.0})
    stage = "orbit"
    divisible = True
    quantities = (_angle("east", "east"), _angle("north", "north"))

    def missing(self, context):
        if context.track.supports("elevation"):
            return "the observer's place on the Earth is known"
        return (
            "an ephemeris gives the direction" if float(context.track.range_km.min()) > FARTHEST_KM else None
        )

    def orbit(self, request, p, context):
        return replace(request, east=p["east"], north=p["north"])
