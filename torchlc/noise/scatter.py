"""What objects of one design, or nights, or stations, differ by: an offset of each, from a population whose spread is learnt.

The offsets are integrated out: rows of one member err together, by the same amount. So the evidence counts members, not
rows, and a member that was not seen is predicted with the spread.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.noise.kind import NoiseKind
from torchlc.parameters import Quantity
from torchlc.stages.noise import Process
from torchlc.stages.showing import NIGHT, Shown


@dataclass(frozen=True)
class Shared(Process):
    """One error for all rows of a member of ``group`` (T,)."""

    name: str
    sd: Tensor
    group: Tensor

    def correlation(self, rows):
        member = self.group[rows]
        return (member[..., :, None] == member[..., None, :]).to(self.sd)

    @property
    def key(self):
        return (self.name,)


class Scatter(NoiseKind):
    """The contract of the kinds below: ``division`` says what the members are."""

    correlates = True
    division: ClassVar[str]

    def missing(self, context):
        member = getattr(context, self.division)
        if member is None:
            return f"no column says which {self.division} a row belongs to"
        if len(torch.unique(member)) < 2:
            return f"the recording has one {self.division}, which differs from no other"
        return super().missing(context)

    def noise(self, noise, p, context):
        return noise.with_process(Shared(self.name, p["mag"], getattr(context, self.division)))

    def trials(self, facts):
        return [{"mag": facts.spread * factor} for factor in (0.15, 0.4, 0.7, 1.0)]

    def closer(self, best, facts):
        return [{"mag": best["mag"] * factor} for factor in (0.7, 0.85, 1.0, 1.2, 1.45)]


def _spread(of: str) -> tuple[Quantity, ...]:
    return (
        Quantity(
            "mag", "mag", 0.0, 5.0, f"standard deviation between {of}", off=0.0, typical=0.3, prior="halfnormal", sigma=0.5
        ),
    )  # fmt: skip


class ObjectScatter(Scatter):
    """Objects of one design differ: each is fainter or brighter by an offset of its own, normal about zero_point.

    0.3 mag is usual for satellites of one design. Neglects that what differs, attitude or surfaces, may do so with
    the geometry: rows of one object then differ too.
    """

    name = "object_scatter"
    title = "objects of one design differ"
    shown = Shown(NIGHT, "mag", {"mag": 0.3})
    division = "object"
    between_objects = True
    quantities = _spread("objects")


class NightScatter(Scatter):
    """Nights differ: all rows of one are fainter or brighter by the same offset, as by haze or another calibration.

    0.02 to 0.1 mag is usual. Neglects that nights may differ by more than an offset.
    """

    name = "night_scatter"
    title = "nights differ"
    shown = Shown(NIGHT, "mag", {"mag": 0.1})
    division = "night"
    only_asked = True
    quantities = _spread("nights")


class StationScatter(Scatter):
    """Stations differ: all rows of one are fainter or brighter by the same offset, as by another zero point or band.

    0.05 to 0.3 mag is usual without a common band. Neglects that observers may differ by more than an offset.
    """

    name = "station_scatter"
    title = "stations differ"
    shown = Shown(NIGHT, "mag", {"mag": 0.1})
    division = "station"
    only_asked = True
    quantities = _spread("stations")
