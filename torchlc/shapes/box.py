"""A box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from torchlc.files.numbers import Free, Name, Real, Size, Table
from torchlc.shapes.component import Component, Side
from torchlc.shapes.part import CORNERS, Facets, Hull, Part, Surroundings, like, number, unit


class TwoTone(Table):
    """The ``share`` of a box's size at its ``side`` is of another material."""

    side: Side
    share: Annotated[Real, Field(gt=0.0, lt=1.0)]
    material: Name


class BoxKeys(Component):
    """``size`` is along body X, Y, Z before ``rotation``. ``face_materials`` of whole faces count before ``two_tone``."""

    size: tuple[Size, Size, Size]
    face_materials: dict[Side, Name] = Field(default_factory=dict)
    two_tone: TwoTone | None = None

    def numbers(self) -> dict[str, float | Free]:
        return {f"size_{axis}": size for axis, size in zip("xyz", self.size, strict=True)}

    def materials(self) -> list[tuple[str, str]]:
        return [
            *super().materials(),
            *((f"face_materials.{face}", name) for face, name in self.face_materials.items()),
            *([] if self.two_tone is None else [("two_tone.material", self.two_tone.material)]),
        ]


class Box(Part):
    """A box with the faces +X, -X, +Y, -Y, +Z and -Z.

    On a face u is the next body axis cyclically (+X: u = +Y), v = normal x u. Of two tones, the faces across the border are two facets each, the far one first.
    Where it follows the Sun it is a thick panel: its front is the widest of +X +Y +Z that can be turned about
    the axis.
    """

    kind = "box"
    keys = BoxKeys
    scalable = True

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
        self._share = np.ones(6)
        corners, index = np.unique(self._vertices.reshape(-1, 3), axis=0, return_inverse=True)
        self.hull = Hull.of(index.reshape(6, 4).tolist())
        if component.two_tone is not None:
            self._divide(component.two_tone, special)
        self._along = torch.as_tensor(np.abs(self._normal).argmax(axis=1))
        apart = np.abs(self._vertices.reshape(-1, 1, 3) - corners).max(axis=-1)
        self._corner = apart.argmin(axis=0)
        if component.tracks is not None:
            size = np.array([number(x) for x in component.size])
            leverage = np.linalg.norm(np.cross(self.turn.T, unit(component.tracks.axis)), axis=1)
            self.front = self.turn[:, np.argmax(leverage**2 / size)]  # face area ~ 1/size along its normal

    def _divide(self, tone: TwoTone, special: Mapping[str, str]) -> None:
        """Faces across the border of two materials as two facets."""
        axis, sign = "XYZ".index(tone.side[1]), 1.0 if tone.side[0] == "+" else -1.0
        border = sign * (0.5 - tone.share)
        pieces = []
        for index, face in enumerate(self.faces):
            other = special.get(face, tone.material)
            ahead = sign * self._normal[index, axis]
            if ahead or face in special:
                pieces.append(
                    (index, 1.0, self._vertices[index], other if ahead > 0 else self.materials[index])
                )
                continue
            for share, end, material in (
                (1 - tone.share, -0.5 * sign, self.materials[index]),
                (tone.share, 0.5 * sign, other),
            ):
                vertices = self._vertices[index].copy()
                vertices[:, axis] = np.where(vertices[:, axis] * end > 0, end, border)
                pieces.append((index, share, vertices, material))
        places = [face_index for face_index, *_ in pieces]
        self.faces = tuple(self.faces[face_index] for face_index in places)
        self.materials = tuple(material for *_, material in pieces)
        self._normal, self._u = self._normal[places], self._u[places]
        self._share = np.array([share for _, share, *_ in pieces])
        self._vertices = np.stack([vertices for *_, vertices, _ in pieces])

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        size = self._size(values)
        vertices = like(self._vertices, size) * size[..., None, None, :]
        return Facets(
            vertices=vertices,
            normal=like(self._normal, size),
            u=like(self._u, size),
            area=self._area(size),
            centroid=like(self._vertices.mean(axis=1), size) * size[..., None, :],
        )

    def areas(self, values: Mapping[str, Tensor]) -> Tensor:
        return self._area(self._size(values))

    def _size(self, values: Mapping[str, Tensor]) -> Tensor:
        return torch.stack(torch.broadcast_tensors(*self.sizes(values, "size_x", "size_y", "size_z")), -1)

    def _area(self, size: Tensor) -> Tensor:
        return (size.roll(-1, -1) * size.roll(-2, -1))[..., self._along] * like(self._share, size)

    def hull_corners(self, facets: Facets) -> Tensor:
        corner = torch.as_tensor(self._corner, device=facets.area.device)
        return facets.vertices.flatten(-3, -2)[..., corner, :]
