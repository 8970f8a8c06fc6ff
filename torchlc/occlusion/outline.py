"""The outline of a convex part on the plane of a facet, as seen along a direction."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.shapes import Hull


@dataclass(frozen=True)
class Joints:
    """A hull's index arrays as tensors on the device of the computation; see `Hull`."""

    loops: Tensor
    edges: Tensor
    sides: Tensor
    around: Tensor

    @classmethod
    def of(cls, hull: Hull, device: torch.device) -> Joints:
        arrays = (hull.loops, hull.edges, hull.sides, hull.around)
        return cls(*(torch.as_tensor(array, device=device) for array in arrays))


def facing(corners: Tensor, joints: Joints, direction: Tensor) -> Tensor:
    """Which faces (N, D, L) of the hull with corners (N, H, 3) face each ``direction`` (N, D, 3)."""
    first, second, third = corners[:, joints.loops[:, :3]].unbind(2)
    return direction @ torch.linalg.cross(second - first, third - second, dim=-1).mT > 0


def cuts(flat: Tensor, height: Tensor, joints: Joints) -> tuple[Tensor, Tensor]:
    """Where the plane cuts the edges (I, E, 2) of each of I hulls, and which edges it cuts (I, E); see `outline`."""
    i, j = joints.edges.T
    passes = (height[:, i] > 0) != (height[:, j] > 0)
    return _crossing(flat[:, i], flat[:, j], height[:, i], height[:, j]), passes


def extent(flat: Tensor, height: Tensor, cut: Tensor, passes: Tensor) -> tuple[Tensor, Tensor]:
    """Least and largest coordinates (I, 2) of what each hull shows above the plane."""
    points = torch.cat([flat, cut], dim=1)
    there = torch.cat([height > 0, passes], dim=1)[..., None]
    return torch.where(there, points, torch.inf).amin(dim=1), torch.where(there, points, -torch.inf).amax(
        dim=1
    )


def outline(
    flat: Tensor, height: Tensor, cut: Tensor, faces: Tensor, joints: Joints
) -> tuple[Tensor, Tensor, Tensor]:
    """Start, end (I, M, 2) and presence (I, M) of the directed edges that bound each of I outlines.

    flat (I, H, 2): the corners moved along the direction into the plane; height (I, H): how far they are
    above it; cut (I, E, 2): where it cuts the edges; faces (I, L): the faces turned to the direction. What is below the plane is
    cut away. On the outline are the edges between a face turned to the direction and one turned away, and where the plane cuts
    a face turned to it; each runs as it does about that face, which is counter-clockwise.
    """
    i, j = joints.edges.T
    left, right = faces[:, joints.sides[:, 0]], faces[:, joints.sides[:, 1]]
    up = height > 0
    up_i, up_j = up[:, i], up[:, j]
    first = torch.where(up_i[..., None], flat[:, i], cut)
    second = torch.where(up_j[..., None], flat[:, j], cut)
    start = torch.where(left[..., None], first, second)
    end = torch.where(left[..., None], second, first)
    present = (left != right) & (up_i | up_j)

    # the plane leaves and enters a convex face once each, on one of the edges about it
    ahead, after = up[:, joints.loops], up[:, joints.loops.roll(-1, dims=1)]
    leaves, enters = ahead & ~after, ~ahead & after
    face = torch.arange(len(joints.loops), device=flat.device)
    cut_start, cut_end = (
        cut.gather(
            1, joints.around[face, crossing.to(torch.uint8).argmax(dim=-1)][..., None].expand(-1, -1, 2)
        )
        for crossing in (leaves, enters)
    )
    cut_present = faces & leaves.any(dim=-1)

    start, end = torch.cat([start, cut_start], dim=1), torch.cat([end, cut_end], dim=1)
    present = torch.cat([present, cut_present], dim=1) & ((end - start).detach() != 0).any(dim=-1)
    return _packed(start, end, present)


def _crossing(a: Tensor, b: Tensor, height_a: Tensor, height_b: Tensor) -> Tensor:
    """Where the line from a to b (..., 2) passes height 0; a where it does not."""
    passes = (height_a > 0) != (height_b > 0)
    share = torch.where(passes, height_a, 0.0) / torch.where(passes, height_a - height_b, 1.0)
    return a + share[..., None] * (b - a)


def _packed(start: Tensor, end: Tensor, present: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The present edges moved to the front, and no more columns than the fullest outline needs."""
    most = int(present.sum(dim=1).max()) if len(present) else 0
    order = present.to(torch.uint8).argsort(dim=1, descending=True, stable=True)[:, :most]
    index = order[..., None].expand(-1, -1, 2)
    return start.gather(1, index), end.gather(1, index), present.gather(1, order)
