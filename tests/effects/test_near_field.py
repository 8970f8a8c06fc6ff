"""Lamp and camera at finite distances: against sums over points, and against a small plate that is moved."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import RANGE_KM, flux, material, seen_from, still, unit
from tests.effects.laboratory import BLOCK, BOX, WHITE, anywhere, turned
from tests.effects.passes import LOW_PASS, orbiting, rows
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve

SCENE = BLOCK
RECORDING = turned(SCENE)
RADIUS = float(np.linalg.norm([0.7, 1.1, 1.8]))
"""Of the block's farthest corner from the origin, m."""


def of_points(lamp: np.ndarray, camera: np.ndarray, points: int = 60) -> np.ndarray:
    """Lambert light of the block (T,) from lamps and cameras at (T, 3) m, summed over points of its faces, over 1/(distance of the
    origin)^2 of both."""
    size, centre = np.array([1.0, 2.0, 3.0]), np.array([0.2, -0.1, 0.3])
    place = (np.arange(points) + 0.5) / points - 0.5
    total = np.zeros(len(lamp))
    for axis in range(3):
        for side in (-1, 1):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            at = np.zeros((points, points, 3))
            at[..., axis] = side * size[axis] / 2
            at[..., i], at[..., j] = np.meshgrid(place * size[i], place * size[j], indexing="ij")
            at = at.reshape(-1, 3) + centre
            area = size[i] * size[j] / points**2
            for t in range(len(lamp)):
                to_lamp, to_camera = lamp[t] - at, camera[t] - at
                near, far = np.linalg.norm(to_lamp, axis=1), np.linalg.norm(to_camera, axis=1)
                cos_i, cos_r = side * to_lamp[:, axis] / near, side * to_camera[:, axis] / far
                lit = np.clip(cos_i, 0, None) * np.clip(cos_r, 0, None) / (near * far) ** 2
                total[t] += 0.8 / np.pi * area * lit.sum() * (lamp[t] @ lamp[t]) * (camera[t] @ camera[t])
    return total / (1e3 * RANGE_KM) ** 2


@pytest.mark.parametrize(("lamp", "camera"), [(0.1, 0.0), (0.0, 0.1), (0.2, 0.3)])
def test_a_block_as_points_see_it(tmp_path, lamp, camera):
    recording, to_lamp, to_camera = anywhere(BLOCK, tmp_path)
    found = flux(BLOCK, recording, ["near_field"], near_field__lamp=lamp, near_field__camera=camera)
    expected = of_points(to_lamp * RADIUS / max(lamp, 1e-9), to_camera * RADIUS / max(camera, 1e-9))
    # a row that just grazes a face sees a part of it: pieces 0.5 m wide are in or out as a whole
    np.testing.assert_allclose(found, expected, rtol=4e-3, atol=4e-3 * expected.max())
    assert np.abs(flux(BLOCK, recording) - expected).max() > 0.05 * expected.max()


def test_a_small_plate_with_a_lobe_is_one_elsewhere_seen_from_there(tmp_path):
    """Of a scene's radius of 2.3 m, lamp at 11 m, camera at 7 m."""
    place = np.array([2.0, 1.0, 0.5])
    lobed = material("white", 60.0, 0.4, 0.2)

    def plate(centre):
        return still(
            f'[[components]]\nname = "p"\nshape = "plate"\nsize = [1e-3, 2e-3]\ncentre = {list(map(float, centre))}\n'
            'u = [1, 0, 0.2]\nv = [0, 1, 0]\nmaterial = "white"\n', lobed,
        )  # fmt: skip

    recording, to_lamp, to_camera = anywhere(plate(place), tmp_path, 60)
    radius = LightCurve(plate(place), recording, effects=[]).assembly.context.radius
    lamp, camera = 11.0 * to_lamp - place, 7.0 * to_camera - place
    moved = seen_from(plate([0, 0, 0]), tmp_path, unit(lamp), unit(camera))
    expected = flux(plate([0, 0, 0]), moved)
    expected *= (11.0 / np.linalg.norm(lamp, axis=1)) ** 2 * (7.0 / np.linalg.norm(camera, axis=1)) ** 2
    found = flux(
        plate(place),
        recording,
        ["near_field"],
        near_field__lamp=radius / 11.0,
        near_field__camera=radius / 7.0,
    )
    np.testing.assert_allclose(
        found, expected, rtol=2e-3, atol=1e-5 * expected.max()
    )  # the plate is 1e-4 rad wide


@pytest.mark.long
def test_at_the_typical_distance_a_glint_is_spread_over_the_face(tmp_path):
    """A plate with a lobe of 2 deg: pieces are fine enough, for twice as fine ones change nothing."""
    wide = still(
        '[[components]]\nname = "p"\nshape = "plate"\nsize = [2.0, 2.0]\ncentre = [0, 0, 0]\nu = [1, 0, 0]\nv = [0, 1, 0]\n'
        'material = "white"\n', material("white", 900.0, 0.5, 0.1),
    )  # fmt: skip
    angle = np.radians(np.linspace(20, 40, 41))
    lamp = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    recording = seen_from(wide, tmp_path, lamp, unit([-np.sin(np.radians(30)), 0, np.cos(np.radians(30))]))
    radius = np.sqrt(2)
    found = flux(wide, recording, ["near_field"], near_field__lamp=0.1, near_field__camera=0.0)
    assert found.max() < 0.75 * flux(wide, recording).max()
    total = 0.0
    for x in (np.arange(40) + 0.5) / 20 - 1:
        for y in (np.arange(10) + 0.5) / 5 - 1:
            away = lamp * radius / 0.1 - [x, y, 0.0]
            part = flux(wide, seen_from(wide, tmp_path, unit(away), recording.obs / RANGE_KM))
            total = total + part / 400 * (radius / 0.1 / np.linalg.norm(away, axis=1)) ** 2
    np.testing.assert_allclose(found, total, rtol=0.02, atol=2e-3 * found.max())


def test_an_object_in_orbit_or_far_away_has_no_near_field(tmp_path):
    scene = orbiting()
    context = LightCurve(scene, rows(scene, LOW_PASS), effects=[]).assembly.context
    assert registry()["near_field"]().missing(context) == "a part tracks the Sun"
    block = still(BOX, WHITE)
    far = seen_from(block, tmp_path, [[1.0, 0, 0]] * 2, [[0, 1.0, 0]] * 2, range_km=2e8)
    context = LightCurve(block, far, effects=[]).assembly.context
    assert registry()["near_field"]().missing(context) == "the object is a point at 1e+07 times its radius"
