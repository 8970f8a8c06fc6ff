"""Laws of rough diffuse surfaces against cavities, published values and the series of scatterings."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.brdf_cases import X, Z, numbers, reflectance, unit
from torchlc.brdf import MODELS


def grooves(sigma_deg: float, s: np.ndarray, o: np.ndarray) -> float:
    """f_r of V-shaped cavities with white Lambert walls, light once scattered: the integral over their slopes.

    Walls tilted by t with density exp(-t^2 / 2 sigma^2) in solid angle, each shadowed and masked by its other half
    (Torrance and Sparrow's factor for a wall of any direction); Oren and Nayar's eq. for isotropic surfaces.
    """
    node, share = np.polynomial.legendre.leggauss(80)
    tilt, around = 0.25 * math.pi * (node + 1), 2 * math.pi * (np.arange(96) + 0.5) / 96
    density = np.exp(-(tilt**2) / (2 * math.radians(sigma_deg) ** 2)) * np.sin(tilt) * share
    flat = np.sin(tilt)[:, None, None] * np.stack([np.cos(around), np.sin(around)], -1)
    wall = np.concatenate([flat, np.broadcast_to(np.cos(tilt)[:, None, None], (80, 96, 1))], -1)
    lit, seen, up = (np.maximum(wall @ axis, 1e-12) for axis in (s, o, np.array([0.0, 0.0, 1.0])))
    clear = np.minimum(1, 2 * up * np.minimum(s[2] / lit, o[2] / seen)) * (lit > 1e-9) * (seen > 1e-9)
    radiance = (lit * seen * clear / up).mean(1) / (s[2] * o[2] * math.pi)
    return float((density * radiance).sum() / density.sum())


@pytest.mark.parametrize(("sigma", "rms"), [(10.0, 0.045), (20.0, 0.065), (30.0, 0.035), (40.0, 0.035)])
def test_oren_nayar_follows_cavities(sigma: float, rms: float) -> None:
    """150 pairs within 80 deg of the normal; what the published fit leaves, mag, is in the law's description."""
    random = np.random.default_rng(0)
    cosine, turn = (
        random.uniform(math.cos(math.radians(80)), 1, (150, 2)),
        random.uniform(0, 2 * math.pi, 150),
    )
    sine = np.sqrt(1 - cosine**2)
    s = np.stack([sine[:, 0], 0 * turn, cosine[:, 0]], -1)
    o = np.stack([sine[:, 1] * np.cos(turn), sine[:, 1] * np.sin(turn), cosine[:, 1]], -1)
    model = MODELS["oren-nayar"](albedo=1.0, sigma=sigma, learnable=False)
    found = model(Z, X, torch.tensor(s), torch.tensor(o)).numpy()
    expected = np.array([grooves(sigma, *pair) for pair in zip(s, o, strict=True)])
    off = 2.5 * np.log10(found / expected)
    assert math.sqrt((off**2).mean()) < rms
    flat = 2.5 * np.log10(1 / math.pi / expected)
    assert flat.std() > 1.9 * off.std()  # a plate of Lambert's law follows them far worse


@pytest.mark.parametrize("sigma", [5.0, 20.0, 40.0])
def test_oren_nayar_sends_out_no_less_than_nothing(sigma: float) -> None:
    """From the normal to 89.99 deg on all sides: the published fit falls to -0.023 / pi at sigma = 40 deg."""
    deg = np.concatenate([np.linspace(0, 85, 18), np.linspace(86, 89.99, 30)])
    a, b, turn = (
        torch.tensor(one).ravel().deg2rad() for one in np.meshgrid(deg, deg, np.linspace(0, 180, 19))
    )
    s = torch.stack([a.sin(), 0 * a, a.cos()], -1)
    o = torch.stack([b.sin() * turn.cos(), b.sin() * turn.sin(), b.cos()], -1)
    model = MODELS["oren-nayar"](albedo=1.0, sigma=sigma, learnable=False)
    assert float(model(Z, X, s, o).min()) >= 0.0


def test_oren_nayar_at_a_published_value() -> None:
    """Face on the law is albedo (1 - 0.5 s2 / (s2 + 0.33)) / pi: C1 alone, 0.773 at 30 deg."""
    value = float(MODELS["oren-nayar"](albedo=0.5, sigma=30.0, learnable=False)(Z, X, Z, Z))
    assert value == pytest.approx(0.5 * 0.7731 / math.pi, rel=1e-4)


@pytest.mark.parametrize("name", ["oren-nayar", "eon"])
def test_a_smooth_rough_surface_is_lamberts(name: str) -> None:
    rough = {"oren-nayar": "sigma", "eon": "roughness"}[name]
    model = MODELS[name](albedo=0.37, **{rough: 0.0}, learnable=False)
    s, o = unit(60, seed=21, up=True), unit(60, seed=22, up=True)
    torch.testing.assert_close(
        model(Z, X, s, o), torch.full((60,), 0.37 / math.pi, dtype=torch.float64), rtol=1e-12, atol=0
    )


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.6, 1.0])
@pytest.mark.parametrize("angle", [0.0, 40.0, 75.0, 89.0])
def test_eon_keeps_all_light_of_a_white_surface(roughness: float, angle: float) -> None:
    """The integral over the exit hemisphere is 1; the quadrature has a kink at right angles to the Sun."""
    assert reflectance(MODELS["eon"], numbers(albedo=1.0, roughness=roughness), angle, 0.0) == pytest.approx(
        1.0, abs=3e-4
    )


def test_eon_of_grey_surfaces_is_the_series_of_its_scatterings() -> None:
    """A cavity sends on once-scattered light E, keeps 1 - E, of which albedo is scattered again, and so on; for light
    from a white sky the sum is albedo E / (1 - albedo (1 - E)) with E from numerical integrals of the white law's
    first term."""
    node, share = np.polynomial.legendre.leggauss(24)
    angles, weights = np.degrees(np.arccos(0.5 * (node + 1))), 0.5 * share * (node + 1)

    def sky(albedo: float) -> float:
        values = numbers(albedo=albedo, roughness=0.7)
        return sum(
            w * reflectance(MODELS["eon"], values, a, 0.0) for a, w in zip(angles, weights, strict=True)
        )

    once = sky(1e-6) / 1e-6
    for albedo in (0.3, 0.8):
        assert sky(albedo) == pytest.approx(albedo * once / (1 - albedo * (1 - once)), rel=1e-3)
