"""Joint visibility of facets among convex parts, exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.shape import Hull, Part
from torchlc.shape.part import like
from torchlc.visibility.cover import covered_area
from torchlc.visibility.outline import Joints, facing, outline

TOUCHING = 1e-9  # of the facet's size: a part that rises less above the plane only touches it
PAIRS_AT_ONCE = 60_000  # (row, facet) pairs, which bounds the memory
TENSORS_PER_PART = 5


@dataclass(frozen=True)
class Posed:
    """N rows of a part: pose (N, 3, 3); at rest vertices (N, F, V, 3), normal, u (N, F, 3); posed corners
    (N, H, 3) of its hull."""

    part: Part
    hull: Hull
    pose: Tensor
    vertices: Tensor
    normal: Tensor
    u: Tensor
    corners: Tensor


@dataclass(frozen=True)
class Planes:
    """The planes of P facets, origin at the facet's middle, one axis along its u.

    row (P,); origin, normal (P, 3); axes (P, 2, 3); facet (P, V, 2) in the plane; slope (P, 2, 2): for the
    directions to Sun and observer, how far a point moves in the plane per height on its way down along the
    direction.
    """

    row: Tensor
    origin: Tensor
    normal: Tensor
    axes: Tensor
    facet: Tensor
    slope: Tensor

    @classmethod
    def of(cls, target: Posed, row: Tensor, facet: Tensor, directions: Tensor) -> Planes:
        pose, pivot = target.pose[row], like(target.part.pivot, target.pose)
        vertices = (target.vertices[row, facet] - pivot) @ pose.mT + pivot
        normal = (pose @ target.normal[row, facet][..., None])[..., 0]
        u = (pose @ target.u[row, facet][..., None])[..., 0]
        axes = torch.stack([u, torch.linalg.cross(normal, u, dim=-1)], dim=1)
        origin = vertices.mean(dim=1)
        ahead = directions[row]
        slope = (ahead @ axes.mT) / (ahead @ normal[..., None])
        return cls(row, origin, normal, axes, (vertices - origin[:, None]) @ axes.mT, slope)

    def project(self, item: Tensor, side: int, corners: Tensor) -> tuple[Tensor, Tensor]:
        """Corners (I, H, 3) moved along a direction into planes ``item`` (I,): (I, H, 2), heights (I, H)."""
        offset = corners - self.origin[item][:, None]
        height = (offset @ self.normal[item][..., None])[..., 0]
        return offset @ self.axes[item].mT - height[..., None] * self.slope[item, side][:, None], height


def polygon_fractions(parts: Sequence[Part], *tensors: Tensor) -> tuple[Tensor, ...]:
    """Fractions (N, F) of each part; tensors: to_sun, to_observer (N, 3), then five a part as in `Posed`."""
    rows = max(1, PAIRS_AT_ONCE // max(len(part.faces) for part in parts))
    chunks = zip(*(tensor.split(rows) for tensor in tensors), strict=True)
    pieces = [_rows_fractions(parts, *chunk) for chunk in chunks]
    return tuple(torch.cat(piece) for piece in zip(*pieces, strict=True))


def _rows_fractions(
    parts: Sequence[Part], to_sun: Tensor, to_observer: Tensor, *tensors: Tensor
) -> list[Tensor]:
    posed = []
    for k, part in enumerate(parts):
        pose, vertices, normal, u, corners = tensors[TENSORS_PER_PART * k : TENSORS_PER_PART * (k + 1)]
        pivot = like(part.pivot, pose)
        assert part.hull is not None
        posed.append(Posed(part, part.hull, pose, vertices, normal, u, (corners - pivot) @ pose.mT + pivot))
    directions = torch.stack([to_sun, to_observer], dim=1)
    return [_part_fractions(own, [other for other in posed if other is not own], directions) for own in posed]


def _part_fractions(target: Posed, others: Sequence[Posed], directions: Tensor) -> Tensor:
    """Fractions (N, F) of one part; directions (N, 2, 3), to the Sun and to the observer."""
    fractions = target.normal.new_ones(target.normal.shape[:2])
    reach = _in_reach(target, others, directions)
    row, facet = reach.any(dim=-1).nonzero(as_tuple=True)
    if not len(row):
        return fractions
    planes = Planes.of(target, row, facet, directions)
    start, end, present = _outlines(planes, reach[row, facet], others, directions)
    hidden = present.any(dim=-1).any(dim=-1)
    if not hidden.any():
        return fractions
    polygon = planes.facet[hidden]
    after = polygon.roll(-1, dims=1)
    whole = 0.5 * (polygon[..., 0] * after[..., 1] - polygon[..., 1] * after[..., 0]).sum(dim=-1)
    covered = covered_area(polygon, start[hidden], end[hidden], present[hidden]) / whole
    return fractions.index_put((row[hidden], facet[hidden]), 1.0 - covered.clamp(0.0, 1.0))


@torch.no_grad()
def _in_reach(target: Posed, others: Sequence[Posed], directions: Tensor) -> Tensor:
    """Which others (N, F, 2 others) may hide the Sun (even) or observer (odd) from a facet turned to both.

    The bounding sphere of a facet, moved along the direction, has to meet that of the other.
    """
    normal = target.normal @ target.pose.mT
    upright = (normal @ directions.mT > 0).all(dim=-1, keepdim=True)
    pivot = like(target.part.pivot, normal)
    at_rest = target.vertices.mean(dim=2)
    radius = (target.vertices - at_rest[:, :, None]).norm(dim=-1).amax(dim=-1)
    middle = (at_rest - pivot) @ target.pose.mT + pivot
    reach = []
    for other in others:
        centre = other.corners.mean(dim=1, keepdim=True)
        size = (other.corners - centre).norm(dim=-1).amax(dim=-1, keepdim=True)
        offset = centre - middle
        along = offset @ directions.mT
        across = offset.square().sum(dim=-1, keepdim=True) - along**2
        both = (size + radius)[..., None]
        rises = ((offset * normal).sum(dim=-1) > -size)[..., None]
        reach.append((across < both**2) & (along > -both) & rises & upright)
    return torch.cat(reach, dim=-1)


def _outlines(
    planes: Planes, reach: Tensor, others: Sequence[Posed], directions: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Start, end (P, K, M, 2), presence (P, K, M) of the edges of the K outlines that may touch a facet."""
    low, high = planes.facet.detach().amin(dim=1), planes.facet.detach().amax(dim=1)
    touching = TOUCHING * (high - low).amax(dim=-1)
    rank = torch.zeros_like(planes.row)
    found = []
    for k, other in enumerate(others):
        joints = Joints.of(other.hull, directions.device)
        for side in range(2):
            (item,) = reach[:, 2 * k + side].nonzero(as_tuple=True)
            flat, height = planes.project(item, side, other.corners[planes.row[item]])
            height = height + (touching if other.part.thin else -touching)[item, None]
            outside = (flat.amax(dim=1) < low[item]) | (flat.amin(dim=1) > high[item])
            near = (height > 0).any(dim=-1) & ~outside.any(dim=-1)
            item, flat, height = item[near], flat[near], height[near]
            faces = facing(other.corners.detach(), joints, directions[:, side].detach())[planes.row[item]]
            start, end, present = outline(flat, height, faces, joints)
            found.append((item, rank[item], start, end, present))
            rank[item] += 1
    shape = (len(planes.row), int(rank.max()), max(present.shape[1] for *_, present in found))
    start, end = planes.facet.new_zeros(*shape, 2), planes.facet.new_zeros(*shape, 2)
    present = torch.zeros(shape, dtype=torch.bool, device=rank.device)
    for item, slot, first, second, there in found:
        edge = torch.arange(there.shape[1], device=rank.device)
        where = (item[:, None], slot[:, None], edge[None, :])
        start, end = start.index_put(where, first), end.index_put(where, second)
        present = present.index_put(where, there)
    return start, end, present
