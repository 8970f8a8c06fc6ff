"""Second bounces against closed-form view factors, rays thrown from the first surface, and a screen in the
way."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.effects.cases import RANGE_KM, check_contract, flux, material, seen_from, still, tilted, unit
from torchlc.errors import InputError
from torchlc.pairs.double_reflection import form_factor

CORNER = """
    [[components]]
    name = "floor"
    shape = "plate"
    size = [2.0, 2.0]
    centre = [1, 0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    material = "white"
    [[components]]
    name = "wall"
    shape = "plate"
    size = [2.0, 2.0]
    centre = [0, 0, 1]
    u = [0, 1, 0]
    v = [0, 0, 1]
    material = "other"
"""
PLATE = """
    [[components]]
    name = "{name}"
    shape = "plate"
    size = [{size}, {size}]
    centre = [{centre}]
    u = [{u}]
    v = [{v}]
    material = "{material}"
"""
FLOOR = PLATE.format(name="floor", size=2.0, centre="1, 0, 0", u="1, 0, 0", v="0, 1, 0", material="white")
CUBE = '[[components]]\nname = "cube"\nshape = "box"\nsize = [1.0, 1.0, 1.0]\ncentre = [0, 0, 0]\nmaterial = "white"\n'


def lambert(**albedo):
    """Materials by name."""
    return "".join(
        f'[materials.{name}]\nmodel = "lambert"\nalbedo = {value}\n' for name, value in albedo.items()
    )


def twice(scene, recording):
    """Light of second bounces alone, m2/sr."""
    effects = ["self_shadowing", "interreflection"]
    both = flux(scene, recording, effects, interreflection__gain=1.0)
    return (both - flux(scene, recording, effects, interreflection__gain=0.0)) * (1e3 * RANGE_KM) ** 2


def test_form_factor_of_squares_that_share_an_edge():
    """0.20004 for two squares at a right angle (Howell, A Catalog of Radiation Configuration Factors,
    C-14)."""
    x, w = (torch.as_tensor(array) for array in np.polynomial.legendre.leggauss(20))
    x, w = 0.5 * (x + 1), 0.5 * w
    floor = torch.stack([x.repeat_interleave(20), x.repeat(20), torch.zeros(400, dtype=x.dtype)], -1)
    wall = torch.tensor([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], dtype=x.dtype)
    factor = form_factor(wall - floor[:, None], torch.tensor([0, 0, 1], dtype=x.dtype))
    assert (torch.outer(w, w).ravel() @ factor).item() == pytest.approx(0.20004, rel=1e-4)


def test_white_corner_has_the_view_factor(tmp_path):
    """A Lambert wall sees a sunlit Lambert floor: albedo^2 E mu0 A F mu / pi, F = 0.20004 for the whole
    wall."""
    scene = still(CORNER, lambert(white=0.6, other=0.5))
    observer = unit([1.0, 0.1, 0.2])
    recording = seen_from(scene, tmp_path, [[0.0, 0.0, 1.0]], [observer])
    expected = 0.6 * 0.5 * 4.0 * 0.20004 * observer[0] / math.pi
    assert twice(scene, recording)[0] == pytest.approx(expected, rel=3e-3)


def test_parallel_plates_exchange_what_the_sun_lights(tmp_path):
    """Squares of side 2 face to face 2 apart, F = 0.19982 (C-11): nothing with the Sun at the zenith, which
    the upper hides; all but a strip of 5 % with the Sun and the observer 3 deg off the plates' planes."""
    above = PLATE.format(name="lid", size=2.0, centre="1, 0, 2", u="1, 0, 0", v="0, 1, 0", material="white")
    scene = still(FLOOR + above, lambert(white=1.0))
    low = unit([1.0, 0.0, 0.05])
    recording = seen_from(scene, tmp_path, [[0, 0, 1.0], low], [unit([1.0, 0.0, -0.05])] * 2)
    dark, lit = twice(scene, recording)
    assert dark == 0
    assert lit == pytest.approx(4.0 * low[2] ** 2 * 0.19982 / math.pi, rel=0.01)


@pytest.mark.parametrize(("n", "close"), [(1.0, 0.02), (100.0, 0.02), (1000.0, 0.03)])
def test_glossy_corner_against_rays(tmp_path, n, close):
    """A million rays from each plate by the cosine law; half the observers stand near the returned Sun."""
    random = np.random.default_rng(5)
    to_sun = unit(np.abs(random.normal(size=(8, 3))) * [1, 0.3, 1])
    to_observer = unit(np.abs(random.normal(size=(8, 3))) * [1, 0.3, 1])
    to_observer[:4] = unit(np.abs(to_sun[:4] + 0.6 / math.sqrt(n + 30) * random.normal(size=(4, 3))))
    one, two = (n, 0.3, 0.3), (n, 0.4, 0.2)
    scene = still(CORNER, material("white", *one) + material("other", *two))
    found = twice(scene, seen_from(scene, tmp_path, to_sun, to_observer))
    there, back = (0, 1, 2), (2, 1, 0)
    rays = {axes: thrown(random, axes, 1_000_000) for axes in (there, back)}
    expected = np.array(
        [
            carried(rays[there], sun, observer, there, one, two)
            + carried(rays[back], sun, observer, back, two, one)
            for sun, observer in zip(to_sun, to_observer, strict=True)
        ]
    )
    np.testing.assert_allclose(found, expected, rtol=close, atol=0.01 * expected.mean())


@pytest.mark.parametrize(("albedo", "left_mag"), [(0.3, 0.0055), (0.5, 0.0157), (0.8, 0.0425)])
def test_what_further_bounces_would_add_is_as_the_docs_say(tmp_path, albedo, left_mag):
    """Paths of two million packets of light in the corner, seen along its diagonal, with the Sun behind: what all bounces
    together are above the first two, which is 0.003 mag of noise and the rule's error."""
    ahead = unit([1.0, 0.0, 1.0])
    scene = still(CORNER, lambert(white=albedo, other=albedo))
    found = flux(scene, seen_from(scene, tmp_path, [ahead], [ahead]), ["self_shadowing", "interreflection"],
                 interreflection__gain=1.0)[0] * (1e3 * RANGE_KM) ** 2  # fmt: skip
    random, packets = np.random.default_rng(1), 2_000_000
    a, b = 2 * random.random(packets), 2 * random.random(packets) - 1  # from the edge, and along it
    power, expected = (
        np.full(packets, 8.0 * ahead[2] / packets),
        0.0,
    )  # on two plates of 4 m2 that look the same
    while len(power):
        expected += albedo / math.pi * ahead[2] * power.sum()
        level, turn = np.sqrt(random.random(len(a))), 2 * math.pi * random.random(len(a))
        way = np.stack([level * np.cos(turn), level * np.sin(turn), np.sqrt(1 - level**2)], -1)
        reach = a / np.maximum(-way[:, 0], 1e-12)
        hit = (way[:, 0] < 0) & (reach * way[:, 2] < 2) & (np.abs(b + reach * way[:, 1]) < 1)
        a, b, power = (reach * way[:, 2])[hit], (b + reach * way[:, 1])[hit], albedo * power[hit]
    assert 2.5 * math.log10(expected / found) == pytest.approx(left_mag, abs=3e-3)


def thrown(random, axes, count):
    """Directions of rays from a 2 x 2 plate along axes 0, 1 (normal: axis 2) that meet the plate across its
    edge."""
    a, b = 2 * random.random(count), 2 * random.random(count) - 1
    level, turn = np.sqrt(random.random(count)), 2 * math.pi * random.random(count)
    way = np.stack([level * np.cos(turn), level * np.sin(turn), np.sqrt(1 - level**2)], -1)
    reach = a / np.maximum(-way[:, 0], 1e-12)
    hit = (way[:, 0] < 0) & (reach * way[:, 2] < 2) & (np.abs(b + reach * way[:, 1]) < 1)
    return way[hit][:, axes], count


def carried(rays, sun, observer, axes, one, two):
    """Sun, first plate, along the rays, second plate, observer."""
    way, count = rays
    normal_1, normal_2 = np.eye(3)[[axes.index(2), axes.index(0)]]
    first = reflected(normal_1, sun, way, *one) / (way @ normal_1)
    second = reflected(normal_2, -way, observer, *two) / -(way @ normal_2)
    return 4.0 * math.pi * (first * second).sum() / count


def reflected(normal, source, target, n, r_spec, r_diff):
    """f_r mu0 mu by Ashikhmin and Shirley's printed equations."""
    half = unit(source + target)
    mu0, mu = np.clip(source @ normal, 0, None), np.clip(target @ normal, 0, None)
    cos_half = (half * source).sum(-1)
    fresnel = r_spec + (1 - r_spec) * (1 - cos_half) ** 5
    power = np.clip(half @ normal, 0, None) ** n
    lobe = (n + 1) / (8 * math.pi) * power * fresnel / cos_half * np.minimum(mu0, mu)
    open_ = (1 - (1 - mu0 / 2) ** 5) * (1 - (1 - mu / 2) ** 5)
    diffuse = 28 * r_diff * (1 - r_spec) / (23 * math.pi) * open_ * mu0 * mu
    return np.where((mu0 > 0) & (mu > 0), lobe + diffuse, 0.0)


def test_a_third_part_in_the_way_stops_it(tmp_path):
    """A screen across the corner's diagonal: no light from floor to wall, though Sun and observer see
    both."""
    screen = PLATE.format(
        name="screen", size=3.0, centre="0.5, 0, 0.5", u="0.7071, 0, 0.7071", v="0, 1, 0", material="other"
    )
    ahead = unit([1.0, 0.0, 1.0])
    open_, shut = (
        twice(scene, seen_from(scene, tmp_path, [ahead], [ahead]))[0]
        for scene in (still(parts, lambert(white=0.6, other=0.5)) for parts in (CORNER, CORNER + screen))
    )
    assert open_ > 0.02
    assert shut < 0.02 * open_


def test_a_convex_body_has_none(tmp_path):
    scene = still(CUBE, lambert(white=0.5))
    with pytest.raises(InputError, match="no two parts"):
        flux(scene, seen_from(scene, tmp_path, [[0, 0, 1.0]], [[0, 0, 1.0]]), ["interreflection"])


def test_contract(tmp_path):
    scene = still(CORNER, material("white", 40.0, 0.3, 0.4) + material("other", 200.0, 0.2, 0.3))
    recording = seen_from(scene, tmp_path, tilted([20.0, 50.0, 70.0]), tilted(40.0, [10.0, 60.0, 5.0]))
    check_contract(scene, recording, "interreflection")
