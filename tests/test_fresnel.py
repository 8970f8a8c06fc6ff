"""Fresnel's equations against 50 digits, textbook values and Mitsuba; and the keys by which a scene asks for them."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch

import torchlc
from tests.effects.cases import STILL
from torchlc.brdf import MODELS
from torchlc.brdf.fresnel import conductor, dielectric
from torchlc.errors import InputError

METALS = {"aluminium": (0.958, 6.69), "gold": (0.42, 2.35), "silver": (0.06, 3.59), "titanium": (2.7, 3.7)}
"""n and k near 550 nm."""


def number(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float64)


def at_angle(deg) -> torch.Tensor:
    return torch.cos(torch.deg2rad(torch.as_tensor(deg, dtype=torch.float64)))


def to_50_digits(deg: float, eta: float, k: float) -> float:
    """The two polarisations' amplitudes at an interface, with complex Snell's law."""
    with mpmath.workdps(50):
        index = mpmath.mpc(eta, k)
        angle = mpmath.radians(mpmath.mpf(deg))
        c, inside = mpmath.cos(angle), mpmath.sqrt(1 - (mpmath.sin(angle) / index) ** 2)
        across = (c - index * inside) / (c + index * inside)
        along = (index * c - inside) / (index * c + inside)
        return float((abs(across) ** 2 + abs(along) ** 2) / 2)


@pytest.mark.parametrize("eta", [1.0 + 1e-9, 1.33, 1.5, 2.4, 5.0])
def test_dielectrics_to_50_digits(eta):
    """To rounding, which near an index of 1 is that of index - 1."""
    for deg in (0.0, 10.0, 45.0, 56.3, 80.0, 89.9):
        expected = to_50_digits(deg, eta, 0.0)
        assert float(dielectric(at_angle(deg), number(eta))) == pytest.approx(expected, rel=1e-10, abs=1e-16)
        assert float(conductor(at_angle(deg), number(eta), number(0.0))) == pytest.approx(
            expected, rel=1e-8, abs=1e-9
        )


@pytest.mark.parametrize(
    ("eta", "k"), [*METALS.values(), (0.01, 20.0), (10.0, 20.0), (0.05, 0.0), (0.5, 1e-3)]
)
def test_conductors_to_50_digits(eta, k):
    for deg in (0.0, 10.0, 45.0, 70.0, 85.0, 89.9):
        expected = to_50_digits(deg, eta, k)
        assert float(conductor(at_angle(deg), number(eta), number(k))) == pytest.approx(expected, rel=1e-9)


def test_textbook_values():
    """Glass reflects 4 % face on; at Brewster's angle, atan(1.5) = 56.31 deg, only the polarisation across the plane,
    ((n^2 - 1) / (n^2 + 1))^2 of it; aluminium reflects 92 %, gold 78 % and silver 98 % of green light; all of it grazing.
    """
    glass = number(1.5)
    assert float(dielectric(at_angle(0.0), glass)) == pytest.approx(0.04, rel=1e-12)
    brewster = math.degrees(math.atan(1.5))
    assert float(dielectric(at_angle(brewster), glass)) == pytest.approx(0.5 * (1.25 / 3.25) ** 2, rel=1e-12)
    for metal, share in (("aluminium", 0.92), ("gold", 0.78), ("silver", 0.98)):
        eta, k = METALS[metal]
        face_on = float(conductor(at_angle(0.0), number(eta), number(k)))
        assert face_on == pytest.approx(((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2), rel=1e-12)
        assert face_on == pytest.approx(share, abs=0.006)
    assert float(dielectric(number(0.0), glass)) == pytest.approx(1.0, abs=1e-12)


def test_what_schlicks_factor_leaves():
    """The sizes in the laws' descriptions: 0.29 mag for glass at 55 deg, 0.28 mag for titanium near 81 deg."""
    deg = torch.linspace(0, 89, 891, dtype=torch.float64)
    c = at_angle(deg)
    for exact, size, place in (
        (dielectric(c, number(1.5)), 0.287, 55.5),
        (conductor(c, *map(number, METALS["titanium"])), -0.280, 81.4),
        (conductor(c, *map(number, METALS["aluminium"])), -0.108, 82.9),
    ):
        off = -2.5 * torch.log10((exact[0] + (1 - exact[0]) * (1 - c) ** 5) / exact)
        worst = int(off.abs().argmax())
        assert float(off[worst]) == pytest.approx(size, abs=2e-3)
        assert float(deg[worst]) == pytest.approx(place, abs=0.2)


def test_gradients_are_finite_everywhere_and_match_differences():
    """At the bounds of the constants and from the normal to grazing light; the step's truncation is below 1e-7."""
    c = torch.tensor([0.0, 1e-12, 0.3, 0.7, 1.0], dtype=torch.float64)
    for function, constants in (
        (dielectric, [(1.0,), (1.5,), (5.0,)]),
        (conductor, [(0.01, 0.0), (1.0, 0.0), (0.9, 6.0), (10.0, 20.0), (0.05, 1e-9)]),
    ):
        for values in constants:
            given = [number(value).requires_grad_() for value in values]
            cosine = c.clone().requires_grad_()
            grads = torch.autograd.grad(function(cosine, *given).sum(), [cosine, *given])
            assert all(torch.isfinite(grad).all() for grad in grads), (function.__name__, values)
    for function, values in ((dielectric, (1.5,)), (conductor, (0.9, 6.0)), (conductor, (2.0, 0.4))):
        inputs = [number(0.6).requires_grad_(), *(number(value).requires_grad_() for value in values)]
        assert torch.autograd.gradcheck(function, inputs, eps=1e-6, atol=1e-8)


