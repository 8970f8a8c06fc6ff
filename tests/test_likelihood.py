"""Every kind of row under every kind of noise against densities written with SciPy and integrated numerically."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import integrate, interpolate, optimize, stats

from tests.effects.cases import PLATE, material, seen_from, still, tilted
from torchlc.api import fit
from torchlc.diagnosis.gate import Battery, gate
from torchlc.diagnosis.hypotheses import Hypothesis
from torchlc.errors import InputError
from torchlc.inference.density import Posterior
from torchlc.inference.likelihood import LEFT_WEAK_MAG, Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.inference.posterior import fitted_at
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.error_law import above_zero, error_powers, power_difference
from torchlc.noise.outliers import Mixture
from torchlc.noise.red_noise import Matern32
from torchlc.scene import Scene
from torchlc.stages.noise import Noise

FREE = '[materials.white]\nmodel = "lambert"\nalbedo = {value = 0.5, low = 0.05, high = 1.0}\n'
KNOWN = '[materials.white]\nmodel = "lambert"\nalbedo = 0.5\n'
GLOSSY = (
    '[materials.white]\nn = {value = 30.0, low = 1.0, high = 1e4, prior = "loguniform"}\n'
    "r_spec = {value = 0.3, low = 0.0, high = 1.0}\nr_diff = {value = 0.3, low = 0.0, high = 1.0}\n"
    '[materials.black]\nmodel = "lambert"\nalbedo = 0.0\n'
)
LIMITS = [1, 4]
JITTER, RED, TAU, SHARE, WIDTH = 0.07, 0.1, 0.2, 0.15, 6.0
MAG_PER_LN = 2.5 / math.log(10)
NOISE = {
    "quoted": {},
    "jitter": {"jitter": JITTER},
    "outliers": {"outliers": SHARE, "width": WIDTH},
    "jitter and outliers": {"jitter": JITTER, "outliers": SHARE, "width": WIDTH},
    "red noise": {"red": RED, "tau": TAU},
    "red noise and jitter": {"red": RED, "tau": TAU, "jitter": JITTER},
}


def noise_of(name: str, likelihood: Likelihood) -> Noise:
    values = {key: torch.tensor([value], dtype=torch.float64) for key, value in NOISE[name].items()}
    noise = Noise()
    if "jitter" in values:
        noise = noise.wider(values["jitter"])
    if "outliers" in values:
        noise = noise.with_law(Mixture(values["outliers"], values["width"]))
    if "red" in values:
        seconds = likelihood.model.assembly.context.seconds
        noise = noise.with_process(Matern32(values["red"], values["tau"], seconds))
    return noise


@pytest.fixture(scope="module")
def seven(tmp_path_factory):
    """Seven rows of a white plate that fades by a magnitude, one every second."""
    scene = still(PLATE, FREE)
    folder = tmp_path_factory.mktemp("seven")
    return scene, seen_from(scene, folder, tilted(np.linspace(5, 65, 7)), tilted(10, 180))


def recorded(
    seven, kind: str, limits: list[int], fitted: bool = False
) -> tuple[Likelihood, np.ndarray, torch.Tensor]:
    """Of rows with residuals of a few errors the likelihood, the model in the recording's unit before gains, and
    theta."""
    scene, rows = seven
    model = LightCurve(scene, rows)
    mag = model(model.theta()).detach().numpy()
    off = np.array([0.05, -0.09, 0.02, -0.06, 0.04, 0.11, -0.03])
    error = np.array([0.04, 0.08, 0.05, 0.03, 0.06, 0.05, 0.07])
    light = mag if kind == "mag" else 10 ** (-0.4 * (mag - mag.min()))
    observed = mag + off if kind == "mag" else 3.0 * light * (1 - off)
    if kind == "flux":
        error = error * light * 3.0
    upper = np.isin(np.arange(7), limits)
    recording = replace(
        rows, kind=kind, observed=observed, error=None if fitted else error, upper_limit=upper
    )
    likelihood = Likelihood(LightCurve(scene, recording))
    return likelihood, light, likelihood.model.theta().detach()


def normal_mixture(x, centre, sd, noise):
    """Density of one row, with outliers where there are any."""
    share, width = noise.get("outliers", 0.0), noise.get("width", 1.0)
    return (1 - share) * stats.norm.pdf(x, centre, sd) + share * stats.norm.pdf(x, centre, width * sd)


def beyond(limit, centre, sd, noise, kind):
    """Integral of a row's density over all that is fainter than its limit."""
    reach = 12 * noise.get("width", 1.0) * sd
    ends = (limit, max(limit, centre) + reach) if kind == "mag" else (min(limit, centre) - reach, limit)
    x = np.linspace(*ends, 4001)
    return float(integrate.simpson(normal_mixture(x, centre, sd, noise), x=x))


def expected_rows(observed, centre, sd, limit, noise, kind) -> float:
    """Sum of the logarithms of independent rows."""
    parts = [
        beyond(x, c, s, noise, kind) if low else normal_mixture(x, c, s, noise)
        for x, c, s, low in zip(observed, centre, sd, limit, strict=True)
    ]
    return float(np.log(parts).sum()) if min(parts) > 0 else -math.inf


