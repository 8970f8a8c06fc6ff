"""Every kind of row under every kind of noise against densities written with SciPy and integrated numerically."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import integrate, stats

from tests.effects.cases import seen_from, tilted
from tests.noisy_rows import (
    MAG_PER_LN,
    NOISE,
    RED,
    TAU,
    listed,
    noise_of,
    recorded,
)
from torchlc.errors import InputError
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve
from torchlc.scene import Scene

LIMITS = [1, 4]


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
