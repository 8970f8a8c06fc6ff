"""Wrinkled facets against the mean of many tilted plates."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.effects.cases import PLATE, check_contract, flux, material, seen_from, still, tilted
from torchlc.inference.identifiability import limits
from torchlc.lightcurve.model import LightCurve


def of_tilted(scene, folder, normal: np.ndarray, to_sun, to_observer) -> np.ndarray:
    """Light (K, T) of plates with these unit normals (K, 3): turning a plate is turning Sun and observer back."""
    u = np.stack([normal[:, 2], 0 * normal[:, 0], -normal[:, 0]], -1)
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    frame = np.stack([u, np.cross(normal, u), normal], 1)
    turned = [np.einsum("kij,tj->kti", frame, one).reshape(-1, 3) for one in (to_sun, to_observer)]
    return flux(scene, seen_from(scene, folder, *turned)).reshape(len(normal), -1)


@pytest.mark.parametrize(("n", "deg"), [(1000.0, 3.0), (50.0, 2.0), (1e5, 1.0)])
def test_is_the_mean_over_tilted_normals(tmp_path, n, deg):
    """40 x 40 Gauss-Hermite tilts resolve the lobe; what remains is the curvature of min(mu0, mu) and of Fresnel's factor, of the order of
    the variance (0.003 at 3 deg)."""
    scene = still(PLATE, material("white", n, 0.5, 0.0))
    width = np.degrees(np.sqrt(1 / n + np.radians(deg) ** 2))
    glint = np.array([0.0, 0.5, 1.0, 1.5, 2.0]) * width
    to_sun, to_observer = tilted(20.0 + glint), tilted(20.0 - glint, 180.0)
    x, w = np.polynomial.hermite_e.hermegauss(120 if n > 1e4 else 40)
    w = w / w.sum()
    tilts = np.radians(deg) * np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    weight = np.outer(w, w).ravel()
    tilts, weight = tilts[weight > 1e-9], weight[weight > 1e-9]
    normal = np.concatenate([tilts, np.ones((len(tilts), 1))], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    each = of_tilted(scene, tmp_path, normal, to_sun, to_observer)
    expected = weight @ each
    recording = seen_from(scene, tmp_path, to_sun, to_observer)
    found = flux(scene, recording, ["normal_dispersion"], normal_dispersion__deg=deg)
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.005 * expected.max())


@pytest.mark.parametrize("deg", [4.0, 15.0])
def test_what_it_neglects_of_diffuse_light_is_told(tmp_path, deg):
    """Against many plates whose normals scatter by as much, evenly tilted over +-4 standard deviations."""
    scene = still(PLATE, material("white", 10.0, 0.0, 0.5))
    x = np.linspace(-4, 4, 41)
    tilts = np.radians(deg) * np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    weight = np.exp(-0.5 * (tilts / np.radians(deg)) ** 2).prod(-1)
    angle = np.linalg.norm(tilts, axis=-1, keepdims=True)
    normal = np.concatenate([np.sinc(angle / np.pi) * tilts, np.cos(angle)], -1)
    to_sun, to_observer = tilted([5.0]), tilted([5.0], 180.0)
    each = of_tilted(scene, tmp_path, normal, to_sun, to_observer)[:, 0]
    recording = seen_from(scene, tmp_path, to_sun, to_observer)
    (found,) = flux(scene, recording, ["normal_dispersion"], normal_dispersion__deg=deg)
    wrong = 2.5 * np.log10(found / (weight @ each / weight.sum()))
    model = LightCurve(scene, recording, effects=["normal_dispersion"])
    told = limits(model, model.parameter_set.start().index_fill(0, torch.tensor([0]), deg))
    assert model.names == ["normal_dispersion.deg[white]"]
    if deg < 5:
        assert wrong < 0.03
        assert told == []
    else:
        (line,) = told
        assert float(line.split(" mag brighter")[0].split()[-1]) == pytest.approx(wrong, rel=0.15)


def test_contract(tmp_path):
    scene = still(PLATE, material("white", 200.0, 0.3, 0.4))
    recording = seen_from(scene, tmp_path, tilted(np.linspace(0, 80, 9)), tilted(20.0, 180.0))
    check_contract(scene, recording, "normal_dispersion")
