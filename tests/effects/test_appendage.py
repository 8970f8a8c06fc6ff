"""A part that the shape lacks, against the same part put into the shape."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import PLATE, check_contract, flux, material, seen_from, still, tilted, unit

WHITE = material("white", 50.0, 0.2, 0.5)
EXTRA = """
    [[components]]
    name = "extra"
    shape = "plate"
    size = [1.0, 1.5]
    centre = [0, 0, 9]
    u = [{u}]
    v = [{v}]
    material = "extra"
"""


@pytest.mark.parametrize(("lon", "lat"), [(30.0, 20.0), (-120.0, 60.0), (0.0, -90.0)])
def test_equals_a_plate_of_the_same_area_and_normal(tmp_path, lon, lat):
    random = np.random.default_rng(1)
    to_sun, to_observer = unit(random.normal(size=(2, 60, 3)))
    normal = tilted(90.0 - lat, lon)
    u = unit(np.cross(normal, [0.3, 0.2, 0.9]))
    spelled = EXTRA.format(u=", ".join(map(str, u)), v=", ".join(map(str, np.cross(normal, u))))
    whole = still(PLATE + spelled, WHITE + material("extra", 200.0, 0.3, 0.4))
    part = still(PLATE, WHITE)
    expected = flux(whole, seen_from(whole, tmp_path, to_sun, to_observer))
    found = flux(
        part, seen_from(part, tmp_path, to_sun, to_observer), ["appendage"],
        appendage__area=1.5, appendage__lon=lon, appendage__lat=lat,
        appendage__n=200.0, appendage__r_spec=0.3, appendage__r_diff=0.4,
    )  # fmt: skip
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_contract(tmp_path):
    scene = still(PLATE, WHITE)
    random = np.random.default_rng(2)
    to_sun, to_observer = unit(random.normal(size=(2, 12, 3)))
    check_contract(scene, seen_from(scene, tmp_path, to_sun, to_observer), "appendage")
