"""The Earth's shadow, against rays from points of the Sun's disc past an ellipsoid."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.effects.cases import AU_KM, unit
from tests.paper_orbits import ORBIT_1, ORBIT_2, recording, tle_scene
from torchlc.effects.earth_shadow import sunlit_fraction
from torchlc.orbit import make_track

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
    """Across the penumbra, over the equator's edge and over the pole's: within 1e-3, sampling error
    3e-4."""
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


def contact(place, sun_direction, h0_km, low, high, inner):
    """Time at which the first (or, ``inner``, the last) point of the Sun's limb goes behind the ellipsoid,
    by bisection."""
    turn = np.arange(3600) * (2 * math.pi / 3600)
    a = EQUATORIAL_KM + h0_km
    scale = 1 / np.array([a, a, a * (1 - FLATTENING)])

    def hidden(time):
        position = place(time)
        axis = unit(AU_KM * sun_direction - position)
        first = unit(np.cross(axis, [0.2, 0.9, -0.4]))
        limb = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * np.cross(axis, first)
        ray = unit(AU_KM * sun_direction - position + SUN_RADIUS_KM * limb)
        start, way = position * scale, ray * scale
        p, q, r = (way**2).sum(-1), (way * start).sum(-1), (start**2).sum() - 1
        hit = (q**2 - p * r > 0) & (q < 0)
        return hit.all() if inner else hit.any()

    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if hidden(middle) else (middle, high)
    return 0.5 * (low + high)


@pytest.mark.parametrize(
    ("radius_km", "inclination_deg", "declination_deg"),
    [(42_164.0, 1.7, 6.5), (42_164.0, 0.0, 0.0), (6878.0, 51.6, 20.0), (7200.0, 98.4, -15.0)],
)
def test_contacts_are_within_half_a_second(radius_km, inclination_deg, declination_deg):
    """Begin and end of penumbra and umbra on circular orbits, high and low: first and last points of the
    Sun's limb."""
    rate = math.sqrt(398_600.4418 / radius_km**3)
    tilt, low_sun = math.radians(inclination_deg), math.radians(declination_deg)
    sun_direction = np.array([-math.cos(low_sun), 0.0, math.sin(low_sun)])
    node = np.array([1.0, 0.0, 0.0])
    ahead = np.array([0.0, math.cos(tilt), math.sin(tilt)])

    def place(time):
        return radius_km * (math.cos(rate * time) * node + math.sin(rate * time) * ahead)

    quarter = 0.5 * math.pi / rate

    def seen(time):
        position = place(time)
        pair = (torch.as_tensor(one) for one in (position, AU_KM * sun_direction - position))
        return float(sunlit_fraction(*pair, torch.tensor(20.0)))

    for side in (-1.0, 1.0):
        for inner, threshold in ((False, 1 - 1e-9), (True, 1e-9)):
            high, low = 0.0, side * quarter
            expected = contact(place, sun_direction, 20.0, low, high, inner)
            for _ in range(40):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if seen(middle) < threshold else (middle, high)
            assert 0.5 * (low + high) == pytest.approx(expected, abs=0.5)


@pytest.mark.parametrize(
    ("orbit", "umbra", "penumbra", "close_s"),
    [
        (ORBIT_1, (16.424 - 4.9 / 60, 16.424 + 4.9 / 60), (16.199, 16.648), 20.0),
        (ORBIT_2, (15.192, 15.720), (15.123, 15.790), 15.0),
    ],
)
def test_eclipses_of_the_papers_orbits(orbit, umbra, penumbra, close_s):
    """10 October 2020, UT hours as found by the audit of the paper: a straight limb and a round Earth
    without air, but for the first umbra, which grazes: there its 9.8 min behind a flattened one are
    meant."""
    seconds = np.arange(0.0, 6600.0, 2.0)
    track = make_track(tle_scene(orbit), recording("2020-10-10T15:00:00", seconds))
    state = track.at(0.0, 0.0, 0.0)
    fraction = sunlit_fraction(state.position, state.sun, torch.tensor(0.0)).numpy()
    hours = 15.0 + seconds / 3600
    found = [hours[fraction < 1e-4], hours[fraction < 1 - 1e-4]]
    for times, expected in zip(found, (umbra, penumbra), strict=True):
        np.testing.assert_allclose(times[[0, -1]], expected, atol=close_s / 3600)
