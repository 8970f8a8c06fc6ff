"""Vectors (..., 3) of many rows."""

from __future__ import annotations

import torch
from torch import Tensor


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Scalar products (...) of vectors (..., 3) that broadcast, component by component: a reduction over an
    axis of three takes several times as long, and would write all products first."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def unit(vector: Tensor) -> Tensor:
    """Directions (..., 3) of vectors (..., 3)."""
    return vector / torch.linalg.vector_norm(vector, dim=-1, keepdim=True)


def least_axis(vector: Tensor) -> Tensor:
    """The coordinate axis (..., 3) that is farthest from each vector (..., 3); under torch.func.vmap too, where
    ``one_hot`` would look at the numbers."""
    axes = torch.arange(3, device=vector.device)
    return (vector.abs().argmin(-1, keepdim=True) == axes).to(vector)
