"""Reflection models against literal equations, closed forms, brute-force integrals and finite differences."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from tests.brdf_cases import SHORT, X, Z, any_values, at, flux, numbers, one_row, tilted, unit
from torchlc.brdf import MODELS, incidence


def ashikhmin_shirley_to_50_digits(s, o, u, n_u, n_v, r_spec, r_diff):
    """Eqs. 2 to 6 as printed, normal = z."""
    mp = mpmath.mp
    s, o, u = (mpmath.matrix([mp.mpf(float(x)) for x in vector]) for vector in (s, o, u))
    s, o, u = (vector / mpmath.norm(vector) for vector in (s, o, u))
    h = (s + o) / mpmath.norm(s + o)
    v = mpmath.matrix([-u[1], u[0], 0])

    def dot(a, b):
        return sum(a[k] * b[k] for k in range(3))

    z = (n_u * dot(h, u) ** 2 + n_v * dot(h, v) ** 2) / (1 - h[2] ** 2)
    fresnel = r_spec + (1 - r_spec) * (1 - dot(s, h)) ** 5
    lobe = mp.sqrt((n_u + 1) * (n_v + 1)) / (8 * mp.pi) * h[2] ** z / (dot(h, s) * max(s[2], o[2])) * fresnel
    side = (1 - (1 - s[2] / 2) ** 5) * (1 - (1 - o[2] / 2) ** 5)
    return lobe + 28 * r_diff / (23 * mp.pi) * (1 - r_spec) * side


@pytest.mark.parametrize("isotropic", [True, False])
def test_ashikhmin_shirley_matches_the_printed_equations(isotropic: bool) -> None:
    """Float64 keeps n theta^2 to a few 1e-16 n theta; 1e-10 leaves a decade at n = 1e6."""
    random = np.random.default_rng(1)
    with mpmath.workdps(50):
        for trial in range(200):
            n_u, n_v = 10 ** random.uniform(-2, 6, 2)
            n_v = n_u if isotropic else n_v
            r_spec, r_diff = random.dirichlet([1, 1, 1])[:2]
            s = unit(1, seed=trial, up=True)[0]
            mirror = s * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
            o = mirror + 4 / math.sqrt(max(n_u, n_v, 1)) * unit(1, seed=trial + 1000)[0]
            o = torch.nn.functional.normalize(o, dim=-1)
            if o[2] <= 0:
                continue
            u = at(90.0, random.uniform(0, 360))
            u[2] = 0.0
            exponents = {"n": n_u} if isotropic else {"n_u": n_u, "n_v": n_v}
            model = MODELS["ashikhmin-shirley"](**exponents, r_spec=r_spec, r_diff=r_diff, learnable=False)
            expected = ashikhmin_shirley_to_50_digits(s, o, u, n_u, n_v, r_spec, r_diff)
            assert float(model(Z, u, s, o)) == pytest.approx(float(expected), rel=1e-10)


def test_log_cosine_is_exact_from_the_glint_to_the_limb() -> None:
    """exp of n log(cos) for n = 1e6 needs the logarithm itself to 1e-13, in every branch of the guard."""
    angles = torch.tensor(
        [0.0, 1e-9, 1e-6, 1e-3, 0.0316, 0.0317, 0.5, 0.78, 0.79, 1.2, 1.57], dtype=torch.float64
    )
    half = torch.stack([torch.sin(angles), 0 * angles, torch.cos(angles)], -1)
    found = incidence(Z, X, half, half).log_half
    with mpmath.workdps(40):
        expected = [float(mpmath.log(mpmath.cos(mpmath.mpf(float(angle))))) for angle in angles]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), rtol=2e-13, atol=0)


def test_exponent_splits_between_the_axes() -> None:
    angles = incidence(Z, X, at(40.0, 25.0), at(40.0, 25.0))
    ratio = math.tan(math.radians(25.0)) ** 2
    assert float(angles.log_v / angles.log_u) == pytest.approx(ratio, rel=1e-12)
    assert float(angles.log_half) == pytest.approx(math.log(math.cos(math.radians(40.0))), rel=1e-12)


def test_face_on_values() -> None:
    """Sun, observer and normal in one line: each model's closed form."""

    def value(name: str, **values: float) -> float:
        return float(MODELS[name](learnable=False, **values)(Z, X, Z, Z))

    edge = (31 / 32) ** 2
    assert value("ashikhmin-shirley", n=99.0, r_spec=0.3, r_diff=0.2) == pytest.approx(
        100 * 0.3 / (8 * math.pi) + 28 * 0.2 * 0.7 * edge / (23 * math.pi), rel=1e-14
    )
    assert value("lambert", albedo=0.4) == pytest.approx(0.4 / math.pi)
    assert value("lommel-seeliger-lambert", weight=0.1) == pytest.approx(0.6 / math.pi)
    assert value("phong-mirror", n=98.0, r_spec=0.3, r_diff=0.0) == pytest.approx(0.3 * 100 / (2 * math.pi))
    assert value("cook-torrance", m=0.1, f0=0.5, r_diff=0.0) == pytest.approx(0.5 / (4 * math.pi * 0.01))
    assert value("ggx", alpha=0.1, f0=0.5, r_diff=0.0) == pytest.approx(0.5 / (4 * math.pi * 0.01))


