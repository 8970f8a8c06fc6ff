"""Evidence by importance sampling against closed forms, a grid and a mixture; coordinates with a standard normal prior
against scipy; the density of unseen rows under outliers against integrals over data and parameter."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import integrate, optimize, stats

from torchlc.diagnosis.discrepancy import Projection
from torchlc.diagnosis.proof import filtered_log_density
from torchlc.inference.evidence import StudentMixture, importance, pareto, smoothed, tempered
from torchlc.inference.normal_scores import NormalScores
from torchlc.noise.outliers import Mixture
from torchlc.parameters import Free, ParameterSet, Prior
from torchlc.stages.noise import Law


def mixture(share: float, width: float) -> Mixture:
    return Mixture(*(torch.tensor([value], dtype=torch.float64) for value in (share, width)))


LAW = mixture(0.1, 8.0)
SLOPES, SIGMA = np.array([1.0, -0.7, 0.4]), np.array([0.5, 0.8, 0.6])


def filtered(delta: np.ndarray, mean: float, variance: float, law: Law = LAW) -> np.ndarray:
    """Log density (N,) of N sequences of rows delta (N, n) with one parameter."""
    number, rows = delta.shape
    return filtered_log_density(
        torch.full((number, 1), mean, dtype=torch.float64),
        torch.full((number, 1, 1), variance, dtype=torch.float64),
        torch.as_tensor(delta),
        torch.as_tensor(SLOPES[:rows, None]).expand(number, rows, 1),
        torch.as_tensor(SIGMA[:rows]).expand(number, rows),
        torch.ones(number, rows, dtype=torch.bool),
        law,
    ).numpy()


def test_it_integrates_to_one():
    """Over both data of two rows, by Simpson's rule to 80 standard deviations; what lies beyond is below 1e-6."""
    x, y = np.linspace(-60, 60, 1601), np.linspace(-60, 60, 1601)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    height = np.exp(filtered(grid, 0.3, 2.0)).reshape(len(x), len(y))
    assert integrate.simpson(integrate.simpson(height, x=y), x=x) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(
    ("delta", "tolerance"),
    [([0.4, -0.1, 0.2], 0.02), ([0.4, 6.0, 0.2], 0.1), ([5.0, -3.0, 9.0], 0.5), ([30.0, -30.0, 30.0], 1.0)],
)
def test_it_is_near_the_mixture_integrated_over_the_parameter(delta, tolerance):
    """ln of the integral over x of the product of the rows' mixtures, of a parameter known as well as it is once seven
    eighths of the rows are; the tolerance is what a normal kept between rows costs."""

    def height(x: float) -> float:
        u = np.array(delta) - SLOPES * x
        rows = 0.9 * stats.norm.pdf(u, scale=SIGMA) + 0.1 * stats.norm.pdf(u, scale=8 * SIGMA)
        return float(rows.prod() * stats.norm.pdf(x, 0.1, 0.3))

    expected = math.log(integrate.quad(height, -4, 4, points=[0.1], epsabs=0)[0])
    assert filtered(np.array([delta]), 0.1, 0.09)[0] == pytest.approx(expected, abs=tolerance)


def test_without_outliers_it_is_the_joint_normal_density():
    delta = np.array([[0.4, -2.0, 0.2], [3.0, 1.0, -1.0]])
    covariance = 2.0 * np.outer(SLOPES, SLOPES) + np.diag(SIGMA**2)
    expected = stats.multivariate_normal.logpdf(delta, 0.3 * SLOPES, covariance)
    none = mixture(1e-300, 8.0)
    np.testing.assert_allclose(filtered(delta, 0.3, 2.0, none), expected, rtol=1e-9)


def test_rows_that_are_not_there_count_nothing():
    delta = np.array([[0.4, -2.0, 0.2]])
    full = filtered(delta[:, :2], 0.3, 2.0)[0]
    cut = filtered_log_density(
        torch.full((1, 1), 0.3, dtype=torch.float64),
        torch.full((1, 1, 1), 2.0, dtype=torch.float64),
        torch.as_tensor(delta),
        torch.as_tensor(SLOPES[None, :, None]),
        torch.as_tensor(SIGMA[None]),
        torch.tensor([[True, True, False]]),
        LAW,
    )
    assert float(cut[0]) == pytest.approx(full, rel=1e-12)


# ------------------------------------------------------------------ importance sampling


