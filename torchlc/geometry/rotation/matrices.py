"""Rotation matrices from angles, differentiable and batched."""

from __future__ import annotations

import torch
from torch import Tensor


def rotation_about(axis: Tensor, angle: Tensor) -> Tensor:
    """Right-handed rotation (..., 3, 3) about unit ``axis`` (..., 3) by ``angle`` (...,) rad (Rodrigues)."""
    x, y, z = axis.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    sine, versine = torch.sin(angle)[..., None, None], (2 * torch.sin(angle / 2) ** 2)[..., None, None]
    return torch.eye(3, dtype=axis.dtype, device=axis.device) + sine * cross + versine * (cross @ cross)


def frame_turned_about_z(angle: Tensor) -> Tensor:
    """Rz (..., 3, 3) that turns the frame by ``angle`` (...,) rad: [[c, s, 0], [-s, c, 0], [0, 0, 1]]."""
    cos, sin, zero, one = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([cos, sin, zero, -sin, cos, zero, zero, zero, one], dim=-1).unflatten(-1, (3, 3))


def frame_turned_about_y(angle: Tensor) -> Tensor:
    """Ry (..., 3, 3) that turns the frame by ``angle`` (...,) rad: [[c, 0, -s], [0, 1, 0], [s, 0, c]]."""
    cos, sin, zero, one = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([cos, zero, -sin, zero, one, zero, sin, zero, cos], dim=-1).unflatten(-1, (3, 3))
