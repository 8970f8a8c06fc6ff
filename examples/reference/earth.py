"""What the Earth does to the light: it hides the Sun, and it shines."""

from __future__ import annotations

import numpy as np
import sky
from sampling import additive_sequence, disc_point, limb
from sky import Array, Mask, basis, unit

MEAN_RADIUS_KM = 6371.0  # of the sphere of the Earth's volume


def behind_earth(position: Array, direction: Array, h0_km: float) -> Mask:
    """Whether rays from position, km, along direction (..., 3; z is the Earth's axis) meet Earth plus h0."""
    equator = sky.EARTH_RADIUS_KM + h0_km
    pole = sky.EARTH_RADIUS_KM * (1.0 - sky.EARTH_FLATTENING) + h0_km
    stretch = np.array([1.0, 1.0, equator / pole])
    p, d = position * stretch, direction * stretch
    along = -(p * d).sum(-1) / (d * d).sum(-1)
    nearest = p + along[..., None] * d
    return (along > 0) & ((nearest**2).sum(-1) < equator**2)


def sunlit_fraction(position: Array, to_sun: Array, h0_km: float, points: int = 4096) -> Array:
    """Share (...) of the limb-darkened Sun in view; position, to_sun (..., 3) km, z the Earth's axis."""
    shape = position.shape[:-1]
    position, to_sun = position.reshape(-1, 3), to_sun.reshape(-1, 3)
    distance = np.linalg.norm(to_sun, axis=-1)
    direction = to_sun / distance[:, None]
    out = np.ones(len(position))
    radius = np.linalg.norm(position, axis=-1)
    edge = np.arcsin(np.minimum((sky.EARTH_RADIUS_KM + h0_km) / radius, 1.0))
    apart = np.arccos(np.clip(-(unit(position) * direction).sum(-1), -1.0, 1.0))
    near = np.flatnonzero(apart < edge + 0.02)
    q = additive_sequence(points, 2)
    weight = limb(q[:, 0]) / limb(q[:, 0]).sum()
    for i in near:
        disc = disc_point(
            np.broadcast_to(direction[i], (points, 3)), np.arcsin(sky.SUN_RADIUS_KM / distance[i]), *q.T
        )
        above = ~behind_earth(position[i], disc, h0_km)
        out[i] = 1.0 if above.all() else weight[above].sum()
    return out.reshape(shape)


def earth_light(position: Array, sun: Array, samples: int, albedo: float) -> tuple[Array, Array]:
    """Directions (B, S, 3) to a Lambert Earth's disc, their irradiance (B, S) over the Sun's at the Earth.

    position, sun (B, 3) km from the geocentre; the disc is cut into equal solid angles.
    """
    radius = np.linalg.norm(position, axis=-1)
    edge = np.sqrt(1.0 - (MEAN_RADIUS_KM / radius) ** 2)
    q = additive_sequence(samples, 2)
    cosine = 1.0 - q[:, 0] * (1.0 - edge[:, None])
    sine, angle = np.sqrt(1.0 - cosine**2), 2.0 * np.pi * q[:, 1]
    down = -unit(position)
    e1, e2 = basis(down)
    direction = (
        cosine[..., None] * down[:, None]
        + (sine * np.cos(angle))[..., None] * e1[:, None]
        + (sine * np.sin(angle))[..., None] * e2[:, None]
    )
    half_chord2 = MEAN_RADIUS_KM**2 - (radius[:, None] * sine) ** 2
    reach = radius[:, None] * cosine - np.sqrt(np.maximum(half_chord2, 0.0))
    ground = unit(position[:, None] + reach[..., None] * direction)
    day = np.maximum((ground * unit(sun)[:, None]).sum(-1), 0.0)
    return direction, albedo / np.pi * day * 2.0 * np.pi * (1.0 - edge[:, None]) / samples