def prediction(observed, light, error, limit, kind) -> np.ndarray:
    if kind == "mag":
        return light
    slope = np.linalg.lstsq((light / error)[~limit, None], (observed / error)[~limit], rcond=None)[0]
    return slope * light


@pytest.mark.parametrize("limits", [[], LIMITS, [2]], ids=["measured", "limits", "a limit"])
@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_density_with_quoted_errors(seven, kind, noise, limits):
    """Independent rows to rounding of the quadrature; rows that err together to the error of log_orthant and of
    SciPy's integral, 1e-3."""
    likelihood, light, theta = recorded(seven, kind, limits)
    recording, values = likelihood.model.recording, NOISE[noise]
    observed, error, limit = recording.observed, recording.error, recording.upper_limit
    centre = prediction(observed, light, error, limit, kind)
    # a magnitude of noise as flux: its share of the light, not below a quarter of the median
    floor = 0.25 * np.median(np.abs(observed[~limit]))
    unit = np.ones(7) if kind == "mag" else np.maximum(centre, floor) / MAG_PER_LN
    sd = np.hypot(error, values.get("jitter", 0.0) * unit)
    found = float(likelihood.log_likelihood(theta, noise_of(noise, likelihood)))
    if "red" not in values:
        assert found == pytest.approx(expected_rows(observed, centre, sd, limit, values, kind), abs=1e-7)
        return
    gap = math.sqrt(3) * np.abs(recording.seconds[:, None] - recording.seconds) / 60 / TAU
    covariance = (1 + gap) * np.exp(-gap) * RED**2 * unit[:, None] * unit + np.diag(sd**2)
    left, seen = observed - centre, ~limit
    expected = stats.multivariate_normal.logpdf(left[seen], cov=covariance[np.ix_(seen, seen)])
    if limit.any():
        gain = np.linalg.solve(covariance[np.ix_(seen, seen)], covariance[np.ix_(seen, limit)]).T
        rest = covariance[np.ix_(limit, limit)] - gain @ covariance[np.ix_(seen, limit)]
        edge = left[limit] - gain @ left[seen]
        sign = -1 if kind == "mag" else 1
        expected += math.log(stats.multivariate_normal.cdf(sign * edge, cov=rest))
    assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("limits", [[], LIMITS], ids=["measured", "limits"])
@pytest.mark.parametrize("noise", ["quoted", "outliers"])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_density_with_fitted_errors(seven, kind, noise, limits):
    """The level of noise integrated over d ln s by SciPy; for relative flux the gain is integrated, too, under which
    the best gain's density gets a factor of s sqrt(2 pi). A perfect model's finite density costs 1e-4."""
    likelihood, light, theta = recorded(seven, kind, limits, fitted=True)
    recording, values = likelihood.model.recording, NOISE[noise]
    observed, limit = recording.observed, recording.upper_limit
    centre = prediction(observed, light, np.ones(7), limit, kind)

    def at(level: float) -> float:
        sd = np.full(7, math.exp(level))
        gain = level + 0.5 * math.log(2 * math.pi) if kind == "flux" else 0.0
        return math.exp(expected_rows(observed, centre, sd, limit, values, kind) + gain)

    middle = math.log(np.std((observed - centre)[~limit]))
    levels = np.linspace(middle - 4, middle + 9, 261)  # steps of 0.05 on peaks 0.4 wide: exact to 1e-8
    expected = math.log(integrate.trapezoid([at(level) for level in levels], levels))
    found = float(likelihood.log_likelihood(theta, noise_of(noise, likelihood)))
    assert found == pytest.approx(expected, abs=1e-4)


UNDER_FITTED = [name for name in NOISE if "jitter" not in name]  # jitter is part of errors that are fitted


@pytest.mark.parametrize(
    ("noise", "fitted"), [*((name, False) for name in NOISE), *((name, True) for name in UNDER_FITTED)]
)
def test_every_curve_of_flux_has_a_unit_of_its_own(seven, noise, fitted):
    """A curve in a unit k times as small has a density that is k^-N times as high, of its N measured rows, and another curve
    knows nothing of it: N is one less where the level of noise is found, for the gain is integrated, too. To rounding."""
    scene, _ = seven
    likelihood, _, theta = recorded(seven, "flux", [5], fitted)
    recording = likelihood.model.recording
    curve = np.array([0, 1, 0, 1, 0, 1, 0])
    values = []
    for unit in (1.0, 1e-3, 1e4):
        size = np.where(curve == 1, unit, 1.0)
        error = None if fitted else recording.error * size
        several = replace(
            recording, observed=recording.observed * size, error=error, curve=curve, curve_ids=("a", "b")
        )
        one = Likelihood(LightCurve(scene, several))
        density = float(one.log_likelihood(theta, noise_of(noise, one)))
        count = 1 if fitted and noise != "red noise" else 2
        values.append(density + count * math.log(unit))
    assert values == pytest.approx(values[:1] * 3, abs=1e-7)