@pytest.fixture
def mitsuba():
    module = pytest.importorskip("mitsuba", reason="mitsuba is not installed (pip install torchlc[test])")
    module.set_variant("scalar_rgb")
    return module


@pytest.mark.parametrize("alpha", [0.05, 0.3, 0.8])
@pytest.mark.parametrize(
    ("law", "values", "description"),
    [
        ("ggx-dielectric", {"ior": 1.5}, {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0}),
        ("ggx-dielectric", {"ior": 2.2}, {"type": "roughdielectric", "int_ior": 2.2, "ext_ior": 1.0}),
        ("ggx-conductor", {"eta": 0.958, "k": 6.69}, {"type": "roughconductor", "eta": 0.958, "k": 6.69}),
        ("ggx-conductor", {"eta": 2.7, "k": 3.7}, {"type": "roughconductor", "eta": 2.7, "k": 3.7}),
    ],
)
def test_lobes_against_mitsuba(mitsuba, law, values, description, alpha):
    """f_r mu of pairs near the mirror direction and anywhere; Mitsuba computes in float32, good to 2e-4."""
    material = mitsuba.load_dict({**description, "distribution": "ggx", "alpha": alpha})
    random = np.random.default_rng(3)
    z, x = torch.eye(3, dtype=torch.float64)[[2, 0]]
    context, pairs = mitsuba.BSDFContext(), []
    for trial in range(200):
        s = random.normal(size=3) * [1, 1, 0.6]
        s[2] = abs(s[2]) + 0.1
        s = s / np.linalg.norm(s)
        o = s * [-1, -1, 1] + alpha * random.normal(size=3) if trial % 2 else random.normal(size=3)
        o = o / np.linalg.norm(o)
        if o[2] > 0.05:
            pairs.append((s, o))
    expected = []
    for s, o in pairs:
        point = mitsuba.SurfaceInteraction3f()
        point.wi = mitsuba.Vector3f(*map(float, o))
        expected.append(material.eval(context, point, mitsuba.Vector3f(*map(float, s)))[0])
    s, o = (torch.tensor(np.array(side)) for side in zip(*pairs, strict=True))
    found = MODELS[law](alpha=alpha, r_diff=0.0, learnable=False, **values)(z, x, s, o) * s[:, 2]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), rtol=3e-4, atol=1e-6)


def scene_of(numbers: str) -> torchlc.Scene:
    return torchlc.Scene.from_toml(
        f'format = "torchlc-scene/1"\nname = "x"\n{STILL}[[components]]\nname = "box"\nshape = "box"\nsize = [1, 1, 1]\n'
        f'centre = [0, 0, 0]\nmaterial = "skin"\n[materials.skin]\n{numbers}\n'
    )


@pytest.mark.parametrize(
    ("numbers", "law"),
    [
        ('model = "ggx"\nalpha = 0.2\nf0 = 0.1\nr_diff = 0.1', "ggx"),
        ('model = "ggx"\nalpha = 0.2\nior = 1.5\nr_diff = 0.1', "ggx-dielectric"),
        ('model = "ggx"\nalpha = 0.2\neta = 0.9\nk = { value = 6.0, low = 1, high = 9 }\nr_diff = 0.1', "ggx-conductor"),
        ('model = "cook-torrance"\nm = 0.2\nior = { value = 1.5, sigma = 0.1 }\nr_diff = 0.1', "cook-torrance-dielectric"),
        ('model = "cook-torrance-conductor"\nm = 0.2\neta = 0.9\nk = 6.0\nr_diff = 0.1', "cook-torrance-conductor"),
    ],
)  # fmt: skip
def test_keys_choose_the_law(numbers, law):
    scene = scene_of(numbers)
    assert scene.materials["skin"].model == law
    assert torchlc.Scene.from_toml(scene.to_toml()) == scene


@pytest.mark.parametrize(
    ("numbers", "word"),
    [
        (
            "alpha = 0.2\nf0 = 0.1\nior = 1.5\nr_diff = 0.1",
            "ior: given beside f0; expected f0, or ior, or eta and k",
        ),
        ("alpha = 0.2\nior = 1.5\nk = 3.0\nr_diff = 0.1", "k: given beside ior"),
        ("alpha = 0.2\neta = 0.9\nr_diff = 0.1", "skin.k: missing"),
        ("alpha = 0.2\nr_diff = 0.1", "skin.f0: missing"),
        ("alpha = 0.2\nior = 0.9\nr_diff = 0.1", "skin.ior: 0.9; expected 1 to 5"),
        ("alpha = 0.2\nn = 1.5\nr_diff = 0.1", "skin.n: unknown key"),
    ],
)
def test_what_the_door_refuses(numbers, word):
    with pytest.raises(InputError, match=word):
        scene_of(f'model = "ggx"\n{numbers}')
