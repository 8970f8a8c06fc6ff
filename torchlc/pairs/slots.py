"""Pairs of every row side by side, in as few slots as the busiest row needs; equal pairs of a row counted once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchlc.brdf.angles import Incidence

MOST_COMPARED = 64
"""Slots up to which equal pairs are looked for."""
ANGLES = len(fields(Incidence))
EMPTY = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
"""What a slot without a pair holds: the fields of :class:`Incidence`, a spread, a weight (the last two
alike, for either may end)."""


def slotted(row: Tensor, columns: Sequence[Tensor], rows: int, empty: Sequence[float]) -> tuple[Tensor, ...]:
    """Values (N,) of pairs that belong to a row (N,) each, side by side: (slots of the busiest row,
    rows)."""
    if bool((torch.diff(row) < 0).any()):
        row, order = torch.sort(row, stable=True)
        columns = [column[order] for column in columns]
    count = torch.bincount(row, minlength=rows)
    slot = torch.arange(len(row), device=row.device) - (count.cumsum(0) - count)[row]
    slots = int(count.max())
    index = slot * rows + row
    return tuple(
        torch.full((slots * rows,), blank, dtype=column.dtype, device=column.device)
        .scatter(0, index, column)
        .view(slots, rows)
        for column, blank in zip(columns, empty, strict=False)
    )


def joined(pieces: Sequence[tuple[Tensor, ...]], empty: Sequence[float]) -> tuple[Tensor, ...]:
    """Pieces of :func:`slotted` for rows that follow one another, as one."""
    slots = max(len(piece[-1]) for piece in pieces)
    return tuple(
        torch.cat([pad(column, (0, 0, 0, slots - len(column)), value=blank) for column in columns], -1)
        for columns, blank in zip(zip(*pieces, strict=True), empty, strict=False)
    )


def deduplicated(columns: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """Merge the weight of a slot into an earlier one of the same row with the same angles (to 1e-13)."""
    weight = columns[-1].clone()
    if not 1 < len(weight) <= MOST_COMPARED:
        return columns
    for first in range(len(weight) - 1):
        later = weight[first + 1 :]
        same = (weight[first] > 0) & (later > 0)
        for column in columns[:-1]:
            same &= (column[first + 1 :] - column[first]).abs() < 1e-13
            if not bool(same.any()):  # most slots are told apart by their first angle
                break
        else:
            weight[first] += torch.where(same, later, 0.0).sum(0)
            weight[first + 1 :] = torch.where(same, 0.0, later)
    row, slot = weight.mT.nonzero(as_tuple=True)
    return slotted(row, [column[slot, row] for column in (*columns[:-1], weight)], weight.shape[1], EMPTY)
