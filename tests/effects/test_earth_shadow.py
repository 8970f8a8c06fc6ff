"""The Earth's shadow, against rays from points of the Sun's disc past an ellipsoid."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.effects.cases import AU_KM, unit
from torchlc.effects.earth_shadow import sunlit_fraction

EQUATORIAL_KM, FLATTENING, SUN_RADIUS_KM = 6378.137, 1 / 298.257223563, 695_700.0
POINTS = 40_000


def sampled(position: np.ndarray, sun: np.ndarray, h0_km: float) -> float:
    """Share of the limb-darkened disc whose rays miss the ellipsoid a = 6378.137 + h0, c = a (1 - f)."""
    k = np.arange(POINTS) + 0.5
    radius, angle = np.sqrt(k / POINTS), k * math.pi * (3 - math.sqrt(5))
    weight = 1 - 0.6 * (1 - np.sqrt(1 - radius**2))
    axis = unit(sun)
    first = unit(np.cross(axis, [0.2, 0.9, -0.4]))
    second = np.cross(axis, first)
    disc = (
        SUN_RADIUS_KM * radius[:, None] * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
    )
    ray = unit(sun + disc)
    a = EQUATORIAL_KM + h0_km
    scale = 1 / np.array([a, a, a * (1 - FLATTENING)])
    start, way = position * scale, ray * scale
    p, q, r = (way**2).sum(-1), (way * start).sum(-1), (start**2).sum() - 1
    hit = (q**2 - p * r > 0) & (q < 0)
    return float(weight[~hit].sum() / weight.sum())


@pytest.mark.parametrize("radius_km", [6878.0, 7500.0, 26_560.0, 42_164.0])
@pytest.mark.parametrize("h0_km", [0.0, 20.0, 60.0])
@pytest.mark.parametrize("azimuth_deg", [0.0, 50.0, 90.0])
def test_fraction_is_that_of_rays_past_the_ellipsoid(radius_km, h0_km, azimuth_deg):
    """Across the penumbra, over the equator's edge and over the pole's: within 1e-3, sampling error 3e-4."""
    to_sun = unit(np.array([1.0, 0.0, 0.12]))
    side = unit(np.cross(to_sun, [0, 0, 1.0]))
    up = np.cross(side, to_sun)
    across = math.cos(math.radians(azimuth_deg)) * side + math.sin(math.radians(azimuth_deg)) * up
    limb = math.asin(min(1.0, (EQUATORIAL_KM + h0_km) / radius_km))
    for step in np.linspace(-1.8, 1.4, 9):
        angle = limb + step * SUN_RADIUS_KM / AU_KM
        position = radius_km * (-math.cos(angle) * to_sun + math.sin(angle) * across)
        sun = AU_KM * to_sun - position
        found = sunlit_fraction(*(torch.as_tensor(one) for one in (position, sun)), torch.tensor(h0_km))
        assert float(found) == pytest.approx(sampled(position, sun, h0_km), abs=1e-3)


def test_day_side_and_umbra_are_exact():
    sun = torch.tensor([AU_KM, 0.0, 0.0], dtype=torch.float64)
    day = torch.tensor([42_164.0, 0.0, 0.0], dtype=torch.float64)
    assert float(sunlit_fraction(day, sun - day, torch.tensor(20.0))) == 1.0
    assert float(sunlit_fraction(-day, sun + day, torch.tensor(20.0))) == 0.0