@pytest.mark.parametrize("limits", [[], LIMITS, [6, 5, 3, 2]], ids=["measured", "limits", "many limits"])
@pytest.mark.parametrize("noise", ["quoted", "outliers"])
def test_density_of_a_curve_of_one_row_without_errors(seven, noise, limits):
    """Its level of noise integrated by SciPy, and six or fewer rows of another curve beside it. The density of one row falls as
    slowly as 1 / s with the level: nodes 0.45 apart leave 1e-4."""
    scene, _ = seven
    likelihood, light, theta = recorded(seven, "mag", limits, fitted=True)
    recording, values = likelihood.model.recording, NOISE[noise]
    curve = (np.arange(7) == 0).astype(int)
    several = replace(recording, curve=curve, curve_ids=("many", "one"))
    one = Likelihood(LightCurve(scene, several))
    expected = 0.0
    for number in (0, 1):
        rows = curve == number
        left = (recording.observed - light)[rows]
        upper = recording.upper_limit[rows]
        middle = math.log(np.sqrt((left[~upper] ** 2).mean()))
        levels = np.linspace(middle - 5, middle + 25, 1201)
        sd = np.exp(levels)[:, None] * np.ones(len(left))
        share, width = values.get("outliers", 0.0), values.get("width", 1.0)
        heights = (1 - share) * stats.norm.pdf(left / sd) / sd + share * stats.norm.pdf(left / sd / width) / (
            sd * width
        )
        beyond_limit = (1 - share) * stats.norm.sf(left / sd) + share * stats.norm.sf(left / sd / width)
        density = np.where(upper, beyond_limit, heights).prod(-1)
        expected += math.log(integrate.trapezoid(density, levels))
    found = float(one.log_likelihood(theta, noise_of(noise, one)))
    assert found == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize(
    ("noise", "fitted"), [*((name, False) for name in NOISE), *((name, True) for name in UNDER_FITTED)]
)
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_slopes_and_batches(seven, kind, noise, fitted):
    """Slopes of the density by central differences (error 1e-9 of the third derivative; 1e-5 with the joint
    probability of limits, whose rounding they see); a batch is its members."""
    likelihood, _, _ = recorded(seven, kind, LIMITS, fitted)
    many = torch.tensor([[0.45], [0.5], [0.58]], dtype=torch.float64)
    values = [likelihood.log_likelihood(one, noise_of(noise, likelihood)) for one in many]
    torch.testing.assert_close(
        likelihood.log_likelihood(many, noise_of(noise, likelihood)),
        torch.stack(values),
        rtol=1e-11,
        atol=1e-9,
    )
    for one in many:
        leaf = one.clone().requires_grad_(True)
        (slope,) = torch.autograd.grad(likelihood.log_likelihood(leaf, noise_of(noise, likelihood)), leaf)
        up, down = (
            float(likelihood.log_likelihood(one + step, noise_of(noise, likelihood)))
            for step in (1e-5, -1e-5)
        )
        assert float(slope) == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-4)


# ------------------------------------------------------------------ upper limits


@pytest.mark.parametrize("noise", [*NOISE, "fitted"])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_a_looser_limit_never_costs_more(seven, kind, noise):
    """From far fainter than the model to far brighter; a hopelessly loose one costs nothing."""
    likelihood, _, theta = recorded(seven, kind, [6], fitted=noise == "fitted")
    found = likelihood.residuals(theta)
    used = Noise() if noise == "fitted" else noise_of(noise, likelihood)
    unit = found.sigma[6] if found.sigma.ndim else found.sigma
    looser = torch.linspace(-30, 200, 116, dtype=torch.float64)[:, None] * unit * likelihood.fainter
    delta = found.delta.repeat(116, 1)
    delta[:, 6] = looser[:, 0]
    log_p = likelihood.density(replace(found, delta=delta), used)
    assert (torch.diff(log_p) >= -1e-9).all()
    without, _, _ = recorded(seven, kind, [6], fitted=noise == "fitted")
    kept = without.model.recording.keep(np.arange(7) != 6, "for a test")
    rest = Likelihood(LightCurve(without.model.scene, kept)).log_likelihood(theta, used)
    assert float(log_p[-1]) == pytest.approx(float(rest), abs=1e-6)


