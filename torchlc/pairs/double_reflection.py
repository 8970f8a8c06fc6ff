"""Light from one side of an object to another: which sides face each other, and the ways between them.

A way is sunlight to a place of the first side, on to a place of the second, and to the observer. Letters: T
rows, R rows or 1 for what never turns, F facets, V corners, D directions, N ways.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, incidence
from torchlc.occlusion.batched_rows import picked, rowwise
from torchlc.occlusion.lines import blocked, planes
from torchlc.occlusion.outline import Joints, cuts, outline
from torchlc.occlusion.polygon_union import covered_area
from torchlc.pairs.slots import ANGLES, EMPTY
from torchlc.shapes import Part, tracking_pose
from torchlc.shapes.part import like
from torchlc.shapes.plate import Plate
from torchlc.stages.effect import Context
from torchlc.stages.light import View
from torchlc.tensors.autodiff_state import traced

POINTS, CELLS = 4, 4
"""Points across the first facet and cells across the second."""
RINGS, SPOKES = 20, 8
SHARPEST = 3e-4
"""Half vectors about a normal: rings of angle from SHARPEST rad to 90 deg in equal ratios, and azimuths. A
lobe is smooth in the angle's logarithm, so that equal steps of it are a rule of high order for every
exponent up to 1e6."""
MOST_FACETS = 32
"""Facets that stand for a curved side."""
SMOOTH = 0.6
"""Least width of a lobe between curved sides, as a standard deviation in widths of a cell."""
SUNS = 64
"""Directions to the Sun for which sides are tried."""
NEAR = 1e-6
"""Of a length or a cosine: below it is 0, but for rounding."""
FAR = 1e3
"""Of the size of the object: where half-planes are cut off."""
BLANK = EMPTY + EMPTY + (0.0,) * 4
"""What a way holds: angles, least variance of the lobe and weight of the first reflection and of the
second, and which products count: lobe then diffuse, diffuse then lobe, lobe twice, diffuse twice."""
FIRST, SECOND = slice(0, ANGLES + 2), slice(ANGLES + 2, 2 * ANGLES + 4)

Ways = tuple[Tensor, ...]


@dataclass(frozen=True)
class Side:
    """Facets of one part that share a label and a material; each of ``facets`` (F,) stands for ``share``
    (F,) of them."""

    part: int
    material: str
    facets: Tensor
    share: Tensor

    @property
    def flat(self) -> bool:
        return len(self.facets) == 1


def facing_sides(context: Context) -> list[tuple[Side, Side]]:
    """Ordered pairs of sides of different parts that rise above each other's planes, wherever the Sun may
    be."""
    sides = _sides(context)
    posed = [_turned_to(_suns(), context, side) for side in sides]

    def above(one: int, other: int) -> Tensor:
        """Whether the other side rises over a facet of the one, for each Sun."""
        (base, normal), (corners, _) = posed[one], posed[other]
        base = base[:, :: base.shape[1] // normal.shape[1]]
        height = ((corners[:, :, None] - base[:, None]) * normal[:, None]).sum(-1)
        size = (corners.amax(1) - corners.amin(1)).norm(dim=-1)
        return height.flatten(1).amax(-1) > NEAR * size

    indices = range(len(sides))
    return [
        (sides[i], sides[j])
        for i in indices
        for j in indices
        if sides[i].part != sides[j].part and bool((above(i, j) & above(j, i)).any())
    ]


def _sides(context: Context) -> list[Side]:
    sides = []
    for number, (part, part_facets) in enumerate(zip(context.parts, context.rest, strict=True)):
        labels = list(zip(part.faces, part.materials, strict=True))
        for label in dict.fromkeys(labels):
            facets = torch.as_tensor([i for i, other in enumerate(labels) if other == label])
            chosen = facets[:: math.ceil(len(facets) / MOST_FACETS)]
            share = part_facets.area[facets].sum() / part_facets.area[chosen].sum()
            sides.append(Side(number, label[1], chosen, share.expand(len(chosen))))
    return sides


def _suns() -> Tensor:
    """Directions (SUNS, 3) all over the sphere."""
    count = np.arange(SUNS) + 0.5
    up, turn = 1 - 2 * count / SUNS, math.pi * (3 - math.sqrt(5)) * count
    level = np.sqrt(1 - up**2)
    return torch.as_tensor(np.stack([level * np.cos(turn), level * np.sin(turn), up], -1))


def _turned_to(suns: Tensor, context: Context, side: Side) -> tuple[Tensor, Tensor]:
    """Corners (T, F V, 3) and normals (T, F, 3) of a side for each direction to the Sun (T, 3)."""
    part, facets = context.parts[side.part], context.rest[side.part]
    corners, normal = facets.vertices[side.facets].flatten(0, 1), facets.normal[side.facets]
    if part.tracks_axis is None:
        return corners.expand(len(suns), -1, -1), normal.expand(len(suns), -1, -1)
    pivot = like(part.pivot, corners)
    pose = tracking_pose(like(part.tracks_axis, corners), like(part.front, corners), suns)
    return (corners - pivot) @ pose.mT + pivot, normal @ pose.mT


@dataclass(frozen=True)
class Posed:
    """The object in T rows at mid-exposure.

    to_sun, to_observer (T, 3); gain (T,) irradiance over range^2; of each part vertices (R, F, 4, 3),
    normal, u (R, F, 3) and the corners (R, H, 3) of its hull.
    """

    parts: Sequence[Part]
    to_sun: Tensor
    to_observer: Tensor
    gain: Tensor
    vertices: Sequence[Tensor]
    normal: Sequence[Tensor]
    u: Sequence[Tensor]
    corners: Sequence[Tensor]

    @classmethod
    def of(cls, view: View, context: Context, rows: slice) -> Posed:
        middle = view.to_observer.shape[0] // 2
        to_sun, to_observer = view.to_sun[middle, rows], view.to_observer[middle, rows]
        sunlight = [light.irradiance[:, middle, rows].sum(0) for light in view.lights if light.primary]
        gain = torch.stack(sunlight).sum(0) / view.range_m[middle, rows] ** 2
        still = torch.eye(3, dtype=to_sun.dtype, device=to_sun.device)[None]
        turns = [still if pose is None else pose[middle, rows] for pose in view.poses]
        vertices, normal, u, corners = [], [], [], []
        for part, facets, turn in zip(context.parts, view.facets, turns, strict=True):
            pivot = like(part.pivot, to_sun)
            fourth = min(3, facets.vertices.shape[1] - 1)
            hull = facets.vertices[:0, 0] if part.hull is None else part.hull_corners(facets)
            moved = torch.einsum("rij,fvj->rfvi", turn, facets.vertices[:, [0, 1, 2, fourth]] - pivot) + pivot
            vertices.append(moved)
            normal.append(facets.normal @ turn.mT)
            u.append(facets.u @ turn.mT)
            corners.append((hull - pivot) @ turn.mT + pivot)
        return cls(context.parts, to_sun, to_observer, gain, vertices, normal, u, corners)

    def ways(self, first: Side, second: Side) -> list[tuple[Ways, bool]]:
        """Row (N,) and the values of BLANK, (N,) each, of ways from the first side to the second, and
        whether diffuse light alone takes them.

        Between flat sides diffuse light goes from points to cells, and what is a lobe at one end or both
        about mirrored directions; between others all goes from points to cells, so that no lobe is narrower
        than a cell.
        """
        if not (first.flat and second.flat):
            return [(self._by_cells(first, second, (1.0, 1.0, 1.0, 1.0))[0], False)]
        by_cells, clear = self._by_cells(first, second, (0.0, 0.0, 0.0, 1.0))
        return [
            (by_cells, True),
            *((self._by_mirror(first, second, clear, which), False) for which in (0, 1)),
        ]

    def _by_cells(self, first: Side, second: Side, counts: tuple[float, ...]) -> tuple[Ways, Tensor]:
        """Ways from every point of the first side to every cell of the second; and the share (T,) of them
        that is free."""
        start, spot = self._points(first)
        cells = self._cells(second)
        end = cells.mean(-2)
        normal_1, u_1 = self._frame(first, start.shape[1])
        normal_2, u_2 = self._frame(second, end.shape[1])
        along = end[:, None] - start[:, :, None]
        along = along / torch.linalg.vector_norm(along, dim=-1, keepdim=True)
        cos_1 = (along * normal_1[:, :, None]).sum(-1)
        cos_2 = -(along * normal_2[:, None]).sum(-1)
        factor = form_factor(cells[:, None] - start[:, :, None, None], normal_1[:, :, None])
        factor = factor * second.share.repeat_interleave(end.shape[1] // len(second.facets))
        factor = torch.where((cos_1 > NEAR) & (cos_2 > NEAR), factor, 0.0)
        clear = self._clear(first, second, start, end)
        exchange = (math.pi * spot[..., None] * factor).expand(clear.shape)
        total = exchange.sum((-1, -2))
        free = torch.where(
            total > 0, (exchange * clear).sum((-1, -2)) / torch.where(total > 0, total, 1.0), 0.0
        )
        lit = (normal_1 @ self.to_sun[:, :, None]) > 0
        seen = (normal_2 @ self.to_observer[:, :, None]).mT > 0
        weight = torch.where(lit & seen, self.gain[:, None, None] * exchange * clear, 0.0)
        row, i, j = _counted(weight)
        given = weight[row, i, j]
        there = (given > 0).to(given)
        way, cos_1, cos_2 = _at(along, row, i, j), _at(cos_1, row, i, j), _at(cos_2, row, i, j)
        per_cos_1, per_cos_2 = there / cos_1.clamp(min=NEAR), there / cos_2.clamp(min=NEAR)
        wide = 0.25 * SMOOTH**2 * math.pi * _at(factor, row, i, j) * per_cos_1
        angles_1 = incidence(_at(normal_1, row, i), _at(u_1, row, i), self.to_sun[row], way)
        angles_2 = incidence(_at(normal_2, row, j), _at(u_2, row, j), -way, self.to_observer[row])
        products = (count * there for count in counts)
        values = (
            *vars(angles_1).values(),
            wide,
            given * per_cos_1,
            *vars(angles_2).values(),
            wide,
            per_cos_2,
            *products,
        )
        return (row, *values), free

    def _by_mirror(self, first: Side, second: Side, clear: Tensor, which: int) -> Ways:
        """Ways in directions about the one that mirrors the Sun in the first facet (``which`` 0), or about
        the one that mirrors the observer in the second (1).

        The area that a direction leads from facet to facet is exact; of it a share ``clear`` (T,) is not
        blocked. What is a lobe at both ends is divided between the two sets by how densely the directions
        of each lie there.
        """
        frames = [tuple(axis[:, 0] for axis in self._frame(side, 1)) for side in (first, second)]
        known = (self.to_sun, self.to_observer)[which]
        half, size = _about(*frames[which])
        cosine = (half * known[:, None]).sum(-1)
        way = 2 * cosine[..., None] * half - known[:, None]
        way = -way if which else way
        (normal_1, u_1), (normal_2, u_2) = (tuple(axis[:, None] for axis in frame) for frame in frames)
        angles_1 = incidence(normal_1, u_1, self.to_sun[:, None], way)
        angles_2 = incidence(normal_2, u_2, -way, self.to_observer[:, None])
        gain = (self.gain * clear)[:, None] * 4 * cosine * size
        ahead = (
            (angles_1.cos_i > 0)
            & (angles_1.cos_r > NEAR)
            & (angles_2.cos_i > NEAR)
            & (angles_2.cos_r > 0)
            & (gain > 0)
        )
        corners = [self.vertices[side.part][:, side.facets[0]] for side in (first, second)]
        (area,) = rowwise(_led, way, ahead.to(way), *corners)
        weight = torch.where(ahead, gain * area, 0.0)
        row, k = _counted(weight)
        given = weight[row, k]
        there, none = (given > 0).to(given), torch.zeros_like(given)
        angles_1, angles_2 = (
            Incidence(*(field.expand(weight.shape)[row, k] for field in vars(angles).values()))
            for angles in (angles_1, angles_2)
        )
        density = [
            1 / (end.cos_half * (SHARPEST**2 - torch.expm1(2 * end.log_half))) for end in (angles_1, angles_2)
        ]
        products = (none, there) if which else (there, none)
        lobes = there * density[which] / (density[0] + density[1])
        per_cos = there / angles_2.cos_i.clamp(min=NEAR)
        return (
            row,
            *vars(angles_1).values(),
            none,
            given,
            *vars(angles_2).values(),
            none,
            per_cos,
            *products,
            lobes,
            none,
        )

    def _points(self, side: Side) -> tuple[Tensor, Tensor]:
        """Points (R, N, 3) of a side and the area (R, N) of each: Gauss-Legendre on one facet, middles of
        many."""
        x, w = np.polynomial.legendre.leggauss(POINTS if side.flat else 1)
        x, w = like(0.5 * (x + 1), self.gain), like(0.5 * w, self.gain)
        point, stretch = _on_quadrilateral(
            self.vertices[side.part][:, side.facets], x.repeat_interleave(len(x)), x.repeat(len(x))
        )
        return point.flatten(1, 2), (side.share[:, None] * stretch * (w[:, None] * w).flatten()).flatten(1, 2)

    def _cells(self, side: Side) -> Tensor:
        """Corners (R, N, 4, 3) of equal pieces of a side: a grid on one facet, the facets themselves of
        many."""
        count = CELLS if side.flat else 1
        edge = torch.linspace(0, 1, count + 1, dtype=self.gain.dtype, device=self.gain.device)
        low, high = edge[:-1], edge[1:]
        vertices = self.vertices[side.part][:, side.facets]
        corners = [
            _on_quadrilateral(vertices, a.repeat_interleave(count), b.repeat(count))[0].flatten(1, 2)
            for a, b in ((low, low), (high, low), (high, high), (low, high))
        ]
        return torch.stack(corners, -2)

    def _frame(self, side: Side, count: int) -> tuple[Tensor, Tensor]:
        """Normal and u (R, count, 3) of the facets on which the points or cells of a side lie."""
        each = count // len(side.facets)
        normal, u = (
            axes[side.part][:, side.facets].repeat_interleave(each, 1) for axes in (self.normal, self.u)
        )
        return normal, u

    def _clear(self, first: Side, second: Side, start: Tensor, end: Tensor) -> Tensor:
        """1 where point and cell (T, N, M) see each other, the point the Sun and the cell the observer,
        else 0."""
        bodies = [k for k, part in enumerate(self.parts) if part.hull is not None]
        function = partial(_clear, self.parts, bodies, first.part, second.part)
        given = (self.to_sun, self.to_observer, start, end, *(self.corners[k] for k in bodies))
        return rowwise(function, *(tensor.detach() for tensor in given))[0]


def _clear(
    parts: Sequence[Part], bodies: Sequence[int], first: int, second: int,
    to_sun: Tensor, to_observer: Tensor, start: Tensor, end: Tensor, *corners: Tensor,
) -> tuple[Tensor]:  # fmt: skip
    hulls = {k: planes(parts[k], hull_corners) for k, hull_corners in zip(bodies, corners, strict=True)}
    far = FAR * max(float(points.abs().max()) for points in (start, end, *corners))

    def free(origin: Tensor, ahead: Tensor, *without: int) -> Tensor:
        met = [blocked(origin, ahead, *hull) for k, hull in hulls.items() if k not in without]
        return ~sum(met, torch.zeros(origin.shape[:-1], dtype=torch.bool, device=origin.device))

    lit = free(start, far * to_sun[:, None], first)
    seen = free(end, far * to_observer[:, None], second)
    along = end[:, None] - start[:, :, None]
    between = free(start[:, :, None].expand_as(along).flatten(1, 2), along.flatten(1, 2), first, second)
    clear = lit[:, :, None] & seen[:, None] & between.unflatten(1, along.shape[1:3])
    return (clear.expand(len(to_sun), -1, -1).to(to_sun),)


def _led(way: Tensor, wanted: Tensor, first: Tensor, second: Tensor) -> tuple[Tensor]:
    """Area (T, D) of the first quadrilateral (R, 4, 3) from which directions ``way`` (T, D, 3) lead to the
    second, where ``wanted`` (T, D) is not 0."""
    row, column = wanted.nonzero(as_tuple=True)
    a, b, ahead = picked(first, row), picked(second, row), way[row, column]
    origin = a.mean(1, keepdim=True)
    normal, along = _unit(torch.linalg.cross(a[:, 2] - a[:, 0], a[:, 3] - a[:, 1])), _unit(a[:, 1] - a[:, 0])
    axes = torch.stack([along, torch.linalg.cross(normal, along)], 1)
    slope = (axes @ ahead[..., None])[..., 0] / (ahead * normal).sum(-1).clamp(min=NEAR)[:, None]
    height = ((b - origin) @ normal[..., None])[..., 0]
    flat = (b - origin) @ axes.mT - height[..., None] * slope[:, None]
    turned = (torch.linalg.cross(b[:, 2] - b[:, 0], b[:, 3] - b[:, 1]) * ahead).sum(-1) > 0
    joints = Joints.of(Plate.hull, way.device)  # pyright: ignore[reportArgumentType]
    cut, _ = cuts(flat, height, joints)
    start, end, present = outline(flat, height, cut, torch.stack([turned, ~turned], -1), joints)
    if not start.shape[1]:
        return (torch.zeros_like(wanted),)
    area = covered_area((a - origin) @ axes.mT, start[:, None], end[:, None], present[:, None])
    return (torch.zeros_like(wanted).index_put((row, column), area),)


def _about(normal: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Half vectors (R, D, 3) in rings about normals (R, 3), and the solid angle (D,) of each."""
    step = math.log(0.5 * math.pi / SHARPEST) / (RINGS - 0.5)
    ring = torch.arange(RINGS, dtype=normal.dtype, device=normal.device)
    angle = SHARPEST * torch.exp(step * ring)
    size = torch.sin(angle) * angle * (2 * math.pi / SPOKES * step)
    size[0] = size[0] / -math.expm1(-2 * step)  # with all rings within, whose areas are a geometric series
    spoke = torch.arange(SPOKES, dtype=normal.dtype, device=normal.device)
    turn = (spoke + 0.5 * (ring % 2)[:, None]) * (2 * math.pi / SPOKES)
    level = torch.sin(angle)[:, None]
    places = [level * torch.cos(turn), level * torch.sin(turn), torch.cos(angle)[:, None].expand_as(turn)]
    axes = torch.stack([u, torch.linalg.cross(normal, u), normal], -2)
    return torch.stack(places, -1).flatten(0, 1) @ axes, size.repeat_interleave(SPOKES)


