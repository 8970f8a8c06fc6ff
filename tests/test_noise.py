"""Noise models: kinds that a test defines, through every verb; densities against SciPy's, and draws against densities."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import integrate, stats
from torch import Tensor

import torchlc
from tests.effects.cases import PLATE, seen_from, still, tilted
from tests.effects.test_red_noise import matern
from tests.noisy_rows import FREE, KNOWN, recorded
from tests.small_case import write_case
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench
from torchlc.diagnosis.proof import filtered_log_density
from torchlc.effects import registry
from torchlc.errors import InputError
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import find_modes
from torchlc.lightcurve.model import LightCurve
from torchlc.naming import Replaced
from torchlc.noise.draw import draw
from torchlc.noise.kind import NoiseKind
from torchlc.noise.outliers import Mixture
from torchlc.noise.red_noise import Matern32
from torchlc.parameters import Quantity
from torchlc.report.listing import effects_lines, effects_listing
from torchlc.stages.effect import EFFECTS
from torchlc.stages.noise import Law, Noise, Process

DOUBLE = torch.float64
ROWS = 4000
CHANCE = 1e-3
"""Of a right draw that fails a Kolmogorov-Smirnov test; seeds are fixed, so that it fails always or never."""


@dataclass(frozen=True)
class Laplace(Law):
    """Two exponentials of standard deviation ``width``."""

    width: Tensor
    name: str = "long_tails"

    def log_density(self, u):
        return -math.sqrt(2) * u.abs() / self.width - torch.log(math.sqrt(2) * self.width)

    def log_below(self, u):
        x = math.sqrt(2) * u / self.width
        upper = torch.log1p(-0.5 * torch.exp(-x.clamp(min=0)))
        return torch.where(x < 0, x.clamp(max=0) - math.log(2), upper)

    @property
    def widest(self):
        return self.width


@dataclass(frozen=True)
class Exponential(Process):
    """Correlation exp(-gap / tau), of an Ornstein-Uhlenbeck process."""

    sd: Tensor
    tau_min: Tensor
    seconds: Tensor
    name: str = "drifting_sky"

    def correlation(self, rows):
        times = self.seconds[rows] / 60
        gap = (times[:, None] - times).abs()
        return torch.exp(-gap / (self.tau_min[..., None] if self.tau_min.ndim else self.tau_min))


@pytest.fixture
def outside() -> Iterator[dict[str, type[NoiseKind]]]:
    """Three kinds that no file of the package holds: another law, another variance, another process."""

    with EFFECTS.restored():

        class LongTails(NoiseKind):
            """Errors follow Laplace's law. Neglects nothing that this test is about."""

            name, title, reshapes = "long_tails", "errors with exponential tails", True
            quantities = (
                Quantity("width", "", 0.2, 20.0, "over the quoted error", typical=2.0, prior="loguniform"),
            )

            def noise(self, noise, p, context):
                return noise.with_law(Laplace(p["width"]))

        class AirmassJitter(NoiseKind):
            """Errors that grow with the air that light crosses. Neglects nothing that this test is about."""

            name, title, widens = "airmass_jitter", "errors that grow with airmass", True
            quantities = (
                Quantity(
                    "mag_per_airmass", "mag", 0.0, 2.0, "sd at an airmass of 1", off=0.0, typical=0.05,
                    prior="halfnormal", sigma=0.1,
                ),
            )  # fmt: skip

            def missing(self, context):
                return None if context.airmass is not None else "the airmass is not known"

            def noise(self, noise, p, context):
                return noise.wider(p["mag_per_airmass"] * context.airmass)

        class DriftingSky(NoiseKind):
            """An Ornstein-Uhlenbeck process. Neglects nothing that this test is about."""

            name, correlates = "drifting_sky", True
            quantities = (
                Quantity(
                    "mag", "mag", 0.0, 2.0, "its sd", off=0.0, typical=0.05, prior="halfnormal", sigma=0.05
                ),
                Quantity("tau_min", "min", 1.0, 120.0, "its time scale", typical=10.0, prior="loguniform"),
            )

            def noise(self, noise, p, context):
                return noise.with_process(Exponential(p["mag"], p["tau_min"], context.seconds))

        yield {kind.name: kind for kind in (LongTails, AirmassJitter, DriftingSky)}


def number(value: float) -> Tensor:
    return torch.tensor([value], dtype=DOUBLE)


# ------------------------------------------------------------------ a kind from outside, through every verb

VALUES = {
    "long_tails": {"width": 3.0},
    "airmass_jitter": {"mag_per_airmass": 0.08},
    "drifting_sky": {"mag": 0.08, "tau_min": 25.0},
}


