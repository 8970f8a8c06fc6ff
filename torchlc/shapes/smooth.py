"""Smooth shapes: cylinder, cone, dish, sphere.

A curved side shines at points that follow Sun and observer (:mod:`torchlc.shapes.curved`), of lobes of any sharpness
alike. It is also cut into facets, N of them a turn: of each what others hide of it is known, and laws without a
lobe are summed over them. Each facet has the area of the true surface it stands for and the true normal at its
middle: areas are exact, and a smooth phase curve is a midpoint rule, off by less than (2 pi/N)^2/12 of its maximum:
8e-4 (0.9 mmag) at N = 64.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.shapes.curved import Band, Dome, Plane, Surface
from torchlc.shapes.part import Facets, Hull, Part, frame_about, like, number, unit

HULL_SIDES = 24  # sides of the prism that a cylinder or cone is when it stands in the way of others


class Cone(Part):
    """A frustum closed by caps: "side" (u up the slope to the top), "cap+" of radius_top, "cap-" of radius.

    Its middle is half-way along the axis; a radius_top fixed at 0 leaves no cap+. In the way of others it is
    a prism of 24 sides with the same girth, its outline within 0.6 % of the radius.
    """

    kind = "cone"
    top_key = "radius_top"

    def __init__(self, component: Any, around: int) -> None:
        super().__init__(component)
        self.axis = unit(component.axis)
        self.front = self.turn @ self.axis
        self._frame = frame_about(self.axis)
        self._around = HULL_SIDES * math.ceil(around / HULL_SIDES)
        top = getattr(component, self.top_key)
        self._has_top = hasattr(top, "value") or top > 0
        caps = ["cap+"] * self._has_top + ["cap-"]
        self.faces = ("side",) * self._around + tuple(np.repeat(caps, HULL_SIDES // 2).tolist())
        self.materials = (component.material,) * len(self.faces)
        flared = self.top_key != "radius"
        self.whole = {
            face: Band.points_of(flared) if face == "side" else 1 for face in dict.fromkeys(self.faces)
        }
        ring = list(range(HULL_SIDES))
        after = [*ring[1:], 0]
        quads = [[a, b, b + HULL_SIDES, a + HULL_SIDES] for a, b in zip(ring, after, strict=True)]
        self.hull = Hull.of([*quads, ring[::-1], [k + HULL_SIDES for k in ring]])

    def surface(self, face: str, values: Mapping[str, Tensor]) -> Surface:
        if face != "side":
            return Plane()
        bottom, top, length = self.sizes(values, "radius", self.top_key, "length")
        slant = torch.sqrt(length**2 + (bottom - top) ** 2)
        return Band(
            frame=like(self._frame @ self.turn.T, length),
            level=length / slant,
            rise=(bottom - top) / slant,
            area=math.pi * (bottom + top) * slant,
            facets=self._around,
            flared=self.top_key != "radius",
        )

    def _ring(self, count: int) -> np.ndarray:
        """Corners (count, 3) of a regular polygon about the axis with the girth of the unit circle."""
        angle = 2 * math.pi * np.arange(count) / count
        half = math.pi / count
        return np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ self._frame[:2] * (half / math.sin(half))

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        bottom, top, length = self.sizes(values, "radius", self.top_key, "length")
        axis, ring = like(self.axis, length), like(self._ring(self._around), length)
        after = ring.roll(-1, dims=0)
        low, high = -0.5 * length * axis, 0.5 * length * axis
        side = torch.stack(
            [bottom * ring + low, bottom * after + low, top * after + high, top * ring + high], dim=1
        )
        outward = torch.nn.functional.normalize(ring + after, dim=-1)
        slant = torch.sqrt(length**2 + (bottom - top) ** 2)
        wall = Facets(
            vertices=side,
            normal=(length * outward + (bottom - top) * axis) / slant,
            u=(length * axis - (bottom - top) * outward) / slant,
            area=(math.pi * (bottom + top) * slant / self._around).expand(self._around),
            centroid=side.mean(dim=1),
        )
        caps = [self._cap(top, high, 1.0)] * self._has_top + [self._cap(bottom, low, -1.0)]
        return joined(wall, *caps)

    def _cap(self, radius: Tensor, middle: Tensor, sign: float) -> Facets:
        """The disc as 12 four-cornered sectors that have the area of the disc in all."""
        sectors = HULL_SIDES // 2
        ring = radius * like(self._ring(HULL_SIDES), radius) + middle
        first, second, third = ring[0::2], ring[1::2], ring.roll(-2, dims=0)[0::2]
        centre = middle.expand(sectors, 3)
        corners = [centre, first, second, third] if sign > 0 else [centre, third, second, first]
        return Facets(
            vertices=torch.stack(corners, dim=1),
            normal=(sign * like(self.axis, radius)).expand(sectors, 3),
            u=like(self._frame[0], radius).expand(sectors, 3),
            area=(math.pi * radius**2 / sectors).expand(sectors),
            centroid=(2 * centre + first + 2 * second + third) / 6,
        )

    def hull_corners(self, facets: Facets) -> Tensor:
        step = self._around // HULL_SIDES
        corners = facets.vertices[: self._around : step]
        rings = torch.cat([corners[:, 0], corners[:, 3]])
        axis = like(self.turn @ self.axis, rings)
        offset = rings - like(self.pivot, rings)
        along = (offset @ axis)[:, None] * axis
        half, fine = math.pi / HULL_SIDES, math.pi / self._around
        widen = (half / math.sin(half)) / (fine / math.sin(fine))
        return like(self.pivot, rings) + along + widen * (offset - along)


class Cylinder(Cone):
    """Closed by two caps: "side" (u = axis), "cap+", "cap-"; in the way of others as `Cone`."""

    kind = "cylinder"
    top_key = "radius"


class Sphere(Part):
    """Bands of latitude about +Z cut into facets of about equal area; u along the meridian towards +Z.

    In the way of others it is a polyhedron of 320 faces with the same mean outline, within 1 % of the radius.
    """

    kind = "sphere"

    def __init__(self, component: Any, around: int) -> None:
        super().__init__(component)
        bands = math.ceil(around / 2)
        self._patches = Patches.of(np.linspace(0.0, math.pi, bands + 1), lambda polar: around * np.sin(polar))
        self._around = around
        self.faces = ("side",) * len(self._patches.polar)
        self.materials = (component.material,) * len(self.faces)
        self.whole = dict.fromkeys(self.faces, Dome.count)
        corners, loops = icosphere(2)
        triangles = corners[loops]
        surface = (
            0.5
            * np.linalg.norm(
                np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=-1
            ).sum()
        )
        self._hull_corners = (
            corners * math.sqrt(4 * math.pi / surface) @ self.turn.T
        )  # mean outline: surface/4
        self.hull = Hull.of(loops.tolist())

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        (radius,) = self.sizes(values, "radius")
        patches = self._patches
        low, high = patches.edges[..., 0], patches.edges[..., 1]
        area = (np.cos(low) - np.cos(high)) * patches.width
        up = 0.5 * (np.sin(high) ** 2 - np.sin(low) ** 2) * patches.width
        across = 0.5 * (high - low - (np.sin(2 * high) - np.sin(2 * low)) / 2) * 2 * np.sin(patches.width / 2)
        tilt = np.arctan2(across, up)  # polar angle of the patch's mean normal
        normal = like(patches.direction(tilt, patches.azimuth), radius)
        return Facets(
            vertices=radius * like(patches.direction(*patches.corners()), radius),
            normal=normal,
            u=like(patches.direction(tilt - math.pi / 2, patches.azimuth), radius),
            area=radius**2 * like(area, radius),
            centroid=radius * normal,
        )

    def surface(self, face: str, values: Mapping[str, Tensor]) -> Surface:
        (radius,) = self.sizes(values, "radius")

        def find(normal: list[Tensor]) -> Tensor:
            x, y, z = normal
            return self._patches.find(torch.atan2(torch.sqrt(x * x + y * y), z), torch.atan2(y, x))

        frame = like(self.turn.T, radius)
        return Dome(frame, None, radius**2, 0, self._around, find)

    def hull_corners(self, facets: Facets) -> Tensor:
        pivot = like(self.pivot, facets.centroid)
        radius = (facets.centroid[0] - pivot).norm()
        return pivot + radius * like(self._hull_corners, facets.centroid)


class Dish(Part):
    """A paraboloid open towards its axis, two-sided: "inside" and "outside"; u up the slope to the rim.

    Its middle is half its depth from the rim. Patches are equal steps of slope, at most 2 pi/N apart.
    """

    kind = "dish"
    thin = True

    def __init__(self, component: Any, around: int) -> None:
        super().__init__(component)
        self.axis = unit(component.axis)
        self.front = self.turn @ self.axis
        self._frame = frame_about(self.axis)
        rim = math.atan(2 * number(component.depth) / number(component.radius))
        bands = max(8, math.ceil(rim * around / (2 * math.pi)))
        reach = np.tan(np.linspace(0.0, rim, bands + 1)) / math.tan(rim)
        self._patches = Patches.of(reach, lambda fraction: around * fraction)
        self._around = around
        count = len(self._patches.polar)
        self.faces = ("inside",) * count + ("outside",) * count
        self.materials = (component.material,) * (2 * count)
        self.whole = dict.fromkeys(self.faces, Dome.count)

    def surface(self, face: str, values: Mapping[str, Tensor]) -> Surface:
        """On the paraboloid the normal leans from the axis by arctan(steep x) at the fraction x of the radius: to the
        axis inside, and from it outside, where the opposite axis is the one it leans from."""
        radius, depth = self.sizes(values, "radius", "depth")
        steep = 2 * depth / radius
        side = 1.0 if face == "inside" else -1.0

        def find(normal: list[Tensor]) -> Tensor:
            x, y, z = normal
            fraction = torch.sqrt(x * x + y * y) / (steep.detach() * z.clamp(min=1e-3))
            return self._patches.find(fraction, torch.atan2(-side * y, -side * x))

        return Dome(
            frame=like(np.array([[1.0], [1.0], [side]]) * (self._frame @ self.turn.T), radius),
            rim=1 / torch.sqrt(1 + steep**2),
            scale=(radius / steep) ** 2,
            power=4,
            around=self._around,
            find=find,
        )

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        radius, depth = self.sizes(values, "radius", "depth")
        patches = self._patches
        axis = like(self.axis, radius)

        def round_about(azimuth: np.ndarray) -> Tensor:
            return like(np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1) @ self._frame[:2], radius)

        def on_surface(fraction: Tensor, outward: Tensor) -> Tensor:
            along = depth * (fraction**2 - 0.5)
            return radius * fraction[..., None] * outward + along[..., None] * axis

        steep = 2 * depth / radius
        low, high = like(patches.edges[:, 0], radius), like(patches.edges[:, 1], radius)
        secant = [(1 + (steep * fraction) ** 2) ** 1.5 for fraction in (low, high)]
        area = radius**2 / (3 * steep**2) * (secant[1] - secant[0]) * like(patches.width, radius)
        middle = like(patches.polar, radius)
        outward = round_about(patches.azimuth)
        slope = torch.atan(steep * middle)[:, None]
        normal = torch.cos(slope) * axis - torch.sin(slope) * outward
        corner_fraction, corner_azimuth = patches.corners()
        vertices = on_surface(like(corner_fraction, radius), round_about(corner_azimuth))
        inside = Facets(
            vertices=vertices,
            normal=normal,
            u=torch.cos(slope) * outward + torch.sin(slope) * axis,
            area=area,
            centroid=on_surface(middle, outward),
        )
        outside = Facets(vertices.flip(1), -normal, inside.u, area, inside.centroid)
        return joined(inside, outside)


class Patches:
    """Rings between steps of a coordinate (polar angle, fraction of a radius), each cut evenly in azimuth.

    polar, azimuth, width (F,): the middle of a patch and its extent in azimuth, rad; edges (F, 2): from and
    to.
    """

    def __init__(self, edges: np.ndarray, azimuth: np.ndarray, width: np.ndarray) -> None:
        self.edges, self.azimuth, self.width = edges, azimuth, width
        self.polar = edges.mean(axis=1)

    @classmethod
    def of(cls, steps: np.ndarray, around: Callable[[float], float]) -> Patches:
        """``around`` says how many patches a ring needs at the given middle."""
        edges, azimuth, width = [], [], []
        for low, high in pairwise(steps):
            count = max(6, math.ceil(around(max(low, high, key=lambda step: around(step)))))
            edges += [(low, high)] * count
            azimuth += list(2 * math.pi * (np.arange(count) + 0.5) / count)
            width += [2 * math.pi / count] * count
        return cls(np.array(edges), np.array(azimuth), np.array(width))

    def find(self, coordinate: Tensor, azimuth: Tensor) -> Tensor:
        """Which patch points (...) lie in; the outermost ring for a coordinate beyond it."""
        starts, place = np.unique(self.edges[:, 0], return_index=True)
        ring = torch.bucketize(coordinate, like(starts[1:], coordinate))
        count = torch.as_tensor(np.diff([*place, len(self.polar)]), device=ring.device)[ring]
        turn = azimuth / (2 * math.pi)
        number = ((turn - turn.floor()) * count).long().clamp(max=count - 1)
        return torch.as_tensor(place, device=ring.device)[ring] + number

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinate and azimuth (F, 4) of the corners, counter-clockwise about (coordinate, azimuth)."""
        low, high = self.edges.T
        left, right = self.azimuth - self.width / 2, self.azimuth + self.width / 2
        return np.stack([low, high, high, low], axis=1), np.stack([left, left, right, right], axis=1)

    @staticmethod
    def direction(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        sine = np.sin(polar)
        return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=-1)


