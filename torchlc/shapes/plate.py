"""A flat plate with two sides."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from pydantic import model_validator
from torch import Tensor

from torchlc.files.numbers import Direction, Free, Name, Size, problem
from torchlc.shapes.component import Component
from torchlc.shapes.part import CORNERS, Facets, Hull, Part, Surroundings, like, unit

MAX_SKEW = 1e-3
"""Largest |cos| of the angle between a plate's u and v that counts as a right angle."""


class PlateKeys(Component):
    """``size`` is along ``u`` and ``v``; without ``back_material`` the back is of ``material``."""

    size: tuple[Size, Size]
    u: Direction
    v: Direction
    back_material: Name | None = None

    @model_validator(mode="after")
    def _right_angle(self) -> PlateKeys:
        cosine = sum(a * b for a, b in zip(self.u, self.v, strict=True)) / (
            math.hypot(*self.u) * math.hypot(*self.v)
        )
        if abs(cosine) > MAX_SKEW:
            raise problem(
                f"{math.degrees(math.acos(max(-1.0, min(1.0, cosine)))):.3f} deg between u and v",
                "90 deg",
                "v",
            )
        return self

    def numbers(self) -> dict[str, float | Free]:
        return {"size_u": self.size[0], "size_v": self.size[1]}

    def materials(self) -> list[tuple[str, str]]:
        return [
            *super().materials(),
            *([("back_material", self.back_material)] if self.back_material else []),
        ]


class Plate(Part):
    """A two-sided rectangle with the faces "front", of normal u x v, and "back"."""

    kind = "plate"
    keys = PlateKeys
    scalable = True
    thin = True
    hull = Hull.of([[0, 1, 2, 3], [0, 3, 2, 1]])

    def __init__(self, component: Any, surroundings: Surroundings) -> None:
        super().__init__(component, surroundings)
        self.faces = ("front", "back")
        self.materials = (component.material, component.back_material or component.material)
        u = unit(component.u)
        v = unit(component.v)
        v = unit(v - (v @ u) * u)
        normal = np.cross(u, v)
        self._axes = np.stack([u, v])
        self._normal = np.stack([normal, -normal])
        self._corners = np.stack([CORNERS, CORNERS[[0, 3, 2, 1]]])
        self.front = self.turn @ normal

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        size = self._size(values)
        axes = like(self._axes, size)
        vertices = (like(self._corners, size) * size[..., None, None, :]) @ axes
        return Facets(
            vertices=vertices,
            normal=like(self._normal, size),
            u=axes[:1].expand(2, 3),
            area=self._area(size),
            centroid=torch.zeros_like(vertices[..., 0, :]),
        )

    def areas(self, values: Mapping[str, Tensor]) -> Tensor:
        return self._area(self._size(values))

    def _size(self, values: Mapping[str, Tensor]) -> Tensor:
        return torch.stack(torch.broadcast_tensors(*self.sizes(values, "size_u", "size_v")), -1)

    @staticmethod
    def _area(size: Tensor) -> Tensor:
        return size.prod(-1, keepdim=True).expand(*size.shape[:-1], 2)

    def hull_corners(self, facets: Facets) -> Tensor:
        return facets.vertices[..., 0, :, :]
