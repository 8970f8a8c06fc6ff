"""A sphere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.files.numbers import Size
from torchlc.shapes.component import Component
from torchlc.shapes.curved import Dome, Surface
from torchlc.shapes.part import Facets, Hull, like, unit
from torchlc.shapes.smooth import Patches, Smooth


class SphereKeys(Component):
    """``radius`` reaches from the centre to the surface."""

    radius: Size


class Sphere(Smooth):
    """A ball with one face, "side".

    Bands of latitude about +Z are cut into facets of about equal area; u is along the meridian towards +Z.

    In the way of others it is a polyhedron of 320 faces with the same mean outline, within 1 % of the radius.
    """

    kind = "sphere"
    keys = SphereKeys
    most_around = 512
    curved_twice = True

    def cut(self, component: Any, around: int) -> None:
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
