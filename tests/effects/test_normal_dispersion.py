"""Wrinkled facets against the mean of many tilted plates."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.effects.cases import PLATE, check_contract, flux, material, seen_from, still, tilted
from torchlc.inference.identifiability import limits
from torchlc.lightcurve.assembly import assemble
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


@pytest.mark.parametrize(("n", "r_spec"), [(10.0, 0.0), (500.0, 0.5)])
@pytest.mark.parametrize("half", [5.0, 40.0])
@pytest.mark.parametrize("deg", [4.0, 15.0])
def test_wide_tilts_are_the_mean_of_tilted_plates(tmp_path, n, r_spec, half, deg):
    """Diffuse light alone and a lobe alone, at phase angles of 10 and 80 deg, to a standard deviation and a half from the glint. Without
    what tilts do to cosines the former is out by 0.3 mag at 15 deg and the latter by 0.5. What is left: orders of the tilts beyond the second,
    and how min(mu0, mu) bends."""
    scene = still(PLATE, material("white", n, r_spec, 0.5 - r_spec))
    x = np.linspace(-4, 4, 61)
    tilts = np.radians(deg) * np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    weight = np.exp(-0.5 * (tilts / np.radians(deg)) ** 2).prod(-1)
    tilts, weight = tilts[weight > 1e-6], weight[weight > 1e-6]
    angle = np.linalg.norm(tilts, axis=-1, keepdims=True)
    normal = np.concatenate([np.sinc(angle / np.pi) * tilts, np.cos(angle)], -1)
    off = np.array([0.0, 0.75, 1.5]) * deg
    to_sun, to_observer = tilted(half + off), tilted(half - off, 180.0)
    expected = weight @ of_tilted(scene, tmp_path, normal, to_sun, to_observer) / weight.sum()
    recording = seen_from(scene, tmp_path, to_sun, to_observer)
    found = flux(scene, recording, ["normal_dispersion"], normal_dispersion__deg=deg)
    np.testing.assert_allclose(found, expected, rtol=0.035)


@pytest.mark.parametrize(("deg", "lines"), [(4.0, 0), (15.0, 1)])
def test_what_a_facet_beyond_grazing_lacks_is_told(tmp_path, deg, lines):
    """A diffuse plate that the Sun lights at 90.5 deg, against the mean of tilted plates, those that face away being dark; at 89.5 deg the light is
    theirs."""
    scene = still(PLATE, material("white", 10.0, 0.0, 0.5) + 'model = "phong-half"\n')
    x = np.linspace(-4, 4, 81)
    tilts = np.radians(deg) * np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    weight = np.exp(-0.5 * (tilts / np.radians(deg)) ** 2).prod(-1)
    angle = np.linalg.norm(tilts, axis=-1, keepdims=True)
    normal = np.concatenate([np.sinc(angle / np.pi) * tilts, np.cos(angle)], -1)
    at_edge, face_on = tilted([0.0, 89.5, 90.5]), tilted([0.0, 0.0, 0.0])
    expected = weight @ of_tilted(scene, tmp_path, normal, at_edge, face_on) / weight.sum()
    recording = seen_from(scene, tmp_path, at_edge, face_on)
    found = flux(scene, recording, ["normal_dispersion"], normal_dispersion__deg=deg)
    _, before, lacking = (expected - found) / expected[0]
    assert abs(before) < 0.1 * lacking
    model = LightCurve(scene, recording, effects=["normal_dispersion"])
    told = limits(model, model.parameter_set.start().index_fill(0, torch.tensor([0]), deg))
    assert model.names == ["normal_dispersion.deg[white]"]
    assert len(told) == lines
    for line in told:
        assert 0.6 * lacking < float(line.split("up to ")[1].split(" %")[0]) / 100 < 1.4 * lacking


def test_no_tables_are_borrowed_from_a_model_without_tilts(tmp_path):
    """A diagnosis has its hypotheses share tables of one geometry: those of flat facets were up to 0.08 mag off here."""
    scene = still(PLATE, material("white", 60.0, 0.4, 0.3))
    recording = seen_from(scene, tmp_path, tilted(np.linspace(5, 65, 7)), tilted(10, 180))
    plain = LightCurve(scene, recording, assembly=assemble(scene, recording, []))
    plain(plain.parameter_set.start())  # its tables are there to be lent
    assembly = assemble(scene, recording, ["normal_dispersion[white]"])
    alone, beside = (
        LightCurve(scene, recording, assembly=assembly, sibling=other) for other in (None, plain)
    )
    theta = alone.parameter_set.start()
    torch.testing.assert_close(beside(theta), alone(theta))
    assert float((alone(theta) - plain(plain.parameter_set.start())).abs().max()) > 0.01


def test_contract(tmp_path):
    scene = still(PLATE, material("white", 200.0, 0.3, 0.4))
    recording = seen_from(scene, tmp_path, tilted(np.linspace(0, 80, 9)), tilted(20.0, 180.0))
    check_contract(scene, recording, "normal_dispersion")