@pytest.mark.parametrize("measured", [1, 2, 12], ids="{} measured".format)
@pytest.mark.parametrize("rows", [1, 2, 12], ids="{} rows".format)
@pytest.mark.parametrize("fitted", [False, True], ids=["quoted", "fitted"])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_corners_of_the_priors_have_a_density_and_slopes(tmp_path, kind, fitted, rows, measured):
    """A plate of dark rows, whose glint, limits and reflectances at their bounds put residuals up to 1e10 errors out; and a model
    that goes through every row. Under every noise there is a finite number with finite slopes, and three of one theta
    have it."""
    scene = still(PLATE + 'back_material = "black"\n', GLOSSY)
    recording = seen_from(scene, tmp_path, tilted(np.linspace(0, 170, 12)), tilted(10, 180))
    recording = recording.keep(np.arange(12) < rows, "cut")
    light = LightCurve(scene, recording).brightness().flux.detach().numpy()
    light = light / light.max()
    recording = replace(
        recording,
        kind=kind,
        observed=light if kind == "flux" else -2.5 * np.log10(np.maximum(light, 1e-3)),
        error=None if fitted else np.full(rows, 0.03),
        upper_limit=np.arange(rows) >= measured,
    )
    for effects in (
        [],
        ["jitter"],
        ["outliers"],
        ["red_noise"],
        ["outliers", "jitter"],
        ["red_noise", "jitter"],
    ):
        if fitted and "jitter" in effects:
            continue  # the level is fitted
        likelihood = Likelihood(LightCurve(scene, recording, effects=effects))
        free = likelihood.model.parameter_set.free
        start = likelihood.model.theta().detach()
        dull = start.clone()
        dull[[k for k, one in enumerate(free) if "r_" in one.name]] = 0.0
        ends = [[one.prior.low for one in free], [min(one.prior.high, 1e9) for one in free]]
        for theta in (start, dull, *torch.tensor(ends, dtype=torch.float64)):
            leaf = theta.clone().requires_grad_()
            value = likelihood.log_likelihood(leaf)
            (slope,) = torch.autograd.grad(value, leaf)
            assert torch.isfinite(value) and torch.isfinite(slope).all(), (effects, theta, slope)
            batch = likelihood.log_likelihood(theta.repeat(3, 1))
            torch.testing.assert_close(batch, value.detach().expand(3), rtol=1e-10, atol=1e-9)


def test_the_gain_is_that_of_the_measured_rows(seven):
    """Whatever limits say, and a curve of nothing but limits says nothing."""
    scene, rows = seven
    light = 10 ** (-0.4 * LightCurve(scene, rows)().detach().numpy())
    light = light / light[0]
    values = []
    for limit in (0.36, 0.5, 1.0, 3.0):
        observed = np.where(np.arange(7) == 6, limit, 2.0 * light)
        recording = replace(
            rows, kind="flux", observed=observed, error=np.full(7, 0.02), upper_limit=np.arange(7) == 6
        )
        likelihood = Likelihood(LightCurve(scene, recording))
        theta = likelihood.model.theta().detach()
        assert likelihood.residuals(theta).gain.item() == pytest.approx(
            2.0 * float(1 / likelihood.model.brightness(theta).flux[0]), rel=1e-9
        )
        expected = 6 * stats.norm.logpdf(0, scale=0.02) + stats.norm.logcdf((limit - 2 * light[6]) / 0.02)
        assert float(likelihood.log_likelihood(theta)) == pytest.approx(expected, rel=1e-9)
        values.append(float(likelihood.log_likelihood(theta)))
        alone = replace(recording, upper_limit=np.ones(7, dtype=bool))
        mute = Likelihood(LightCurve(scene, alone))
        # P(0 < limit) of every row, whatever the model's light
        expected = stats.norm.logcdf(observed / 0.02).sum()
        assert float(mute.log_likelihood(theta)) == pytest.approx(expected, abs=1e-12)
        assert mute.gains == 0 and any("say nothing" in text for text in mute.remarks(theta))
    assert values == sorted(values)


def lobe(folder: Path, kind: str, seed: int, error: str = "quoted"):
    """A plate's lobe of n = 40 in sixty rows, of which the 36 faintest are only known to be fainter than a limit."""
    scene = still(
        PLATE,
        '[materials.white]\nn = {value = 150.0, low = 1.0, high = 1e4, prior = "loguniform"}\nr_spec = 0.3\nr_diff = 0.01\n',
    )
    truth = still(PLATE, material("white", 40.0, 0.3, 0.01))
    across = np.linspace(-60, 60, 60) + 20
    rows = seen_from(
        scene, folder, np.tile(tilted(20), (60, 1)), tilted(np.abs(across), np.where(across < 0, 0, 180))
    )
    mag = LightCurve(truth, rows)().detach().numpy()
    generator = np.random.default_rng(seed)
    if kind == "mag":
        observed, sigma = mag + 0.05 * generator.normal(size=60), np.full(60, 0.05)
        edge = np.sort(observed)[24]
        limit = observed >= edge
    else:
        flux = 10 ** (-0.4 * (mag - mag.min()))
        observed, sigma = flux + 0.02 * generator.normal(size=60), np.full(60, 0.02)
        edge = np.sort(observed)[-25]
        limit = observed <= edge
    recording = replace(
        rows,
        kind=kind,
        observed=np.where(limit, edge, observed),
        error=sigma if error == "quoted" else None,
        upper_limit=limit,
    )
    assert limit.sum() == 36
    return Likelihood(LightCurve(scene, recording))


