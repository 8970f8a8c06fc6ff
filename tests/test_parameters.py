"""Priors against SciPy's distributions, numerical integrals, finite differences and the sampler."""

from __future__ import annotations

import math

import emcee
import numpy as np
import pytest
import torch
from scipy import integrate, stats

import torchlc
from tests.effects.cases import seen_from, still
from torchlc.effects import registry
from torchlc.errors import InputError
from torchlc.lightcurve.assembly import assemble
from torchlc.parameters import Free, ParameterSet, Prior
from torchlc.parameters.prior import PRIORS, prior_of

BOUNDS = [(-90.0, 90.0), (-30.0, 75.0), (80.0, 90.0), (-89.0, -88.0)]
EVERY = [
    Prior("uniform", -2.0, 3.0),
    Prior("loguniform", 0.1, 50.0),
    *(Prior("isotropic", low, high) for low, high in BOUNDS),
    Prior("normal", -1.0, 2.0, 0.5, 0.8),
    Prior("lognormal", 0.0, math.inf, 2.0, 0.5),
    Prior("halfnormal", 0.0, math.inf, 0.0, 1.5),
    Prior("cauchy", -180.0, 180.0, 4.0, 2.5),
    Prior("cauchy", -1.0, math.inf, 0.0, 0.3),
]
PLATE = (
    '[[components]]\nname = "plate"\nshape = "plate"\nsize = [1.0, 1.0]\ncentre = [0, 0, 0]\n'
    'u = [1, 0, 0]\nv = [0, 1, 0]\nmaterial = "white"\n'
)
WHITE = '[materials.white]\nmodel = "lambert"\nalbedo = 0.5\n'


def one_by_one(*priors: Prior) -> ParameterSet:
    return ParameterSet([Free(f"p{k}", prior, _start(prior)) for k, prior in enumerate(priors)], {})


def _start(prior: Prior) -> float:
    return float(prior.quantile(torch.tensor(0.4, dtype=torch.float64)))


def test_every_kind_is_tried():
    assert {prior.kind for prior in EVERY} == set(PRIORS)


@pytest.mark.parametrize("prior", EVERY)
def test_densities_integrate_to_one(prior):
    """SciPy's adaptive quadrature; and the vectorised density is the single one."""
    low = prior.low
    high = (
        prior.high if prior.kind == "cauchy" else min(prior.high, 200.0)
    )  # others' tails beyond are below 1e-15

    def density(x):
        return math.exp(float(prior.log_density(torch.tensor(x, dtype=torch.float64))))

    total, _ = integrate.quad(density, low, high, limit=400, epsabs=1e-10)
    assert total == pytest.approx(1.0, abs=1e-7)
    theta = prior.quantile(torch.rand(20, 1, dtype=torch.float64))
    together = one_by_one(prior).log_prior(theta)
    torch.testing.assert_close(together, prior.log_density(theta)[:, 0], rtol=1e-12, atol=1e-12)


