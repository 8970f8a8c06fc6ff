"""A mixed surface against two plates side by side."""

from __future__ import annotations

import numpy as np

from tests.effects.cases import PLATE, check_contract, flux, material, seen_from, still, tilted

FIRST = material("white", 150.0, 0.05, 0.3)
HALVES = PLATE.replace("[2.0, 3.0]", "[2.0, 2.25]") + PLATE.replace("[2.0, 3.0]", "[2.0, 0.75]").replace(
    '"plate"\n    shape', '"strip"\n    shape'
).replace('"white"', '"bright"')


def test_equals_two_plates_that_share_the_area(tmp_path):
    to_sun, to_observer = tilted(np.linspace(-60, 60, 41)), tilted(15.0, 180.0)
    apart = still(HALVES, FIRST + material("bright", 2000.0, 0.5, 0.1))
    mixed = still(PLATE, FIRST)
    expected = flux(apart, seen_from(apart, tmp_path, to_sun, to_observer))
    found = flux(
        mixed, seen_from(mixed, tmp_path, to_sun, to_observer), ["second_material"],
        second_material__weight=0.25, second_material__n=2000.0,
        second_material__r_spec=0.5, second_material__r_diff=0.1,
    )  # fmt: skip
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_contract(tmp_path):
    scene = still(PLATE, FIRST)
    recording = seen_from(scene, tmp_path, tilted(np.linspace(0, 80, 9)), tilted(20.0, 180.0))
    check_contract(scene, recording, "second_material")
