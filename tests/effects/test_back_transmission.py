"""Light through a plate: energy over the dark side, nothing on the bright side."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.effects.cases import PLATE, RANGE_KM, check_contract, flux, material, seen_from, still, tilted

WHITE = material("white", 50.0, 0.2, 0.5)


@pytest.mark.parametrize("sun_deg", [20.0, 70.0, 130.0])
def test_the_dark_side_gives_off_the_share_that_enters(tmp_path, sun_deg):
    """Integral of Phi range^2 over the far hemisphere = t_d A mu0, by Gauss-Legendre in the cosine."""
    scene = still(PLATE, WHITE)
    x, w = np.polynomial.legendre.leggauss(12)
    side = -np.sign(math.cos(math.radians(sun_deg)))
    polar = np.degrees(np.arccos(side * 0.5 * (x + 1)))
    azimuth = np.arange(6) * 60.0
    to_observer = tilted(np.repeat(polar, 6), np.tile(azimuth, 12))
    recording = seen_from(scene, tmp_path, tilted(sun_deg), to_observer)
    through = flux(scene, recording, ["back_transmission"], back_transmission__t_d=0.1)
    power = np.sum(np.repeat(0.5 * w, 6) * 2 * math.pi / 6 * through) * (1e3 * RANGE_KM) ** 2
    assert power == pytest.approx(0.1 * 6.0 * abs(math.cos(math.radians(sun_deg))), rel=1e-9)


def test_the_bright_side_is_as_before(tmp_path):
    scene = still(PLATE, WHITE)
    recording = seen_from(scene, tmp_path, tilted([20.0, 160.0]), tilted([50.0, 130.0], 90.0))
    np.testing.assert_array_equal(flux(scene, recording, ["back_transmission"]), flux(scene, recording))


def test_contract(tmp_path):
    scene = still(PLATE, WHITE)
    recording = seen_from(scene, tmp_path, tilted(np.linspace(0, 80, 9)), tilted(100.0, 180.0))
    check_contract(scene, recording, "back_transmission")
