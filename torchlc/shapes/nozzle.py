"""A nozzle: the wall of a frustum, seen from inside and outside."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import torch
from torch import Tensor

from torchlc.files.numbers import Constant, Direction, Name, Size, between
from torchlc.shapes.component import Component
from torchlc.shapes.cone import frustum_wall, ring_about
from torchlc.shapes.curved import Band, Surface
from torchlc.shapes.part import Facets, frame_about, like, unit
from torchlc.shapes.smooth import Around, Smooth, joined


class NozzleKeys(Component):
    """``radius`` is at the mouth, ``radius_top`` at the other end, to which ``axis`` points. Without ``inside_material`` the inside is of
    ``material``."""

    radius: Size
    radius_top: Annotated[Constant, between(0.0)] = 0.0
    length: Size
    axis: Direction = (0.0, 0.0, 1.0)
    facets: Around | None = None
    inside_material: Name | None = None

    def materials(self) -> list[tuple[str, str]]:
        return [
            *super().materials(),
            *([] if self.inside_material is None else [("inside_material", self.inside_material)]),
        ]


class Nozzle(Smooth):
    """A thin round wall that is open at both ends, with the faces "inside" and "outside".

    The axis u is up the slope to the top. Its middle is half-way along the axis. What it hides of itself and of others, rays trace, if the
    model has self_shadowing: without it the inside shines through the wall. Facets inside are counted by the azimuth of their normals, the twin of each outside with it.
    """

    kind = "nozzle"
    keys = NozzleKeys
    thin = True

    def cut(self, component: Any, around: int) -> None:
        self.axis = unit(component.axis)
        self.front = self.turn @ self.axis
        self._frame = frame_about(self.axis)
        self._around = around
        self.faces = ("inside",) * around + ("outside",) * around
        inside = component.inside_material or component.material
        self.materials = (inside,) * around + (component.material,) * around
        self.whole = dict.fromkeys(self.faces, Band.points_of(True))

    def surface(self, face: str, values: Mapping[str, Tensor]) -> Surface:
        bottom, top, length = self.sizes(values, "radius", "radius_top", "length")
        slant = torch.sqrt(length**2 + (bottom - top) ** 2)
        side = 1.0 if face == "inside" else -1.0
        turned = np.array([[side], [side], [1.0]]) * (self._frame @ self.turn.T)
        return Band(
            frame=like(turned, length),
            level=length / slant,
            rise=-side * (bottom - top) / slant,
            area=math.pi * (bottom + top) * slant,
            facets=self._around,
            flared=True,
        )

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        bottom, top, length = self.sizes(values, "radius", "radius_top", "length")
        axis = like(self.axis, length)
        # the other way round the axis: facets inside are counted by the azimuth of their normals
        ring = like(-ring_about(self._frame, self._around), length)
        outside = frustum_wall(ring, axis, bottom, top, length)
        inside = Facets(outside.vertices.flip(1), -outside.normal, outside.u, outside.area, outside.centroid)
        return joined(inside, outside)
