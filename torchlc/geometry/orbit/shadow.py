"""Where an object stands relative to the Earth's shadow (Montenbruck & Gill 2000, section 3.4), in torch."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.geometry.orbit.track import angle_between

EARTH_RADIUS_KM = 6378.137
SUN_RADIUS_KM = 695700.0
FLATTENING = 1 / 298.257


@dataclass(frozen=True)
class ShadowCoordinate:
    """Angles (...,), rad, seen from the object: radii a of the Sun and b of the Earth, separation c.

    ``t`` = (c - b)/a: umbra below -1, penumbra up to 1, full sunlight above.
    """

    sun_radius: Tensor
    earth_radius: Tensor
    separation: Tensor

    @property
    def t(self) -> Tensor:
        return (self.separation - self.earth_radius) / self.sun_radius


def shadow_coordinate(
    position: Tensor, sun: Tensor, air_km: Tensor | float = 0.0, flattening: float = FLATTENING
) -> ShadowCoordinate:
    """For an object at geocentric ``position``, with ``sun`` its vector to the Sun, (..., 3), km.

    ``air_km`` (...,) of opaque air are added to the Earth's radius. The flattened Earth
    becomes a sphere by stretching z, in position and Sun direction alike; the axis is taken as that of GCRS
    (it has moved by 0.1 deg since 2000: 20 m at the limb).
    """
    stretch = position.new_tensor([1.0, 1.0, 1.0 / (1.0 - flattening)])
    position, towards_sun = position * stretch, sun * stretch
    sine_earth = (EARTH_RADIUS_KM + air_km) / torch.linalg.norm(position, dim=-1)
    return ShadowCoordinate(
        sun_radius=torch.asin(SUN_RADIUS_KM / torch.linalg.norm(sun, dim=-1)),
        earth_radius=torch.asin(sine_earth.clamp(max=1.0 - 1e-9)),
        separation=angle_between(towards_sun, -position),
    )