def test_a_cauchy_density_is_scipys():
    """Truncated to its bounds; to 1e-12, the rounding of an arc tangent near pi / 2."""
    prior = Prior("cauchy", -180.0, 180.0, 4.0, 2.5)
    x = np.linspace(-179.0, 179.0, 57)
    law = stats.cauchy(4.0, 2.5)
    expected = law.logpdf(x) - math.log(law.cdf(180.0) - law.cdf(-180.0))
    np.testing.assert_allclose(prior.log_density(torch.as_tensor(x)), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("prior", EVERY)
def test_draws_follow_the_density(prior):
    """Kolmogorov-Smirnov against the integral of the density."""
    parameters = one_by_one(prior)
    draws = parameters.sample_prior(4000, torch.Generator().manual_seed(3))[:, 0].numpy()
    grid = np.linspace(max(prior.low, draws.min() - 1e-9), min(prior.high, draws.max() + 1e-9), 20001)
    density = np.exp(prior.log_density(torch.as_tensor(grid)).numpy())
    cumulative = integrate.cumulative_trapezoid(np.where(np.isfinite(density), density, 0.0), grid, initial=0)
    shares = np.interp(draws, grid, cumulative / cumulative[-1])
    assert stats.kstest(shares, stats.uniform.cdf).pvalue > 1e-3


@pytest.mark.parametrize(("low", "high"), BOUNDS)
def test_directions_are_uniform_on_the_sphere(low, high):
    """Points uniform on the sphere (normals of length one) whose latitude is within the bounds have uniform sines."""
    prior = Prior("isotropic", low, high)
    draws = one_by_one(prior).sample_prior(4000, torch.Generator().manual_seed(4))[:, 0].numpy()
    assert draws.min() >= low and draws.max() <= high
    normals = np.random.default_rng(5).normal(size=(400_000, 3))
    latitude = np.degrees(np.arcsin(normals[:, 2] / np.linalg.norm(normals, axis=1)))
    latitude = latitude[(latitude >= low) & (latitude <= high)]
    if len(latitude) > 100:
        assert stats.ks_2samp(draws, latitude).pvalue > 1e-3
    sines = np.sin(np.radians([low, high]))
    assert stats.kstest(np.sin(np.radians(draws)), stats.uniform(sines[0], np.ptp(sines)).cdf).pvalue > 1e-3


@pytest.mark.parametrize("prior", EVERY)
def test_coordinates_go_there_and_back(prior):
    """Unconstrained, flat and straight coordinates, bounds included; and the slopes that the sampler adds."""
    parameters = one_by_one(prior)
    theta = prior.quantile(torch.linspace(0.0, 1.0, 41, dtype=torch.float64))[:, None]
    inside = theta[1:-1]
    back = parameters.to_natural(parameters.to_unconstrained(inside))
    torch.testing.assert_close(back, inside, rtol=1e-8, atol=1e-6)
    torch.testing.assert_close(parameters.from_flat(parameters.to_flat(theta)), theta, rtol=1e-9, atol=1e-6)
    assert torch.isfinite(parameters.to_unconstrained(theta)).all()
    x = parameters.to_straight(inside)
    again, log_det = parameters.from_straight(x)
    torch.testing.assert_close(again, inside, rtol=1e-9, atol=1e-9)
    step = 1e-6
    slope = (parameters.from_straight(x + step)[0] - parameters.from_straight(x - step)[0]) / (2 * step)
    torch.testing.assert_close(log_det, torch.log(slope)[:, 0], rtol=0, atol=1e-5)


@pytest.mark.parametrize("prior", EVERY)
def test_gradients_of_the_density_match_central_differences(prior):
    parameters = one_by_one(prior)
    theta = prior.quantile(torch.linspace(0.03, 0.97, 15, dtype=torch.float64))[:, None].requires_grad_()
    (gradient,) = torch.autograd.grad(parameters.log_prior(theta).sum(), theta)
    step = 1e-5 * min(1.0, prior.high - prior.low)
    with torch.no_grad():
        ends = [parameters.log_prior(theta + sign * step) for sign in (1, -1)]
    torch.testing.assert_close(gradient[:, 0], (ends[0] - ends[1]) / (2 * step), rtol=1e-5, atol=1e-6)
    z = parameters.to_unconstrained(theta.detach()).requires_grad_()
    (through,) = torch.autograd.grad(parameters.to_natural(z).sum(), z)
    with torch.no_grad():
        moved = (parameters.to_natural(z + 1e-5) - parameters.to_natural(z - 1e-5)) / 2e-5
    torch.testing.assert_close(through, moved, rtol=1e-5, atol=1e-7)


def test_bounds_at_the_poles_have_finite_gradients():
    """At a pole the latitude has no slope against its sine; what comes back is a number, as it is beyond."""
    parameters = one_by_one(Prior("isotropic", -90.0, 90.0))
    y = torch.tensor([[-1.1], [-1.0], [1.0], [1.1]], dtype=torch.float64, requires_grad=True)
    theta, log_det = parameters.from_straight(y)
    (gradient,) = torch.autograd.grad(theta.sum() + log_det.sum(), y)
    assert torch.isfinite(gradient).all() and torch.isfinite(log_det).all()
    assert theta[1:3, 0].tolist() == pytest.approx([-90.0, 90.0], abs=1e-9)
    outside = parameters.log_prior(theta)
    assert outside[[0, 3]].tolist() == [-math.inf] * 2


def test_the_sampler_of_the_prior_alone_gives_it_back():
    """emcee in straight coordinates with the slopes added, as in a fit, against a sine that is uniform."""
    parameters = one_by_one(Prior("isotropic", -90.0, 60.0), Prior("uniform", -180.0, 180.0))

    def density(x):
        theta, log_det = parameters.from_straight(torch.as_tensor(x))
        total = parameters.log_prior(theta) + log_det
        return torch.where(torch.isfinite(total), total, -math.inf).numpy()

    start = parameters.to_straight(parameters.sample_prior(64, torch.Generator().manual_seed(1))).numpy()
    sampler = emcee.EnsembleSampler(64, 2, density, vectorize=True)
    state = emcee.State(start, random_state=np.random.RandomState(2).get_state())
    sampler.run_mcmc(state, 2000)
    chain = sampler.get_chain(thin=50, discard=200, flat=True)  # thinned to about its autocorrelation time
    theta = parameters.from_straight(torch.as_tensor(chain))[0].numpy()
    sines = np.sin(np.radians(theta[:, 0]))
    assert stats.kstest(sines, stats.uniform(-1.0, 1.0 + math.sin(math.radians(60.0))).cdf).pvalue > 1e-3
    assert stats.kstest(theta[:, 1], stats.uniform(-180.0, 360.0).cdf).pvalue > 1e-3


def test_every_direction_of_the_library_is_isotropic():
    """Each latitude that an effect declares, told by its unit and its bounds from pole to pole."""
    latitudes = [
        quantity
        for effect in registry().values()
        for quantity in effect.quantities
        if quantity.unit == "deg" and (quantity.low, quantity.high) == (-90.0, 90.0)
    ]
    assert len(latitudes) == 2
    assert {prior_of(quantity).kind for quantity in latitudes} == {"isotropic"}


def scene_of(attitude: str, parameters: str = "", effects: str = "[]") -> torchlc.Scene:
    return torchlc.Scene.from_toml(
        f'format = "torchlc-scene/1"\nname = "x"\n[orbit]\nvectors = "icrs"\n[attitude]\n{attitude}\n{PLATE}{WHITE}'
        f"[model]\neffects = {effects}\n[model.parameters]\nband_sun_magnitude = -26.7\n{parameters}\n"
    )


def assembled(tmp_path, scene):
    recording = seen_from(still(PLATE, WHITE), tmp_path, [[0, 0, 1.0]] * 2, [[0, 0, 1.0]] * 2)
    return assemble(scene, recording)


POLE = 'mode = "spin-pole"\nperiod = 5.0\nphase = 0.0\nepoch = 2459000.5\npole = [{{ value = 20.0, low = -180.0, high = 180.0 }}, {{ {latitude} }}]'


@pytest.mark.parametrize(
    ("latitude", "prior", "warned"),
    [
        ('value = 10.0, prior = "isotropic"', Prior("isotropic", -90.0, 90.0), False),
        ('value = 10.0, low = -5.0, high = 40.0, prior = "isotropic"', Prior("isotropic", -5.0, 40.0), False),
        ("value = 10.0, low = -90.0, high = 90.0", Prior("uniform", -90.0, 90.0), True),
        ('value = 10.0, low = -90.0, high = 90.0, prior = "uniform"', Prior("uniform", -90.0, 90.0), False),
    ],
)
def test_a_pole_may_be_isotropic(tmp_path, latitude, prior, warned):
    """A prior that is named is taken; bounds alone are the format's uniform, with a warning."""
    scene = scene_of(POLE.format(latitude=latitude))
    assembly = assembled(tmp_path, scene)
    free = {one.name: one.prior for one in assembly.parameters.free}
    assert (free["attitude.pole_lat"].kind, free["attitude.pole_lat"].low, free["attitude.pole_lat"].high) == (
        prior.kind, prior.low, prior.high,
    )  # fmt: skip
    assert any("uniform on the sphere" in warning for warning in assembly.warnings) is warned
    assert torchlc.Scene.from_toml(scene.to_toml()) == scene


@pytest.mark.parametrize(
    ("attitude", "parameters", "word"),
    [
        ('mode = "inertial"\nx_angle = { value = 1.0, prior = "isotropic" }', "", "attitude.x_angle.prior"),
        ('mode = "inertial"', '"wobble.axis_lon" = { value = 1.0, prior = "isotropic" }', "wobble.axis_lon.prior"),
        ('mode = "inertial"', 'zero_point = { value = 1.0, prior = "isotropic" }', "no latitude"),
    ],
)  # fmt: skip
def test_what_is_no_latitude_is_not_isotropic(tmp_path, attitude, parameters, word):
    with pytest.raises(InputError, match=word.replace(".", r"\.")):
        assembled(tmp_path, scene_of(attitude, parameters, '["wobble"]'))


def test_a_latitude_beyond_a_pole_is_refused():
    with pytest.raises(InputError, match="-90 to 90, a latitude"):
        scene_of(POLE.format(latitude='value = 10.0, low = -100.0, high = 40.0, prior = "isotropic"'))
