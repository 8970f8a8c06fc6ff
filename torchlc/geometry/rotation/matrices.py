"""Rotation matrices from angles, differentiable and batched."""

from __future__ import annotations

import torch
from torch import Tensor

from torchlc.tensors.vectors import east_and_north

SERIES_BELOW = 1e-4
"""Square of the angle, rad^2, below which the series of Rodrigues' coefficients are exact to 1e-17."""


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


def rotation_towards(direction: Tensor, east_deg: Tensor, north_deg: Tensor) -> Tensor:
    """Rotation (..., 3, 3) that moves unit directions (..., 3) by the arc (``east_deg``, ``north_deg``), (...,), along its
    great circle."""
    east, north = east_and_north(direction)
    return rotation_of(
        torch.deg2rad(east_deg)[..., None] * north - torch.deg2rad(north_deg)[..., None] * east
    )


def rotation_of(vector: Tensor) -> Tensor:
    """Rotation (..., 3, 3) of a rotation vector w (..., 3), rad, smooth at 0: I + a [w]x + b [w]x^2."""
    square = (vector * vector).sum(-1)
    small = square < SERIES_BELOW
    angle = torch.sqrt(torch.where(small, 1.0, square))
    half = torch.sin(angle / 2) / (angle / 2)
    series_a = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
    series_b = 0.5 - square / 24 * (1 - square / 30 * (1 - square / 56))
    a = torch.where(small, series_a, torch.sin(angle) / angle)
    b = torch.where(small, series_b, 0.5 * half * half)
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    unit = torch.eye(3, dtype=vector.dtype, device=vector.device)
    return unit + a[..., None, None] * cross + b[..., None, None] * (cross @ cross)
