"""How much of each facet is both sunlit and seen, with every part in the way of every other.

Letters: N rows (each a direction to the Sun and one to the observer), F facets, V corners of a facet.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from torchlc.occlusion.batched_rows import rowwise
from torchlc.occlusion.polygons import polygon_fractions
from torchlc.occlusion.rays import ray_fractions
from torchlc.occlusion.reach import may_meet
from torchlc.shapes import Facets, Shape

__all__ = ["may_meet", "visible_fractions"]


def visible_fractions(
    shape: Shape,
    facets: Sequence[Facets],
    poses: Sequence[Tensor | None],
    to_sun: Tensor,
    to_observer: Tensor,
) -> list[Tensor]:
    """Fraction (N, F) of each part's facet areas that is lit and seen at once; 1 where nothing is in the way.

    facets: one a part, at rest; of sizes that differ, those of each row (N, F, ...). poses: rotation (N, 3, 3) of each part about
    its pivot, or None; to_sun, to_observer (N, 3): unit vectors, all in the body frame. Whether a facet faces the two is not included;
    where it does not, 1.

    Convex parts among themselves: exact, with exact gradients. With a dish or a mesh among them: `rays`, no
    gradient.
    """
    rows = len(to_sun)
    convex = all(part.hull is not None for part in shape.parts)
    if convex and len(shape.parts) == 1:
        return [to_sun.new_ones(rows, len(shape.parts[0].faces))]
    if to_sun.is_meta:  # shapes alone are asked for, and which polygons cut which is told by numbers
        return [to_sun.new_empty(rows, len(part.faces)) for part in shape.parts]
    each: list[Tensor] = []
    for part, part_facets, pose in zip(shape.parts, facets, poses, strict=True):
        turn = torch.eye(3, dtype=to_sun.dtype, device=to_sun.device) if pose is None else pose
        fixed = [(part_facets.vertices, 3), (part_facets.normal, 2)]
        fixed += [(part_facets.u, 2), (part.hull_corners(part_facets), 2)] if convex else []
        each += [turn if turn.dim() > 2 else turn[None]]
        each += [tensor if tensor.dim() > ends else tensor[None] for tensor, ends in fixed]
    if convex:
        return list(rowwise(partial(polygon_fractions, shape.parts), to_sun, to_observer, *each))
    still = tuple(pose is None for pose in poses)
    constants = [tensor.detach() for tensor in (to_sun, to_observer, *each)]
    return list(rowwise(partial(ray_fractions, shape.parts, still), *constants))
