"""A dish."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.files.numbers import Direction, Size
from torchlc.shapes.component import Component
from torchlc.shapes.curved import Dome, Surface
from torchlc.shapes.part import Facets, frame_about, like, number, unit
from torchlc.shapes.smooth import Around, Patches, Smooth, joined


class DishKeys(Component):
    """``radius`` is that of the rim; ``axis`` points out of the opening."""

    radius: Size
    depth: Size
    axis: Direction = (0.0, 0.0, 1.0)
    facets: Around | None = None


class Dish(Smooth):
    """A two-sided paraboloid that is open towards its axis, with the faces "inside" and "outside".

    The axis u is up the slope to the rim. Its middle is half its depth from the rim. Patches are equal steps of slope, at most 2 pi/N
    apart.
    """

    kind = "dish"
    keys = DishKeys
    most_around = 512
    curved_twice = True
    thin = True

    def cut(self, component: Any, around: int) -> None:
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
