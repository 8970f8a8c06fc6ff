"""How much of the Sun's disc is seen past the limb of the oblate Earth, with a hard edge or through air that bends light."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.geometry.orbit.shadow import EARTH_RADIUS_KM, SUN_RADIUS_KM

LIMB_DARKENING = 0.6
"""Linear, in green light: the limb is at 0.4 of the middle."""
FLATTENING = 1 / 298.257223563
REFRACTIVITY = 2.78e-4
"""n - 1 of air at sea level, 15 C, 550 nm (Ciddor 1996)."""
LEAST_STRIPS, MOST_STRIPS = 64, 640
WRIGHT_STEPS, NEWTON_STEPS = 6, 2
"""5 leave rounding of Wright's omega for any argument, and NEWTON_STEPS the curvature's share."""
MOST_CURVED = 0.5
"""Largest curvature of a ray over the Earth's that is followed: of rays 6 km under the ground."""


@dataclass(frozen=True)
class Limb:
    """The limb as an object sees it, (...): the Earth's ``distance`` from its centre, km, and the Sun's ``separation`` from
    the centre and ``radius``, rad, along the line of centres; ``day`` where the Sun stands on the object's side. The
    ellipsoid is made a sphere by stretching z."""

    distance: Tensor
    separation: Tensor
    radius: Tensor
    day: Tensor

    @classmethod
    def seen(cls, position: Tensor, sun: Tensor) -> Limb:
        """Of an object at ``position`` (..., 3) km with ``sun`` (..., 3) km from it to the Sun."""
        stretch = torch.ones(3, dtype=position.dtype, device=position.device)
        stretch[2] = 1 / (1 - FLATTENING)
        r = position * stretch
        towards = sun * stretch
        distance_sun = torch.linalg.vector_norm(towards, dim=-1)
        cross = torch.linalg.vector_norm(torch.linalg.cross(towards, -r), dim=-1)
        return cls(
            torch.linalg.vector_norm(r, dim=-1),
            torch.atan2(cross, -(towards * r).sum(-1)),
            SUN_RADIUS_KM / distance_sun * _stretch_across(position, sun, stretch),
            (towards * r).sum(-1) > 0,
        )

    def altitude(self) -> Tensor:
        """Height, km, (...), at which the straight ray from the lowest point of the Sun's disc passes the limb; on the day side,
        where none does, that of the object. It is continuous."""
        return (
            self.distance * torch.sin((self.separation - self.radius).clamp(0.0, 0.5 * math.pi))
            - EARTH_RADIUS_KM
        )

    def heights(self) -> tuple[Tensor, Tensor]:
        """Heights, km, (...), at which straight rays from the lowest and the highest point of the Sun's disc pass the limb."""
        low, high = (self.separation + side * self.radius for side in (-1.0, 1.0))
        passed = torch.where(self.day, math.inf, 0.0)
        return (
            self.distance * torch.sin(low.clamp(0.0, 0.5 * math.pi)) - EARTH_RADIUS_KM + passed,
            self.distance * torch.sin(high.clamp(max=0.5 * math.pi)) - EARTH_RADIUS_KM + passed,
        )


def sunlit_fraction(position: Tensor, sun: Tensor, h0_km: Tensor) -> Tensor:
    """Share of the limb-darkened Sun (...) that an object at ``position`` (..., 3) km sees past an Earth
    raised by ``h0_km`` of opaque air; ``sun`` is object to Sun, km. The ellipsoid is made a sphere by
    stretching z, and its limb across the disc is an arc.

    The covered part is integrated over 48 chords of the disc parallel to the line of centres.
    """
    limb = Limb.seen(position, sun)
    equatorial = EARTH_RADIUS_KM + h0_km
    earth = torch.asin((equatorial / limb.distance).clamp(max=1 - 1e-12))
    y, w = _chords(position)
    # the Sun's disc in its own radii: x along the line of centres, away from the Earth; the limb stands at x
    # = edge(y)
    across = y * limb.radius[..., None]
    earth_ = earth[..., None]
    edge = (torch.sqrt((earth_**2 - across**2).clamp(min=0)) - limb.separation[..., None]) / limb.radius[
        ..., None
    ]
    half = torch.sqrt(1 - y * y)
    share = _chord_share((edge / half).clamp(-1, 1), half)
    seen = (w * share).sum(-1)
    return torch.where(limb.day, torch.ones_like(seen), seen)


