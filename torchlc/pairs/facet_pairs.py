"""From geometry to the material's tables: angles and weight of every pair of facet and instant that is lit
and seen.

Letters: L lights, Q instants, T rows, F facets, K pairs of one row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from torchlc.brdf.base import Brdf, Incidence, projected
from torchlc.pairs.discs import DiscPairs
from torchlc.shapes.curved import Band, Dome, Plane, Points, share_near
from torchlc.stages.instants import Columns
from torchlc.stages.light import Light, Patch, Response, View
from torchlc.tensors.autodiff_state import followed, readable, transformed
from torchlc.tensors.vectors import dot, turned_back

PAIRS_PER_CHUNK = 200_000
"""Pairs of facet and instant held at once while a table is made: a few megabytes, which stay in the
cache."""
DARKEST_RADIANCE = 1e-9
"""Of that of a surface that faces its source: what is left is light of no account, and a power below 1 has no slope at 0."""
MOST_COMPARED = 64
"""Slots up to which equal pairs are looked for."""
ANGLES = len(fields(Incidence))
EMPTY = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
"""What a slot without a pair holds: the fields of :class:`Incidence`, a spread, a weight (the last two
alike, for either may end)."""


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
        patches = [_as_one(patch) for patch in patches]
    if not compact:
        gridded = _gridded(view, patches)
        return None if gridded is None else tabulated(model, gridded)
    if columns is None:
        own = torch.arange(view.to_observer.shape[1])
        columns = Columns(own, own, own, own)
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
    return tabulated(model, _deduplicated(pairs)) if len(pairs[-1]) else None


def _as_one(patch: Patch) -> Patch:
    """A patch whose facets are pieces of one plane as one facet."""
    if not isinstance(patch.surface, Plane):
        return patch
    visible, seen = (
        None
        if share is None
        else (patch.area * share).sum(-1, keepdim=True) / patch.area.sum(-1, keepdim=True)
        for share in (patch.visible, patch.seen)
    )
    area = patch.area.sum(-1, keepdim=True)
    normal, u = patch.normal[..., :1, :], patch.u[..., :1, :]
    return replace(patch, normal=normal, u=u, area=area, visible=visible, seen=seen, surface=None)


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


def _falling(patch: Patch, light: Light) -> Light:
    """A light from as many directions as a patch needs."""
    if not isinstance(patch.surface, Band | Dome):
        return light if light.disc is None or not patch.by_facet else light.disc.spread(light, -1)
    if light.disc is not None:
        return light.disc.spread(light, 2 - patch.surface.axes)
    return light if light.fewer is None else light.fewer[patch.surface.axes - 1]


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
        observer = _into(pose, view.to_observer[:, rows])
        for light in view.lights:
            source = _into(pose, light.direction[:, :, rows])
            if patch.by_facet:
                cos_i, cos_r, _, _, square, weight = _by_facet(view, patch, light, source, observer, rows)
                half = 0.5 * torch.sqrt(square.clamp(min=1e-30))
            else:
                cos_i, cos_r = ((direction @ patch.normal.mT).mT for direction in (source, observer))
                weight = _weight(view, patch, light, cos_i, cos_r, rows)
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


@dataclass(frozen=True)
class Sides:
    """Planes that keep still to one another: ``normal``, ``u`` (..., G, 3), and the area times visible fraction
    on the side of the normal and on the other (None: there is no other), (..., G) or (Q, T, G)."""

    pose: Tensor | None
    normal: Tensor
    u: Tensor
    front: Tensor
    back: Tensor | None


def _gridded(view: View, patches: Sequence[Patch]) -> tuple[Tensor, ...] | None:
    """The fields of :class:`Incidence`, the least variance of the lobe if a source has an extent, and the
    weight of all pairs, whether lit or not: (K, T), or (B, K, T) where the values of a batch differ. Pairs of :func:`disc_pairs` are left out; None
    if there are no others."""
    curved = [
        patch for patch in patches if isinstance(patch.surface, Band | Dome) and not patch.model.additive
    ]
    flat = [patch for patch in patches if not patch.by_facet and not any(patch is one for one in curved)]
    found = [
        _of_sides(view, light, sides)
        for light in view.lights
        if light.disc is None
        for sides in _sides(view, flat, light.primary)
    ]
    found += [
        _of_points(
            view,
            light,
            _by_facet(
                view,
                patch,
                light,
                _into(patch.pose, light.direction),
                _into(patch.pose, view.to_observer),
                slice(None),
            ),
        )
        for patch in patches
        if patch.by_facet
        for light in (_falling(patch, one) for one in view.lights)
    ]
    found += [
        _of_points(view, _falling(patch, light), pairs)
        for patch in curved
        for light in view.lights
        for pairs in _about(view, patch, _falling(patch, light), slice(None))
    ]
    if not found:
        return None
    joint = _side_by_side(found)
    alone = all(column.shape[1] == 1 for column in joint)
    return tuple(column[:, 0] if alone else column.movedim(0, 1) for column in joint)


def _side_by_side(found: Sequence[tuple[Tensor, ...]]) -> list[Tensor]:
    """Columns (K, B or 1, T) of several groups of pairs as one, each of one axis B that is 1 where nothing differs."""
    if len(found) == 1:
        return list(found[0])
    sizes = [max(map(len, columns)) for columns in found]
    joint = []
    for column in zip(*found, strict=True):
        batch = max(one.shape[1] for one in column)
        joint.append(
            torch.cat([one.expand(size, batch, -1) for size, one in zip(sizes, column, strict=True)])
        )
    return joint


def _alike(columns: Sequence[Tensor]) -> list[Tensor]:
    """Columns (G, L, Q, B or 1, T) as (G L Q, B or 1, T): of one shape but for the axis of the batch, along which what is the same
    for all stays one."""
    shape = np.broadcast_shapes(*(column.shape for column in columns))
    return [column.expand(*shape[:3], -1, shape[4]).flatten(0, 2) for column in columns]


def disc_pairs(view: View, patches: Sequence[Patch]) -> DiscPairs | None:
    """All pairs of flat facets of one material with lights that are discs; None if there are none."""
    model = patches[0].model
    flat = [one if model.additive else _as_one(one) for one in patches if not one.by_facet]
    flat = [one for one in flat if model.additive or not isinstance(one.surface, Band | Dome)]
    lights = [light for light in view.lights if light.disc is not None]
    found = [
        _side_pairs(view, light, sides) for light in lights for sides in _sides(view, flat, light.primary)
    ]
    if not found:
        return None
    joint = [column.movedim(0, 1).contiguous() for column in _side_by_side(found)]
    su, sv, ci, ou, ov, cr, radius, gain, cover = joint
    area = reduce(torch.add, (patch.area.sum(-1) for patch in view.patches))
    area = area[:, None, None] if area.ndim else area
    disc = lights[0].disc
    assert disc is not None
    return DiscPairs(disc, model, su, sv, ci, ou, ov, cr, radius, cover / area, gain * area)


def _side_pairs(view: View, light: Light, sides: Sides) -> tuple[Tensor, ...]:
    """Of some sides in a light that is a disc, (K, B or 1, T) each: the directions to its middle and to the observer along
    u, v and the normal on the observer's side, the disc's radius, what multiplies areas, and the area."""
    source = view.apart(_into(sides.pose, light.direction), 1).movedim(-1, 0).contiguous()
    observer = view.apart(_into(sides.pose, view.to_observer))[None].movedim(-1, 0).contiguous()
    v = torch.linalg.cross(sides.normal, sides.u)
    cos_i, cos_r = _facing(sides.normal, source), _facing(sides.normal, observer)
    cover = _by_plane(view, sides.front)
    if sides.back is not None:
        ahead = cos_r > 0
        cos_i, cover = (
            torch.where(ahead, cos_i, -cos_i),
            torch.where(ahead, cover, _by_plane(view, sides.back)),
        )
        cos_r = cos_r.abs()
    assert light.disc is not None
    radius = view.apart(light.disc.radius)[None, None]
    gain = view.apart(light.irradiance, 1) * view.apart(view.nodes.weight) / view.apart(view.range_m) ** 2
    columns = (
        _facing(sides.u, source),
        _facing(v, source),
        cos_i,
        _facing(sides.u, observer),
        _facing(v, observer),
        cos_r,
        radius,
        gain,
        cover * (cos_r > 0) * (cos_i > -radius),
    )
    return tuple(_alike(columns))


def _sides(view: View, patches: Sequence[Patch], primary: bool) -> list[Sides]:
    """The facets of some patches, those of one plane or of opposite ones together: never two such are lit and
    seen at once, and but for the weight they are alike.

    Facets that a free number turns stay apart: they may lie in one plane now and have different slopes.
    """
    groups: dict[int, list[Patch]] = {}
    found: list[Sides] = []
    for patch in patches:
        turned = followed(patch.normal) or followed(patch.u)
        if turned or transformed() or patch.normal.ndim > 2 or not readable(patch.normal):
            found.append(Sides(patch.pose, patch.normal, patch.u, cover_of(view, patch, primary), None))
        else:
            groups.setdefault(id(patch.pose), []).append(patch)
    for alike in groups.values():
        normal, ahead = _signed(torch.cat([patch.normal for patch in alike]))
        u, _ = _signed(torch.cat([patch.u for patch in alike]))
        planes, member = torch.unique(torch.cat([normal, u], 1), dim=0, return_inverse=True)
        covers = [cover_of(view, patch, primary) for patch in alike]
        rows = np.broadcast_shapes(*(cover.shape[:-1] for cover in covers))
        cover = torch.cat([one.expand(*rows, one.shape[-1]) for one in covers], -1)
        front, back = (
            cover.new_zeros(*rows, len(planes)).index_add(-1, member[side], cover[..., side])
            for side in (ahead, ~ahead)
        )
        found.append(Sides(alike[0].pose, planes[:, :3], planes[:, 3:], front, back))
    return found


def _signed(vectors: Tensor) -> tuple[Tensor, Tensor]:
    """Vectors (F, 3) or their opposites, with the first component that is not 0 positive; which were so
    (F,)."""
    lead = vectors.gather(1, (vectors != 0).to(torch.uint8).argmax(1, keepdim=True))
    return torch.where(lead > 0, vectors, -vectors) + 0.0, lead[:, 0] > 0


def cover_of(view: View, patch: Patch, primary: bool) -> Tensor:
    """What facets count, (F,), or (Q, T or 1, F) where it is not the same at all instants."""
    visible = patch.visible if primary else patch.seen
    area = patch.area
    if area.ndim > 1:  # of a batch, whose members are the last axis of Q
        instants = max(1, len(view.nodes.offset) // view.batch)
        area = area[:, None].repeat(instants, 1, 1)
    return area if visible is None else area * visible


def _of_sides(view: View, light: Light, sides: Sides) -> tuple[Tensor, ...]:
    """The columns of :func:`_gridded` of some sides in one light, (K, B or 1, T) each."""
    source = view.apart(_into(sides.pose, light.direction), 1).movedim(-1, 0).contiguous()
    observer = view.apart(_into(sides.pose, view.to_observer))[None].movedim(-1, 0).contiguous()
    bisector = source + observer
    v = torch.linalg.cross(sides.normal, sides.u)
    cos_i, cos_r = _facing(sides.normal, source), _facing(sides.normal, observer)
    angles = projected(
        cos_i.abs(),
        cos_r.abs(),
        _facing(sides.u, bisector),
        _facing(v, bisector),
        bisector.square().sum(0)[None],
    )
    front = _by_plane(view, sides.front)
    if sides.back is None:
        cover = front * (torch.minimum(cos_i, cos_r) > 0)
    elif not _sloped(sides) and torch.equal(sides.front, sides.back):
        cover = front * (cos_i * cos_r > 0)
    else:
        turned = front * (cos_i > 0) + _by_plane(view, sides.back) * (cos_i < 0)
        cover = turned * (cos_i * cos_r > 0)
    gain = view.apart(light.irradiance, 1) * view.apart(view.nodes.weight) / view.apart(view.range_m) ** 2
    spread = [] if light.spread is None else [0.25 * view.apart(light.spread, 1)]
    columns = (*vars(angles).values(), *spread, gain * cover)
    if source.shape[1] * source.shape[2] > 1:  # else what all planes share stays as it is
        return tuple(_alike(columns))
    return tuple(column.flatten(0, 2) for column in columns)


def _sloped(sides: Sides) -> bool:
    """Whether a free number changes what the two sides count, which may differ in slope where they are equal."""
    return any(cover is not None and followed(cover) for cover in (sides.front, sides.back))


def _facing(normal: Tensor, direction: Tensor) -> Tensor:
    """Scalar products (G, L, Q, B, T) of vectors (G, 3), or (B, G, 3), with directions (3, L, Q, B, T)."""
    if normal.ndim > 2:
        return dot(normal.movedim(-2, 0)[:, None, None, :, None], direction.movedim(0, -1))
    return (normal @ direction.flatten(1)).unflatten(1, direction.shape[1:])


def _by_plane(view: View, cover: Tensor) -> Tensor:
    """What planes (G,) or (Q, T, G) count, shaped to meet (G, L, Q, B, T)."""
    cover = cover.movedim(-1, 0)
    return view.apart(cover, 1)[:, None] if cover.ndim == 3 else cover[:, None, None, None, None]


def packed(view: View, patches: Sequence[Patch], rows: slice, column: Tensor) -> tuple[Tensor, ...]:
    """The columns of :func:`_gridded` for a few rows, without the pairs of no weight: (slots of the busiest
    column, columns), each row being of a ``column`` (rows,)."""
    column = column - column[0]
    found: list[tuple[Tensor, ...]] = []
    for patch in patches:
        pose = None if patch.pose is None else patch.pose[..., rows, :, :]
        observer = _into(pose, view.to_observer[:, rows])
        for light in (_falling(patch, one) for one in view.lights):
            if isinstance(patch.surface, Band | Dome):
                several = _about(view, patch, light, rows)
            elif patch.by_facet:
                source = _into(pose, light.direction[:, :, rows])
                several = [_by_facet(view, patch, light, source, observer, rows)]
            else:
                projections = _projections(patch, _into(pose, light.direction[:, :, rows]), observer)
                cos_i, cos_r = projections[:2]
                several = [(*projections, _weight(view, patch, light, cos_i, cos_r, rows))]
            for cos_i, cos_r, along_u, along_v, square, given in several:
                shape = cos_i.shape
                weight = _by_row(given, shape)
                lit = weight.nonzero()[:, 0]
                asked = (cos_i, cos_r, along_u, along_v, square)
                angles = projected(*(_by_row(one, shape)[lit] for one in asked))
                spread = []
                if light.spread is not None:
                    spread = [0.25 * _by_row(light.spread[:, :, None, rows], shape)[lit]]
                row = lit // (len(weight) // shape[-1])
                found.append((row, *vars(angles).values(), *spread, weight[lit]))
    row, *columns = (torch.cat(values) for values in zip(*found, strict=True))
    return slotted(column[row], columns, int(column[-1]) + 1, EMPTY)


def _by_row(pairs: Tensor, shape: torch.Size) -> Tensor:
    """Pairs (L, Q, F, T), or what is the same along some of these axes, one after the other, those of a row side by
    side: (T * L * Q * F,)."""
    return pairs.expand(shape).movedim(-1, 0).flatten()


def _projections(patch: Patch, source: Tensor, observer: Tensor) -> tuple[Tensor, ...]:
    """What :func:`~torchlc.brdf.base.projected` asks for, of directions to light (L, Q, T, 3) and observer
    (Q, T, 3) in the patch's frame: (L, Q, F, T) each, with an axis of 1 where it is the same along it."""
    bisector = source + observer
    v = torch.linalg.cross(patch.normal, patch.u)
    pairs = ((source, patch.normal), (observer, patch.normal), (bisector, patch.u), (bisector, v))
    return *((one @ axis.mT).mT for one, axis in pairs), dot(bisector, bisector)[..., None, :]


