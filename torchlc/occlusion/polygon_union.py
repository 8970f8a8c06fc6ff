"""How much of a convex facet a set of convex polygons covers together, exactly.

By Green's theorem the area of (union of polygons) within a facet is half the integral of p x dp along its
boundary: those stretches of polygon edges that are inside the facet and in no other polygon, and those
stretches of facet edges that are in a polygon. A line meets a convex polygon in one interval, so every
stretch follows from intervals alone; no polygon is ever clipped. Cost per facet: the square of the number of
edges.
"""

from __future__ import annotations

import torch
from torch import Tensor

INFLATION = 1e-9  # of the facet's size; see covered_area
VALUES_AT_ONCE = 3_000_000  # (facet, edge, edge) triples, which bounds the memory


@torch.no_grad()
def settled(facet: Tensor, start: Tensor, end: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Which facets (P,) are clear of all polygons, and which lie within one: most facets of a smooth part.

    Arguments as in `covered_area`. A polygon is clear of a facet that is outside one of its edges.
    """
    outward = _outward(end - start)
    offset = torch.where(valid, _dot(outward, start), torch.inf).flatten(1, 2)
    beyond = (facet @ outward.flatten(1, 2).mT - offset[:, None]).unflatten(-1, valid.shape[1:])
    there = valid.any(dim=-1)
    clear = (beyond.amin(dim=1) >= 0).any(dim=-1) | ~there
    within = (beyond.amax(dim=1) <= 0).all(dim=-1) & there
    return clear.all(dim=-1), within.any(dim=-1)


def covered_area(facet: Tensor, start: Tensor, end: Tensor, valid: Tensor) -> Tensor:
    """Area (P,) of each of P facets that lies in at least one of its K polygons.

    facet (P, V, 2) counter-clockwise about the origin; start, end (P, K, M, 2): directed edges of each
    polygon, counter-clockwise, in any order; valid (P, K, M): which of them there are (none: no polygon).

    The k-th polygon is inflated by k INFLATION, so that edges that coincide (shadow and occlusion of a part
    that touches the facet, Sun behind the observer) count once; the error is as small. The gradient is that
    of a moving boundary, integral of (velocity x dp), with the stretches held fixed: exact where the area is
    differentiable, and, since the stretches are constants in it, no second derivatives.
    """
    corner_start, corner_end = facet, facet.roll(-1, dims=1)
    a = torch.cat([start.flatten(1, 2), corner_start], dim=1)
    b = torch.cat([end.flatten(1, 2), corner_end], dim=1)
    here, there = a.detach(), b.detach()
    along = there - here
    step = max(1, VALUES_AT_ONCE // a.shape[1] ** 2)
    cuts = zip(*(tensor.detach().split(step) for tensor in (facet, start, end, valid)), strict=True)
    once, first = (torch.cat(piece) for piece in zip(*(_stretches(*cut) for cut in cuts), strict=True))
    moved = _cross(a - here, along) * (once - first) + _cross(b - there, along) * first
    return (0.5 * _cross(here, along) * once + moved).sum(dim=1)


def _stretches(facet: Tensor, start: Tensor, end: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Length and first moment (P, K M + V), each edge from 0 to 1, of what bounds the covered area."""
    pairs, polygons, edges = valid.shape
    size = facet.abs().amax(dim=(1, 2))
    inflation = (
        INFLATION * size[:, None] * torch.arange(1, polygons + 1, dtype=size.dtype, device=size.device)
    )
    outward = _outward(end - start)
    shifted = start + inflation[:, :, None, None] * outward
    offset = torch.where(valid, _dot(outward, shifted), torch.inf)
    corner_end = facet.roll(-1, dims=1)
    walls = _outward(corner_end - facet)
    wall_offset = _dot(walls, facet)

    a = torch.cat([shifted.flatten(1, 2), facet], dim=1)
    along = torch.cat([(end - start).flatten(1, 2), corner_end - facet], dim=1)
    low, high = _inside(a, along, outward.flatten(1, 2), offset.flatten(1, 2), edges)
    within_low, within_high = _inside(a, along, walls, wall_offset, walls.shape[1])
    owner = torch.arange(polygons, device=size.device).repeat_interleave(edges)
    owner = torch.cat([owner, owner.new_full((facet.shape[1],), -1)])
    nowhere = (owner[:, None] == torch.arange(polygons, device=size.device)) | ~valid.any(dim=-1)[:, None, :]
    nowhere = nowhere | (low >= high)
    low = torch.where(nowhere, torch.inf, low)
    high = torch.where(nowhere, torch.inf, high)

    is_wall = owner < 0
    begin = torch.where(is_wall, 0.0, within_low[..., 0].clamp(0.0, 1.0))
    finish = torch.where(is_wall, 1.0, within_high[..., 0].clamp(0.0, 1.0))
    finish = torch.maximum(begin, finish)
    free, free_moment = _left_free(begin, finish, low, high)
    once = torch.where(is_wall, 1.0 - free, free)
    first = torch.where(is_wall, 0.5 - free_moment, free_moment)
    there = torch.cat([valid.flatten(1, 2), valid.new_ones(pairs, facet.shape[1])], dim=1)
    return once * there, first * there


def _inside(a: Tensor, along: Tensor, outward: Tensor, offset: Tensor, group: int) -> tuple[Tensor, Tensor]:
    """Interval (P, E, G) of s for which a + s along (P, E, 2) is in each of G polygons of ``group`` edges."""
    room = offset[:, None, :] - a @ outward.mT
    speed = along @ outward.mT
    still = speed == 0
    reach = room / torch.where(still, 1.0, speed)
    outside = still & (room < 0)
    enter = torch.where(speed < 0, reach, -torch.inf).masked_fill(outside, torch.inf)
    leave = torch.where(speed > 0, reach, torch.inf)
    groups = (reach.shape[-1] // group, group)
    return enter.unflatten(-1, groups).amax(dim=-1), leave.unflatten(-1, groups).amin(dim=-1)


def _left_free(begin: Tensor, finish: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Length and first moment (P, E) of [begin, finish] outside all intervals [low, high] (P, E, K)."""
    low, order = low.sort(dim=-1)
    high = high.gather(-1, order)
    begin, finish = begin[..., None], finish[..., None]
    reached = torch.cat([begin, high], dim=-1).cummax(dim=-1).values
    upto = torch.cat([low, finish], dim=-1)
    gap_low = torch.minimum(torch.maximum(reached, begin), finish)
    gap_high = torch.maximum(torch.minimum(upto, finish), gap_low)
    return (gap_high - gap_low).sum(dim=-1), 0.5 * (gap_high**2 - gap_low**2).sum(dim=-1)


def _outward(along: Tensor) -> Tensor:
    """Unit normals (..., 2) to the right of counter-clockwise edges; zero for an edge of no length."""
    length = torch.sqrt(_dot(along, along))[..., None]
    right = torch.stack([along[..., 1], -along[..., 0]], dim=-1)
    return right / torch.where(length > 0, length, 1.0)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    """Scalar products (...) of vectors (..., 2): a reduction over an axis of two takes several times as long."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
