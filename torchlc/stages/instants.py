"""The instants of a row: nodes within an exposure, and the columns of tables made at them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchlc.tensors.autodiff_state import apart


@dataclass(frozen=True)
class Nodes:
    """Instants of each row: seconds after the stamp (Q, T) and weights (Q, 1) or (Q, T) that sum to 1 over
    Q."""

    offset: Tensor
    weight: Tensor


@dataclass(frozen=True)
class Instants:
    """Which instants N of each exposure are worked out, those of a row one after the other: more where light changes.

    ``row`` (N,) that an instant belongs to; ``place`` (N,) in the exposure, -1/2 to 1/2; ``weight`` (N,), its share of
    the exposure. Each is a Gauss-Legendre node of a ``panel`` (N,), a part of the exposure; ``span`` (P,) is how
    much of the exposure each panel takes. There are ``rows``, of which some may have none.
    """

    row: Tensor
    place: Tensor
    weight: Tensor
    panel: Tensor
    span: Tensor
    rows: int | None = None

    @property
    def middle(self) -> Tensor:
        """The instant nearest to mid-exposure of each row, (T,); the first of all for rows that have none."""
        with apart():
            count = len(self.row)
            order = torch.argsort(self.place.abs(), stable=True)
            rank = torch.empty_like(order).scatter(0, order, torch.arange(count, device=order.device))
            rows = int(self.row[-1]) + 1 if self.rows is None else self.rows
            nearest = order.new_full((rows,), count).scatter_reduce(0, self.row, rank, "amin")
            return torch.where(nearest < count, order[nearest.clamp(max=count - 1)], 0)

    def at(self, instants: Tensor) -> Instants:
        """Some of the instants (K,)."""
        return replace(
            self,
            row=self.row[instants],
            place=self.place[instants],
            weight=self.weight[instants],
            panel=self.panel[instants],
        )


@dataclass(frozen=True)
class Columns:
    """What the tables hold side by side, C columns: a whole exposure where the light that falls on the object stays
    the same within it, else an instant of it.

    ``of`` (N,) is the column of each instant; ``row`` (C,) its row, ``weight`` (C,) its share of the exposure,
    ``instant`` (C,) one of its instants.
    """

    of: Tensor
    row: Tensor
    weight: Tensor
    instant: Tensor

    @classmethod
    def of_each(cls, instants: Instants) -> Columns:
        """Every instant a column of its own."""
        number = torch.arange(len(instants.row), device=instants.row.device)
        return cls(number, instants.row, instants.weight, number)

    @classmethod
    def joined(cls, instants: Instants, apart: Tensor) -> Columns:
        """The instants of a row as one column, unless they are kept ``apart`` (T,)."""
        row = instants.row
        starts = torch.ones_like(row, dtype=torch.bool)
        starts[1:] = (row[1:] != row[:-1]) | apart[row[1:]]
        of = starts.long().cumsum(0) - 1
        instant = torch.nonzero(starts)[:, 0]
        weight = instants.weight.new_zeros(len(instant)).index_add(0, of, instants.weight)
        return cls(of, row[instant], weight, instant)


@dataclass(frozen=True)
class Request:
    """Seconds after the stamp for observer and object, (Q, T), how far the object is ahead on its orbit, rad (1,) or
    (T,), and by how much the observer's direction is off to the ``east`` and ``north``, deg, None where it is not."""

    observer_offset: Tensor
    object_offset: Tensor
    ahead: Tensor
    east: Tensor | None = None
    north: Tensor | None = None
