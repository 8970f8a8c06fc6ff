"""Light leaves the object before it is recorded."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.geometry.orbit.earth import LIGHT_KM_S
from torchlc.geometry.rotation.attitude import TURNING
from torchlc.stages.effect import Effect
from torchlc.stages.showing import SPIN, Shown


class LightTime(Effect):
    """The object is taken range/c before the stamp: 0.12 s at GEO, below 1e-4 mag unless it spins in seconds.

    One iteration from the stamp; neglects the second, which would move a LEO object by 0.02 m.
    """

    name = "light_time"
    title = "the time that light takes to the observer"
    shown = Shown(SPIN, "spin_phase", materials={"body.n": 3000.0, "panel.n": 3000.0})
    stage = "orbit"
    known = True

    def missing(self, context):
        if context.light_time_corrected or context.mode in TURNING:
            return "the times are already those at the object"
        if not context.track.supports("motion"):
            return "the recording gives no motion from which to step back by the light time"
        return None

    def orbit(self, request, p, context):
        state = context.track.at(request.observer_offset, request.object_offset, request.ahead)
        delay = torch.linalg.vector_norm(state.observer, dim=-1) / LIGHT_KM_S
        return replace(request, object_offset=request.object_offset - delay)
