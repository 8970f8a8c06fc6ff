"""Which rows have parts that one may hide another of, as seen along a direction."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchlc.shapes import Facets, Part
from torchlc.shapes.part import like

MARGIN = 1e-9
"""Of the distance between two parts: spheres, and of their size: outlines, that come as close as that count as touching."""
LEAST_SINE = 1e-6
"""Of the angle between a direction and an edge, below which their product is no axis."""
MOST_AXES = 6
"""Edges of a hull that its outline is told apart from another's by."""


@torch.no_grad()
def may_meet(
    parts: Sequence[Part], facets: Sequence[Facets], rows: torch.Size, directions: Sequence[Tensor]
) -> Tensor:
    """Which ``rows`` (Q, T) have a part that may hide another along any of the ``directions`` (Q or 1, T, 3), unit vectors in
    the body frame; of sizes that differ within a batch B the last axis of Q is B. All if a part is hollow, for it may hide
    itself.

    Each part stays within the sphere about its pivot that holds its corners, however it turns about that; along a direction
    two spheres overlap where their middles pass each other closer than the sum of the radii.
    """
    if any(part.hull is None for part in parts):
        return torch.ones(rows, dtype=torch.bool, device=directions[0].device)
    meeting = torch.zeros((1, 1), dtype=torch.bool, device=directions[0].device)
    spheres = [_sphere(part, part_facets) for part, part_facets in zip(parts, facets, strict=True)]
    for number, (pivot, radius) in enumerate(spheres):
        for other, size in spheres[number + 1 :]:
            offset = other - pivot
            square = offset @ offset
            both = (radius + size) ** 2 - square * (1 - MARGIN)
            if both.ndim:
                both = both.repeat(rows[0] // len(both))[:, None]
            for direction in directions:
                meeting = meeting | ((direction @ offset).square() > -both)
    return meeting.expand(rows)


@torch.no_grad()
def overlapping(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor], directions: Tensor) -> Tensor:
    """Along which of the directions (N, D, 3) the outlines of two convex hulls may overlap, (N, D): not where an axis parts them
    (Gottschalk, Lin & Manocha 1996, Proc. SIGGRAPH, 171). Of each hull corners (N or 1, H, 3) and pairs of corners that are
    its edges (E, 2).

    The axes are at right angles to the direction and to an edge, of each hull up to MOST_AXES that are not parallel: for
    boxes and plates that is exact, of rounder hulls some that pass each other narrowly count as overlapping. Hulls that only touch
    do not overlap.
    """
    sides = [corners[:, edges[:, 1]] - corners[:, edges[:, 0]] for corners, edges in (first, second)]
    along = torch.cat([side[:, _unlike(side[0])].expand(len(directions), -1, -1) for side in sides], 1)
    axis = torch.linalg.cross(*torch.broadcast_tensors(directions[:, :, None], along[:, None]), dim=-1)
    length = torch.linalg.vector_norm(axis, dim=-1)
    least, most = [], []
    for corners, _ in (first, second):
        projected = corners.expand(len(directions), -1, -1) @ axis.flatten(1, 2).mT
        least.append(projected.amin(1).view_as(length))
        most.append(projected.amax(1).view_as(length))
    gap = torch.maximum(least[0] - most[1], least[1] - most[0])
    size = torch.maximum(most[0], most[1]) - torch.minimum(least[0], least[1])
    scale = torch.linalg.vector_norm(along, dim=-1)[:, None]
    parted = (gap > -MARGIN * size) & (length > LEAST_SINE * scale)
    return ~parted.any(-1)


def _unlike(sides: Tensor) -> list[int]:
    """Numbers of up to MOST_AXES of the edges (E, 3) that are not parallel."""
    unit = (sides / torch.linalg.vector_norm(sides, dim=-1, keepdim=True).clamp(min=1e-300)).tolist()
    kept: list[int] = []
    for number, edge in enumerate(unit):
        alike = any(abs(sum(a * b for a, b in zip(edge, unit[k], strict=True))) > 1 - MARGIN for k in kept)
        if not alike and len(kept) < MOST_AXES:
            kept.append(number)
    return kept


def _sphere(part: Part, facets: Facets) -> tuple[Tensor, Tensor]:
    """The pivot (3,) and the distance from it (), or (B,), of the farthest corner of a convex part."""
    pivot = like(part.pivot, facets.area)
    return pivot, torch.linalg.vector_norm(part.hull_corners(facets) - pivot, dim=-1).amax(-1)
