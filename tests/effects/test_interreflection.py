"""Light that bounces twice, against a double sum over points of two plates."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import RANGE_KM, check_contract, flux, material, seen_from, still, tilted, unit

CORNER = """
    [[components]]
    name = "floor"
    shape = "plate"
    size = [2.0, 2.0]
    centre = [1.0, 0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    material = "white"
    [[components]]
    name = "wall"
    shape = "plate"
    size = [2.0, 2.0]
    centre = [0, 0, 1.02]
    u = [0, 1, 0]
    v = [0, 0, 1]
    material = "white"
"""
ALBEDO_PARTS = material("white", 0.0, 0.0, 0.7)


def lambert_like(cos_i: np.ndarray, cos_r: np.ndarray) -> np.ndarray:
    """Eqs. 3 and 6 at n = 0, r_spec = 0, but for Schlick's grazing lobe, which stays below 3 % here."""
    shape = (1 - (1 - cos_i / 2) ** 5) * (1 - (1 - cos_r / 2) ** 5)
    return 28 * 0.7 / (23 * np.pi) * shape


def double_sum(to_sun: np.ndarray, to_observer: np.ndarray, count: int = 40) -> float:
    """Sun to floor to wall to observer, and the other way round, over count^2 points of each plate."""
    edge = (np.arange(count) + 0.5) / count * 2.0
    floor = np.stack([*np.meshgrid(edge, edge - 1.0), np.zeros((count, count))], -1).reshape(-1, 3)
    y, z = np.meshgrid(edge - 1.0, edge + 0.02)
    wall = np.stack([np.zeros_like(y), y, z], -1).reshape(-1, 3)
    up, right = np.array([0, 0, 1.0]), np.array([1.0, 0, 0])
    area = (2.0 / count) ** 2
    gap = wall[None] - floor[:, None]
    square = (gap**2).sum(-1)
    way = gap / np.sqrt(square)[..., None]
    cos_floor, cos_wall = way @ up, -(way @ right)
    total = 0.0
    for normal_1, cos_1, normal_2, cos_2 in (
        (up, cos_floor, right, cos_wall),
        (right, cos_wall, up, cos_floor),
    ):
        cos_i, cos_r = normal_1 @ to_sun, normal_2 @ to_observer
        first = lambert_like(cos_i, cos_1) * cos_i
        second = lambert_like(cos_2, cos_r) * cos_r
        total += (first * cos_1 * cos_2 / square * second).sum() * area**2
    return total / (1e3 * RANGE_KM) ** 2


@pytest.mark.parametrize(("sun_deg", "observer_deg"), [(40.0, 50.0), (60.0, 30.0)])
def test_corner_of_two_plates_is_the_double_sum(tmp_path, sun_deg, observer_deg):
    """Both plates lit and seen: the second bounce within 8 %, the share of the lobe that the sum leaves out."""
    scene = still(CORNER, ALBEDO_PARTS)
    to_sun, to_observer = tilted(np.array([sun_deg])), tilted(np.array([observer_deg]))
    recording = seen_from(scene, tmp_path, to_sun, to_observer)
    bounced = flux(scene, recording, ["interreflection"], interreflection__gain=1.0) - flux(scene, recording)
    assert float(bounced[0]) == pytest.approx(double_sum(to_sun[0], to_observer[0]), rel=0.08)


def test_contract(tmp_path):
    random = np.random.default_rng(2)
    scene = still(CORNER, ALBEDO_PARTS)
    to_sun, to_observer = unit(np.abs(random.normal(size=(2, 12, 3))) + 0.1)
    check_contract(scene, seen_from(scene, tmp_path, to_sun, to_observer), "interreflection")