@pytest.mark.long
@pytest.mark.parametrize("name", ["long_tails"])
def test_a_kind_from_outside_goes_through_every_verb(outside, tmp_path: Path, name: str) -> None:
    """Simulated with it, fitted and sampled with it, and found by a diagnosis that the scene does not tell of it."""
    scene_file, _ = write_case(tmp_path, rows=97)
    plain = scene_file.read_text()
    effects = next(line for line in plain.splitlines() if line.startswith("effects"))
    own = effects.partition("[")[2].partition("]")[0]
    listed = plain.replace(effects, f'effects = [{own}, "{name}"]')
    numbers = "\n".join(f'"{name}.{key}" = {value}' for key, value in VALUES[name].items())
    noisy = tmp_path / "noisy.toml"
    noisy.write_text(listed.rstrip() + f"\n{numbers}\n")
    curve = torchlc.simulate(
        noisy, start="2020-10-17T15:00:00", hours=4.0, cadence=4 * 3600 / 96, noise=0.02, seed=2
    )
    recording = curve.write(tmp_path / "noisy.ecsv")

    free = tmp_path / "free.toml"
    free.write_text(listed)
    fit = torchlc.fit(free, recording, steps=40, seed=1, out=tmp_path / "fit")
    for key, value in VALUES[name].items():
        row = fit.parameters()[f"{name}.{key}"]
        assert abs(row["median"] - value) < 5 * row["sd"]
    page = (tmp_path / "fit" / "report.html").read_text()
    assert f"{name}: {outside[name].title}" in page

    found = torchlc.diagnose(
        scene_file, recording, effects=["background"], quick=True, out=tmp_path / "diagnosis"
    )
    rows = {row["effect"]: row for row in found.to_json()["candidates"]}
    assert rows[name]["delta_log_evidence"] > 10
    assert rows[name]["heldout_delta_log_likelihood"] > 3
    content = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text())
    assert name in [row["effect"] for row in content["candidates"]]
    page = (tmp_path / "diagnosis" / "report.html").read_text()
    assert name in page
    if found.verdict == "noise_model" and found.named[0] == name:
        assert f"{name} ({outside[name].title})" in page

    listing = {row["name"]: row for row in effects_listing()}[name]
    assert listing["title"] == outside[name].title and listing["stage"] == "noise"
    assert any(line.startswith(f"{name}: {outside[name].title}.") for line in effects_lines())


def test_a_class_without_a_title_is_called_by_its_name(outside) -> None:
    assert outside["drifting_sky"].title == "drifting sky"


def test_defined_again_it_takes_the_place_of_the_first(outside) -> None:
    with pytest.warns(Replaced, match="effect 'long_tails' is now"):

        class LongTails(NoiseKind):
            """The same name."""

            name, title = "long_tails", "a second try"

    assert registry()["long_tails"].title == "a second try"


def test_two_laws_or_a_law_among_correlated_rows_are_refused(outside, tmp_path: Path) -> None:
    scene_file, recording = write_case(tmp_path)
    scene, rows = torchlc.load(scene_file, recording)
    for effects in (["outliers", "long_tails"], ["long_tails", "red_noise"], ["outliers", "drifting_sky"]):
        with pytest.raises(InputError, match="cannot be applied"):
            LightCurve(scene, rows, effects=effects)
    both = LightCurve(scene, rows, effects=["airmass_jitter", "jitter", "long_tails"])
    assert [effect.name for effect in both.effects] == ["airmass_jitter", "jitter", "long_tails"]


# ------------------------------------------------------------------ densities


@pytest.mark.parametrize("kind", ["mag", "flux"])
@pytest.mark.parametrize("limits", [[], [1, 4]], ids=["measured", "limits"])
def test_density_of_another_law(seven, kind: str, limits: list[int]) -> None:
    """SciPy's Laplace distribution; limits by a numerical integral of its density, good to 1e-9."""
    likelihood, _, theta = recorded(seven, kind, limits)
    recording = likelihood.model.recording
    found = likelihood.residuals(theta)
    off, scale = found.delta.numpy(), 1.7 * recording.error / math.sqrt(2)
    expected = 0.0
    for x, b, upper in zip(off, scale, recording.upper_limit, strict=True):
        ends = (x, x + 60 * b) if kind == "mag" else (x - 60 * b, x)
        if upper:
            height = stats.laplace(scale=b).pdf
            expected += math.log(
                integrate.quad(height, *ends, points=[0.0] if ends[0] < 0 < ends[1] else None)[0]
            )
        else:
            expected += stats.laplace.logpdf(x, scale=b)
    noise = Noise().with_law(Laplace(number(1.7)))
    assert float(likelihood.log_likelihood(theta, noise)) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("law", ["normal", "laplace"])
