"""The Earth's shadow, against rays from points of the Sun's disc past an ellipsoid."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.special import wrightomega

from tests.effects.cases import AU_KM, unit
from tests.effects.passes import LOW_PASS, TUMBLING, orbiting, rows
from tests.paper_orbits import LOW, ORBIT_1, ORBIT_2, recording, tle_scene
from torchlc.api import simulate
from torchlc.geometry.orbit import make_track
from torchlc.geometry.orbit.sunlight import softened_fraction, sunlit_fraction, wright_omega
from torchlc.lightcurve.model import LightCurve

FREE = """
"earth_shadow.scale_height" = { value = 8.0, low = 0.0, high = 20.0 }
"earth_shadow.refraction" = { value = 0.9, low = 0.0, high = 1.5 }
"earth_shadow.wavelength" = { value = 600.0, low = 300.0, high = 1100.0 }
"""
SCENE = orbiting(TUMBLING, tle=LOW, parameters=FREE)
"""With all numbers of the shadow free: the contract of effects holds their gradients against finite differences."""
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


NU, SEA_LEVEL_KM = 2.78e-4, EQUATORIAL_KM
"""Refractivity at the ground of the exponential atmosphere that rays are traced through."""


def traced(impact_km: np.ndarray, h0_km: float, scale_km: float, nu: float) -> tuple[np.ndarray, np.ndarray]:
    """Bending, rad, and transmission of rays of given impact parameters b through n = 1 + nu exp(-(r - R) / H) and an
    absorption that is proportional to the density, by Bouguer's law: the integrals along the ray over s, r = r0 + s^2.

    The absorption gives a straight ray that passes at h0 an optical depth of 1 (its path is as long as sqrt(2 pi R H)).
    """
    s, weight = np.polynomial.legendre.leggauss(400)
    s = 0.5 * (s + 1) * math.sqrt(25 * scale_km)
    weight = 0.5 * weight * math.sqrt(25 * scale_km)
    k0 = math.exp(h0_km / scale_km) / math.sqrt(2 * math.pi * SEA_LEVEL_KM * scale_km)

    def index(r):
        return 1 + nu * np.exp(-(r - SEA_LEVEL_KM) / scale_km)

    perigee = impact_km.copy()
    for _ in range(60):  # r n(r) = b
        perigee = impact_km / index(perigee)
    r = perigee[:, None] + s**2
    n = index(r)
    slope = -nu / scale_km * np.exp(-(r - SEA_LEVEL_KM) / scale_km)
    # n^2 r^2 - b^2, over s^2, without its cancellation
    inside = (n * r + impact_km[:, None]) * (n * r - impact_km[:, None]) / s**2
    bending = -2 * impact_km * (2 * weight * slope / (n * np.sqrt(inside))).sum(-1)
    density = np.exp(-(r - SEA_LEVEL_KM) / scale_km)
    depth = 2 * k0 * (2 * weight * density * n * r / np.sqrt(inside)).sum(-1)
    return bending, np.exp(-depth)


def by_elements(radius_km: float, angle: np.ndarray, h0_km: float, scale_km: float, nu: float) -> np.ndarray:
    """Sunlight over that without the Earth, for the Sun's centre at ``angle`` (N,), rad, from the Earth's centre as seen
    from ``radius_km``: element by element of the disc, each with the ray that reaches the object from it."""
    heights = np.concatenate(
        [np.linspace(0, 60, 6000), np.linspace(60.01, 0.99 * radius_km - SEA_LEVEL_KM, 4000)]
    )
    impact = SEA_LEVEL_KM + heights[heights < 0.99 * radius_km - SEA_LEVEL_KM]
    bending, passed = traced(impact, h0_km, scale_km, nu)
    # the outgoing ray passes the centre at b as the incoming one did, turned by the bending
    straight = np.arcsin(impact / radius_km) - bending
    x, y = radius_km * np.cos(straight), radius_km * np.sin(straight)
    # light on a ring b db falls on a ring y dy at the object's depth x, where y = (b - x sin(bending)) / cos(bending)
    turn = np.gradient(bending, impact, edge_order=2)
    sine, cosine = np.sin(bending), np.cos(bending)
    moved = ((1 - x * cosine * turn) * cosine + (impact - x * sine) * sine * turn) / cosine**2
    light = passed * impact / (y * moved)
    k = np.arange(20_000) + 0.5
    r, around = np.sqrt(k / 20_000), k * math.pi * (3 - math.sqrt(5))
    weight = 1 - 0.6 * (1 - np.sqrt(1 - r**2))
    size = SUN_RADIUS_KM / AU_KM
    found = []
    for centre in angle:
        along, across = centre + size * r * np.cos(around), size * r * np.sin(around)
        element = np.interp(np.arccos(np.cos(along) * np.cos(across)), straight, light, left=0.0, right=1.0)
        found.append((weight * element).sum() / weight.sum())
    return np.array(found)


def entering(radius_km: float, heights_km: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """Places and directions to the Sun for straight rays from its centre that pass the equator at some heights, and
    the angles between Sun and Earth."""
    angle = math.asin(EQUATORIAL_KM / radius_km) + heights_km / math.sqrt(radius_km**2 - EQUATORIAL_KM**2)
    place = radius_km * np.stack([-np.cos(angle), np.sin(angle), 0 * angle], -1)
    return torch.as_tensor(place), torch.tensor([AU_KM, 0.0, 0.0]).expand(len(angle), 3).double(), angle


@pytest.mark.parametrize("radius_km", [6778.0, 7500.0, 26_560.0, 42_164.0])
@pytest.mark.parametrize(("scale_km", "h0_km"), [(8.0, 20.0), (6.5, 30.0)])
@pytest.mark.parametrize("nu", [0.0, NU])
def test_soft_edge_is_that_of_rays_through_an_exponential_atmosphere(radius_km, scale_km, h0_km, nu):
    """Down to a hundredth of the light within 0.01 mag, to a thousandth within 0.02: the optical depth along a ray is taken
    as exp(-(z - h0) / H), but the ray's path grows as sqrt(R + z), at z = 30 km by 0.2 % of a depth of 5."""
    place, sun, angle = entering(radius_km, np.linspace(-60.0 if nu else -20.0, 120.0, 46))
    expected = by_elements(radius_km, angle, h0_km, scale_km, nu)
    h0, scale = (torch.full((len(angle),), one).double() for one in (h0_km, scale_km))
    bends = torch.ones_like(h0) if nu else None
    found = softened_fraction(place, sun, h0, scale, bends, 128).numpy()
    for least, tolerance in ((1e-2, 1e-2), (1e-3, 2e-2)):
        seen = expected > least
        assert seen.sum() > 15
        assert np.abs(2.5 * np.log10(found[seen] / expected[seen])).max() < tolerance
    assert found[expected < 1e-6].max(initial=0.0) < 1e-5