def normal(size: int, spread: float = 1.0, dof: int = 5) -> StudentMixture:
    return StudentMixture(
        torch.zeros(1, size, dtype=torch.float64),
        spread * torch.eye(size, dtype=torch.float64)[None],
        torch.zeros(1, dtype=torch.float64),
        dof,
    )


def test_the_proposal_is_the_t_distribution_of_scipy():
    """Its density, and the covariance of its draws, which for 5 degrees of freedom is 5/3 of its scale; 40,000 draws give a
    variance of so heavy tails to some 3 %."""
    scale = np.array([[2.0, 0.6], [0.6, 0.5]])
    one = StudentMixture(
        torch.tensor([[1.0, -2.0]], dtype=torch.float64),
        torch.tensor(scale[None]),
        torch.zeros(1, dtype=torch.float64),
    )
    x = np.array([[0.0, 0.0], [1.0, -2.0], [9.0, 4.0]])
    expected = stats.multivariate_t([1.0, -2.0], scale, df=5).logpdf(x)
    np.testing.assert_allclose(one.log_density(torch.tensor(x)), expected, rtol=1e-12)
    draws = one.draw(40_000, torch.Generator().manual_seed(1)).numpy()
    np.testing.assert_allclose(np.cov(draws.T), scale * 5 / 3, rtol=0.08)


@pytest.mark.parametrize("size", [1, 6, 15])
def test_the_evidence_of_a_regression_is_the_normal_one(size):
    """y = M x + noise: log N(y; 0, 1 + M M') within five standard errors, which are what they say."""
    random = np.random.default_rng(size)
    m, y = random.normal(size=(30, size)), random.normal(size=30) * 3
    expected = stats.multivariate_normal(np.zeros(30), np.eye(30) + m @ m.T).logpdf(y)
    precision = np.eye(size) + m.T @ m
    mean = np.linalg.solve(precision, m.T @ y)
    tm, ty = torch.tensor(m), torch.tensor(y)

    def log_density(x):
        left = ty - x @ tm.T
        constant = -0.5 * (30 + size) * math.log(2 * math.pi)
        return constant - 0.5 * left.square().sum(-1) - 0.5 * x.square().sum(-1)

    proposal = StudentMixture(
        torch.tensor(mean)[None],
        torch.tensor(np.linalg.inv(precision))[None],
        torch.zeros(1, dtype=torch.float64),
    )
    found = importance(log_density, proposal, 4000, torch.Generator().manual_seed(3))
    assert found.trusted and 0 < found.error < 0.1
    assert abs(found.log_z - expected) < 5 * found.error
    weight = torch.exp(found.log_weight)
    spread = np.sqrt(np.diag(np.linalg.inv(precision)) / found.effective)
    np.testing.assert_array_less(np.abs((weight @ found.draws).numpy() - mean), 5 * spread)


def test_two_maxima_and_a_bent_ridge_against_a_grid():
    """A banana and a small peak beside it, in two dimensions: the sum over a grid of 1200 x 1200."""

    def log_density(x):
        banana = -0.5 * (x[:, 0] / 1.5) ** 2 - 0.5 * ((x[:, 1] - 0.4 * x[:, 0] ** 2) / 0.3) ** 2
        peak = -0.5 * ((x - x.new_tensor([4.0, -3.0])) / 0.25).square().sum(-1) - 0.7
        return torch.logaddexp(banana, peak)

    axis = torch.linspace(-9, 12, 1200, dtype=torch.float64)
    grid = torch.cartesian_prod(axis, axis)
    step = float(axis[1] - axis[0])
    expected = float(torch.logsumexp(log_density(grid), 0)) + 2 * math.log(step)
    proposal = StudentMixture(
        torch.tensor([[0.0, 0.0], [4.0, -3.0]], dtype=torch.float64),
        torch.stack([torch.diag(torch.tensor([2.25, 0.09])), 0.0625 * torch.eye(2)]).double(),
        torch.tensor([0.0, -2.0], dtype=torch.float64),
    )
    found = importance(log_density, proposal, 8000, torch.Generator().manual_seed(5), adaptations=3)
    assert found.log_z == pytest.approx(expected, abs=max(4 * found.error, 0.02))
    assert found.error < 0.06
    near = (found.draws - found.draws.new_tensor([4.0, -3.0])).norm(dim=-1) < 1.5
    share = float(torch.exp(found.log_weight)[near].sum())
    inside = (grid - grid.new_tensor([4.0, -3.0])).norm(dim=-1) < 1.5
    height = torch.softmax(log_density(grid), 0)
    assert share == pytest.approx(float(height[inside].sum()), abs=0.03)


