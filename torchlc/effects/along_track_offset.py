"""The object runs ahead of its orbit or lags behind."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import PASS, PASS_GLINT, Shown


class AlongTrackOffset(Effect):
    """The object is further along its orbit by a constant mean anomaly: 0.02 mag for 0.1 deg at GEO.

    Its own clock (spin) and the Sun stay. Neglects errors across the track, and the growth of the error
    within a recording.
    """

    name = "along_track_offset"
    title = "the object ahead of, or behind, its predicted place in the orbit"
    shown = Shown(PASS, PASS_GLINT, {"deg": 0.1})
    stage = "orbit"
    order = -1  # the light time is that from where the object is
    quantities = (
        Quantity(
            "deg", "deg", -10.0, 10.0, "mean anomaly ahead of the orbit given",
            off=0.0, typical=0.1, prior="normal", mean=0.0, sigma=0.1,
        ),
    )  # fmt: skip

    def missing(self, context):
        if not context.track.supports("along_track"):
            return "the recording gives no orbit along which the object could be moved"
        return None

    def orbit(self, request, p, context):
        return replace(request, ahead=request.ahead + torch.deg2rad(p["deg"]))
