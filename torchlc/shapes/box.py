"""A box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from torchlc.files.numbers import Free, Name, Size
from torchlc.shapes.component import Component, Side
from torchlc.shapes.part import CORNERS, Facets, Hull, Part, Surroundings, like, number, unit


class BoxKeys(Component):
    """``size`` along body X, Y, Z before ``rotation``."""

    size: tuple[Size, Size, Size]
    face_materials: dict[Side, Name] = Field(default_factory=dict)

    def numbers(self) -> dict[str, float | Free]:
        return {f"size_{axis}": size for axis, size in zip("xyz", self.size, strict=True)}

    def materials(self) -> list[tuple[str, str]]:
        return [
            *super().materials(),
            *((f"face_materials.{face}", name) for face, name in self.face_materials.items()),
        ]


class Box(Part):
    """Six faces +X -X +Y -Y +Z -Z; u is the next body axis cyclically (+X: u = +Y), v = normal x u.

    Where it follows the Sun it is a thick panel: its front is the widest of +X +Y +Z that can be turned about
    the axis.
    """

    kind = "box"
    keys = BoxKeys

    def __init__(self, component: Any, surroundings: Surroundings) -> None:
        super().__init__(component, surroundings)
        axes = np.eye(3)
        self.faces = tuple(f"{sign}{axis}" for axis in "XYZ" for sign in "+-")
        special = component.face_materials or {}
        self.materials = tuple(special.get(face, component.material) for face in self.faces)
        self._normal = np.stack([sign * axes[k] for k in range(3) for sign in (1.0, -1.0)])
        self._u = np.stack([axes[(k + 1) % 3] for k in range(3) for _ in range(2)])
        v = np.cross(self._normal, self._u)
        self._vertices = np.stack([0.5 * self._normal + a * self._u + b * v for a, b in CORNERS], axis=1)
        _, self._corner, index = np.unique(
            self._vertices.reshape(-1, 3), axis=0, return_index=True, return_inverse=True
        )
        self.hull = Hull.of(index.reshape(6, 4).tolist())
        if component.tracks is not None:
            size = np.array([number(x) for x in component.size])
            leverage = np.linalg.norm(np.cross(self.turn.T, unit(component.tracks.axis)), axis=1)
            self.front = self.turn[:, np.argmax(leverage**2 / size)]  # face area ~ 1/size along its normal

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        size = torch.stack(self.sizes(values, "size_x", "size_y", "size_z"))
        vertices = like(self._vertices, size) * size
        return Facets(
            vertices=vertices,
            normal=like(self._normal, size),
            u=like(self._u, size),
            area=(size.roll(-1) * size.roll(-2)).repeat_interleave(2),
            centroid=vertices.mean(dim=1),
        )

    def hull_corners(self, facets: Facets) -> Tensor:
        return facets.vertices.flatten(0, 1)[torch.as_tensor(self._corner, device=facets.area.device)]
