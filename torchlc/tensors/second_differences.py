"""Slopes and curvatures by differences of one batched call."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def second_differences(
    function: Callable[[Tensor], Tensor], at: Tensor, step: Tensor | float
) -> tuple[Tensor, Tensor]:
    """Gradient (k,) and Hessian (k, k) at a point (k,) by central differences, all in one call of (B, k) ->
    (B,)."""
    k = len(at)
    axes = torch.eye(k, dtype=at.dtype, device=at.device) * step
    pairs = [(i, j) for i in range(k) for j in range(i)]
    corners = [sign * (axes[i] + axes[j]) for i, j in pairs for sign in (1.0, -1.0)]
    values = function(at + torch.stack([torch.zeros_like(at), *axes, *-axes, *corners]))
    size = torch.diagonal(axes)
    middle, up, down, both = values[0], values[1 : k + 1], values[k + 1 : 2 * k + 1], values[2 * k + 1 :]
    second = up + down - 2 * middle
    hessian = torch.diag(second)
    for (i, j), corner in zip(pairs, both.reshape(-1, 2).sum(-1), strict=True):
        hessian[i, j] = hessian[j, i] = 0.5 * (corner - 2 * middle - second[i] - second[j])
    return torch.nan_to_num((up - down) / (2 * size)), torch.nan_to_num(hessian / size[:, None] / size)