@pytest.mark.parametrize("error", ["quoted", "fitted"])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_a_lobe_of_which_most_rows_are_limits(tmp_path, kind, error):
    """n of six recordings: each within 4 of its standard deviations of 40, their mean within 3 of its own."""
    off = []
    for seed in range(6):
        found = fit_map(lobe(tmp_path, kind, seed, error), starts=8, adam_steps=60)
        sd = math.sqrt(float(found.modes[0].covariance[0, 0]))  # of ln n
        off.append((math.log(float(found.theta)) - math.log(40.0)) / sd)
        assert found.dof == 24 - 1 - (kind == "flux")
    assert np.max(np.abs(off)) < 4 and abs(np.mean(off)) < 3 / math.sqrt(6)


def test_limits_that_the_model_breaks_are_told(seven):
    likelihood, _, theta = recorded(seven, "mag", [3])
    assert likelihood.remarks(theta) == []
    bright = replace(likelihood.model.recording, observed=likelihood.model.recording.observed + 1.0)
    told = Likelihood(LightCurve(seven[0], bright)).remarks(theta)
    assert told == ["the model is brighter than 1 of 1 upper limits allow"]


def test_no_error_column_and_limits(tmp_path):
    """Albedo 0.5 of a plate of which half the rows are limits two magnitudes brighter than it: as without them."""
    scene = still(PLATE, FREE)
    rows = seen_from(scene, tmp_path, np.tile(tilted(20), (200, 1)), tilted(10, 180))
    mag = LightCurve(still(PLATE, KNOWN), rows)().detach().numpy()
    observed = mag + 0.1 * np.random.default_rng(0).normal(size=200)
    limit = np.arange(200) % 2 == 1
    recording = replace(rows, observed=np.where(limit, mag - 2.0, observed), error=None, upper_limit=limit)
    found = fit_map(Likelihood(LightCurve(scene, recording)), starts=4, adam_steps=30)
    best = 0.5 * 10 ** (-0.4 * (observed - mag)[~limit].mean())
    assert float(found.theta) == pytest.approx(best, rel=1e-4)
    level = found.likelihood.fitted_levels(found.likelihood.residuals(found.theta).delta)
    assert float(level) == pytest.approx((observed - mag)[~limit].std(ddof=1), rel=1e-3)


@pytest.mark.parametrize("limits", [0.0, 0.3])
@pytest.mark.parametrize("kind", ["mag", "flux"])
def test_red_noise_without_errors_takes_the_best_level_of_white_noise(tmp_path, kind, limits):
    """SciPy's normal density of the measured rows at 60 levels: at that of the steps it is within 0.5 of the largest (0.42 in 48
    draws), and limits far from the model neither change that nor count."""
    scene = still(PLATE, FREE)
    rows = seen_from(scene, tmp_path, np.tile(tilted(20), (60, 1)), tilted(10, 180))
    mag = LightCurve(still(PLATE, KNOWN), rows)().detach().numpy()
    gap = math.sqrt(3) * np.abs(rows.seconds[:, None] - rows.seconds) / 60 / TAU
    shared = (1 + gap) * np.exp(-gap) * RED**2
    for seed in range(6):
        random = np.random.default_rng(seed)
        off = random.multivariate_normal(np.zeros(60), shared + 0.05**2 * np.eye(60))
        limit = random.random(60) < limits
        observed = np.where(limit, mag - 0.6, mag + off)
        if kind == "flux":
            observed = np.where(limit, 6.0, 3 - 3 * off / MAG_PER_LN)
        recording = replace(rows, kind=kind, observed=observed, error=None, upper_limit=limit)
        likelihood = Likelihood(LightCurve(scene, recording))
        theta = torch.tensor([0.5], dtype=torch.float64)
        found = likelihood.residuals(theta)
        seen, unit = ~limit, found.scale.numpy()
        covariance = (shared * unit[:, None] * unit)[np.ix_(seen, seen)]
        levels = unit.mean() * np.geomspace(0.005, 0.3, 60)
        best = max(
            stats.multivariate_normal.logpdf(
                found.delta.numpy()[seen], cov=covariance + level**2 * np.eye(seen.sum())
            )
            for level in levels
        )
        value = float(likelihood.log_likelihood(theta, noise_of("red noise", likelihood)))
        assert value == pytest.approx(best, abs=0.5)


def test_a_level_that_is_not_fitted_is_told(seven):
    scene = Scene.from_toml(listed('["red_noise"]'), Path())
    _, rows = seven
    for error, count in ((None, 1), (np.full(7, 0.05), 0)):
        model = LightCurve(scene, replace(rows, error=error))
        told = Likelihood(model).remarks(model.theta())
        assert sum("the white noise beside red_noise" in text for text in told) == count


# ------------------------------------------------------------------ what is refused


def listed(effects: str):
    return still(PLATE, KNOWN, "").to_toml().replace("effects = []", f"effects = {effects}")


