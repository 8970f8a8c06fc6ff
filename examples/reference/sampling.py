"""Points to sample by: an additive sequence, the limb-darkened solar disc, tilted normals."""

from __future__ import annotations

import numpy as np
from sky import Array, basis, unit

LIMB_DARKENING = 0.6  # I = 1 - u (1 - mu), broad band


def additive_sequence(count: int, dimensions: int) -> Array:
    """Low-discrepancy points (count, dimensions) in [0, 1), from powers of the generalised golden ratio."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    return np.mod(np.arange(1, count + 1)[:, None] * ratio ** -np.arange(1.0, dimensions + 1), 1.0)


def disc_point(direction: Array, radius_rad: Array, a: Array, b: Array) -> Array:
    """Points of a disc of that angular radius (small) about ``direction`` (..., 3), uniform in a, b (...)."""
    e1, e2 = basis(direction)
    r, angle = np.tan(radius_rad) * np.sqrt(a), 2.0 * np.pi * b
    return unit(direction + (r * np.cos(angle))[..., None] * e1 + (r * np.sin(angle))[..., None] * e2)


def limb(a: Array) -> Array:
    """Brightness of the solar disc at squared radius ``a``, mean 1."""
    return (1.0 - LIMB_DARKENING * (1.0 - np.sqrt(1.0 - a))) / (1.0 - LIMB_DARKENING / 3.0)


def tilted(normal: Array, u: Array, v: Array, sigma_rad: float, a: Array, b: Array) -> Array:
    """Normals (N, 3) tilted by a two-dimensional Gaussian of sigma per axis, from uniform a, b (N,)."""
    tilt = np.minimum(sigma_rad * np.sqrt(-2.0 * np.log1p(-a)), np.pi / 2.0)[:, None]
    angle = (2.0 * np.pi * b)[:, None]
    return np.cos(tilt) * normal + np.sin(tilt) * (np.cos(angle) * u + np.sin(angle) * v)
