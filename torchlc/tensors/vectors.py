"""Vectors (..., 3) of many rows."""

from __future__ import annotations

import torch
from torch import Tensor

AT_POLE = 1e-6
"""Sine of the distance from a pole, 0.2 arcsec, below which a direction has no east of its own."""


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Scalar products (...) of vectors (..., 3) that broadcast, component by component: a reduction over an
    axis of three takes several times as long, and would write all products first."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def turned_back(rotation: Tensor, vector: Tensor) -> Tensor:
    """R^T v (..., 3) of rotations (..., 3, 3) and vectors (..., 3) that broadcast, row by row: a product of many small matrices
    takes several times as long."""
    x, y, z = (vector[..., i : i + 1] for i in range(3))
    first = rotation[..., 0, :] * x
    return torch.addcmul(torch.addcmul(first, rotation[..., 1, :], y), rotation[..., 2, :], z)


def unit(vector: Tensor) -> Tensor:
    """Directions (..., 3) of vectors (..., 3)."""
    return vector / torch.linalg.vector_norm(vector, dim=-1, keepdim=True)


def least_axis(vector: Tensor) -> Tensor:
    """The coordinate axis (..., 3) that is farthest from each vector (..., 3); under torch.func.vmap too, where
    ``one_hot`` would look at the numbers."""
    axes = torch.arange(3, device=vector.device)
    return (vector.abs().argmin(-1, keepdim=True) == axes).to(vector)


def east_and_north(direction: Tensor) -> tuple[Tensor, Tensor]:
    """Unit vectors (..., 3) at right angles to unit directions (..., 3), of growing longitude and latitude; at a pole, where
    there is no east, +Y is."""
    x, y, _ = direction.unbind(-1)
    square = x**2 + y**2
    polar = square < AT_POLE**2
    across = torch.sqrt(torch.where(polar, 1.0, square))
    east = torch.stack(
        [torch.where(polar, 0.0, -y / across), torch.where(polar, 1.0, x / across), torch.zeros_like(x)], -1
    )
    north = torch.linalg.cross(direction, east)
    return east, north / torch.linalg.vector_norm(north, dim=-1, keepdim=True)
