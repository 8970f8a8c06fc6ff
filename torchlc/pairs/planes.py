"""Flat facets that lie in one plane or in opposite ones, counted together: never two of them are lit and seen at once.

Letters: L lights, Q instants, T rows, F facets, G planes, B batch, K pairs of one row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchlc.brdf.angles import projected
from torchlc.pairs.patch_pairs import into_part
from torchlc.stages.light import Light, Patch, View
from torchlc.tensors.autodiff_state import followed, readable, transformed
from torchlc.tensors.vectors import dot


@dataclass(frozen=True)
class Sides:
    """Planes that keep still to one another: ``normal``, ``u`` (..., G, 3), and the area times visible fraction
    on the side of the normal and on the other (None: there is no other), (..., G) or (Q, T, G)."""

    pose: Tensor | None
    normal: Tensor
    u: Tensor
    front: Tensor
    back: Tensor | None


def disc_columns_of_sides(view: View, light: Light, sides: Sides) -> tuple[Tensor, ...]:
    """Of some sides in a light that is a disc, (K, B or 1, T) each: the directions to its middle and to the observer along
    u, v and the normal on the observer's side, the disc's radius, what multiplies areas, and the area."""
    source = view.apart(into_part(sides.pose, light.direction), 1).movedim(-1, 0).contiguous()
    observer = view.apart(into_part(sides.pose, view.to_observer))[None].movedim(-1, 0).contiguous()
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


def sides_of(view: View, patches: Sequence[Patch], primary: bool) -> list[Sides]:
    """The facets of some patches, those of one plane or of opposite ones together: never two such are lit and
    seen at once, and but for the weight they are alike.

    Facets that a free number turns stay apart: they may lie in one plane now and have different slopes.
    """
    groups: dict[int, list[Patch]] = {}
    sides: list[Sides] = []
    for patch in patches:
        turned = followed(patch.normal) or followed(patch.u)
        if turned or transformed() or patch.normal.ndim > 2 or not readable(patch.normal):
            sides.append(Sides(patch.pose, patch.normal, patch.u, cover_of(view, patch, primary), None))
        else:
            groups.setdefault(id(patch.pose), []).append(patch)
    for alike in groups.values():
        normal, ahead = _signed(torch.cat([patch.normal for patch in alike]))
        u, _ = _signed(torch.cat([patch.u for patch in alike]))
        planes, member = torch.unique(torch.cat([normal, u], 1), dim=0, return_inverse=True)
        covers = [cover_of(view, patch, primary) for patch in alike]
        rows = np.broadcast_shapes(*(cover.shape[:-1] for cover in covers))
        cover = torch.cat([piece.expand(*rows, piece.shape[-1]) for piece in covers], -1)
        front, back = (
            cover.new_zeros(*rows, len(planes)).index_add(-1, member[side], cover[..., side])
            for side in (ahead, ~ahead)
        )
        sides.append(Sides(alike[0].pose, planes[:, :3], planes[:, 3:], front, back))
    return sides


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


def columns_of_sides(view: View, light: Light, sides: Sides) -> tuple[Tensor, ...]:
    """The fields of :class:`Incidence`, the least variance of the lobe if the light has an extent, and the weight of some sides in
    one light, (K, B or 1, T) each."""
    source = view.apart(into_part(sides.pose, light.direction), 1).movedim(-1, 0).contiguous()
    observer = view.apart(into_part(sides.pose, view.to_observer))[None].movedim(-1, 0).contiguous()
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


def _alike(columns: Sequence[Tensor]) -> list[Tensor]:
    """Columns (G, L, Q, B or 1, T) as (G L Q, B or 1, T): of one shape but for the axis of the batch, along which what is the same
    for all stays one."""
    shape = np.broadcast_shapes(*(column.shape for column in columns))
    return [column.expand(*shape[:3], -1, shape[4]).flatten(0, 2) for column in columns]
