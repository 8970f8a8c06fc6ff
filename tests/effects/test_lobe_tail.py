"""The tailed lobe: its half width, its integral by quadrature, the shape of GGX."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from tests.effects.cases import PLATE, check_contract, flux, material, seen_from, still, tilted

WIDTHS = [1.0, 30.0, 1e3, 1e6]


def ratio(tmp_path, n, g, glint_deg):
    """Tailed lobe over cosine power at glint angles: observer at the Sun, so all but the distribution
    cancels."""
    scene = still(PLATE, material("white", n, 0.5, 0.0))
    direction = tilted(np.asarray(glint_deg))
    recording = seen_from(scene, tmp_path, direction, direction)
    return flux(scene, recording, ["lobe_tail"], lobe_tail__g=g) / flux(scene, recording)


@pytest.mark.parametrize("n", WIDTHS)
@pytest.mark.parametrize("g", [1.0, 1.0001, 2.0, 4.5, 10.0])
def test_half_width_and_integral(tmp_path, n, g):
    half = math.degrees(math.acos(0.5 ** (1 / n)))
    peak, at_half = ratio(tmp_path, n, g, [0.0, half])
    assert at_half == pytest.approx(peak, rel=1e-6)
    top = peak * (n + 1) / (2 * math.pi)
    steep = (2 ** (1 / g) - 1) / math.sin(math.radians(half)) ** 2

    def tailed(log_angle):
        angle = math.exp(log_angle)
        return top * (1 + steep * math.sin(angle) ** 2) ** -g * 2 * math.pi * math.sin(angle) * angle

    total, _ = quad(tailed, math.log(1e-9), math.log(math.pi / 2), epsrel=1e-10, limit=400)
    assert total == pytest.approx(1.0, rel=1e-7)


@pytest.mark.parametrize("n", [100.0, 1e4])
def test_two_is_the_shape_of_ggx(tmp_path, n):
    """Walter et al. (2007), eq. 33, with the roughness that halves it at the half width."""
    half = math.acos(0.5 ** (1 / n))
    slope2 = math.tan(half) ** 2
    # D(half)/D(0) = cos^-4 (1 + tan^2/alpha^2)^-2 = 1/2
    alpha2 = slope2 / (math.sqrt(2) / math.cos(half) ** 2 - 1)
    glint = np.array([0.3, 1.0, 2.0, 5.0, 8.0]) * half
    ggx = 1 / (np.cos(glint) ** 4 * (1 + np.tan(glint) ** 2 / alpha2) ** 2)
    change = ratio(tmp_path, n, 2.0, np.degrees(np.append(0.0, glint)))
    found = change[1:] / change[0] * np.cos(glint) ** n
    np.testing.assert_allclose(found, ggx, rtol=1e-5)


def test_anisotropic_lobe_keeps_its_half_widths(tmp_path):
    scene = still(PLATE, "[materials.white]\nn_u = 50.0\nn_v = 800.0\nr_spec = 0.5\nr_diff = 0.0\n")
    for n, azimuth in ((50.0, 0.0), (800.0, 90.0)):
        half = math.degrees(math.acos(0.5 ** (1 / n)))
        direction = tilted([0.0, half], azimuth)
        recording = seen_from(scene, tmp_path, direction, direction)
        change = flux(scene, recording, ["lobe_tail"], lobe_tail__g=2.0) / flux(scene, recording)
        assert change[1] == pytest.approx(change[0], rel=1e-6)


def test_contract(tmp_path):
    scene = still(PLATE, material("white", 200.0, 0.3, 0.4))
    recording = seen_from(scene, tmp_path, tilted(np.linspace(0, 80, 9)), tilted(20.0, 180.0))
    check_contract(scene, recording, "lobe_tail")