def test_red_noise_beside_outliers_is_refused(seven):
    scene = Scene.from_toml(listed('["outliers", "red_noise"]'))
    with pytest.raises(InputError, match="red_noise cannot be applied: outliers are in the list"):
        LightCurve(scene, seven[1])
    likelihood, _, theta = recorded(seven, "mag", [])
    both = noise_of("red noise", likelihood).with_law(noise_of("outliers", likelihood).law)
    with pytest.raises(InputError, match="red_noise cannot be applied"):
        likelihood.log_likelihood(theta, both)


def test_red_noise_beside_very_many_limits_is_refused(tmp_path):
    scene = Scene.from_toml(listed('["red_noise"]'))
    rows = seen_from(scene, tmp_path, np.tile(tilted(20), (160, 1)), tilted(10, 180))
    with pytest.raises(InputError, match="a curve has 155 upper limits"):
        LightCurve(scene, replace(rows, upper_limit=np.arange(160) < 155))
    LightCurve(scene, replace(rows, upper_limit=np.arange(160) < 150))


# ------------------------------------------------------------------ low signal to noise


def faint(folder: Path, ratio: float, rows: int, seed: int, spread: float = 0.0):
    """A white plate of albedo 0.5 whose flux has normal errors, of a size that differs from row to row by ``spread``;
    magnitudes and their errors are worked out from what was measured, if that is above 0."""
    scene = still(PLATE, FREE)
    recording = seen_from(scene, folder, np.tile(tilted(20), (rows, 1)), tilted(10, 180))
    flux = 10 ** (-0.4 * LightCurve(still(PLATE, KNOWN), recording)().detach().numpy())
    generator = np.random.default_rng(seed)
    sigma = flux / ratio * np.exp(spread * generator.normal(size=rows))
    measured = flux + sigma * generator.normal(size=rows)
    seen = measured > 0
    recording = recording.keep(seen, "without a magnitude")
    measured, sigma = measured[seen], sigma[seen]
    return (
        scene,
        replace(recording, observed=-2.5 * np.log10(measured), error=MAG_PER_LN * sigma / measured),
        measured,
        sigma,
    )


@pytest.mark.parametrize("spread", [0.0, 0.3])
@pytest.mark.parametrize("ratio", [2, 3, 5, 10, 50])
def test_albedo_at_low_signal_to_noise(tmp_path, ratio, spread):
    """Of 20,000 rows, whose mean is known to 1.0857 / ratio / 141 = 0.004 mag at 2; the bias of magnitudes is 0.31,
    0.16, 0.059, 0.015 mag."""
    scene, recording, _, _ = faint(tmp_path, ratio, 20_000, 3, spread)
    found = fit_map(Likelihood(LightCurve(scene, recording)), starts=2, adam_steps=20)
    assert 2.5 * math.log10(float(found.theta) / 0.5) == pytest.approx(0.0, abs=0.01)
    assert 1e-4 < found.p_value < 1 - 1e-4


@pytest.mark.long
def test_short_curves_with_errors_that_also_scatter(tmp_path):
    """200 curves of 20 rows at a signal-to-noise ratio of 3, errors scattered by 0.3 from row to row: the most probable albedo
    is on average within 0.01 mag of the mean of the fluxes by their known errors, the best there is (0.006 +- 0.002).
    Magnitudes are 0.13 mag off; where one curve in nine misses its law, 0.018."""
    albedos = torch.linspace(0.25, 0.85, 61, dtype=torch.float64)[:, None]
    off = []
    for seed in range(200):
        scene, recording, measured, sigma = faint(tmp_path, 3, 20, 1000 + seed, 0.3)
        likelihood = Likelihood(LightCurve(scene, recording))
        with torch.no_grad():
            spline = interpolate.CubicSpline(albedos[:, 0], -likelihood.log_likelihood(albedos))
        found = optimize.minimize_scalar(spline, bounds=(0.25, 0.85), method="bounded").x
        full = 10 ** (-0.4 * float(LightCurve(still(PLATE, KNOWN), recording)()[0].detach())) / 0.5
        known = np.sum(measured / sigma**2) / np.sum(1 / sigma**2) / full
        off.append(2.5 * math.log10(found / known))
    assert abs(np.mean(off)) < 0.01