def test_light_is_bent_into_the_umbra():
    """In the middle of the umbra of the Moon's distance the Sun's light comes from all around the limb; at GEO, half a degree
    inside the geometric edge, a 40 km high ray is bent by 0.008 deg: nothing comes there but through lower air."""
    place, sun, angle = entering(42_164.0, np.array([-300.0, -200.0, -100.0]))
    h0, scale = torch.full((3,), 15.0).double(), torch.full((3,), 8.0).double()
    hard = sunlit_fraction(place, sun, h0)
    bent = softened_fraction(place, sun, h0, scale, torch.ones_like(h0), 128)
    expected = by_elements(42_164.0, angle, 15.0, 8.0, NU)
    assert hard[0] == 0
    assert bent[0] > 1e-4
    # the umbra is lit by a hundredth of the Sun's disc, spread hundredfold
    np.testing.assert_allclose(bent.numpy(), expected, rtol=2e-2)


def test_wright_omega_is_scipys():
    a = torch.cat([torch.linspace(-60, 60, 2001), torch.logspace(1, 4, 50)]).double()
    np.testing.assert_allclose(wright_omega(a).numpy(), wrightomega(a.numpy()), rtol=1e-13)


def test_reddening_is_rayleighs():
    """Optical depth goes as the fourth power of 1/wavelength: in blue light h0 lies where the depth at 550 nm is
    (440/550)^4."""
    scene = orbiting(tle=LOW, parameters='"earth_shadow.h0" = 20.0\n"earth_shadow.scale_height" = 8.0\n')
    higher = 20.0 + 8.0 * math.log((550 / 440) ** 4)
    blue = orbiting(
        tle=LOW,
        parameters='"earth_shadow.h0" = 20.0\n"earth_shadow.scale_height" = 8.0\n"earth_shadow.wavelength" = 440.0\n',
    )
    raised = orbiting(
        tle=LOW, parameters=f'"earth_shadow.h0" = {higher}\n"earth_shadow.scale_height" = 8.0\n'
    )
    grid = rows(scene, LOW_PASS, 0.16, 6.0)
    green, found, expected = (
        LightCurve(one, grid, effects=["earth_shadow"])().detach() for one in (scene, blue, raised)
    )
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=0)
    partly = torch.isfinite(found) & (green < found - 1e-3)
    assert partly.sum() >= 3  # blue light goes first