def test_density_of_a_variance_beside_a_fitted_level(seven, law: str) -> None:
    """The level integrated over d ln s by SciPy, with a variance that differs from row to row; a perfect model's finite
    density costs 1e-4."""
    likelihood, _, theta = recorded(seven, "mag", [], fitted=True)
    extra = np.linspace(0.01, 0.13, 7)
    off = likelihood.residuals(theta).delta.numpy()
    noise = Noise().wider(torch.as_tensor(extra))
    if law == "laplace":
        noise = noise.with_law(Laplace(number(1.0)))
    of_law = stats.norm if law == "normal" else stats.laplace
    soft = 7 * (1e-3 * float(likelihood.noise_level)) ** 2

    def height(level: float) -> float:
        sd = np.sqrt(math.exp(2 * level) + extra**2)
        rows = of_law.logpdf(off, scale=sd if law == "normal" else sd / math.sqrt(2)).sum()
        return math.exp(rows - 0.5 * soft * math.exp(-2 * level))

    levels = np.linspace(-14, 4, 7201)  # steps of 0.0025: exact to 1e-9 where the integrand is smooth
    expected = math.log(integrate.simpson([height(level) for level in levels], x=levels))
    assert float(likelihood.log_likelihood(theta, noise)) == pytest.approx(expected, abs=1e-4)


def test_density_of_another_process(seven) -> None:
    """Beside red noise and a jitter: all three in one covariance, by SciPy."""
    likelihood, _, theta = recorded(seven, "mag", [])
    recording = likelihood.model.recording
    seconds = likelihood.model.assembly.context.seconds
    noise = (
        Noise()
        .wider(number(0.03))
        .with_process(Exponential(number(0.1), number(0.05), seconds))
        .with_process(Matern32(number(0.07), number(0.2), seconds))
    )
    minutes = recording.seconds / 60
    gap = np.abs(minutes[:, None] - minutes)
    covariance = 0.01 * np.exp(-gap / 0.05) + 0.07**2 * matern(gap, 0.2, 1.5)
    covariance += np.diag(recording.error**2 + 0.03**2)
    expected = stats.multivariate_normal.logpdf(likelihood.residuals(theta).delta.numpy(), cov=covariance)
    assert float(likelihood.log_likelihood(theta, noise)) == pytest.approx(expected, rel=1e-10)


LAWS = {"outliers": Mixture(number(0.1), number(8.0)), "laplace": Laplace(number(1.4))}


def height_of(law: Law):
    """The density of a law, a function of one number."""
    return lambda u: float(torch.exp(law.log_density(torch.tensor([u], dtype=DOUBLE))))


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_a_density_and_what_lies_below_is_its_integral(name: str) -> None:
    law = LAWS[name]
    height = height_of(law)
    for u in (-9.0, -1.3, 0.0, 0.4, 5.0):
        below = integrate.quad(height, -200, u, points=[-8.0, 0.0], limit=400)[0]
        assert float(torch.exp(law.log_below(number(u)))) == pytest.approx(below, rel=1e-6)
    assert integrate.quad(height, -200, 200, points=[-8.0, 0.0, 8.0], limit=400)[0] == pytest.approx(
        1, rel=1e-8
    )