@pytest.mark.parametrize(
    ("ratio", "sky", "fading", "within"),
    [
        *((3, sky, fading, 0.01) for sky in (0.0, 0.3, 1.0, 5.0) for fading in (0, 60)),
        (5, 0.0, 0, 0.01),
        (5, 1.0, 60, 0.01),
        (10, 0.0, 0, 0.01),
        *((2, sky, fading, LEFT_WEAK_MAG) for sky in (0.0, 0.3, 1.0) for fading in (0, 60)),
    ],
)
def test_albedo_of_counted_photons(tmp_path, ratio, sky, fading, within):
    """Poisson's counts of object and ``sky`` (over the object's), less the sky, with the root of what was counted for
    error, of a still plate and of one that turns by ``fading`` deg, to where it is half as bright. Albedo to 0.01 mag, of which
    0.004 are chance at 3; roots without their shift are 0.032 mag off at 3, 0.011 at 5, magnitudes 0.15 and 0.046, one power
    for all rows 0.016 (still) and 0.032 (turning) with a sky of 0.3. At 2 what the warning says."""
    scene = still(PLATE, FREE)
    angles = tilted(20 + fading * np.linspace(-1, 1, 20_000) ** 2)
    recording = seen_from(scene, tmp_path, angles, tilted(10, 180))
    mag = LightCurve(still(PLATE, KNOWN), recording)().detach().numpy()
    light = 10 ** (-0.4 * (mag - mag.min()))
    counts = ratio**2 * (1 + sky)
    counted = np.random.default_rng(2).poisson(counts * (light + sky))
    flux, error = (counted - sky * counts) / counts, np.sqrt(counted) / counts
    seen = flux > 0
    recording = replace(
        recording,
        observed=mag.min() - 2.5 * np.log10(np.where(seen, flux, 1.0)),
        error=MAG_PER_LN * np.where(seen, error, 1.0) / np.where(seen, flux, 1.0),
    ).keep(seen, "without a magnitude")
    found = fit_map(Likelihood(LightCurve(scene, recording)), starts=2, adam_steps=20)
    assert 2.5 * math.log10(float(found.theta) / 0.5) == pytest.approx(0.0, abs=within)


def test_the_scale_of_photons_beside_a_sky():
    """Differences are SciPy's integrals of dF / sigma(F) over the variance a + b F, in units of the slope at the datum; the
    height above a flux of 0 is the integral from there, and errors of the same curve give the same law back."""
    generator = np.random.default_rng(1)
    for sky, photons in ((1.0, 0.3), (1.0, 5.0), (0.02, 1.0)):
        flux = generator.uniform(0.05, 3.0, 60)
        error = MAG_PER_LN * np.sqrt(sky + photons * flux) / flux
        power = error_powers(flux, error, np.zeros(60, dtype=int), np.ones(60, dtype=bool))
        np.testing.assert_allclose(2 * (1 - power), photons * flux / (sky + photons * flux), rtol=1e-4)
        ratio = generator.uniform(0.02, 4.0, 60)
        delta, worth = power_difference(torch.as_tensor(ratio), torch.as_tensor(power))
        height = above_zero(worth, torch.as_tensor(power))
        for k, datum in enumerate(flux):

            def slope(f, datum=datum, sky=sky, photons=photons):
                return MAG_PER_LN / datum * math.sqrt((sky + photons * datum) / (sky + photons * f))

            assert float(delta[k]) == pytest.approx(
                integrate.quad(slope, datum, ratio[k] * datum)[0], rel=1e-4
            )
            assert float(height[k]) == pytest.approx(integrate.quad(slope, 0, ratio[k] * datum)[0], rel=1e-4)
            assert float(worth[k]) == pytest.approx(
                slope(ratio[k] * datum) * ratio[k] * datum / MAG_PER_LN, rel=1e-4
            )


@pytest.mark.parametrize(("ratio", "told"), [(2, True), (20, False)])
def test_a_chi_square_cut_by_limits_is_told(tmp_path, ratio, told):
    """Limits at three errors. The albedo is right to four of its errors, but of a ratio of 2 chi-square's p is below 1e-6."""
    rows = 2000
    scene = still(PLATE, FREE)
    recording = seen_from(scene, tmp_path, np.tile(tilted(20), (rows, 1)), tilted(10, 180))
    mag = LightCurve(still(PLATE, KNOWN), recording)().detach().numpy()
    measured = 1 + np.random.default_rng(4).normal(size=rows) / ratio
    faint_rows = measured < 3 / ratio
    faint_rows[0] = True
    shown = np.where(faint_rows, 3 / ratio, measured)
    shown[0] = 2.0  # a limit that says nothing, for every ratio has one
    recording = replace(
        recording,
        observed=mag - 2.5 * np.log10(shown),
        error=MAG_PER_LN / ratio / shown,
        upper_limit=faint_rows,
    )
    found = fit_map(Likelihood(LightCurve(scene, recording)), starts=2, adam_steps=20)
    assert 2.5 * math.log10(float(found.theta) / 0.5) == pytest.approx(
        0, abs=4 * MAG_PER_LN / ratio / math.sqrt(rows) * 2
    )
    assert (found.p_value < 1e-6) == told
    assert any("bright part of the noise" in text for text in found.likelihood.remarks(found.theta)) == told


def test_large_errors_of_an_unclear_law_are_told(tmp_path):
    """Fifty rows at a ratio of 3 with a constant error: magnitudes, which the table of biases says are 0.16 mag too bright."""
    scene, recording, _, _ = faint(tmp_path, 3, 50, 2)
    constant = replace(recording, error=np.full(len(recording), 0.33))
    theta = LightCurve(scene, constant).theta().detach()
    told = Likelihood(LightCurve(scene, constant)).remarks(theta)
    assert any("compared in magnitudes, which is 0.15 mag too bright" in text for text in told)
    precise = replace(recording, error=np.full(len(recording), 0.05))
    assert Likelihood(LightCurve(scene, precise)).remarks(theta) == []


