"""The Earth's limb covers the Sun."""

from __future__ import annotations

import torch
from torch import Tensor

from torchlc.effects.base import Effect, Sky
from torchlc.effects.finite_sun import LIMB_DARKENING, SUN_RADIUS_KM
from torchlc.parameters import Quantity
from torchlc.tracing import traced

EARTH_RADIUS_KM = 6378.137
FLATTENING = 1 / 298.257223563


def sunlit_fraction(position: Tensor, sun: Tensor, h0_km: Tensor) -> Tensor:
    """Share of the limb-darkened Sun (...) that an object at ``position`` (..., 3) km sees past an Earth
    raised by ``h0_km`` of opaque air; ``sun`` is object to Sun, km. The ellipsoid is made a sphere by
    stretching z, and its limb across the disc is an arc.

    The covered part is integrated over 48 chords of the disc parallel to the line of centres.
    """
    equatorial = EARTH_RADIUS_KM + h0_km
    stretch = torch.ones(3, dtype=position.dtype, device=position.device)
    stretch[2] = 1 / (1 - FLATTENING)
    r = position * stretch
    towards = sun * stretch
    distance_sun = torch.linalg.vector_norm(towards, dim=-1)
    distance = torch.linalg.vector_norm(r, dim=-1)
    cross = torch.linalg.vector_norm(torch.linalg.cross(towards, -r), dim=-1)
    separation = torch.atan2(cross, -(towards * r).sum(-1))
    earth = torch.asin((equatorial / distance).clamp(max=1 - 1e-12))
    radius = SUN_RADIUS_KM / distance_sun * _stretch_across(position, sun, stretch)
    y, w = _chords(position)
    # the Sun's disc in its own radii: x along the line of centres, away from the Earth; the limb stands at x
    # = edge(y)
    across = y * radius[..., None]
    earth_ = earth[..., None]
    edge = (torch.sqrt((earth_**2 - across**2).clamp(min=0)) - separation[..., None]) / radius[..., None]
    half = torch.sqrt(1 - y * y)
    share = _chord_share((edge / half).clamp(-1, 1), half)
    seen = (w * share).sum(-1)
    return torch.where((towards * r).sum(-1) > 0, torch.ones_like(seen), seen)


def _stretch_across(position: Tensor, sun: Tensor, stretch: Tensor) -> Tensor:
    """By how much the stretch lengthens the Sun's radius that points to the Earth's centre, (...)."""
    along = (position * sun).sum(-1, keepdim=True) / (sun * sun).sum(-1, keepdim=True)
    across = position - along * sun
    square = (across * across).sum(-1)
    apart = square > 1e-12
    ratio = ((across * stretch) ** 2).sum(-1) / torch.where(apart, square, 1.0)
    return torch.sqrt(torch.where(apart, ratio, 1.0))


def _chords(like: Tensor) -> tuple[Tensor, Tensor]:
    """Chord positions y and their weights, (48,): midpoints in the angle, which is smooth at the ends of the
    disc.
    """
    count = 48
    angle = (torch.arange(count, dtype=like.dtype, device=like.device) + 0.5) * (torch.pi / count)
    y = -torch.cos(angle)
    half = torch.sin(angle)
    light = (1 - LIMB_DARKENING) * 2 * half + LIMB_DARKENING * (torch.pi / 2) * half**2
    w = light * torch.sin(angle)
    return y, w / w.sum()


def _chord_share(edge: Tensor, half: Tensor) -> Tensor:
    """Share of a chord's light beyond x = edge * half, for brightness 1 - u + u sqrt(half^2 - x^2)."""
    inside = edge.clamp(-1 + 1e-15, 1 - 1e-15)
    flat = (1 - LIMB_DARKENING) * half * (1 - inside)
    curved = LIMB_DARKENING * half**2 * 0.5 * (torch.acos(inside) - inside * torch.sqrt(1 - inside * inside))
    total = (1 - LIMB_DARKENING) * 2 * half + LIMB_DARKENING * (torch.pi / 2) * half**2
    share = (flat + curved) / total
    return torch.where(
        edge >= 1, torch.zeros_like(share), torch.where(edge <= -1, torch.ones_like(share), share)
    )


class EarthShadow(Effect):
    """Umbra and penumbra of the oblate Earth raised by h0 of opaque air: total, for up to 72 min at GEO near
    the equinoxes.

    Neglects light refracted into the umbra (below 1e-3 of sunlight) and the softness of the air's edge, 8 km.
    """

    name = "earth_shadow"
    stage = "shade"
    known = True
    quantities = (
        Quantity(
            "h0", "km", 0.0, 60.0, "height of the opaque air over the Earth", typical=20.0,
            prior="normal", mean=20.0, sigma=15.0,
        ),
    )  # fmt: skip

    def __init__(self, target=None):
        super().__init__(target)
        self._near: tuple[Sky, Tensor] | None = None

    def missing(self, context):
        return None if context.track.supports("position") else "the recording gives no geocentric position"

    def shade(self, sky, p, context):
        position, sun, weight = sky.state.position, sky.state.sun, sky.nodes.weight
        assert position is not None  # see `missing`
        if not sky.fixed:
            seen = sunlit_fraction(position, sun, p["h0"][..., None, :])
            return (weight * seen).sum(-2)
        if self._near is None or self._near[0] is not sky:
            self._near = (sky, _near_shadow(position, sun))
        near = self._near[1]
        if not len(near):
            return torch.ones_like(p["h0"]) if traced() else torch.ones(())
        factor = p["h0"].new_ones(*p["h0"].shape[:-1], position.shape[-2])
        seen = sunlit_fraction(position[:, near], sun[:, near], p["h0"][..., None, :])
        factor[..., near] = (weight.expand(position.shape[:-1])[:, near] * seen).sum(-2)
        return factor


def _near_shadow(position: Tensor, sun: Tensor) -> Tensor:
    """Indices of the rows that a shadow with any h0 could touch: the Sun within half a degree of the raised
    limb."""
    cosine = -(position * sun).sum(-1) / (
        torch.linalg.vector_norm(position, dim=-1) * torch.linalg.vector_norm(sun, dim=-1)
    )
    limb = torch.asin(((EARTH_RADIUS_KM + 60.0) / torch.linalg.vector_norm(position, dim=-1)).clamp(max=1.0))
    return torch.nonzero((torch.acos(cosine.clamp(-1, 1)) < limb + 0.0175).any(0))[:, 0]