def joined(*pieces: Facets) -> Facets:
    return Facets(
        vertices=torch.cat([piece.vertices for piece in pieces]),
        normal=torch.cat([piece.normal for piece in pieces]),
        u=torch.cat([piece.u for piece in pieces]),
        area=torch.cat([piece.area for piece in pieces]),
        centroid=torch.cat([piece.centroid for piece in pieces]),
    )


def icosphere(divisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of an icosahedron in the unit sphere, its faces quartered ``divisions`` times."""
    golden = (1 + math.sqrt(5)) / 2
    flat = [(0.0, a, b * golden) for a in (1.0, -1.0) for b in (1.0, -1.0)]
    corners = [unit(np.roll(point, k)) for k in range(3) for point in flat]
    near = [[np.linalg.norm(a - b) < 1.1 for b in corners] for a in corners]
    triangles = [
        (i, j, k) if np.linalg.det([corners[i], corners[j], corners[k]]) > 0 else (i, k, j)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i][j] and near[j][k] and near[i][k]
    ]
    for _ in range(divisions):
        middle: dict[tuple[int, int], int] = {}
        finer = []
        for i, j, k in triangles:
            halves = []
            for a, b in ((i, j), (j, k), (k, i)):
                key = (min(a, b), max(a, b))
                if key not in middle:
                    middle[key] = len(corners)
                    corners.append(unit(corners[a] + corners[b]))
                halves.append(middle[key])
            ij, jk, ki = halves
            finer += [(i, ij, ki), (j, jk, ij), (k, ki, jk), (ij, jk, ki)]
        triangles = finer
    return np.array(corners), np.array(triangles)