def test_a_hard_edge_where_the_air_is_soft_is_told():
    """In a low orbit by its size, at GEO, where the Sun's disc is 390 km of air, not at all."""
    low = simulate(_shadowed(LOW), start=LOW_PASS, hours=0.16, cadence=2.0)
    assert any("0." in text and "scale_height" in text for text in low.warnings)
    high = simulate(_shadowed(ORBIT_1), start="2020-10-10T15:00:00", hours=2.0, cadence=20.0)
    assert 0 < np.isfinite(high.mag).sum() < len(high.mag)
    assert not any("scale_height" in text for text in high.warnings)


def _shadowed(tle):
    scene = orbiting(tle=tle, parameters='"earth_shadow.h0" = 20.0\n')
    return scene.model_copy(update={"model": scene.model.model_copy(update={"effects": ["earth_shadow"]})})


@pytest.mark.parametrize(("radius_km", "least", "most"), [(6778.0, 0.5, 0.8), (42_164.0, 0.0, 0.01)])
def test_the_best_hard_edge_is_as_far_off_as_the_docs_say(radius_km, least, most):
    """Largest error while more than 5 % of the light is left, against rays through an exponential atmosphere: 0.7 mag in a
    low orbit, below a hundredth at GEO, where the default therefore does."""
    reach = 260.0 if radius_km > 4e4 else 60.0
    place, sun, angle = entering(radius_km, np.linspace(-reach, reach + 60.0, 120))
    expected = by_elements(radius_km, angle, 20.0, 8.0, 0.0)
    seen = expected > 0.05
    errors = []
    for h0 in np.arange(8.0, 40.0, 0.5):
        hard = sunlit_fraction(place, sun, torch.full((len(angle),), h0).double()).numpy()
        errors.append(np.abs(2.5 * np.log10(np.maximum(hard[seen], 1e-9) / expected[seen])).max())
    assert least < min(errors) < most