def _by_facet(
    view: View, patch: Patch, light: Light, source: Tensor, observer: Tensor, rows: slice
) -> tuple[Tensor, ...]:
    """The projections of :func:`_projections` and the weight of a patch, (L, Q, F, T) each, whose facets have directions of
    their own to lamp and camera, and whose radiance is not recorded linearly.

    With s the direction from the body's origin and d the distance, a facet at c sees the lamp along s - c / d, whose length r takes
    1 / r^2 of the light; likewise the camera.
    """
    cos_i, cos_r = ((direction @ patch.normal.mT).mT for direction in (source, observer))
    v = torch.linalg.cross(patch.normal, patch.u)
    axes = () if patch.model.additive else (patch.u, v)
    light_along, sight_along = ([(one @ axis.mT).mT for axis in axes] for one in (source, observer))
    cosine = dot(source, observer)[..., None, :]
    gain: Tensor | None = None
    radiance = cos_i
    if patch.near is not None:
        point = patch.near.point
        lamp, camera = (
            one if one.shape[-1] == 1 else one[:, rows] for one in (patch.near.lamp, patch.near.camera)
        )
        lamp, camera = lamp[:, None] * light.primary, camera[:, None]
        size, off = dot(point, point)[..., None], dot(point, patch.normal)[..., None]
        to_lamp, to_camera = ((one @ point.mT).mT for one in (source, observer))
        nearer = torch.rsqrt(1 - 2 * lamp * to_lamp + lamp**2 * size)
        closer = torch.rsqrt(1 - 2 * camera * to_camera + camera**2 * size)
        cos_i, cos_r = (cos_i - lamp * off) * nearer, (cos_r - camera * off) * closer
        places = [dot(point, axis)[..., None] for axis in axes]
        light_along = [(one - lamp * at) * nearer for one, at in zip(light_along, places, strict=True)]
        sight_along = [(one - camera * at) * closer for one, at in zip(sight_along, places, strict=True)]
        cosine = cosine - camera * to_lamp - lamp * to_camera + lamp * camera * size
        cosine = cosine * nearer * closer
        radiance = cos_i * nearer**2
        gain = (nearer * closer) ** 2
    weight = _weight(view, patch, light, cos_i, cos_r, rows)
    if gain is not None:
        weight = weight * gain
    if patch.response is not None and light.primary:
        weight = weight * _recorded(patch.response, radiance, rows)
    along = [one + other for one, other in zip(light_along, sight_along, strict=True)] or [cosine, cosine]
    return cos_i, cos_r, *along, 2 + 2 * cosine, weight


