"""Reflection models against Mitsuba 3, a renderer: point by point, and a rendered sphere.

Mitsuba computes in float32, so single values agree to 1e-4. It has no Ashikhmin-Shirley and no Phong model;
those are compared with the printed equations and with lumos-sat.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchlc.brdf import MODELS, incidence

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "reference"))

import surface

mitsuba: Any = pytest.importorskip("mitsuba", reason="mitsuba is not installed (pip install torchlc[test])")

Z, X = torch.eye(3, dtype=torch.float64)[[2, 0]]


@pytest.fixture(autouse=True)
def _scalar_variant() -> None:
    mitsuba.set_variant("scalar_rgb")


def metal(distribution: str, alpha: float) -> dict[str, Any]:
    """A rough metal that reflects all light: "none" has a Fresnel factor of 1, as f0 = 1 has here."""
    return {"type": "roughconductor", "distribution": distribution, "alpha": alpha, "material": "none"}


def directions(count: int, steepest_deg: float, seed: int) -> Tensor:
    random = np.random.default_rng(seed)
    cosine = random.uniform(math.cos(math.radians(steepest_deg)), 1, count)
    turn, sine = random.uniform(0, 2 * math.pi, count), np.sqrt(1 - cosine**2)
    return torch.tensor(np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], -1))


def rendered(description: dict[str, Any], to_sun: Tensor, to_observer: Tensor) -> Tensor:
    """Mitsuba's f_r mu, (N,)."""
    material, context = mitsuba.load_dict(description), mitsuba.BSDFContext()
    found = []
    for s, o in zip(to_sun.tolist(), to_observer.tolist(), strict=True):
        point = mitsuba.SurfaceInteraction3f()
        point.wi = mitsuba.Vector3f(*o)
        found.append(material.eval(context, point, mitsuba.Vector3f(*s))[0])
    return torch.tensor(found, dtype=torch.float64)


def test_lambert() -> None:
    s, o = directions(50, 89, 1), directions(50, 89, 2)
    description = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.37}}
    found = MODELS["lambert"](albedo=0.37)(Z, X, s, o).detach() * s[:, 2]
    torch.testing.assert_close(found, rendered(description, s, o), rtol=1e-5, atol=0)


@pytest.mark.parametrize("alpha", [0.03, 0.1, 0.3, 0.7, 1.0])
def test_ggx(alpha: float) -> None:
    """Half of the pairs are random, half near the mirror direction, where the light is."""
    s = directions(200, 85, 3)
    mirror = s * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    near = torch.nn.functional.normalize(
        mirror + alpha * torch.tensor(np.random.default_rng(8).normal(size=s.shape)), dim=-1
    )
    o = torch.where(
        (torch.arange(200) % 2 == 0)[:, None] & (near[:, 2:] > 0.05), near, directions(200, 85, 4)
    )
    found = MODELS["ggx"](alpha=alpha, f0=1.0, r_diff=0.0)(Z, X, s, o).detach() * s[:, 2]
    torch.testing.assert_close(found, rendered(metal("ggx", alpha), s, o), rtol=2e-4, atol=1e-7)


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.6])
def test_beckmann(alpha: float) -> None:
    """Mitsuba has a rational fit to the masking, within 1 %."""
    s, o = directions(200, 85, 15), directions(200, 85, 16)
    found = MODELS["beckmann"](alpha=alpha, f0=1.0, r_diff=0.0)(Z, X, s, o).detach() * s[:, 2]
    expected = rendered(metal("beckmann", alpha), s, o)
    lobe = expected > 1e-6 * expected.max()
    torch.testing.assert_close(found[lobe], expected[lobe], rtol=1e-2, atol=0)


def test_ggx_over_a_lambert_base() -> None:
    """f mu0 mu of Mitsuba's conductor, and its Lambert surface as what the diffuse part adds."""
    s, o = directions(200, 85, 13), directions(200, 85, 14)
    found = MODELS["ggx-lambert"](alpha=0.2, f0=1.0, r_diff=0.0)(Z, X, s, o).detach() * s[:, 2]
    base = MODELS["ggx-lambert"](alpha=0.2, f0=0.5, r_diff=0.37)(Z, X, s, o).detach() * s[:, 2]
    bare = MODELS["ggx-lambert"](alpha=0.2, f0=0.5, r_diff=0.0)(Z, X, s, o).detach() * s[:, 2]
    torch.testing.assert_close(found, rendered(metal("ggx", 0.2), s, o), rtol=2e-4, atol=1e-7)
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.37}}
    torch.testing.assert_close(base - bare, rendered(white, s, o), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.6])
