"""The surge at the phase angles where its height is known."""

from __future__ import annotations

import math

import numpy as np

from tests.effects.cases import PLATE, check_contract, flux, material, seen_from, still, tilted

LAMBERT = '[materials.white]\nmodel = "lambert"\nalbedo = 0.5\n'


def test_full_half_and_none(tmp_path):
    """1 + b0 at zero phase, 1 + b0 / 2 where tan(phase / 2) = h, 1 + b0 / (1 + 1/h) at 90 degrees."""
    h, b0 = 0.1, 0.6
    phase = np.array([0.0, 2 * math.degrees(math.atan(h)), 90.0])
    scene = still(PLATE, LAMBERT)
    recording = seen_from(scene, tmp_path, tilted(phase / 2), tilted(phase / 2, 180.0))
    surge = flux(scene, recording, ["opposition_surge"], opposition_surge__b0=b0, opposition_surge__h=h)
    expected = [1 + b0, 1 + b0 / 2, 1 + b0 / (1 + 1 / h)]
    np.testing.assert_allclose(surge / flux(scene, recording), expected, rtol=1e-6)


def test_the_lobe_does_not_surge(tmp_path):
    scene = still(PLATE, material("white", 100.0, 0.5, 0.0))
    recording = seen_from(scene, tmp_path, tilted([2.0, 5.0]), tilted([2.0, 5.0], 180.0))
    np.testing.assert_allclose(
        flux(scene, recording, ["opposition_surge"]), flux(scene, recording), rtol=1e-12
    )


def test_contract(tmp_path):
    scene = still(PLATE, LAMBERT)
    recording = seen_from(scene, tmp_path, tilted(np.linspace(0, 80, 9)), tilted(20.0, 180.0))
    check_contract(scene, recording, "opposition_surge")