def test_a_proposal_that_is_too_narrow_says_so_and_is_adapted():
    """A normal density of unit variance drawn from one a fifth as wide: k above 0.7, and the integral 1 once adapted."""

    def log_density(x):
        return -0.5 * x.square().sum(-1) - math.log(2 * math.pi)

    narrow = normal(2, 0.04, dof=40)
    blind = importance(
        log_density, narrow, 2000, torch.Generator().manual_seed(1), adaptations=0, moving=False
    )
    assert not blind.trusted
    seeing = importance(log_density, narrow, 2000, torch.Generator().manual_seed(1), adaptations=12)
    assert seeing.pareto_k < blind.pareto_k
    assert abs(seeing.log_z) < 0.15 < abs(blind.log_z)


@pytest.mark.parametrize("k", [-0.3, 0.2, 0.8])
def test_the_shape_of_pareto_excesses_is_found(k):
    """Draws of scipy's; the estimate's standard deviation is (1 + k) / sqrt(n), 0.02 to 0.04 of 2000."""
    draws = np.sort(stats.genpareto(k, scale=2.0).rvs(2000, random_state=1))
    shape, scale = pareto(torch.tensor(draws))
    assert shape == pytest.approx(k, abs=0.1)
    assert scale == pytest.approx(2.0, rel=0.15)


