"""A cone, or a frustum."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from torchlc.files.numbers import Constant, Direction, Name, Size, between
from torchlc.shapes.component import Component
from torchlc.shapes.curved import Band, Plane, Surface
from torchlc.shapes.part import Facets, Hull, frame_about, like, unit
from torchlc.shapes.smooth import Around, Smooth, joined

HULL_SIDES = 24  # sides of the prism that a cylinder or cone is when it stands in the way of others


class RoundKeys(Component):
    """A body that is round about ``axis``; ``facets`` is the least number of side facets, ``face_materials`` of what "side",
    "cap+" or "cap-" is made where it is not ``material``."""

    axis: Direction = (0.0, 0.0, 1.0)
    facets: Around | None = None
    face_materials: dict[Literal["side", "cap+", "cap-"], Name] = Field(default_factory=dict)

    def materials(self) -> list[tuple[str, str]]:
        return [
            *super().materials(),
            *((f"face_materials.{face}", name) for face, name in self.face_materials.items()),
        ]


class ConeKeys(RoundKeys):
    """``radius`` is at cap-, ``radius_top`` at cap+, to which ``axis`` points. ``face_materials`` names faces of other materials."""

    radius: Size
    radius_top: Annotated[Constant, between(0.0)] = 0.0
    length: Size


def ring_about(frame: np.ndarray, count: int) -> np.ndarray:
    """Corners (count, 3) of a regular polygon in the first two directions of a frame (3, 3) with the girth of the unit circle."""
    angle = 2 * math.pi * np.arange(count) / count
    half = math.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ frame[:2] * (half / math.sin(half))


def frustum_wall(ring: Tensor, axis: Tensor, bottom: Tensor, top: Tensor, length: Tensor) -> Facets:
    """The side from radius ``bottom`` to ``top`` over a ring (N, 3) of unit girth about ``axis`` (3,), seen from outside: N
    facets, u up the slope."""
    after = ring.roll(-1, dims=0)
    low, high = -0.5 * length * axis, 0.5 * length * axis
    side = torch.stack(
        [bottom * ring + low, bottom * after + low, top * after + high, top * ring + high], dim=1
    )
    outward = torch.nn.functional.normalize(ring + after, dim=-1)
    slant = torch.sqrt(length**2 + (bottom - top) ** 2)
    return Facets(
        vertices=side,
        normal=(length * outward + (bottom - top) * axis) / slant,
        u=(length * axis - (bottom - top) * outward) / slant,
        area=(math.pi * (bottom + top) * slant / len(ring)).expand(len(ring)),
        centroid=side.mean(dim=1),
    )


class Cone(Smooth):
    """A frustum that is closed by caps, with the faces "side", "cap+" and "cap-".

    On the side u is up the slope to the top. Its middle is half-way along the axis; a radius_top fixed at 0 leaves no cap+. In the
    way of others it is a prism of 24 sides with the same girth, its outline within 0.6 % of the radius.
    """

    kind = "cone"
    keys = ConeKeys
    top_key = "radius_top"

    def cut(self, component: Any, around: int) -> None:
        self.axis = unit(component.axis)
        self.front = self.turn @ self.axis
        self._frame = frame_about(self.axis)
        self._around = HULL_SIDES * math.ceil(around / HULL_SIDES)
        top = getattr(component, self.top_key)
        self._has_top = hasattr(top, "value") or top > 0
        caps = ["cap+"] * self._has_top + ["cap-"]
        self.faces = ("side",) * self._around + tuple(np.repeat(caps, HULL_SIDES // 2).tolist())
        special = component.face_materials
        self.materials = tuple(special.get(face, component.material) for face in self.faces)
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

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        bottom, top, length = self.sizes(values, "radius", self.top_key, "length")
        axis, ring = like(self.axis, length), like(ring_about(self._frame, self._around), length)
        wall = frustum_wall(ring, axis, bottom, top, length)
        low, high = -0.5 * length * axis, 0.5 * length * axis
        caps = [self._cap(top, high, 1.0)] * self._has_top + [self._cap(bottom, low, -1.0)]
        return joined(wall, *caps)

    def _cap(self, radius: Tensor, middle: Tensor, sign: float) -> Facets:
        """The disc as 12 four-cornered sectors that have the area of the disc in all."""
        sectors = HULL_SIDES // 2
        ring = radius * like(ring_about(self._frame, HULL_SIDES), radius) + middle
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
