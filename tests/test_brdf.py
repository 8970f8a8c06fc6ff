"""Reflection models against literal equations, closed forms, brute-force integrals and finite differences."""

from __future__ import annotations

import copy
import math

import mpmath
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchlc import brdf
from torchlc.brdf import MODELS, Brdf, Incidence, incidence
from torchlc.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func's own
SHORT = settings(max_examples=25, deadline=None, derandomize=True)
Z, X = torch.eye(3, dtype=torch.float64)[[2, 0]]


def unit(*shape: int, seed: int, up: bool = False) -> Tensor:
    vector = torch.randn(*shape, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    if up:
        vector[..., 2] = vector[..., 2].abs()
    return torch.nn.functional.normalize(vector, dim=-1)


def at(angle_deg: float, azimuth_deg: float = 0.0) -> Tensor:
    angle, azimuth = math.radians(angle_deg), math.radians(azimuth_deg)
    sine = math.sin(angle)
    return torch.tensor(
        [sine * math.cos(azimuth), sine * math.sin(azimuth), math.cos(angle)], dtype=torch.float64
    )


def tilted(angle: Tensor) -> tuple[Tensor, Tensor]:
    """Normal and u of a facet turned about y by angles in rad."""
    sine, cosine, zero = torch.sin(angle), torch.cos(angle), 0 * angle
    return torch.stack([sine, zero, cosine], -1), torch.stack([cosine, zero, -sine], -1)


def numbers(**values: float) -> dict[str, Tensor]:
    return {name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()}


def one_row(angles: Incidence, weight: Tensor) -> tuple[Incidence, Tensor]:
    fields = torch.broadcast_tensors(
        angles.cos_i, angles.cos_r, angles.cos_half, angles.log_u, angles.log_v, weight
    )
    *fields, weight = (field.reshape(1, -1) for field in fields)
    return Incidence(*fields), weight


def flux(
    model: type[Brdf], values: dict[str, Tensor], normal: Tensor, u: Tensor, s: Tensor, o: Tensor
) -> Tensor:
    """f_r mu0 mu of single facets, in the way a scene computes it."""
    angles = incidence(normal, u, s, o)
    angles, weight = one_row(angles, angles.lit_and_seen.to(s.dtype))
    specular, diffuse = model.parts(model.tabulate(angles, weight), values)
    return specular + diffuse


@st.composite
def any_values(draw: st.DrawFn, model: type[Brdf]) -> dict[str, float]:
    """Values anywhere in the allowed range, bounds included."""
    values, left = {}, 1.0
    for quantity in model.quantities:
        share = draw(st.floats(0.0, 1.0))
        if quantity.name in model.simplex:
            values[quantity.name] = left * share
            left -= values[quantity.name]
        elif quantity.prior == "loguniform":
            shift = 0.0 if quantity.low else 1.0
            ratio = (quantity.high + shift) / (quantity.low + shift)
            value = (quantity.low + shift) * ratio**share - shift
            values[quantity.name] = min(max(value, quantity.low), quantity.high)
        else:
            values[quantity.name] = quantity.low + (quantity.high - quantity.low) * share
    return values


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


def reflectance(model: type[Brdf], values: dict[str, Tensor], incidence_deg: float, axis_deg: float) -> float:
    """Share of the light from one direction that leaves the facet, by brute force.

    Half of the samples follow the half vector, graded towards the lobe (d omega_o = 4 (h.s) d omega_h), and
    integrate the lobe; the others are uniform in the exit cosine and integrate the diffuse part.
    """
    s, azimuths = at(incidence_deg), 128
    node, share = (torch.tensor(x) for x in np.polynomial.legendre.leggauss(160))
    phi = 2 * math.pi * (torch.arange(azimuths, dtype=torch.float64) + 0.5) / azimuths
    around = torch.stack([torch.cos(phi), torch.sin(phi)], -1)

    def directions(sine: Tensor, cosine: Tensor) -> Tensor:
        flat = sine[:, None, None] * around
        return torch.cat([flat, cosine[:, None, None].expand(-1, azimuths, 1)], -1)

    def total(o: Tensor, solid_angle: Tensor, part: int) -> float:
        angles = incidence(Z, at(90.0, axis_deg), s, o)
        weight = torch.where(angles.lit_and_seen, solid_angle / angles.cos_i, 0.0)
        angles, weight = one_row(angles, weight)
        return float(model.parts(model.tabulate(angles, weight), values)[part].sum())

    cosine = 0.5 * (node + 1)
    ring = 0.5 * share * 2 * math.pi / azimuths
    diffuse = total(directions(torch.sqrt(1 - cosine**2), cosine), ring[:, None].expand(-1, azimuths), 1)

    width = min(float(model.lobe_variance(values)) ** 0.5, 1.0)
    top = math.asinh(1e3 / width)
    tangent, slope = width * torch.sinh(cosine * top), width * torch.cosh(cosine * top) * top
    cosine = 1 / torch.sqrt(1 + tangent**2)
    half = directions(tangent * cosine, cosine)
    towards = (half * s).sum(-1)
    ring = (share * 0.5 * slope * cosine**2 * tangent * cosine * 2 * math.pi / azimuths)[:, None]
    exits = 2 * towards[..., None] * half - s
    return diffuse + total(exits, torch.where(towards > 0, 4 * towards * ring, 0.0), 0)


@pytest.mark.parametrize("name", sorted(set(MODELS) - {"lommel-seeliger-lambert"}))
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


def test_every_law_is_tried() -> None:
    assert set(STEEP) == set(MODELS)


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


GRAZING = [(0.0, 0.0), (30.0, -30.0), (30.0, 10.0), (89.9, -89.8), (89.99, 20.0), (60.0, -61.0)]
WIDTHS_AND_INDICES = [(1e-3, 1.5), (0.01, 1.001), (0.3, 1.33), (1.0, 4.9)]
STEEP = {
    "ashikhmin-shirley": [{"n": n, "r_spec": 0.3, "r_diff": 0.4} for n in (0.0, 1.0, 1e2, 1e4, 1e6)]
    + [{"n_u": 30.0, "n_v": 3e3, "r_spec": 0.3, "r_diff": 0.4}],
    "lambert": [{"albedo": 0.4}],
    "lommel-seeliger-lambert": [{"weight": 0.2, "albedo": 0.4}],
    "phong-mirror": [{"n": n, "r_spec": 0.3, "r_diff": 0.4} for n in (0.0, 1.0, 1e2, 1e4, 1e6)],
    "phong-half": [{"n": n, "r_spec": 0.3, "r_diff": 0.4} for n in (0.0, 1.0, 1e2, 1e4, 1e6)],
    "cook-torrance": [{"m": m, "f0": 0.3, "r_diff": 0.4} for m in (1e-3, 0.01, 0.3, 1.0)],
    "ggx": [{"alpha": alpha, "f0": 0.3, "r_diff": 0.4} for alpha in (1e-3, 0.01, 0.3, 1.0)],
    "ggx-dielectric": [{"alpha": alpha, "ior": ior, "r_diff": 0.4} for alpha, ior in WIDTHS_AND_INDICES],
    "ggx-conductor": [
        {"alpha": a, "eta": n - 0.9, "k": 2.0 * n, "r_diff": 0.1} for a, n in WIDTHS_AND_INDICES
    ],
    "cook-torrance-dielectric": [{"m": m, "ior": ior, "r_diff": 0.4} for m, ior in WIDTHS_AND_INDICES],
    "cook-torrance-conductor": [
        {"m": m, "eta": n - 0.9, "k": 2.0 * n, "r_diff": 0.1} for m, n in WIDTHS_AND_INDICES
    ],
    "oren-nayar": [{"albedo": 0.4, "sigma": sigma} for sigma in (0.0, 1.0, 15.0, 40.0)],
    "eon": [{"albedo": 0.9, "roughness": roughness} for roughness in (0.0, 0.1, 0.6, 1.0)],
}


@pytest.mark.parametrize("name", STEEP)
def test_gradients_match_central_differences(name: str) -> None:
    """Along every value and along a turn of the normal, from h = n to grazing light.

    Steps are 1e-5 of the value, and 1e-4 of the lobe's width for the turn: truncation stays below 1e-7.
    """
    model = MODELS[name]
    for values in STEEP[name]:
        width = min(float(model.lobe_variance(numbers(**values))) ** 0.5, 0.1)
        for angle_i, angle_r in GRAZING:
            s, o = at(angle_i), at(angle_r, 5.0)

            def flux_of(theta: Tensor, values: dict = values, s: Tensor = s, o: Tensor = o) -> Tensor:
                given = dict(zip(values, theta[:-1], strict=True))
                return flux(model, given, *tilted(theta[-1]), s, o).sum()

            theta = torch.tensor([*values.values(), 0.0], dtype=torch.float64)
            steps = torch.tensor([*(1e-5 * max(v, 1e-3) for v in values.values()), 1e-4 * width]).double()
            gradient = torch.autograd.functional.jacobian(flux_of, theta)
            scale = flux_of(theta).abs()
            for k, step in enumerate(steps):
                move = torch.zeros_like(theta)
                move[k] = step
                numeric = (flux_of(theta + move) - flux_of(theta - move)) / (2 * step)
                floor = float(2e-12 * scale / step) + 1e-100  # roundoff of the difference
                assert float(gradient[k]) == pytest.approx(float(numeric), rel=2e-5, abs=floor), (values, k)


@pytest.mark.parametrize("name", STEEP)
def test_pairs_without_weight_leave_no_trace(name: str) -> None:
    """Opposed, tangential, behind, and h = n exactly: finite values and first and second derivatives."""
    model = MODELS[name]
    s = torch.stack([Z, X, -Z, Z, at(90.0), at(120.0), Z]).requires_grad_()
    o = torch.stack([-Z, -X, -Z, Z, at(90.0, 180.0), at(120.0, 180.0), X])
    for values in STEEP[name]:
        given = {k: v.requires_grad_() for k, v in numbers(**values).items()}
        out = flux(model, given, Z, X, s, o)
        gradients = torch.autograd.grad(out.sum(), [s, *given.values()], create_graph=True)
        second = torch.autograd.grad(sum(g.sum() for g in gradients), [s, *given.values()], allow_unused=True)
        assert bool(torch.isfinite(out).all())
        assert all(bool(torch.isfinite(g).all()) for g in (*gradients, *second) if g is not None)
        assert out[[0, 2, 5]].abs().max() == 0
        assert not gradients[0][[0, 2, 5]].any()


@pytest.mark.parametrize("name", STEEP)
def test_batches_agree_with_loops_and_vmap(name: str) -> None:
    model, (s, o) = MODELS[name], (unit(1, 9, seed=3, up=True), unit(1, 9, seed=4, up=True))
    angles = incidence(unit(20, 1, seed=5, up=True), X, s, o)
    table = model.tabulate(angles, angles.lit_and_seen.double())
    rows = [numbers(**values) for values in STEEP[name][:4]]
    batch = {key: torch.stack([row[key] for row in rows]) for key in rows[0]}
    whole = model.parts(table, batch)
    mapped = torch.func.vmap(lambda values: model.parts(table, values))(batch)
    for part in (0, 1):
        assert whole[part].shape == (len(rows), 9)
        torch.testing.assert_close(whole[part], mapped[part], rtol=1e-13, atol=0)
        for k, row in enumerate(rows):
            torch.testing.assert_close(whole[part][k], model.parts(table, row)[part], rtol=1e-13, atol=0)


def test_equal_exponents_given_apart_are_the_isotropic_lobe() -> None:
    model = MODELS["ashikhmin-shirley"]
    s, o = unit(40, seed=6, up=True), unit(40, seed=7, up=True)
    one = model(n=350.0, r_spec=0.3, r_diff=0.3)(Z, X, s, o)
    two = model(n_u=350.0, n_v=350.0, r_spec=0.3, r_diff=0.3)(Z, X, s, o)
    torch.testing.assert_close(one, two, rtol=1e-10, atol=0)


@pytest.mark.parametrize("name", MODELS)
@SHORT
@given(data=st.data())
def test_values_survive_storage(name: str, data: st.DataObject) -> None:
    """Fixed values to the last digit, learnable ones to the nudge off a bound."""
    values = data.draw(any_values(MODELS[name]))
    fixed, learnable = (MODELS[name](**values, learnable=flag).values() for flag in (False, True))
    for quantity in MODELS[name].quantities:
        assert float(fixed[quantity.name]) == values[quantity.name]
        spread = (
            (quantity.high - quantity.low)
            if quantity.prior != "loguniform"
            else 20 * (values[quantity.name] + 1)
        )
        assert float(learnable[quantity.name].detach()) == pytest.approx(
            values[quantity.name], rel=1e-12, abs=2.1e-9 * spread
        )


def test_paper_values_on_the_bound() -> None:
    for sums in ((0.8, 0.2), (0.7, 0.3), (0.1, 0.9), (1.0, 0.0), (0.0, 1.0)):
        model = MODELS["ashikhmin-shirley"](n=0.0, r_spec=sums[0], r_diff=sums[1], learnable=False)
        assert (float(model.n), float(model.r_spec), float(model.r_diff)) == (0.0, *sums)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("optimiser", [torch.optim.SGD, torch.optim.Adam])
def test_no_step_leaves_the_bounds(name: str, optimiser: type[torch.optim.Optimizer]) -> None:
    values = {q.name: 0.3 * (1 if q.high <= 1 else q.high) for q in MODELS[name].quantities}
    model = MODELS[name](**values)
    steps = optimiser(model.parameters(), lr=3.0)  # type: ignore[call-arg]
    generator = torch.Generator().manual_seed(8)
    for _ in range(200):
        for parameter in model.parameters():
            parameter.grad = 10 * torch.randn((), generator=generator, dtype=torch.float64)
        steps.step()
        now = model.values()
        for quantity in model.quantities:
            assert quantity.low <= float(now[quantity.name].detach()) <= quantity.high
        assert float(sum(now[part].detach() for part in model.simplex)) <= 1.0


def test_module_works_in_a_training_script() -> None:
    """state_dict, deepcopy, functional_call, jacfwd, vmap over parameters, and Adam finding its way back."""
    s, o = at(20.0).expand(30, 3), torch.stack([at(float(a), 180.0) for a in np.linspace(0, 60, 30)])
    truth = MODELS["ashikhmin-shirley"](n=300.0, r_spec=0.4, r_diff=0.2)
    target = truth(Z, X, s, o).detach()
    model = MODELS["ashikhmin-shirley"](n=50.0, r_spec=0.1, r_diff=0.5)
    assert "n=50" in repr(model)
    assert "learnable" in repr(model)

    other = copy.deepcopy(model)
    other.load_state_dict(truth.state_dict())
    torch.testing.assert_close(other(Z, X, s, o), target, rtol=0, atol=0)

    state = {name: p.detach() for name, p in truth.named_parameters()}

    def call(parameters: dict[str, Tensor]) -> Tensor:
        return torch.func.functional_call(model, parameters, (Z, X, s, o))

    torch.testing.assert_close(call(state), target, rtol=0, atol=0)
    forward = torch.func.jacfwd(call)(state)
    reverse = torch.func.jacrev(call)(state)
    for name in state:
        torch.testing.assert_close(forward[name], reverse[name], rtol=1e-10, atol=1e-14)
    many = {name: p + torch.linspace(0, 1, 3, dtype=torch.float64) for name, p in state.items()}
    mapped = torch.func.vmap(call)(many)
    torch.testing.assert_close(mapped[0], target, rtol=1e-12, atol=0)

    adam = torch.optim.Adam(model.parameters(), lr=0.05)
    for _ in range(1500):
        adam.zero_grad()
        torch.log(model(Z, X, s, o) / target).square().mean().backward()
        adam.step()
    assert float(model.n.detach()) == pytest.approx(300.0, rel=1e-3)
    assert float(model.r_spec.detach()) == pytest.approx(0.4, rel=1e-3)


def test_batch_of_materials_and_single_precision() -> None:
    n = torch.tensor([1.0, 100.0, 1e4], dtype=torch.float32)
    model = MODELS["ashikhmin-shirley"](n=n, r_spec=0.3, r_diff=0.3, dtype=torch.float32)
    s, o = unit(5, 2, seed=9, up=True).float(), unit(2, seed=10, up=True).float()
    out = model(Z.float(), X.float(), s, o)
    assert out.shape == (3, 5, 2)
    assert out.dtype == torch.float32
    for k in range(3):
        single = MODELS["ashikhmin-shirley"](n=float(n[k]), r_spec=0.3, r_diff=0.3)
        expected = single(Z, X, s.double(), o.double())
        torch.testing.assert_close(out[k].double(), expected, rtol=1e-2, atol=1e-6)
    assert model(Z.float(), X.float(), Z.float(), Z.float()).shape == (3,)


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
    for spread in (0.0, 0.02**2):
        given = model.broadened(natural, torch.tensor(spread, dtype=torch.float64))
        expected = float(model.lobe_variance(natural)) + spread
        tilt = 0.03 * math.sqrt(expected)
        angles = incidence(*tilted(torch.tensor([0.0, tilt], dtype=torch.float64)), Z, Z)
        specular, _ = model.parts(model.tabulate(*one_row(angles, torch.ones(2).double())), given)
        assert -(tilt**2) / 2 / math.log(specular[1] / specular[0]) == pytest.approx(expected, rel=0.01)


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


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"n": 10.0, "r_spec": 0.5}, "missing"),
        ({"n": 10.0, "r_spec": 0.6, "r_diff": 0.6}, "at most 1"),
        ({"n": -1.0, "r_spec": 0.5, "r_diff": 0.5}, "0 to 1e+06"),
        ({"n": float("nan"), "r_spec": 0.5, "r_diff": 0.5}, "nan"),
        ({"n": 1.0, "r_spec": 0.5, "r_diff": 0.5, "gloss": 1.0}, "unknown"),
    ],
)
def test_impossible_values_are_refused_with_a_reason(values: dict[str, float], word: str) -> None:
    with pytest.raises(InputError, match=word.replace("+", r"\+")):
        MODELS["ashikhmin-shirley"](**values)


def test_models_are_found_without_a_list() -> None:
    """The scene format's seven names, and those beyond it; a class of one's own joins by being defined."""
    promised = {"ashikhmin-shirley", "lambert", "lommel-seeliger-lambert", "phong-mirror", "phong-half"}
    assert promised | {"cook-torrance", "ggx"} | {"oren-nayar", "eon"} | {
        f"{law}-{kind}" for law in ("ggx", "cook-torrance") for kind in ("dielectric", "conductor")
    } == set(MODELS)
    mine = type("Mine", (MODELS["lambert"],), {"model": "mine"})
    assert brdf.MODELS.pop("mine") is mine
    assert all(
        quantity.meaning and quantity.low < quantity.high
        for m in MODELS.values()
        for quantity in m.quantities
    )