def form_factor(corners: Tensor, normal: Tensor) -> Tensor:
    """Share (...) of a Lambert point's light that a polygon with corners (..., V, 3) relative to it
    receives.

    Lambert's formula, exact for polygons above the plane of the point, whose normal is (..., 3).
    """
    unit = _unit(corners)
    after = unit.roll(-1, dims=-2)
    cross = torch.linalg.cross(unit, after)
    square = (cross * cross).sum(-1)
    there = square > 1e-24
    sine = torch.sqrt(torch.where(there, square, 1.0))
    angle = torch.where(there, torch.atan2(sine, (unit * after).sum(-1)), 0.0)
    return ((angle / sine) * (cross @ normal[..., None])[..., 0]).sum(-1).abs() / (2 * math.pi)


def _on_quadrilateral(vertices: Tensor, a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Points (R, F, N, 3) at bilinear coordinates (N,) of facets (R, F, 4, 3), and how the map stretches
    area there."""
    p, q, r, s = (corner[:, :, None] for corner in vertices.unbind(2))
    a, b = a[:, None], b[:, None]
    points = (1 - a) * (1 - b) * p + a * (1 - b) * q + a * b * r + (1 - a) * b * s
    along_a, along_b = (1 - b) * (q - p) + b * (r - s), (1 - a) * (s - p) + a * (r - q)
    square = (torch.linalg.cross(along_a, along_b) ** 2).sum(-1)
    return points, torch.where(square > 0, torch.sqrt(torch.where(square > 0, square, 1.0)), 0.0)


def _unit(vector: Tensor) -> Tensor:
    return vector / torch.linalg.vector_norm(vector, dim=-1, keepdim=True)


def _counted(weight: Tensor) -> tuple[Tensor, ...]:
    """Indices of what has weight; of everything where a trace follows."""
    return (torch.ones(weight.shape, device=weight.device) if traced() else weight).nonzero(as_tuple=True)


def _at(tensor: Tensor, row: Tensor, *index: Tensor) -> Tensor:
    """Elements at rows and further indices, of a tensor with all rows or one for all."""
    return tensor[row if len(tensor) > 1 else torch.zeros_like(row), *index]