def test_dark_side_and_hidden_side_are_zero() -> None:
    down = torch.tensor([0.6, 0.0, -0.8], dtype=torch.float64)
    shiny = MODELS["ashikhmin-shirley"](n=10.0, r_spec=0.5, r_diff=0.5, learnable=False)
    for model in (shiny, MODELS["lambert"](albedo=1.0, learnable=False)):
        assert float(model(Z, X, down, Z)) == 0.0
        assert float(model(Z, X, Z, down)) == 0.0


@pytest.mark.parametrize("name", MODELS)
@SHORT
@given(data=st.data())
def test_reciprocity(name: str, data: st.DataObject) -> None:
    model = MODELS[name](**data.draw(any_values(MODELS[name])), learnable=False)
    seed = data.draw(st.integers(0, 10_000))
    s, o, u = unit(50, seed=seed, up=True), unit(50, seed=seed + 1, up=True), at(90.0, seed)
    torch.testing.assert_close(model(Z, u, s, o), model(Z, u, o, s), rtol=1e-9, atol=1e-250)


def test_equal_exponents_given_apart_are_the_isotropic_lobe() -> None:
    model = MODELS["ashikhmin-shirley"]
    s, o = unit(40, seed=6, up=True), unit(40, seed=7, up=True)
    one = model(n=350.0, r_spec=0.3, r_diff=0.3)(Z, X, s, o)
    two = model(n_u=350.0, n_v=350.0, r_spec=0.3, r_diff=0.3)(Z, X, s, o)
    torch.testing.assert_close(one, two, rtol=1e-10, atol=0)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ashikhmin-shirley", {"n": 1e4, "r_spec": 0.5, "r_diff": 0.2}),
        ("phong-mirror", {"n": 1e4, "r_spec": 0.5, "r_diff": 0.2}),
        ("phong-half", {"n": 1e4, "r_spec": 0.5, "r_diff": 0.2}),
        ("cook-torrance", {"m": 0.01, "f0": 0.5, "r_diff": 0.2}),
        ("ggx", {"alpha": 0.01, "f0": 0.5, "r_diff": 0.2}),
    ],
)
def test_lobe_variance_is_the_curvature_at_the_glint(name: str, values: dict[str, float]) -> None:
    """A facet turned by e from the glint shines as exp(-e^2 / 2 variance), to which ``broadened`` adds.

    The facet's projection adds a few times the variance (1e-4 here) to the exponent's rate: 1 %.
    """
    model, natural = MODELS[name], numbers(**values)
    for spread in (
        (0.0, 0.02**2) if name != "ggx" else (0.0, 0.001**2)
    ):  # whose core holds a part of its light
        given = model.broadened(natural, torch.tensor(spread, dtype=torch.float64))
        expected = float(model.lobe_variance(natural)) + spread
        tilt = 0.03 * math.sqrt(expected)
        angles = incidence(*tilted(torch.tensor([0.0, tilt], dtype=torch.float64)), Z, Z)
        specular, _ = model.parts(model.tabulate(*one_row(angles, torch.ones(2).double())), given)
        assert -(tilt**2) / 2 / math.log(specular[1] / specular[0]) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("times", [0.1, 0.5, 2.0, 10.0, 100.0])
def test_broadened_ggx_is_as_bright_on_its_axis_as_the_mean_over_tilts(times: float) -> None:
    """The mean by quadrature of 1 / (1 + t^2 / alpha^2)^2 over a Gaussian of variance ``times`` alpha^2 per axis."""
    model, alpha = MODELS["ggx"], 1e-3
    variance = times * alpha**2

    def over_ring(t: float) -> float:
        return t / variance * math.exp(-0.5 * t * t / variance) / (1 + (t / alpha) ** 2) ** 2

    mean, _ = quad(over_ring, 0.0, 12 * math.sqrt(variance), points=[alpha, 3 * alpha], limit=400)
    wide = model.broadened(numbers(alpha=alpha, f0=0.5, r_diff=0.0), torch.tensor(variance).double())
    assert float(wide["alpha"]) == pytest.approx(alpha / math.sqrt(mean), rel=0.003)


def test_broadened_lobe_is_the_average_over_tilted_normals() -> None:
    """Gauss-Hermite average of n = 1000 over normals spread by 3 degrees, across the glint."""
    model = MODELS["ashikhmin-shirley"]
    values = numbers(n=1000.0, r_spec=0.5, r_diff=0.0)
    sigma = math.radians(3.0)
    node, share = np.polynomial.hermite_e.hermegauss(25)
    s = o = torch.stack([at(float(angle)) for angle in (0.0, 2.0, 4.0, 6.0)])
    average = torch.zeros(4, dtype=torch.float64)
    for a, wa in zip(node, share, strict=True):
        for b, wb in zip(node, share, strict=True):
            slopes = torch.tensor([sigma * a, sigma * b, 1.0], dtype=torch.float64)
            normal = torch.nn.functional.normalize(slopes, dim=0)
            u = torch.nn.functional.normalize(X - normal * normal[0], dim=0)
            average += wa * wb / (2 * math.pi) * flux(model, values, normal, u, s, o)
    wide = model.broadened(values, torch.tensor(sigma**2, dtype=torch.float64))
    torch.testing.assert_close(flux(model, wide, Z, X, s, o), average, rtol=0.03, atol=0)