def _recorded(response: Response, radiance: Tensor, rows: slice) -> Tensor:
    """What is recorded of a radiance (L, Q, F, T) over the radiance itself; 1 where there is none."""
    power, threshold, pedestal = (
        (one if one.shape[-1] == 1 else one[:, rows])[:, None]
        for one in (response.power, response.threshold, response.pedestal)
    )
    lit = radiance > DARKEST_RADIANCE
    safe = torch.where(lit, radiance, 1.0)
    recorded = (safe**power - threshold).clamp(min=0) + pedestal
    return torch.where(lit, recorded / safe, 1.0)


def _about(view: View, patch: Patch, light: Light, rows: slice) -> list[tuple[Tensor, ...]]:
    """The projections of :func:`_projections` and the weight of a curved patch, (L, Q, K, T) each: of points that follow
    Sun and observer, and where others may hide facets also of these, which then share the light with the points."""
    surface = patch.surface
    assert isinstance(surface, Band | Dome)
    pose = None if patch.pose is None else patch.pose[..., rows, :, :]
    source = _into(pose, light.direction[:, :, rows])
    observer = _into(pose, view.to_observer[:, rows])
    visible = patch.visible if light.primary else patch.seen
    options = {"mirrored": visible is None} if isinstance(surface, Dome) else {}
    points = surface.points(source, observer, **options)
    points = Points(*(one.movedim(-1, -2) for one in vars(points).values()))
    square = dot(source + observer, source + observer)[..., None, :]
    gain = (
        light.irradiance[..., rows]
        * view.nodes.weight.expand(view.range_m.shape)[:, rows]
        / view.range_m[:, rows] ** 2
    )[:, :, None]
    weight = gain * points.area * (torch.minimum(points.cos_i, points.cos_r) > 0)
    found = []
    if visible is not None:
        share = visible.expand(-1, view.range_m.shape[-1], -1)[:, rows].mT.expand(
            *points.facet.shape[:2], -1, -1
        )
        weight = weight * share_near(points.apart2, surface.bump) * share.gather(2, points.facet)
        cos_i, cos_r, *bisector = _projections(patch, source, observer)
        nearest = surface.nearest(source + observer)
        far = 1 - share_near(2 * (1 - (nearest @ patch.normal.mT).mT), surface.bump)
        found.append((cos_i, cos_r, *bisector, far * _weight(view, patch, light, cos_i, cos_r, rows)))
    return [(points.cos_i, points.cos_r, points.along_u, points.along_v, square, weight), *found]