def test_smoothing_keeps_the_order_and_the_sum():
    ratio = torch.randn(1000, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    smooth, k = smoothed(ratio)
    assert k < 0.5
    assert torch.equal(torch.argsort(smooth), torch.argsort(ratio))
    assert float(torch.logsumexp(smooth, 0)) == pytest.approx(float(torch.logsumexp(ratio, 0)), abs=0.02)


def test_gains_are_the_ratio_of_dense_normal_densities():
    """log N(y; 0, 1 + J J' + a^2 F F') - log N(y; 0, 1 + J J') with full matrices, F at some of the rows."""
    random = np.random.default_rng(4)
    j, f, mean = random.normal(size=(25, 4)), np.zeros((25, 3)), random.normal(size=4)
    index = torch.tensor([3, 4, 8, 9, 11, 17, 20])
    f[index] = random.normal(size=(len(index), 3))
    u = random.normal(size=25)
    y, zero = u - j @ mean, np.zeros(25)
    base = np.eye(25) + j @ j.T
    plain = stats.multivariate_normal(zero, base).logpdf(y)
    projection = Projection(torch.tensor(u), torch.tensor(j), torch.tensor(mean))
    amplitudes = torch.tensor([0.7, 3.0], dtype=torch.float64)
    found = projection.gains(torch.tensor(f)[index][None], amplitudes, index[None])
    whole = projection.gains(torch.tensor(f)[None], amplitudes)
    for number, a in enumerate(amplitudes.tolist()):
        expected = stats.multivariate_normal(zero, base + a**2 * f @ f.T).logpdf(y) - plain
        assert float(found[number, 0]) == pytest.approx(expected, abs=1e-9)
        assert float(whole[number, 0]) == pytest.approx(expected, abs=1e-9)


# ------------------------------------------------------------------ coordinates


def parameters(
    *priors: Prior, pairs: tuple[tuple[int, int], ...] = (), coupled: bool = False
) -> ParameterSet:
    free = [Free(f"p{index}", prior, 0.5 * (prior.low + prior.high)) for index, prior in enumerate(priors)]
    named = [(f"p{a}", f"p{b}") for a, b in pairs]
    return ParameterSet(free, {}, named, coupled=named if coupled else ())


def test_standard_normal_coordinates_give_the_priors():
    """Each quantile at Phi(g) against scipy's distributions, and back."""
    numbers = parameters(
        Prior("uniform", 2.0, 5.0),
        Prior("loguniform", 1.0, 1e6),
        Prior("normal", -math.inf, math.inf, 1.8, 0.2),
        Prior("normal", 0.0, 1.0, 0.3, 0.4),
        Prior("halfnormal", 0.0, 2.0, 0.0, 0.05),
        Prior("lognormal", 0.0, math.inf, 3.0, 0.5),
        Prior("isotropic", -90.0, 90.0),
    )
    scores = NormalScores(numbers)
    g = torch.linspace(-3, 3, 13, dtype=torch.float64)[:, None].expand(-1, 7)
    p = stats.norm.cdf(g[:, 0])
    cut = stats.truncnorm((0 - 0.3) / 0.4, (1 - 0.3) / 0.4, 0.3, 0.4)
    half = stats.truncnorm(0, 40, 0, 0.05)
    expected = np.stack(
        [
            2 + 3 * p, 10 ** (6 * p), stats.norm(1.8, 0.2).ppf(p), cut.ppf(p), half.ppf(p),
            stats.lognorm(0.5, scale=3.0).ppf(p), np.degrees(np.arcsin(2 * p - 1)),
        ],
        -1,
    )  # fmt: skip
    np.testing.assert_allclose(scores.theta(g), expected, rtol=1e-9)
    torch.testing.assert_close(scores.scores(scores.theta(g)), g, rtol=0, atol=1e-6)


def test_two_reflectances_are_uniform_on_their_triangle():
    """20,000 normal coordinates: shares of four equal parts of the triangle, and back."""
    scores = NormalScores(parameters(Prior("uniform", 0.0, 1.0), Prior("uniform", 0.0, 1.0), pairs=((0, 1),)))
    g = torch.randn(20_000, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    first, second = scores.theta(g).unbind(-1)
    assert bool((first + second <= 1).all())
    corners = [first > 0.5, second > 0.5, first + second < 0.5]
    shares = [float(one.double().mean()) for one in corners]
    np.testing.assert_allclose(shares, 0.25, atol=0.01)  # 3 standard deviations
    torch.testing.assert_close(scores.scores(scores.theta(g)), g, rtol=0, atol=1e-5)


def test_what_diffuse_light_leaves_open_of_two_reflectances_is_integrated():
    """r_diff (1 - r_spec) known to 0.3 %, r_spec not at all: a bent line in both. Of a uniform triangle the density of d is -ln d, and
    the share of r_spec below r is ln(1 - r) / ln(d) * 2."""
    box = Prior("uniform", 0.0, 1.0)
    scores = NormalScores(parameters(box, box, pairs=((0, 1),), coupled=True))
    known, error = 0.377, 0.001
    g = torch.randn(20_000, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    first, second = scores.theta(g).unbind(-1)
    shares = [
        float(one.double().mean())
        for one in (first > 0.5, second > 0.5, (first + second < 0.5), first < 0.25)
    ]
    np.testing.assert_allclose(shares, [0.25, 0.25, 0.25, 1 - 0.75**2], atol=0.01)
    torch.testing.assert_close(scores.scores(scores.theta(g)), g, rtol=0, atol=1e-5)
    other_first, other_second = scores.theta(g * torch.tensor([0.1, 1.0])).unbind(-1)
    torch.testing.assert_close(second * (1 - first), other_second * (1 - other_first), rtol=1e-9, atol=1e-12)

    def log_density(at):
        r_spec, r_diff = scores.theta(at).unbind(-1)
        return (
            -0.5 * ((r_diff * (1 - r_spec) - known) / error) ** 2
            - 0.5 * at.square().sum(-1)
            - math.log(2 * math.pi)
        )

    centre = scores.scores(torch.tensor([0.2, known / 0.8], dtype=torch.float64))
    centre[0] = 0.0
    slope = torch.func.jacrev(lambda at: scores.theta(at)[1] * (1 - scores.theta(at)[0]))(centre) / error
    covariance = torch.linalg.inv(torch.outer(slope, slope) + torch.eye(2, dtype=torch.float64))
    proposal = StudentMixture(centre[None], covariance[None], torch.zeros(1, dtype=torch.float64))
    found = importance(log_density, proposal, 500, torch.Generator().manual_seed(3))
    assert found.trusted and found.effective > 150
    expected = math.log(-math.log(known) * error * math.sqrt(2 * math.pi))
    assert found.log_z == pytest.approx(expected, abs=0.15)
    r_spec = scores.theta(found.draws)[:, 0]
    weight = torch.exp(found.log_weight)
    for r in (0.1, 0.2, 0.3):
        share = 2 * math.log(1 - r) / math.log(known)
        assert float(weight[r_spec < r].sum()) == pytest.approx(share, abs=0.1)  # three sd of 200 draws


def as_scipy(prior: Prior):
    if prior.kind == "normal":
        low, high = ((end - prior.centre) / prior.sigma for end in (prior.low, prior.high))
        return stats.truncnorm(low, high, prior.centre, prior.sigma)
    if prior.kind == "loguniform":
        return stats.loguniform(prior.low, prior.high)
    return stats.uniform(prior.low, prior.high - prior.low)


@pytest.mark.parametrize(
    "first, second",
    [
        (Prior("normal", 0.0, 1.0, 0.3, 0.2), Prior("normal", 0.0, 1.0, 0.5, 0.3)),
        (Prior("uniform", 0.0, 1.0), Prior("normal", 0.0, 1.0, 0.29, 0.05)),
        (Prior("normal", 0.0, 1.0, 0.7, 0.05), Prior("uniform", 0.1, 1.0)),
        (Prior("loguniform", 0.01, 1.0), Prior("uniform", 0.0, 0.6)),
    ],
)
def test_a_pair_with_other_priors_has_their_density_on_the_triangle(first, second):
    """ln prior + ln |d theta / d g| - ln N(g) is the logarithm of what the triangle holds of both priors, which scipy integrates; and back."""
    numbers = parameters(first, second, pairs=((0, 1),))
    scores = NormalScores(numbers)
    g = 0.8 * torch.randn(40, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    step = 1e-5 * torch.eye(2, dtype=torch.float64)
    columns = [(scores.theta(g + step[k]) - scores.theta(g - step[k])) / 2e-5 for k in range(2)]
    log_det = torch.linalg.slogdet(torch.stack(columns, -1))[1]
    density = numbers.log_prior(scores.theta(g)) + log_det + 0.5 * g.square().sum(-1) + math.log(2 * math.pi)
    one, other = (as_scipy(prior) for prior in (first, second))
    kinks = [1 - second.high, first.centre, 1 - second.centre]
    whole = integrate.quad(
        lambda x: one.pdf(x) * other.cdf(1 - x), first.low, first.high, points=[x for x in kinks if 0 < x < 1]
    )[0]
    torch.testing.assert_close(density, torch.full_like(density, math.log(whole)), rtol=0, atol=2e-4)
    torch.testing.assert_close(scores.scores(scores.theta(g)), g, rtol=0, atol=1e-5)


def test_a_pair_has_no_coordinate_where_both_priors_leave_no_room():
    """A second that is known to be 0.29 leaves the first below 0.71 + what 7 standard deviations are: no g leads beyond."""
    scores = NormalScores(
        parameters(Prior("uniform", 0.0, 1.0), Prior("normal", 0.0, 1.0, 0.29, 0.008), pairs=((0, 1),))
    )
    g = torch.stack(
        [torch.linspace(-7, 7, 141, dtype=torch.float64), torch.zeros(141, dtype=torch.float64)], -1
    )
    first, second = scores.theta(g).unbind(-1)
    assert bool((torch.diff(first) >= 0).all()) and 0.70 < float(first.max()) < 0.78
    assert float(((second - 0.29) / 0.008).abs().max()) < 7.5


def test_a_plateau_that_no_curvature_tells_of():
    """A standard normal prior in four dimensions, cut off by likelihoods Phi(k (c - g)), whose integrals are closed:
    Phi(k c / sqrt(1 + k^2)). The normal distribution about the maximum is half as wide as the plateau."""
    k = torch.tensor([8.0, 3.0, 20.0, 8.0], dtype=torch.float64)
    cut = torch.tensor([-1.0, -0.5, 0.5, 0.0], dtype=torch.float64)

    def log_density(g):
        prior = -0.5 * g.square().sum(-1) - 2 * math.log(2 * math.pi)
        return prior + torch.special.log_ndtr(k * (cut - g)).sum(-1)

    start = torch.zeros(4, dtype=torch.float64)
    reached = optimize.minimize(lambda g: -float(log_density(torch.as_tensor(g)[None])[0]), start.numpy())
    mean, covariance = torch.as_tensor(reached.x), torch.as_tensor(reached.hess_inv)
    proposal = StudentMixture(
        torch.stack([mean, start]),
        torch.stack([covariance, torch.eye(4, dtype=torch.float64)]),
        torch.log(torch.tensor([0.9, 0.1], dtype=torch.float64)),
    )
    exact = float(torch.special.log_ndtr(k * cut / torch.sqrt(1 + k**2)).sum())
    for seed in range(5):
        generator = torch.Generator().manual_seed(seed)
        assert tempered(log_density, proposal, 2000, generator).log_z == pytest.approx(exact, abs=0.3)
        assert importance(log_density, proposal, 2000, generator).log_z == pytest.approx(exact, abs=0.2)