@pytest.mark.parametrize("exposure_s", [None, 1.0])
def test_a_free_clock_takes_the_shadow_with_it(exposure_s):
    """Rows that are far from the edge for every offset of a batch are not integrated: light is still, row by row, what is
    left of that without a shadow by rays past the ellipsoid at the very time of each row (2e-3: their sampling; 0.02: the mean
    over an exposure of 1 s, an eighth of an entry, is not quite its middle)."""
    scene = orbiting(TUMBLING, tle=LOW)
    seen = rows(scene, LOW_PASS, 1.0, 40.0)
    exptime = None if exposure_s is None else np.full(len(seen), exposure_s)
    seen = dataclasses.replace(seen, kind="flux", exptime=exptime)
    more = [] if exposure_s is None else ["exposure_smearing"]
    shaded, bare = (
        LightCurve(scene, seen, effects=[*chosen, "time_offset", *more]) for chosen in (["earth_shadow"], [])
    )
    column = shaded.names.index("time_offset.s")
    theta = shaded.parameter_set.start().repeat(9, 1)
    theta[:-1, column] = 5.0 * torch.arange(8, dtype=theta.dtype)
    theta[-1, column] = 300.0
    h0 = theta[:, shaded.names.index("earth_shadow.h0")]
    of_bare = [shaded.names.index(name) for name in bare.names]
    with torch.no_grad():
        light, whole = shaded.brightness(theta).flux, bare.brightness(theta[:, of_bare]).flux
        alone = torch.stack([shaded.brightness(row).flux for row in theta])
    torch.testing.assert_close(light, alone, rtol=1e-11, atol=0)
    seen_at_all = whole > 0
    share = torch.where(seen_at_all, light / torch.where(seen_at_all, whole, 1.0), 1.0)
    partly = (share > 0) & (share < 1)
    assert int(partly.sum()) >= 2
    assert bool((share == 0).any())
    track = make_track(scene, seen)
    limit = 2e-3 if exposure_s is None else 0.02
    others = seen_at_all & (torch.arange(len(seen)) % 10 == 0)
    others[1:-1] = False
    for which, row in torch.nonzero(partly | others).tolist():
        offset = float(theta[which, column])
        state = track.at(offset, offset, 0.0)
        assert state.position is not None
        place, sun = (one.reshape(-1, 3)[row].numpy() for one in (state.position, state.sun))
        assert sampled(place, sun, float(h0[which])) == pytest.approx(float(share[which, row]), abs=limit)


@pytest.mark.parametrize(
    ("tle", "start", "hours"), [(ORBIT_1, "2020-10-10T10:00:00", 10.0), (LOW, LOW_PASS, 0.1)]
)
def test_rows_that_no_offset_of_the_clock_darkens_are_known(tle, start, hours):
    """Against the cone of half-shade behind a sphere of the polar radius, at every third second of the hour either way that an
    offset may be: no such row is ever in it. Of a night at GEO in the season of eclipses some rows are such, and their exposures
    need no more instants than without a shadow; a low object is in the shadow at some time of two hours."""
    scene = orbiting(TUMBLING, tle=tle)
    seen = rows(scene, start, hours, 300.0 if hours > 1 else 10.0, exptime=5.0)
    model = LightCurve(scene, seen, effects=["time_offset", "earth_shadow", "exposure_smearing"])
    (shadow,) = (effect for effect in model.effects if effect.name == "earth_shadow")
    track, lit = make_track(scene, seen), shadow.lit.numpy()
    darkened = np.zeros(len(seen), dtype=bool)
    for shift in np.arange(-3602.0, 3602.1, 3.0):
        state = track.at(shift, shift, 0.0)
        assert state.position is not None
        place, sun = (np.broadcast_to(one.numpy(), (len(seen), 3)) for one in (state.position, state.sun))
        towards = unit(sun)
        along = -(place * towards).sum(-1)
        across = np.linalg.norm(place + along[:, None] * towards, axis=-1)
        darkened |= (along > 0) & (across < EQUATORIAL_KM * (1 - FLATTENING) + along * SUN_RADIUS_KM / AU_KM)
    assert not (lit & darkened).any()
    assert darkened.any()
    if hours > 1:
        assert 10 < lit.sum() < len(lit) - 10
        bare = LightCurve(scene, seen, effects=["time_offset", "exposure_smearing"])
        instants, without = (torch.bincount(one.assembly.instants.row).numpy() for one in (model, bare))
        assert (instants[lit] == without[lit]).all()
        assert (instants[~lit] > without[~lit]).any()
