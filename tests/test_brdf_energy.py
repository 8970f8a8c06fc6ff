"""How much of the light that falls on a surface a law of reflection sends out."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.brdf_cases import SHORT, Z, any_values, at, numbers, reflectance
from torchlc.brdf import MODELS, incidence


@pytest.mark.parametrize("name", sorted(set(MODELS) - {"lommel-seeliger-lambert", "ggx-lambert"}))
@SHORT
@given(data=st.data())
def test_never_more_light_out_than_in(name: str, data: st.DataObject) -> None:
    """The quadrature is good to 1e-3: facets' horizons cut the samples."""
    values = data.draw(any_values(MODELS[name]))
    if name == "ashikhmin-shirley":  # the sampling resolves one width; strong anisotropy is tested apart
        values["n_v"] = values["n_u"]
    angle = data.draw(st.floats(0.0, 85.0))
    assert reflectance(MODELS[name], numbers(**values), angle, 0.0) <= 1 + 2e-3


@pytest.mark.parametrize("angle", [0.0, 45.0, 75.0])
def test_anisotropic_lobe_keeps_energy_and_its_norm(angle: float) -> None:
    """At normal incidence the lobe sends out r_spec but for 4/n: 0.987 to 0.9987 for n from 300 to 3000."""
    values = numbers(n_u=300.0, n_v=3000.0, r_spec=1.0, r_diff=0.0)
    for axis in (0.0, 30.0, 90.0):
        share = reflectance(MODELS["ashikhmin-shirley"], values, angle, axis)
        assert share <= 1 + 2e-3
        assert angle > 0 or 0.987 <= share <= 0.9987


@pytest.mark.parametrize("n", [0.0, 0.5, 3.0, 40.0, 1e3])
@pytest.mark.parametrize("name", ["phong-mirror", "phong-half"])
def test_phong_reflects_r_spec_at_normal_incidence(name: str, n: float) -> None:
    share = reflectance(MODELS[name], numbers(n=n, r_spec=0.7, r_diff=0.0), 0.0, 0.0)
    assert share == pytest.approx(0.7, rel=2e-3)


@pytest.mark.parametrize("angle", [0.0, 50.0, 80.0])
def test_lommel_seeliger_lambert_reflectance(angle: float) -> None:
    """Integral of the law over the exit hemisphere: albedo [2 (1 - mu0 ln(1 + 1/mu0)) + weight]."""
    mu0 = math.cos(math.radians(angle))
    expected = 0.3 * (2 * (1 - mu0 * math.log(1 + 1 / mu0)) + 0.25)
    share = reflectance(MODELS["lommel-seeliger-lambert"], numbers(weight=0.25, albedo=0.3), angle, 0.0)
    assert share == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("angle", [0.0, 40.0, 70.0])
def test_ggx_over_lambert_adds_its_diffuse_reflectance_at_every_angle(angle: float) -> None:
    """A Lambert surface sends out r_diff of what falls in, whatever the angle, beside what the lobe does."""
    lobe = reflectance(MODELS["ggx"], numbers(alpha=0.3, f0=0.4, r_diff=0.0), angle, 0.0)
    both = reflectance(MODELS["ggx-lambert"], numbers(alpha=0.3, f0=0.4, r_diff=0.25), angle, 0.0)
    assert both - lobe == pytest.approx(0.25, abs=1e-3)


def test_white_lambert_sphere() -> None:
    """Phase law of a Lambert sphere of radius 1, 2/(3 pi) [sin a + (pi - a) cos a], from 40000 points."""
    count = 40_000
    k = torch.arange(count, dtype=torch.float64) + 0.5
    z, turn = 1 - 2 * k / count, math.pi * (1 + math.sqrt(5)) * k
    normal = torch.stack(
        [torch.sqrt(1 - z**2) * torch.cos(turn), torch.sqrt(1 - z**2) * torch.sin(turn), z], -1
    )
    u = torch.nn.functional.normalize(torch.linalg.cross(normal, at(33.0, 17.0).expand_as(normal)), dim=-1)
    phase = torch.linspace(0.1, 3.0, 12, dtype=torch.float64)
    o = torch.stack([torch.sin(phase), 0 * phase, torch.cos(phase)], -1)
    angles = incidence(normal[:, None], u[:, None], Z, o)
    weight = 4 * math.pi / count * angles.lit_and_seen.double()
    model = MODELS["lambert"]
    _, found = model.parts(model.tabulate(angles, weight), numbers(albedo=1.0))
    expected = 2 / (3 * math.pi) * (torch.sin(phase) + (math.pi - phase) * torch.cos(phase))
    torch.testing.assert_close(found, expected, rtol=2e-3, atol=1e-4)
