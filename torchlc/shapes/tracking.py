"""How a part that follows the Sun stands."""

from __future__ import annotations

import torch
from torch import Tensor

from torchlc.tensors.autodiff_state import readable, transformed
from torchlc.tensors.vectors import dot, unit

ALONG_AXIS = 1e-6  # sine of the angle to the axis below which the Sun does not say how the part should turn


def tracking_pose(axis: Tensor, front: Tensor, to_sun: Tensor) -> Tensor:
    """Rotations (..., T, 3, 3) about ``axis`` (3,) that turn ``front`` (3,) to ``to_sun`` (..., T, 3) as far
    as they can.

    All in the body frame; axis and front are unit vectors, front need not be perpendicular to the axis but
    not along it. The turn brings the parts of front and Sun perpendicular to the axis together, which
    maximises front . Sun. A row whose Sun is along the axis keeps the turn of the last row before it that has
    one, the rows before the first such row take that of the first, and where no row has one the part stays at
    rest.
    """
    across = to_sun - (to_sun @ axis)[..., None] * axis
    defined = dot(across, across).detach() > ALONG_AXIS**2 * dot(to_sun, to_sun).detach()
    rest = front - (front @ axis) * axis
    rest = rest / rest.norm()
    chosen = (
        across
        if not transformed() and readable(defined) and bool(defined.all())
        else _carried(across, defined, rest)
    )
    turned = unit(chosen)
    third = torch.linalg.cross(axis, rest, dim=-1)
    now = torch.stack([turned, torch.linalg.cross(axis.expand(turned.shape), turned, dim=-1)], dim=-1)
    return now @ torch.stack([rest, third]) + axis[:, None] * axis


def _carried(across: Tensor, defined: Tensor, rest: Tensor) -> Tensor:
    """``across`` (..., T, 3) with rows that are not ``defined`` (..., T) taken from the last one that is."""
    row = torch.arange(defined.shape[-1], device=across.device).expand(defined.shape)
    last = torch.where(defined, row, -1).cummax(dim=-1).values
    first = torch.where(defined, row, row.shape[-1]).amin(dim=-1, keepdim=True)
    source = torch.where(last < 0, first, last)
    none = source >= row.shape[-1]
    chosen = across.gather(-2, source.clamp(max=row.shape[-1] - 1)[..., None].expand(across.shape))
    return torch.where(none[..., None], rest, chosen)