def softened_fraction(
    position: Tensor,
    sun: Tensor,
    h0_km: Tensor,
    scale_height_km: Tensor,
    refraction: Tensor | None = None,
    strips: int = LEAST_STRIPS,
) -> Tensor:
    """Sunlight (...) over that outside the shadow, past air whose optical depth along a ray that grazes at height z is
    exp(-(z - ``h0_km``) / ``scale_height_km``).

    With ``refraction``, 1 for air of the Earth's density, rays are those of n = 1 + nu exp(-(r - R) / H), see
    :func:`refracted`.

    The disc is cut into strips across the line of centres. In a strip the limb's curvature counts by its mean. Neglects
    that the ground ends the rays below z = 0, where tau is 12 at h0 = 20 and H = 8 km, light from the opposite limb,
    and the change of H with height: see docs/physics/neglected.md for sizes.
    """
    limb = Limb.seen(position, sun)
    angle = (torch.arange(strips, dtype=position.dtype, device=position.device) + 0.5) * (math.pi / strips)
    x, half = -torch.cos(angle), torch.sin(angle)
    flat, curved = (1 - LIMB_DARKENING) * 2 * half, LIMB_DARKENING * (math.pi / 2) * half**2
    weight = (flat + curved) * half
    weight = weight / weight.sum()
    square = (flat * half**2 / 3 + curved * half**2 / 4) / (flat + curved)
    radius, distance = limb.radius[..., None], limb.distance[..., None]
    along = limb.separation[..., None] + x * radius
    lower = (along > 1e-9) & (along < 0.5 * math.pi - 1e-9)
    safe = torch.where(lower, along, 0.25 * math.pi)
    apart = safe + 0.5 * square * radius**2 / torch.tan(safe)
    straight = distance * torch.sin(apart) - EARTH_RADIUS_KM
    h0, scale = h0_km[..., None], scale_height_km[..., None]
    if refraction is None:
        light = torch.exp(-torch.exp((-(straight - h0) / scale).clamp(max=50.0)))
    else:
        light = refracted(straight, distance * torch.cos(apart), h0, scale, refraction[..., None])
    light = torch.where(lower, light, (along > 0.25 * math.pi).to(light))
    seen = (weight * light).sum(-1)
    return torch.where(limb.day, torch.ones_like(seen), seen)


def refracted(straight: Tensor, reach: Tensor, h0: Tensor, scale: Tensor, refraction: Tensor) -> Tensor:
    """Light (...) of a point source over that without air, for an object ``reach`` km behind the limb whose straight ray passes
    at the height ``straight``, km.

    With e = exp(-z / H) of the height z where the bent ray passes and kappa = nu R e / H, its curvature over the Earth's: it
    comes in nu R e above z, is bent by nu sqrt(2 pi R / H) e / sqrt(1 - kappa), reaches the object by ``reach`` times that
    lower, meets exp(-(z - h0) / H) / sqrt(1 - kappa) of optical depth, and is spread as neighbours are moved apart (Baum & Code
    1953), less what the limb's curvature gathers. Without kappa z follows from Wright's omega; Newton's method adds it.
    """
    air = refraction * REFRACTIVITY * EARTH_RADIUS_KM
    bent = reach * refraction * REFRACTIVITY * torch.sqrt(2 * math.pi * EARTH_RADIUS_KM / scale)
    a = torch.log(((bent - air) / scale).clamp(min=1e-30)) - straight / scale
    height = straight + scale * wright_omega(a)
    for _ in range(NEWTON_STEPS):
        thin = torch.exp((-height / scale).clamp(max=50.0))
        kappa = (air / scale * thin).clamp(max=MOST_CURVED)
        longer = torch.rsqrt(1 - kappa)
        off = height + (air - bent * longer) * thin - straight
        slope = 1 + (bent * longer * (1 + 0.5 * kappa / (1 - kappa)) - air) * thin / scale
        height = height - off / slope
    thin = torch.exp((-height / scale).clamp(max=50.0))
    kappa = (air / scale * thin).clamp(max=MOST_CURVED)
    longer = torch.rsqrt(1 - kappa)
    slope = 1 + (bent * longer * (1 + 0.5 * kappa / (1 - kappa)) - air) * thin / scale
    focus = (EARTH_RADIUS_KM + height) / (EARTH_RADIUS_KM + straight).clamp(min=0.1 * EARTH_RADIUS_KM)
    depth = torch.exp((-(height - h0) / scale).clamp(max=50.0)) * longer
    return torch.exp(-depth) * focus * (1 - kappa) / slope


def wright_omega(a: Tensor) -> Tensor:
    """w (...) with w + ln w = a (...), by Newton's method for ln w, which is convex and started from its upper side."""
    low = a <= 1
    v = torch.where(low, a, torch.log(torch.where(low, 1.0, a)))
    for _ in range(WRIGHT_STEPS):
        w = torch.exp(v)
        v = v - (w + v - a) / (w + 1)
    return torch.exp(v)


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
