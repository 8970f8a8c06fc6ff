"""A geometry that an effect learns: no table may be older than what it has learnt."""

from __future__ import annotations

from torch import Tensor

from torchlc.lightcurve.evaluators.exact import ExactGeometry
from torchlc.stages.light import Brightness


class LearntGeometry(ExactGeometry):
    """Tables for every theta at every call; none is kept."""

    gridded = False  # pyright: ignore[reportAssignmentType, reportIncompatibleVariableOverride] - settled for all

    def _sharing(self, flat: Tensor, shares: bool) -> Brightness | None:
        return None
