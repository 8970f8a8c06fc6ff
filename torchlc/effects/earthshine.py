"""The sunlit Earth lights the object."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from torchlc.effects.sun_distance import AU_KM
from torchlc.parameters import REFLECTANCE, Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.light import Light
from torchlc.stages.showing import PASS, WHITE, Shown
from torchlc.tensors.vectors import least_axis

EARTH_RADIUS_KM = 6371.0
LEAST, MOST = 12, 20
"""Tiles along each side of the Earth's disc."""
MOST_ON_MANY = 8
"""Tiles along each side for curved shapes and meshes of many facets."""
SMOOTH = 0.6
"""Least width of a lobe, as a standard deviation in widths of a tile."""


def tiles_across(radius: float, n: float) -> int:
    """Tiles along each side of an Earth of angular ``radius``, rad, for a lobe of exponent ``n`` to be as wide in
    the reflection, 2 / sqrt(n), as SMOOTH of the widest tile, pi / 2 of the mean."""
    return min(max(math.ceil(0.5 * math.pi * SMOOTH * radius * math.sqrt(n)), LEAST), MOST)


def sunlit_tiles(position: Tensor, to_sun: Tensor, across: int) -> tuple[Tensor, Tensor, Tensor]:
    """The part of the Earth that is both in sunlight and in sight of an object at ``position`` (..., 3) km,
    as tiles.

    ``to_sun`` (..., 3) is the unit vector from the Earth's centre. Returns unit vectors from the object to
    the tiles (L, ..., 3), the solid angle of each and its cosine of the Sun's zenith angle, (L, ...), L =
    across^2.

    Longitude and latitude are about the normal of the plane through object, Earth and Sun: at a latitude,
    limb and terminator are two longitudes, between which a Gauss-Legendre rule meets no edge; over
    latitudes, where the lit width falls to 0 as a square root, the rule is the midpoints of an angle. Both
    run in what the object sees, so that tiles are of a size in its sky.
    """
    distance = torch.linalg.vector_norm(position, dim=-1)
    up = position / distance[..., None]
    pole = _perpendicular(up, to_sun)
    forward = torch.linalg.cross(pole, up)
    elongation = torch.atan2((to_sun * forward).sum(-1), (to_sun * up).sum(-1))
    height = (distance / EARTH_RADIUS_KM).clamp(min=1 + 1e-9)
    turn = (torch.arange(across, dtype=position.dtype, device=position.device) + 0.5) * (math.pi / across)
    turn = turn.reshape(-1, *(1,) * elongation.ndim)
    seen = -torch.asin(1 / height) * torch.cos(turn)
    latitude, slope = _earth_angle(seen, height)
    step = torch.asin(1 / height) * torch.sin(turn) * (math.pi / across) * slope
    height = height / torch.cos(latitude)
    limb = torch.acos(1 / (height * torch.cos(latitude) ** 2))
    start = torch.minimum(torch.maximum(-limb, elongation - 0.5 * math.pi), limb)
    first, last = (torch.atan2(torch.sin(angle), height - torch.cos(angle)) for angle in (start, limb))
    nodes, weights = (
        torch.as_tensor(array).to(position) for array in np.polynomial.legendre.leggauss(across)
    )
    y, v = (array.reshape(-1, *(1,) * (elongation.ndim + 1)) for array in (nodes, weights))
    longitude, slope = _earth_angle(0.5 * (first + last) + 0.5 * (last - first) * y, height)
    step = 0.5 * (last - first) * v * slope * step * torch.cos(latitude)
    latitude, longitude = torch.broadcast_tensors(latitude, longitude)
    normal = (
        torch.cos(latitude)[..., None]
        * (torch.cos(longitude)[..., None] * up + torch.sin(longitude)[..., None] * forward)
        + torch.sin(latitude)[..., None] * pole
    )
    away = EARTH_RADIUS_KM * normal - position
    reach = torch.linalg.vector_norm(away, dim=-1)
    slant = (-(away * normal).sum(-1) / reach).clamp(min=0)
    solid_angle = EARTH_RADIUS_KM**2 * step * slant / reach**2
    zenith = (normal * to_sun).sum(-1).clamp(min=0)
    return (away / reach[..., None]).flatten(0, 1), solid_angle.flatten(0, 1), zenith.flatten(0, 1)


def _earth_angle(seen: Tensor, height: Tensor) -> tuple[Tensor, Tensor]:
    """Angle at the centre of a circle of a point of it that is seen at an angle from the centre, from
    ``height`` radii, and its derivative."""
    both = torch.asin((height * torch.sin(seen)).clamp(-1 + 1e-12, 1 - 1e-12))
    return both - seen, height * torch.cos(seen) / torch.cos(both) - 1


def _perpendicular(up: Tensor, to_sun: Tensor) -> Tensor:
    """Unit normal (..., 3) of the plane of two directions; any normal of the first where the two are
    parallel."""
    normal = torch.linalg.cross(up, to_sun)
    other = torch.linalg.cross(up, least_axis(up))
    normal = torch.where((normal * normal).sum(-1, keepdim=True) > 1e-20, normal, other)
    return normal / torch.linalg.vector_norm(normal, dim=-1, keepdim=True)


class Earthshine(Effect):
    """The sunlit part of the Earth in sight of the object, as Lambert tiles, each a light of its own.

    0.06 to 0.5 % of sunlight at GEO, up to 25 % in low orbit. Of 144 tiles, or as many as the sharpest lobe asks
    for, at most 400: within 1 % for n up to 300 in low orbit and 20,000 at GEO. A sharper mirror that faces down
    shows the Earth's image no sharper than half a tile. Curved shapes and meshes of more than 100 facets get 64 tiles: within 1 % for n up to
    1000 and 1e-4 of all light for n = 1e4 on a cylinder in high orbit. Neglected: clouds, seas and their glint (a factor 2 in albedo),
    the flattening (0.3 %), twilight, what other parts hide of the Earth, moonlight (1e-5 of sunlight).
    """

    name = "earthshine"
    title = "light of the sunlit Earth"
    shown = Shown(PASS, "phase_angle_deg", {"albedo": 0.3}, materials=WHITE)
    stage = "light"
    order = 3
    linear = True
    quantities = (
        Quantity(
            "albedo", "", 0.0, 1.0, "the Earth's diffuse reflectance", off=0.0, typical=0.3,
            prior="normal", mean=0.3, sigma=0.1,
            role=REFLECTANCE,
        ),
    )  # fmt: skip

    def missing(self, context):
        return None if context.track.supports("position") else "the recording gives no geocentric position"

    def prepared(self, context):
        position = context.track.at(0.0, 0.0, 0.0).position
        assert position is not None
        height = torch.linalg.vector_norm(position, dim=-1).min() / EARTH_RADIUS_KM
        self.across = tiles_across(math.asin(min(1.0, 1 / float(height))), max(context.lobes.values()))
        if context.many_facets or context.curved:
            self.across = min(self.across, MOST_ON_MANY)
        self.nodes = self.across**2
        return self

    def light(self, lights, view, p, context):
        position = view.state.position
        assert position is not None
        sun = position + view.state.sun
        distance = torch.linalg.vector_norm(sun, dim=-1)
        direction, solid_angle, zenith = sunlit_tiles(position, sun / distance[..., None], self.across)
        body = torch.einsum("...ij,l...i->l...j", view.rotation, direction)
        irradiance = (AU_KM / distance) ** 2 * solid_angle * zenith / math.pi
        earth = Light(
            body, irradiance, primary=False, spread=SMOOTH**2 * solid_angle, scale=self.full_name("albedo")
        )
        return (*lights, earth)