def test_conductors_of_the_brute_force_reference(distribution: str, alpha: float) -> None:
    """f mu0 mu of what the concealed cases are made of. Mitsuba has a rational fit to Beckmann's masking, within 1 %."""
    s, o = directions(200, 85, 11), directions(200, 85, 12)
    z, x, y = (np.broadcast_to(axis, s.shape) for axis in np.eye(3)[[2, 0, 1]])
    material = {"model": distribution, "alpha": alpha, "f0": 1.0, "r_diff": 0.0}
    found = surface.reflected(material, {}, z, x, y, s.numpy(), o.numpy())
    expected = (rendered(metal(distribution, alpha), s, o) * o[:, 2]).numpy()
    lobe = expected > 1e-6 * expected.max()
    tolerance = {"ggx": 2e-4, "beckmann": 1e-2}[distribution]
    np.testing.assert_allclose(found[lobe], expected[lobe], rtol=tolerance)


@pytest.mark.parametrize("m", [0.05, 0.15, 0.3])
def test_cook_torrance_where_nothing_is_masked(m: float) -> None:
    """Within 35 degrees of the normal neither model's cavities hide anything: only D is left."""
    s, o = directions(200, 35, 5), directions(200, 35, 6)
    found = MODELS["cook-torrance"](m=m, f0=1.0, r_diff=0.0)(Z, X, s, o).detach() * s[:, 2]
    expected = rendered(metal("beckmann", m), s, o)
    lobe = expected > 1e-6 * expected.max()
    torch.testing.assert_close(found[lobe], expected[lobe], rtol=1e-3, atol=0)


@pytest.mark.parametrize(("alpha", "phase_deg"), [(0.3, 20.0), (0.3, 80.0), (0.6, 130.0)])
def test_flux_of_a_sphere(alpha: float, phase_deg: float) -> None:
    """40000 points on a sphere against 96 x 96 pixels of 64 samples: both are good to a few 1e-3."""
    phase = math.radians(phase_deg)
    image = mitsuba.render(
        mitsuba.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct"},
                "sensor": {
                    "type": "orthographic",
                    "to_world": mitsuba.ScalarTransform4f().look_at([0, 0, 10], [0, 0, 0], [0, 1, 0]),
                    "film": {
                        "type": "hdrfilm",
                        "width": 96,
                        "height": 96,
                        "rfilter": {"type": "box"},
                        "pixel_format": "luminance",
                    },
                    "sampler": {"type": "stratified", "sample_count": 64, "seed": 7},
                },
                "light": {
                    "type": "directional",
                    "direction": [-math.sin(phase), 0, -math.cos(phase)],
                    "irradiance": 1.0,
                },
                "shape": {"type": "sphere", "radius": 1.0, "bsdf": metal("ggx", alpha)},
            }
        )
    )
    expected = 4.0 * float(np.array(image).mean())  # the film covers 2 x 2 m

    count = 40_000
    k = torch.arange(count, dtype=torch.float64) + 0.5
    z, turn = 1 - 2 * k / count, math.pi * (1 + math.sqrt(5)) * k
    sine = torch.sqrt(1 - z**2)
    normal = torch.stack([sine * torch.cos(turn), sine * torch.sin(turn), z], -1)[:, None]
    u = torch.nn.functional.normalize(torch.linalg.cross(normal, X.expand_as(normal)), dim=-1)
    sun = torch.tensor([math.sin(phase), 0.0, math.cos(phase)], dtype=torch.float64)
    angles = incidence(normal, u, sun, Z)
    model = MODELS["ggx"]
    values = {"alpha": alpha, "f0": 1.0, "r_diff": 0.0}
    table = model.tabulate(angles, angles.lit_and_seen * (4 * math.pi / count))
    found, _ = model.parts(table, {name: torch.tensor(value).double() for name, value in values.items()})
    assert float(found) == pytest.approx(expected, rel=5e-3)
