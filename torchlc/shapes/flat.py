"""Shapes that are their own facets: box and plate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.shapes.part import Facets, Hull, Part, like, number, unit

CORNERS = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


class Box(Part):
    """Six faces +X -X +Y -Y +Z -Z; u is the next body axis cyclically (+X: u = +Y), v = normal x u.

    Where it follows the Sun it is a thick panel: its front is the widest of +X +Y +Z that can be turned about
    the axis.
    """

    kind = "box"
    scalable = True

    def __init__(self, component: Any) -> None:
        super().__init__(component)
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
        size = torch.stack(torch.broadcast_tensors(*self.sizes(values, "size_x", "size_y", "size_z")), -1)
        vertices = like(self._vertices, size) * size[..., None, None, :]
        return Facets(
            vertices=vertices,
            normal=like(self._normal, size),
            u=like(self._u, size),
            area=(size.roll(-1, -1) * size.roll(-2, -1)).repeat_interleave(2, -1),
            centroid=vertices.mean(dim=-2),
        )

    def hull_corners(self, facets: Facets) -> Tensor:
        corner = torch.as_tensor(self._corner, device=facets.area.device)
        return facets.vertices.flatten(-3, -2)[..., corner, :]


class Plate(Part):
    """A two-sided rectangle: "front" with normal u x v, and "back" with its own material if it has one."""

    kind = "plate"
    scalable = True
    thin = True
    hull = Hull.of([[0, 1, 2, 3], [0, 3, 2, 1]])

    def __init__(self, component: Any) -> None:
        super().__init__(component)
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
        size = torch.stack(torch.broadcast_tensors(*self.sizes(values, "size_u", "size_v")), -1)
        axes = like(self._axes, size)
        vertices = (like(self._corners, size) * size[..., None, None, :]) @ axes
        return Facets(
            vertices=vertices,
            normal=like(self._normal, size),
            u=axes[:1].expand(2, 3),
            area=size.prod(-1, keepdim=True).expand(*size.shape[:-1], 2),
            centroid=vertices.mean(dim=-2),
        )

    def hull_corners(self, facets: Facets) -> Tensor:
        return facets.vertices[..., 0, :, :]
