"""Which rows have parts close enough, as seen along a direction, that one may hide another."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchlc.shapes import Facets, Part
from torchlc.shapes.part import like

MARGIN = 1e-9
"""Of the distance between two parts: spheres that come as close as that count as touching."""


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
    spheres = [_sphere(part, own) for part, own in zip(parts, facets, strict=True)]
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


def _sphere(part: Part, facets: Facets) -> tuple[Tensor, Tensor]:
    """The pivot (3,) and the distance from it (), or (B,), of the farthest corner of a convex part."""
    pivot = like(part.pivot, facets.area)
    return pivot, torch.linalg.vector_norm(part.hull_corners(facets) - pivot, dim=-1).amax(-1)
