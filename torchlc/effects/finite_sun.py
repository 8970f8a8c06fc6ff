"""The Sun is a limb-darkened disc, not a point."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from torchlc.effects.base import Effect, Light

SUN_RADIUS_KM = 695_700.0
LIMB_DARKENING = 0.6


def disc_nodes(dtype: torch.dtype, device: torch.device | str) -> tuple[torch.Tensor, torch.Tensor]:
    """Points (D, 2) in radii of the disc and weights (D,) that sum to 1: a quadrature over the limb-darkened
    disc 1 - u (1 - sqrt(1 - r^2)) by Gauss-Legendre rings in r^2."""
    rings, spokes = 4, 9
    x, w = torch.linalg.eigh(_legendre(rings))
    x, w = 0.5 * (x + 1), w[0] ** 2
    radius = torch.sqrt(x)
    brightness = 1 - LIMB_DARKENING * (1 - torch.sqrt(1 - x))
    weight = w * brightness
    angle = (
        2
        * math.pi
        * (torch.arange(spokes, dtype=x.dtype)[None] / spokes + torch.arange(rings)[:, None] / (2 * spokes))
    )
    points = torch.stack([radius[:, None] * torch.cos(angle), radius[:, None] * torch.sin(angle)], -1)
    weights = (weight / weight.sum())[:, None].expand(rings, spokes) / spokes
    return points.reshape(-1, 2).to(dtype=dtype, device=device), weights.reshape(-1).to(
        dtype=dtype, device=device
    )


def _legendre(order: int) -> torch.Tensor:
    k = torch.arange(1, order, dtype=torch.float64)
    return torch.diag(k / torch.sqrt(4 * k * k - 1), 1) + torch.diag(k / torch.sqrt(4 * k * k - 1), -1)


class FiniteSun(Effect):
    """The limb-darkened disc of the Sun lights the object from 36 directions: a mirror glint is as wide as
    the Sun.

    Peak loss 0.13 % at n = 1e3, 1.3 % at 1e4, 12 % at 1e5. Neglects the softening of shadow edges, 9 mm at 2
    m.
    """

    name = "finite_sun"
    stage = "light"
    known = True
    order = 1
    nodes = 36

    def missing(self, context):
        if all(context.models[name].additive for name in context.materials):
            return "no material has a lobe that the disc could widen"
        return None

    def light(self, lights, view, p, context):
        points, weights = disc_nodes(view.to_sun.dtype, view.to_sun.device)
        radius = SUN_RADIUS_KM / torch.linalg.vector_norm(view.state.sun, dim=-1)
        return tuple(_spread(one, points, weights, radius) if one.primary else one for one in lights)


def _spread(light: Light, points: torch.Tensor, weights: torch.Tensor, radius: torch.Tensor) -> Light:
    """Replace each source (L, Q, T) by the points of a disc of angular ``radius`` (Q, T) around it, (D L, Q,
    T)."""
    centre = light.direction
    axis = torch.nn.functional.one_hot(centre.abs().argmin(-1), 3).to(centre)
    first = torch.linalg.cross(centre, axis)
    first = first / torch.linalg.vector_norm(first, dim=-1, keepdim=True)
    second = torch.linalg.cross(centre, first)
    step = (
        points[:, 0, None, None, None, None] * first + points[:, 1, None, None, None, None] * second
    ) * radius[..., None]
    spread = centre + step
    spread = spread / torch.linalg.vector_norm(spread, dim=-1, keepdim=True)
    irradiance = weights[:, None, None, None] * light.irradiance
    return replace(light, direction=spread.flatten(0, 1), irradiance=irradiance.flatten(0, 1))
