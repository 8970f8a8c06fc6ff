"""Earthshine against the view factor, Lambert's sphere, a fine grid of the whole globe, and the effect's
own limits."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
import torch

from tests.effects.cases import (
    AU_KM,
    RANGE_KM,
    check_contract,
    flux,
    material,
    seen_from,
    still,
    tilted,
    unit,
)
from tests.effects.test_finite_sun import CYLINDER
from torchlc.effects import earthshine
from torchlc.effects.earthshine import EARTH_RADIUS_KM, sunlit_tiles, tiles_across
from torchlc.lightcurve.model import LightCurve

LAMBERT = '[materials.white]\nmodel = "lambert"\nalbedo = 1.0\n'
CUBE = """
    [[components]]
    name = "cube"
    shape = "box"
    size = [2.0, 2.0, 2.0]
    centre = [0, 0, 0]
    material = "white"
"""
PLATE = """
    [[components]]
    name = "plate"
    shape = "plate"
    size = [1.0, 1.0]
    centre = [0, 0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    material = "white"
"""


def earthlight(scene, folder, to_sun, to_observer, position):
    """Phi from the Earth alone at albedo 1; the Sun's distance from the Earth is 1 au."""
    vectors = AU_KM * np.asarray(to_sun) - position
    recording = seen_from(
        scene, folder, unit(vectors), to_observer, position=position, sun_km=np.linalg.norm(vectors, axis=-1)
    )
    both = flux(scene, recording, ["earthshine"], earthshine__albedo=1.0)
    return both - flux(scene, recording, ["earthshine"], earthshine__albedo=0.0)


@pytest.mark.parametrize("radius", [6771.0, 26560.0, 42164.0])
def test_full_earth_has_the_view_factor(radius):
    """The solid angles add up to the Earth's disc, and their cosines to a horizontal plate to the view
    factor (R/r)^2."""
    position = torch.tensor([[0.0, 0.0, radius]], dtype=torch.float64)
    to_sun = torch.tensor([[0.1, 0.0, 1.0]], dtype=torch.float64)
    to_sun = to_sun / to_sun.norm()
    if radius < 1e4:
        direction, solid_angle, _ = sunlit_tiles(position, to_sun, 16)
    else:  # terminator in sight: count the dark part too, from the other side
        pieces = [sunlit_tiles(position, sign * to_sun, 16) for sign in (1, -1)]
        direction, solid_angle = (torch.cat([piece[k] for piece in pieces]) for k in (0, 1))
    sine = EARTH_RADIUS_KM / radius
    assert solid_angle.sum().item() == pytest.approx(2 * math.pi * (1 - math.sqrt(1 - sine**2)), rel=1e-3)
    assert (-direction[..., 2] * solid_angle).sum().item() == pytest.approx(math.pi * sine**2, rel=1e-3)


def test_far_away_the_earth_is_a_lambert_sphere(tmp_path):
    """Irradiance (2/3) (R/r)^2 [sin b + (pi - b) cos b]/pi, b the elongation, on a plate that faces the
    Earth."""
    radius = 3e7
    position = np.array([0.0, 0.0, -radius])
    elongation = np.array([10.0, 60.0, 90.0, 120.0, 165.0])
    found = earthlight(still(PLATE, LAMBERT), tmp_path, tilted(180 - elongation), [0, 0, 1], position)
    b = np.radians(elongation)
    sphere = 2 / 3 * (EARTH_RADIUS_KM / radius) ** 2 * (np.sin(b) + (np.pi - b) * np.cos(b)) / np.pi
    expected = sphere / np.pi / (1e3 * RANGE_KM) ** 2
    np.testing.assert_allclose(
        found, expected, rtol=4e-3
    )  # R/r = 0.012 deg of the crescent of 15 deg is behind the limb, by its third power


@pytest.mark.parametrize(
    ("radius", "n", "close"), [(42164.0, 5000.0, 3e-3), (26560.0, 1000.0, 3e-3), (7000.0, 200.0, 5e-3)]
)
def test_every_pixel_of_a_fine_globe_as_a_light(tmp_path, radius, n, close):
    """Brute force: 400 000 equal pixels over the whole Earth, each dark, hidden or a light, on a cube by
    the printed equations in numpy. the pixels themselves are good to about 1e-3."""
    random = np.random.default_rng(4)
    count = 4
    position = radius * unit(random.normal(size=(count, 3)))
    to_sun = unit(unit(position) + 1.2 * unit(random.normal(size=(count, 3))))
    to_observer = unit(-unit(position) + 0.7 * unit(random.normal(size=(count, 3))))
    scene = still(CUBE, material("white", n, 0.3, 0.3))
    found = np.concatenate(
        [
            earthlight(scene, tmp_path, to_sun[i : i + 1], to_observer[i : i + 1], position[i])
            for i in range(count)
        ]
    )
    index = np.arange(400_000) + 0.5
    up = 1 - 2 * index / 400_000
    turn = index * math.pi * (3 - math.sqrt(5))
    level = np.sqrt(1 - up * up)
    pixel = np.stack([level * np.cos(turn), level * np.sin(turn), up], -1)
    expected = [globe(pixel, position[i], to_sun[i], to_observer[i], n) for i in range(count)]
    np.testing.assert_allclose(found, expected, rtol=close)


@pytest.mark.parametrize(("radius", "n"), [(6878.0, 20.0), (6878.0, 300.0), (26560.0, 5000.0)])
def test_ten_times_as_many_tiles_give_the_same(tmp_path, monkeypatch, radius, n):
    """Within 1 %, or 1 % of the median where a lobe has just left the lit Earth."""
    random = np.random.default_rng(8)
    position = radius * unit(np.array([0.3, 0.2, 1.0]))
    to_sun = unit(unit(position) + 1.2 * unit(random.normal(size=(8, 3))))
    to_observer = unit(-unit(position) + 0.7 * unit(random.normal(size=(8, 3))))
    scene = still(CUBE, material("white", n, 0.3, 0.3))
    light = [earthlight(scene, tmp_path, to_sun, to_observer, np.tile(position, (8, 1)))]
    monkeypatch.setattr(
        earthshine, "tiles_across", lambda *given: round(math.sqrt(10) * tiles_across(*given))
    )
    light.append(earthlight(scene, tmp_path, to_sun, to_observer, np.tile(position, (8, 1))))
    found, finer = (np.asarray(one) for one in light)
    np.testing.assert_allclose(found, finer, rtol=0.01, atol=0.01 * np.median(finer))


@pytest.mark.parametrize("n", [50.0, 1000.0])
def test_few_tiles_do_for_a_cylinder_in_high_orbit(tmp_path, monkeypatch, n):
    """64 tiles against 400, within 1 %."""
    random = np.random.default_rng(9)
    position = 26560.0 * unit(np.array([0.3, 0.2, 1.0]))
    to_sun = unit(unit(position) + 1.2 * unit(random.normal(size=(8, 3))))
    to_observer = unit(-unit(position) + 0.7 * unit(random.normal(size=(8, 3))))
    scene = still(CYLINDER, material("white", n, 0.3, 0.3))
    light = [earthlight(scene, tmp_path, to_sun, to_observer, np.tile(position, (8, 1)))]
    monkeypatch.setattr(earthshine, "MOST_ON_MANY", 20)
    monkeypatch.setattr(earthshine, "LEAST", 20)
    light.append(earthlight(scene, tmp_path, to_sun, to_observer, np.tile(position, (8, 1))))
    found, finer = (np.asarray(one) for one in light)
    assert not np.array_equal(found, finer)
    np.testing.assert_allclose(found, finer, rtol=0.01)


def globe(pixel, position, to_sun, to_observer, n):
    """Ashikhmin and Shirley's flux from a cube of 4 m2 faces with r_spec = r_diff = 0.3, lit by Lambert
    pixels."""
    away = EARTH_RADIUS_KM * pixel - position
    reach = np.linalg.norm(away, axis=-1)
    source = away / reach[:, None]
    slant = -(source * pixel).sum(-1)
    lamp = np.clip(pixel @ to_sun, 0, None) * np.clip(slant, 0, None) / reach**2
    lamp *= 4 * math.pi / len(pixel) * EARTH_RADIUS_KM**2 / math.pi
    keep = lamp > 0
    source, lamp = source[keep], lamp[keep]
    half = unit(source + to_observer)
    total = 0.0
    for normal in np.concatenate([np.eye(3), -np.eye(3)]):
        mu = to_observer @ normal
        mu0 = np.clip(source @ normal, 0, None)
        if mu <= 0:
            continue
        hs = (half * source).sum(-1)
        fresnel = 0.3 + 0.7 * (1 - hs) ** 5
        lobe = (n + 1) / (8 * math.pi) * np.clip(half @ normal, 0, None) ** n * fresnel / hs
        specular = lobe * np.minimum(mu0, mu)
        diffuse = (
            28 * 0.3 * 0.7 / (23 * math.pi) * (1 - (1 - mu0 / 2) ** 5) * (1 - (1 - mu / 2) ** 5) * mu0 * mu
        )
        total += 4.0 * (lamp * (mu0 > 0) * (specular + diffuse)).sum()
    return total / (1e3 * RANGE_KM) ** 2


def test_mirror_shows_an_even_image(tmp_path):
    """A smooth mirror facing a full Earth: turning it over the disc leaves the radiance as it is, without a
    lattice."""
    scene = still(PLATE, material("white", 1e5, 0.8, 0.0))
    position = np.array([0.0, 0.0, -42164.0])
    angle = np.linspace(-4.0, 4.0, 41)  # the mirror direction runs over +-4 of +-8.7 degrees
    found = earthlight(scene, tmp_path, np.array([[0.0, 0.0, -1.0]]), tilted(angle, 20.0), position)
    seen = np.radians(np.abs(angle))
    cos_zenith = np.cos(np.arcsin(42164.0 / EARTH_RADIUS_KM * np.sin(seen)) - seen)
    expected = 0.8 / np.pi * cos_zenith * np.cos(seen) / (1e3 * RANGE_KM) ** 2
    np.testing.assert_allclose(found, expected, rtol=0.05)


def test_dark_earth_gives_nothing(tmp_path):
    scene = still(CUBE, LAMBERT)
    position = np.array([0.0, 0.0, 7000.0])
    assert earthlight(scene, tmp_path, [[0.2, 0.0, -1.0]], [[0.0, 0.6, -0.8]], position)[0] == 0


def test_contract(tmp_path):
    scene = still(CUBE, material("white", 50.0, 0.3, 0.3))
    position = 8000.0 * tilted(np.linspace(0, 140, 6), 30.0)
    recording = seen_from(scene, tmp_path, tilted(25.0), tilted(70.0, 130.0), position=position)
    check_contract(scene, recording, "earthshine")


def test_five_thousand_observations_a_second(tmp_path):
    """A cube's six faces, by the processor's clock of one thread and with tables made."""
    scene = still(CUBE, material("white", 200.0, 0.3, 0.3))
    turn = np.linspace(0.0, 360.0, 2000)
    position = 42164.0 * tilted(90.0, turn)
    recording = seen_from(
        scene, tmp_path, tilted(70.0, turn + 40.0), tilted(100.0, turn + 180.0), position=position
    )
    model = LightCurve(scene, recording, effects=["earthshine"])
    with torch.no_grad():
        model.brightness()
        start = time.process_time()
        model.brightness()
        spent = time.process_time() - start
    assert 2000 / spent > 5000