@pytest.mark.parametrize("name", LAWS)
def test_weights_have_the_slope_of_the_density(name: str) -> None:
    """Central differences of the density by steps of 1e-5: 1e-8."""
    law, u = LAWS[name], torch.tensor([-7.0, -2.0, -0.3, 0.1, 1.0, 4.0], dtype=DOUBLE)
    slope = (law.log_density(u + 1e-5) - law.log_density(u - 1e-5)) / 2e-5
    torch.testing.assert_close(law.weight(u) * u, -slope, rtol=1e-7, atol=1e-8)
    torch.testing.assert_close(Law.weight(law, u), law.weight(u), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("known", [1e-4, 0.04, 1.0, 400.0])
def test_a_law_blurred_by_an_uncertain_prediction(name: str, known: float) -> None:
    """Density, slope and curvature against Simpson's rule on law times normal, by moments. The library's rule is
    good to 1e-3 in ln, far below the gain of 1 that held-out scores decide by; where a law's own form is exact, that
    agrees with the rule, too."""
    law, sigma = LAWS[name], 0.5
    left = np.array([-6.0, -0.4, 0.0, 1.1, 20.0])
    root = math.sqrt(known)
    arguments = (
        torch.as_tensor(left),
        torch.full((5,), sigma, dtype=DOUBLE),
        torch.full((5,), known, dtype=DOUBLE),
    )
    by_rule, by_itself = Law.blurred(law, *arguments), law.blurred(*arguments)
    for one, other, unit in zip(by_rule, by_itself, (1.0, root, known), strict=True):
        torch.testing.assert_close(one * unit, other * unit, rtol=1e-3, atol=1e-3)
    z = np.linspace(-10 * root, 10 * root, 200_001)
    for row, x in enumerate(left):
        height = torch.exp(law.log_density(torch.as_tensor((x - z) / sigma))).numpy() / sigma
        product = stats.norm.pdf(z, scale=root) * height
        moments = [integrate.simpson(z**k * product, x=z) for k in range(3)]
        mean = moments[1] / moments[0]
        variance = moments[2] / moments[0] - mean**2
        assert float(by_rule[0][row]) == pytest.approx(math.log(moments[0]), abs=1e-3)
        assert float(by_rule[1][row]) * root == pytest.approx(mean / root, abs=2e-3)
        assert float(by_rule[2][row]) * known == pytest.approx(1 - variance / known, abs=4e-3)


@pytest.mark.long
def test_the_held_out_density_of_another_law_is_a_density() -> None:
    """Integrated by Simpson's rule over both data of two rows, to 20 and more standard deviations; the rule of the blurred
    law costs 1e-3."""
    x = np.linspace(-20, 20, 101)
    grid = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    count = len(grid)
    height = torch.exp(
        filtered_log_density(
            torch.full((count, 1), 0.3, dtype=DOUBLE),
            torch.full((count, 1, 1), 2.0, dtype=DOUBLE),
            torch.as_tensor(grid),
            torch.tensor([[1.0], [-0.7]], dtype=DOUBLE).expand(count, 2, 1),
            torch.tensor([0.5, 0.8], dtype=DOUBLE).expand(count, 2),
            torch.ones(count, 2, dtype=torch.bool),
            LAWS["laplace"],
        )
    ).reshape(101, 101)
    assert integrate.simpson(integrate.simpson(height, x=x), x=x) == pytest.approx(1.0, abs=2e-3)


# ------------------------------------------------------------------ fits and scores


def test_the_optimiser_weighs_rows_by_the_law(outside, tmp_path: Path) -> None:
    """Of a plate seen under one angle, whose albedo is free, the best level under Laplace's law is the weighted median
    of the data. Rows are weighed anew four times, which ends within a quarter of the level's standard deviation of it.
    """
    scene = still(PLATE, FREE)
    rows = seen_from(scene, tmp_path, np.tile(tilted(20), (61, 1)), tilted(10, 180))
    generator = np.random.default_rng(0)
    sigma = generator.uniform(0.01, 0.04, 61)
    off = sigma * generator.laplace(size=61)
    mag = LightCurve(still(PLATE, KNOWN), rows)().detach().numpy()
    recording = replace(rows, observed=mag + off, error=sigma)
    likelihood = Likelihood(LightCurve(scene, recording, effects=["long_tails"]))
    modes, _, _ = find_modes(likelihood, starts=4, adam_steps=40)
    order = np.argsort(off)
    half = np.searchsorted(np.cumsum(1 / sigma[order]), 0.5 * (1 / sigma).sum())
    best = -2.5 * math.log10(float(modes[0].theta[0]) / 0.5)
    sd = 1 / math.sqrt(
        (1 / sigma**2).sum()
    )  # of the level: Laplace's law of scale sigma has information 1 / sigma^2
    assert best == pytest.approx(off[order][half], abs=0.25 * sd)


@pytest.mark.long
def test_a_diagnosis_finds_the_numbers_of_a_kind_from_outside(outside, tmp_path: Path) -> None:
    """Width 3 of Laplace's law and airmass jitter, from 97 rows drawn of each: better evidence than white noise's, and no
    lower density than at the numbers that were drawn with."""
    scene_file, recording = write_case(tmp_path, rows=97)
    scene, rows = torchlc.load(scene_file, recording)
    plain = Workbench(scene, rows).likelihood(Hypothesis())
    found = plain.residuals(plain.model.parameter_set.start())
    for name, values in VALUES.items():
        kind, context = outside[name]().prepared(plain.model.assembly.context), plain.model.assembly.context
        numbers = {key: context.seconds.new_tensor([value]) for key, value in values.items()}
        noise = kind.noise(Noise(), numbers, context)
        delta = draw(noise, found.sigma.expand(97), context.curve, np.random.default_rng(4))
        drawn = replace(rows, observed=(found.prediction + delta).numpy())
        search = Search(Workbench(scene, drawn), Clock(None), 0)
        search.null()
        own = search.visited[Hypothesis(noise=(name,))]
        assert own.log_z > search.visited[Hypothesis()].log_z + 10
        theta = own.theta.clone()
        for key, value in values.items():
            theta[own.names.index(f"{name}.{key}")] = value
        with torch.no_grad():
            assert own.peak > float(own.posterior.log_density(own.posterior.coordinates(theta)[None])) - 0.1
