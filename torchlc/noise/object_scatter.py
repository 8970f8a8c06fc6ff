"""What objects of one design differ by: an offset of each, from a population whose spread is learnt.

The offsets are integrated out: rows of one object err together, by the same amount. So the evidence counts objects, not
rows, and an object that was not seen is predicted with the spread.
"""

from __future__ import annotations

from dataclasses import dataclass

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


class ObjectScatter(NoiseKind):
    """Objects of one design differ: each is fainter or brighter by an offset of its own, normal about zero_point.

    0.3 mag is usual for satellites of one design. Neglects that what differs, attitude or surfaces, may do so with
    the geometry: rows of one object then differ too.
    """

    name = "object_scatter"
    title = "objects of one design differ"
    shown = Shown(NIGHT, "mag", {"mag": 0.3})
    correlates = True
    between_objects = True
    quantities = (
        Quantity(
            "mag", "mag", 0.0, 5.0, "standard deviation between objects",
            off=0.0, typical=0.3, prior="halfnormal", sigma=0.5,
        ),
    )  # fmt: skip

    def missing(self, context):
        if context.object is None:
            return "no column says which object a row belongs to"
        if len(torch.unique(context.object)) < 2:
            return "the recording is of one object, which differs from no other"
        return super().missing(context)

    def noise(self, noise, p, context):
        assert context.object is not None  # else the effect is missing
        return noise.with_process(Shared(self.name, p["mag"], context.object))

    def trials(self, facts):
        return [{"mag": facts.spread * factor} for factor in (0.15, 0.4, 0.7, 1.0)]

    def closer(self, best, facts):
        return [{"mag": best["mag"] * factor} for factor in (0.7, 0.85, 1.0, 1.2, 1.45)]
