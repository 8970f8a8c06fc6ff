"""From geometry to the material's tables: angles and weight of every pair of facet and instant that is lit
and seen.

Letters: L lights, Q instants, T rows, F facets, K pairs of one row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce

import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, projected
from torchlc.brdf.base import Brdf
from torchlc.pairs.discs import DiscPairs
from torchlc.pairs.patch_pairs import (
    as_one_facet,
    curved_pairs,
    falling_light,
    into_part,
    pair_projections,
    pair_weight,
    pairs_by_facet,
)
from torchlc.pairs.planes import columns_of_sides, disc_columns_of_sides, sides_of
from torchlc.pairs.slots import ANGLES, EMPTY, deduplicated, joined, slotted
from torchlc.shapes.curved import Band, Dome
from torchlc.stages.instants import Columns
from torchlc.stages.light import Light, Patch, View

PAIRS_PER_CHUNK = 200_000
"""Pairs of facet and instant held at once while a table is made: a few megabytes, which stay in the
cache."""


def pair_table(
    view: View, patches: Sequence[Patch], compact: bool, columns: Columns | None = None
) -> Mapping[str, Tensor] | None:
    """The material's table of all facets, lights and instants of some patches of one material; None if none
    is lit and seen.

    The weight of a pair is area x visible fraction x irradiance x share of the exposure / range^2 if lit
    and seen and 0 elsewhere. Where the values of a batch differ tables have an axis B before the others. With ``compact`` only the pairs that are lit and seen are worked out, in as
    few slots as the busiest row needs, and equal pairs (wings that share a normal) are counted once. Models
    without a lobe are summed over facets a few rows at a time, so that a mesh needs little memory. ``columns`` says
    which of the instants along the axis T share a column of such a table (None: each has its own).
    """
    model = patches[0].model
    if not model.additive:
        patches = [as_one_facet(patch) for patch in patches]
    if not compact:
        gridded = _gridded(view, patches)
        return None if gridded is None else tabulated(model, gridded)
    if columns is None:
        every = torch.arange(view.to_observer.shape[1])
        columns = Columns(every, every, every, every)
    instants = view.to_observer.shape[0]
    lights = sum(light.irradiance.shape[0] for light in view.lights)
    facets = sum(_slots(patch) for patch in patches)
    size = max(1, PAIRS_PER_CHUNK // (instants * lights * facets))
    cuts = _cuts(columns, size)
    if model.additive:
        sums = [_summed(view, patches, rows, columns.of[rows]) for rows in cuts]
        return {name: torch.cat([table[name] for table in sums], -1) for name in sums[0]}
    pieces = [packed(view, patches, rows, columns.of[rows]) for rows in cuts]
    pairs = joined(pieces, EMPTY)
    return tabulated(model, deduplicated(pairs)) if len(pairs[-1]) else None


def _slots(patch: Patch) -> int:
    """Pairs with each direction and instant that a patch may have."""
    match patch.surface:
        case Band(flared=flared):
            points = Band.points_of(flared)
        case Dome():
            points = Dome.count
        case _:
            return len(patch.area)
    return points + (0 if patch.visible is None and patch.seen is None else len(patch.area))


def _cuts(columns: Columns, size: int) -> list[slice]:
    """Pieces of about ``size`` instants, none of which cuts a column in two."""
    cuts, start = [], 0
    ends = torch.cumsum(torch.bincount(columns.of), 0)
    while start < len(columns.of):
        fits = int(torch.searchsorted(ends, start + size, right=True))
        last = columns.of[start] if fits <= int(columns.of[start]) else fits - 1
        end = int(ends[last])
        cuts.append(slice(start, end))
        start = end
    return cuts


def _summed(view: View, patches: Sequence[Patch], rows: slice, column: Tensor) -> dict[str, Tensor]:
    """The table of a model without a lobe, which asks for the cosines and the phase angle, of a few rows, each of which
    belongs to a ``column`` (rows,)."""
    model = patches[0].model
    total: dict[str, Tensor] = {}
    for patch in patches:
        pose = None if patch.pose is None else patch.pose[..., rows, :, :]
        observer = into_part(pose, view.to_observer[:, rows])
        for light in view.lights:
            source = into_part(pose, light.direction[:, :, rows])
            if patch.by_facet:
                cos_i, cos_r, _, _, square, weight = pairs_by_facet(
                    view, patch, light, source, observer, rows
                )
                half = 0.5 * torch.sqrt(square.clamp(min=1e-30))
            else:
                cos_i, cos_r = ((direction @ patch.normal.mT).mT for direction in (source, observer))
                weight = pair_weight(view, patch, light, cos_i, cos_r, rows)
                half = 0.5 * torch.linalg.vector_norm(source + observer, dim=-1)[:, :, None]
            shape = (-1, weight.shape[-1])
            none = torch.zeros_like(weight[0, 0, 0])
            half, cos_r = (cosine.expand_as(weight).reshape(shape) for cosine in (half, cos_r))
            angles = Incidence(cos_i.reshape(shape), cos_r, half, none, none)
            for name, table in model.tabulate(angles, weight.reshape(shape)).items():
                total[name] = total[name] + table if name in total else table
    column = column - column[0]
    count = int(column[-1]) + 1
    if count == len(column):
        return total
    return {
        name: table.new_zeros(*table.shape[:-1], count).index_add(-1, column, table)
        for name, table in total.items()
    }


def tabulated(model: type[Brdf], columns: tuple[Tensor, ...]) -> dict[str, Tensor]:
    table = model.tabulate(Incidence(*columns[:ANGLES]), columns[-1])
    return table if model.additive or len(columns) == ANGLES + 1 else {**table, "spread": columns[ANGLES]}


def _gridded(view: View, patches: Sequence[Patch]) -> tuple[Tensor, ...] | None:
    """The fields of :class:`Incidence`, the least variance of the lobe if a source has an extent, and the
    weight of all pairs, whether lit or not: (K, T), or (B, K, T) where the values of a batch differ. Pairs of :func:`disc_pairs` are left out; None
    if there are no others."""
    curved = [
        patch for patch in patches if isinstance(patch.surface, Band | Dome) and not patch.model.additive
    ]
    flat = [patch for patch in patches if not patch.by_facet and not any(patch is other for other in curved)]
    groups = [
        columns_of_sides(view, light, sides)
        for light in view.lights
        if light.disc is None
        for sides in sides_of(view, flat, light.primary)
    ]
    groups += [
        _of_points(
            view,
            light,
            pairs_by_facet(
                view,
                patch,
                light,
                into_part(patch.pose, light.direction),
                into_part(patch.pose, view.to_observer),
                slice(None),
            ),
        )
        for patch in patches
        if patch.by_facet
        for light in (falling_light(patch, original) for original in view.lights)
    ]
    groups += [
        _of_points(view, falling_light(patch, light), pairs)
        for patch in curved
        for light in view.lights
        for pairs in curved_pairs(view, patch, falling_light(patch, light), slice(None))
    ]
    if not groups:
        return None
    joint = _side_by_side(groups)
    alone = all(column.shape[1] == 1 for column in joint)
    return tuple(column[:, 0] if alone else column.movedim(0, 1) for column in joint)


def _side_by_side(groups: Sequence[tuple[Tensor, ...]]) -> list[Tensor]:
    """Columns (K, B or 1, T) of several groups of pairs as one, each of one axis B that is 1 where nothing differs."""
    if len(groups) == 1:
        return list(groups[0])
    sizes = [max(map(len, columns)) for columns in groups]
    joint = []
    for column in zip(*groups, strict=True):
        batch = max(piece.shape[1] for piece in column)
        joint.append(
            torch.cat([piece.expand(size, batch, -1) for size, piece in zip(sizes, column, strict=True)])
        )
    return joint


def disc_pairs(view: View, patches: Sequence[Patch]) -> DiscPairs | None:
    """All pairs of flat facets of one material with lights that are discs; None if there are none."""
    model = patches[0].model
    flat = [patch if model.additive else as_one_facet(patch) for patch in patches if not patch.by_facet]
    flat = [patch for patch in flat if model.additive or not isinstance(patch.surface, Band | Dome)]
    lights = [light for light in view.lights if light.disc is not None]
    groups = [
        disc_columns_of_sides(view, light, sides)
        for light in lights
        for sides in sides_of(view, flat, light.primary)
    ]
    if not groups:
        return None
    joint = [column.movedim(0, 1).contiguous() for column in _side_by_side(groups)]
    su, sv, ci, ou, ov, cr, radius, gain, cover = joint
    area = reduce(torch.add, (patch.area.sum(-1) for patch in view.patches))
    area = area[:, None, None] if area.ndim else area
    disc = lights[0].disc
    assert disc is not None
    return DiscPairs(disc, model, su, sv, ci, ou, ov, cr, radius, cover / area, gain * area)


def packed(view: View, patches: Sequence[Patch], rows: slice, column: Tensor) -> tuple[Tensor, ...]:
    """The columns of :func:`_gridded` for a few rows, without the pairs of no weight: (slots of the busiest
    column, columns), each row being of a ``column`` (rows,)."""
    column = column - column[0]
    pieces: list[tuple[Tensor, ...]] = []
    for patch in patches:
        pose = None if patch.pose is None else patch.pose[..., rows, :, :]
        observer = into_part(pose, view.to_observer[:, rows])
        for light in (falling_light(patch, original) for original in view.lights):
            if isinstance(patch.surface, Band | Dome):
                several = curved_pairs(view, patch, light, rows)
            elif patch.by_facet:
                source = into_part(pose, light.direction[:, :, rows])
                several = [pairs_by_facet(view, patch, light, source, observer, rows)]
            else:
                projections = pair_projections(patch, into_part(pose, light.direction[:, :, rows]), observer)
                cos_i, cos_r = projections[:2]
                several = [(*projections, pair_weight(view, patch, light, cos_i, cos_r, rows))]
            for cos_i, cos_r, along_u, along_v, square, given in several:
                shape = cos_i.shape
                weight = _by_row(given, shape)
                lit = weight.nonzero()[:, 0]
                asked = (cos_i, cos_r, along_u, along_v, square)
                angles = projected(*(_by_row(tensor, shape)[lit] for tensor in asked))
                spread = []
                if light.spread is not None:
                    spread = [0.25 * _by_row(light.spread[:, :, None, rows], shape)[lit]]
                row = lit // (len(weight) // shape[-1])
                pieces.append((row, *vars(angles).values(), *spread, weight[lit]))
    row, *columns = (torch.cat(values) for values in zip(*pieces, strict=True))
    return slotted(column[row], columns, int(column[-1]) + 1, EMPTY)


def _by_row(pairs: Tensor, shape: torch.Size) -> Tensor:
    """Pairs (L, Q, F, T), or what is the same along some of these axes, one after the other, those of a row side by
    side: (T * L * Q * F,)."""
    return pairs.expand(shape).movedim(-1, 0).flatten()


def _of_points(view: View, light: Light, pairs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """The columns of :func:`_gridded` of pairs (L, Q, K, T) in one light, (L K instants, B or 1, T) each."""
    cos_i, cos_r, along_u, along_v, square, weight = pairs
    angles = projected(cos_i, cos_r, along_u, along_v, square)
    spread = [] if light.spread is None else [0.25 * light.spread[:, :, None]]
    columns = torch.broadcast_tensors(*vars(angles).values(), *spread, weight)
    return tuple(view.apart(column.transpose(1, 2), 2).flatten(0, 2) for column in columns)