@pytest.mark.parametrize("ratio", [2, 3, 10])
def test_rows_with_errors_of_the_measured_flux_are_normal_in_flux(tmp_path, ratio):
    """SciPy's normal density cut off at a flux of 0, times |d flux / d mag|."""
    scene, recording, measured, sigma = faint(tmp_path, ratio, 300, 1)
    likelihood = Likelihood(LightCurve(scene, recording))
    for albedo in (0.3, 0.5, 0.6):
        flux = likelihood.model.brightness(torch.tensor([albedo], dtype=torch.float64)).flux.numpy() * 10 ** (
            0.4 * 26.7
        )
        rows = stats.truncnorm.logpdf(measured, -flux / sigma, np.inf, flux, sigma)
        expected = (rows + np.log(measured / MAG_PER_LN)).sum()
        found = float(likelihood.log_likelihood(torch.tensor([albedo], dtype=torch.float64)))
        assert found == pytest.approx(expected, rel=1e-9)


def test_errors_that_do_not_follow_the_flux_are_of_magnitudes(tmp_path):
    """A constant error of 0.36 mag, and errors that vary by chance: normal in magnitudes to rounding."""
    scene, recording, _, _ = faint(tmp_path, 3, 300, 2)
    generator = np.random.default_rng(3)
    for error in (np.full(len(recording), 0.36), 0.3 * generator.uniform(0.5, 1.5, len(recording))):
        likelihood = Likelihood(LightCurve(scene, replace(recording, error=error)))
        theta = likelihood.model.theta().detach()
        model = likelihood.model(theta).numpy()
        expected = stats.norm.logpdf(recording.observed, model, error).sum()
        assert likelihood.power is None
        assert float(likelihood.log_likelihood(theta)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("noise", NOISE)
def test_slopes_at_low_signal_to_noise(tmp_path, noise):
    """No jump and no kink: the slope is that of central differences from a dark model to one ten times too bright."""
    scene, recording, _, _ = faint(tmp_path, 3, 40, 5)
    likelihood = Likelihood(LightCurve(scene, recording))
    assert likelihood.power is not None
    for albedo in (0.05 + 1e-3, 0.3, 0.5, 0.99):
        leaf = torch.tensor([albedo], dtype=torch.float64, requires_grad=True)
        (slope,) = torch.autograd.grad(likelihood.log_likelihood(leaf, noise_of(noise, likelihood)), leaf)
        up, down = (
            float(likelihood.log_likelihood(leaf.detach() + step, noise_of(noise, likelihood)))
            for step in (1e-6, -1e-6)
        )
        assert float(slope) == pytest.approx((up - down) / 2e-6, rel=1e-5, abs=1e-5)
    dark = torch.zeros(len(recording), dtype=torch.float64, requires_grad=True)
    for power in (0.0, 0.3, 0.5, 0.7, 1.0):
        delta, scale = power_difference(dark, torch.full_like(dark, power))
        (slope,) = torch.autograd.grad((delta + scale).sum(), dark)
        assert torch.isfinite(slope).all() and torch.isfinite(delta).all()


@pytest.mark.parametrize("ratio", [3, 50])
def test_chi_square_of_clean_recordings_is_uniform(tmp_path, ratio):
    """p of 60 recordings by Kolmogorov and Smirnov."""
    p = []
    for seed in range(60):
        scene, recording, _, _ = faint(tmp_path, ratio, 150, 100 + seed)
        p.append(fit_map(Likelihood(LightCurve(scene, recording)), starts=2, adam_steps=10).p_value)
    assert stats.kstest(p, "uniform").pvalue > 0.01


@pytest.mark.parametrize("ratio", [3, 50])
def test_the_gate_of_clean_recordings_is_uniform(tmp_path, ratio):
    """Its global p of 50 recordings by Kolmogorov and Smirnov."""
    p = []
    for seed in range(50):
        scene, recording, _, _ = faint(tmp_path, ratio, 100, 300 + seed)
        likelihood = Likelihood(LightCurve(scene, recording))
        posterior = Posterior(likelihood, scaled=False)
        found = fit_map(likelihood, starts=2, adam_steps=10).theta
        best = fitted_at(Hypothesis(), posterior, posterior.coordinates(found))
        seconds = likelihood.model.assembly.context.seconds
        battery = Battery(seconds, likelihood.curve, {"time": seconds}, {}, with_chi2=True)
        p.append(gate(best, battery, seed, draws=400).global_p)
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_a_fit_says_on_what_scale_rows_are_compared(tmp_path):
    scene, recording, _, _ = faint(tmp_path, 3, 100, 1)
    result = fit(scene, recording, steps=50)
    assert any("errors follow the measured flux in curve" in text for text in result.all_warnings)
    np.testing.assert_allclose(result.prediction, result.model(result.fit.theta).detach().numpy(), rtol=1e-12)
    np.testing.assert_allclose(result.delta, recording.observed - result.prediction, rtol=0, atol=1e-12)
