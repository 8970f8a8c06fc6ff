"""Reflectances, in which light is linear once everything else is settled: which they are, what light is of them,
and the data as a regression for them needs them.

Letters: B batch, P parameters, K reflectances, T rows.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchlc.model import LightCurve

NAMES = ("r_spec", "r_diff", "f0", "albedo")
REWEIGHTED = 2
"""Times that a regression is done again about its own result, so that it is one of magnitudes, not of flux."""


def linear_columns(model: LightCurve) -> list[int]:
    """Columns of theta that are reflectances and do not move the geometry."""
    moving = set(model.assembly.geometry_columns)
    short = [name.partition("[")[0].rpartition(".")[2] for name in model.names]
    return [i for i, name in enumerate(short) if name in NAMES and i not in moving]


def linear_light(model: LightCurve, x: Tensor, linear: list[int]) -> tuple[Tensor, Tensor]:
    """Flux (B, T) at straight coordinates x (B, P) with the ``linear`` ones at zero, and what each of them adds
    for a whole one (B, T, K)."""
    points = x[:, None].repeat(1, len(linear) + 1, 1)
    points[:, :, linear] = 0.0
    for place, column in enumerate(linear):
        points[:, place + 1, column] = 1.0
    flux = model.brightness(model.parameter_set.from_straight(points)[0]).flux
    return flux[:, 0], (flux[:, 1:] - flux[:, :1]).transpose(1, 2)


def about(dark: Tensor, design: Tensor, values: Tensor, observed: Tensor) -> tuple[Tensor, Tensor]:
    """Flux (B, T) to compare with, and the flux that a magnitude's error is relative to, for a regression of
    magnitudes about reflectances ``values`` (B, K): the tangent of the logarithm there."""
    predicted = dark + (design @ values[..., None])[..., 0]
    near = torch.minimum(torch.maximum(predicted, 0.2 * observed), 5.0 * observed)
    return near * (1.0 + torch.log(observed / near)), near