def _of_points(view: View, light: Light, pairs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """The columns of :func:`_gridded` of pairs (L, Q, K, T) in one light, (L K instants, B or 1, T) each."""
    cos_i, cos_r, along_u, along_v, square, weight = pairs
    angles = projected(cos_i, cos_r, along_u, along_v, square)
    spread = [] if light.spread is None else [0.25 * light.spread[:, :, None]]
    columns = torch.broadcast_tensors(*vars(angles).values(), *spread, weight)
    return tuple(view.apart(one.transpose(1, 2), 2).flatten(0, 2) for one in columns)


def slotted(row: Tensor, columns: Sequence[Tensor], rows: int, empty: Sequence[float]) -> tuple[Tensor, ...]:
    """Values (N,) of pairs that belong to a row (N,) each, side by side: (slots of the busiest row,
    rows)."""
    if bool((torch.diff(row) < 0).any()):
        row, order = torch.sort(row, stable=True)
        columns = [column[order] for column in columns]
    count = torch.bincount(row, minlength=rows)
    slot = torch.arange(len(row), device=row.device) - (count.cumsum(0) - count)[row]
    slots = int(count.max())
    place = slot * rows + row
    return tuple(
        torch.full((slots * rows,), blank, dtype=column.dtype, device=column.device)
        .scatter(0, place, column)
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


def _weight(view: View, patch: Patch, light: Light, cos_i: Tensor, cos_r: Tensor, rows: slice) -> Tensor:
    """What a facet turned to both Sun and observer counts, (L, Q, F, rows); 0 if it is not."""
    gain = (
        light.irradiance[..., rows]
        * view.nodes.weight.expand(view.range_m.shape)[:, rows]
        / view.range_m[:, rows] ** 2
    )
    weight = gain[:, :, None] * patch.area[:, None]
    visible = patch.visible if light.primary else patch.seen
    if visible is not None:
        weight = weight * (visible if visible.shape[1] == 1 else visible[:, rows]).mT
    return weight * (torch.minimum(cos_i, cos_r) > 0)


def _into(pose: Tensor | None, direction: Tensor) -> Tensor:
    """A body-frame direction (..., Q, T, 3) seen in the rest frame of a posed part; the facet axis is added
    by the caller."""
    if pose is None:
        return direction
    return turned_back(pose, direction)


def _deduplicated(columns: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
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
