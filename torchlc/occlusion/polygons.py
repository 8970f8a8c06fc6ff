"""Joint visibility of facets among convex parts, exact.

Round parts hide others as prisms or polyhedra (`torchlc.shapes`). Of parts in contact, a plate flat on a box
hides what is below it, as if it lay on top; plates that overlap in one plane hide each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.occlusion.batched_rows import picked
from torchlc.occlusion.outline import Joints, cuts, extent, facing, outline
from torchlc.occlusion.polygon_union import covered_area, settled
from torchlc.occlusion.reach import overlapping
from torchlc.shapes import Hull, Part
from torchlc.shapes.part import like

GRAZING = 1e-9  # cosine of incidence or view below which a facet gives no light worth the division
TOUCHING = 1e-9  # of the facet's size: a part that rises less above the plane only touches it
VALUES_AT_ONCE = (
    500_000  # (row, facet, corner of a hull) triples: a few MB a tensor, which the allocator keeps at hand
)
TENSORS_PER_PART = 5
"""That a part is handed over as, for ``vmap`` takes no objects."""


@dataclass(frozen=True)
class Posed:
    """A part in N rows; what is the same in all of them may have one row.

    pose (N, 3, 3); vertices (N, F, V, 3), normal, u (N, F, 3) at rest; of its hull, posed, corners (N, H, 3)
    and which faces (N, 2, L) are turned to the Sun and to the observer.
    """

    part: Part
    joints: Joints
    pose: Tensor
    vertices: Tensor
    normal: Tensor
    u: Tensor
    corners: Tensor
    faces: Tensor


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
        pose, pivot = picked(target.pose, row), like(target.part.pivot, target.pose)

        def own(tensor: Tensor) -> Tensor:
            return tensor[row if len(tensor) > 1 else torch.zeros_like(row), facet]

        vertices = (own(target.vertices) - pivot) @ pose.mT + pivot
        normal = (pose @ own(target.normal)[..., None])[..., 0]
        u = (pose @ own(target.u)[..., None])[..., 0]
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
    corners = max(tensor.shape[1] for tensor in tensors[1 + TENSORS_PER_PART :: TENSORS_PER_PART])
    step = max(1, VALUES_AT_ONCE // (corners * max(len(part.faces) for part in parts)))
    pieces = [
        _rows_fractions(
            parts, *(tensor[start : start + step] if len(tensor) > 1 else tensor for tensor in tensors)
        )
        for start in range(0, len(tensors[0]), step)
    ]
    return tuple(torch.cat(piece) for piece in zip(*pieces, strict=True))


def _rows_fractions(
    parts: Sequence[Part], to_sun: Tensor, to_observer: Tensor, *tensors: Tensor
) -> list[Tensor]:
    """Fractions (N, F) of each part; only rows in which the outlines of two parts overlap are worked out."""
    given = [tensors[k : k + TENSORS_PER_PART] for k in range(0, len(tensors), TENSORS_PER_PART)]
    corners = [_posed(part, group[0], group[-1]) for part, group in zip(parts, given, strict=True)]
    joints = [Joints.of(_hull(part), to_sun.device) for part in parts]
    directions = torch.stack([to_sun, to_observer], dim=1)
    overlap = _overlaps(corners, joints, directions)
    whole = [to_sun.new_ones(len(to_sun), len(part.faces)) for part in parts]
    (some,) = torch.stack(list(overlap.values())).any(0).any(-1).nonzero(as_tuple=True)
    if not len(some):
        return whole
    directions = directions[some]
    overlap = {pair: mask[some] for pair, mask in overlap.items()}
    posed = []
    for part, pieces, hull, points in zip(parts, given, joints, corners, strict=True):
        pose, vertices, normal, u, points = (x[some] if len(x) > 1 else x for x in (*pieces[:-1], points))
        faces = facing(points.detach(), hull, directions.detach())
        posed.append(Posed(part, hull, pose, vertices, normal, u, points, faces))
    for k, own in enumerate(posed):
        others = [other for other in range(len(posed)) if other != k]
        reach = torch.cat([overlap[min(k, other), max(k, other)] for other in others], dim=-1)
        fractions = _part_fractions(own, [posed[other] for other in others], reach, directions)
        whole[k] = whole[k].index_copy(0, some, fractions)
    return whole


def _hull(part: Part) -> Hull:
    assert part.hull is not None
    return part.hull


def _posed(part: Part, pose: Tensor, corners: Tensor) -> Tensor:
    pivot = like(part.pivot, pose)
    return (corners - pivot) @ pose.mT + pivot


def _overlaps(
    corners: Sequence[Tensor], joints: Sequence[Joints], directions: Tensor
) -> dict[tuple[int, int], Tensor]:
    """Along which of the directions (N, 2) two parts, by their numbers, may hide each other."""
    hulls = [(points.detach(), hull.edges) for points, hull in zip(corners, joints, strict=True)]
    return {
        (k, other): overlapping(hulls[k], hulls[other], directions.detach())
        for other in range(len(hulls))
        for k in range(other)
    }


def _part_fractions(target: Posed, others: Sequence[Posed], overlap: Tensor, directions: Tensor) -> Tensor:
    """Fractions (N, F) of one part; directions (N, 2, 3), to the Sun and to the observer. Others (N, 2 others) that may hide the
    Sun (even) or observer (odd) are those whose outlines ``overlap`` with its own."""
    normal = (target.normal @ target.pose.mT).detach()
    upright = (normal @ directions.detach().mT > GRAZING).all(dim=-1)
    fractions = normal.new_ones(upright.shape)
    row, facet = upright.nonzero(as_tuple=True)
    reach = overlap[row]
    close = reach.any(dim=-1)
    row, facet, reach = row[close], facet[close], reach[close]
    if not len(row):
        return fractions
    planes = Planes.of(target, row, facet, directions)
    start, end, present = _outlines(planes, reach, others)
    (hidden,) = present.flatten(1).any(dim=-1).nonzero(as_tuple=True)
    if not len(hidden):
        return fractions
    row, facet, polygons = row[hidden], facet[hidden], planes.facet[hidden]
    start, end, present = start[hidden], end[hidden], present[hidden]
    clear, within = settled(polygons, start, end, present)
    fractions[row[within], facet[within]] = 0.0
    partly = ~clear & ~within
    number = present.any(dim=-1).sum(dim=-1)
    for count in range(1, present.shape[1] + 1):  # cost is the square of how many hide a facet
        (alike,) = (partly & (number == count)).nonzero(as_tuple=True)
        if not len(alike):
            continue
        polygon = polygons[alike]
        after = polygon.roll(-1, dims=1)
        whole = 0.5 * (polygon[..., 0] * after[..., 1] - polygon[..., 1] * after[..., 0]).sum(dim=-1)
        there = present[alike].any(dim=-1).to(torch.uint8)
        order = there.argsort(dim=1, descending=True, stable=True)[:, :count]
        edges = order[..., None].expand(-1, -1, present.shape[2])
        ends = edges[..., None].expand(-1, -1, -1, 2)
        covered = covered_area(
            polygon,
            start[alike].gather(1, ends),
            end[alike].gather(1, ends),
            present[alike].gather(1, edges),
        )
        covered = (covered / whole).clamp(0.0, 1.0)
        fractions = fractions.index_put((row[alike], facet[alike]), 1.0 - covered)
    return fractions


def _outlines(planes: Planes, reach: Tensor, others: Sequence[Posed]) -> tuple[Tensor, Tensor, Tensor]:
    """Start, end (P, K, M, 2), presence (P, K, M) of the edges of the K outlines that may touch a facet."""
    low, high = planes.facet.detach().amin(dim=1), planes.facet.detach().amax(dim=1)
    touching = TOUCHING * (high - low).amax(dim=-1)
    rank = torch.zeros_like(planes.row)
    outlines = []
    for k, other in enumerate(others):
        for side in range(2):
            (item,) = reach[:, 2 * k + side].nonzero(as_tuple=True)
            flat, height = planes.project(item, side, picked(other.corners, planes.row[item]))
            height = height + (touching if other.part.thin else -touching)[item, None]
            outside = (flat.amax(dim=1) < low[item]) | (flat.amin(dim=1) > high[item])
            near = (height > 0).any(dim=-1) & ~outside.any(dim=-1)
            item, flat, height = item[near], flat[near], height[near]
            cut, passes = cuts(flat, height, other.joints)
            least, most = extent(flat.detach(), height, cut.detach(), passes)
            (near,) = ((most >= low[item]) & (least <= high[item])).all(dim=-1).nonzero(as_tuple=True)
            item, flat, height, cut = item[near], flat[near], height[near], cut[near]
            faces = picked(other.faces, planes.row[item])[:, side]
            start, end, present = outline(flat, height, cut, faces, other.joints)
            outlines.append((item, rank[item], start, end, present))
            rank[item] += 1
    shape = (len(planes.row), max(int(rank.max()), 1), max(present.shape[1] for *_, present in outlines))
    start, end = planes.facet.new_zeros(*shape, 2), planes.facet.new_zeros(*shape, 2)
    present = torch.zeros(shape, dtype=torch.bool, device=rank.device)
    for item, slot, first, second, there in outlines:
        edge = torch.arange(there.shape[1], device=rank.device)
        where = (item[:, None], slot[:, None], edge[None, :])
        start, end = start.index_put(where, first), end.index_put(where, second)
        present = present.index_put(where, there)
    return start, end, present
