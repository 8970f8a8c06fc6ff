"""What of a hypothesis nobody could see, what a search promises and judges, and what is unknown."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

import torchlc
from tests.ball import BALL, ERROR, changed, searched
from torchlc.diagnosis.alternatives import NOMINAL
from torchlc.diagnosis.coordinates import coordinates
from torchlc.diagnosis.hypotheses import SCALE, Hypothesis, Workbench
from torchlc.diagnosis.probabilities import probabilities
from torchlc.diagnosis.probes import AGAIN, beyond, probe
from torchlc.diagnosis.run import diagnose
from torchlc.diagnosis.unseen import UNSEEN, unseen_shares
from torchlc.diagnosis.values import materials
from torchlc.diagnosis.words import headline, lines, words
from torchlc.effects import effect_class, registry
from torchlc.inference.density import Posterior
from torchlc.inference.posterior import LEFT, fitted_at, integrated, polished
from torchlc.lightcurve.evaluators import exact
from torchlc.stages.memory import bytes_of


@pytest.mark.parametrize("slope", [0.0, 0.003, 0.02])
def test_the_unseen_share_of_a_drift_is_that_of_its_normal_posterior(ball, slope) -> None:
    """A slope in mag/h beside a free zero point: least squares with both priors in numpy, the rest by scipy."""
    scene, recording = ball
    hours = (recording.seconds - recording.seconds.mean()) / 3600
    search = searched(changed(ball, slope * hours), "zero_point_drift")
    drift = search.visited[Hypothesis(("zero_point_drift",))]
    # least squares of what is left at the zero point's and the drift's prior means
    (column,) = [i for i, name in enumerate(drift.names) if "drift" in name]
    prior = drift.model.parameter_set.free[column].prior
    sigma = np.array([0.02, prior.quantile(torch.tensor(0.841344746, dtype=torch.float64)).item()])
    design = np.stack([np.ones_like(hours), hours], 1) / ERROR
    curve = torchlc.simulate(scene, recording)
    left = (recording.observed + slope * hours - np.asarray(curve.to_table()["mag"])) / ERROR
    covariance = np.linalg.inv(design.T @ design + np.diag(sigma**-2.0))
    mean = covariance @ design.T @ left
    # of one unit of slope, what the zero point with its prior cannot take up
    own = design[:, 1]
    taken = design[:, 0] * (design[:, 0] @ own) / (design[:, 0] @ design[:, 0] + 0.02**-2)
    seen = math.sqrt(float((own - taken) @ own))
    sd = math.sqrt(covariance[1, 1])
    expected = stats.norm.cdf((UNSEEN / seen - mean[1]) / sd) - stats.norm.cdf(
        (-UNSEEN / seen - mean[1]) / sd
    )
    assert unseen_shares(drift, search.visited[Hypothesis()], "zero_point_drift")[0] == pytest.approx(
        expected,
        abs=0.08,  # 200 draws: two and a half standard deviations at one half
    )


@pytest.mark.parametrize("shift", [-3.0, 2.0])
def test_the_unseen_share_does_not_depend_on_where_the_fit_without_the_effect_stands(ball, shift) -> None:
    """What the zero point has already paid for, to take up some of a change, is not had for nothing. All is linear here."""
    hours = (ball[1].seconds - ball[1].seconds.mean()) / 3600
    search = searched(changed(ball, 0.006 * hours), "zero_point_drift")
    drift, without = search.visited[Hypothesis(("zero_point_drift",))], search.visited[Hypothesis()]
    expected = unseen_shares(drift, without, "zero_point_drift")[0]
    assert 0.02 < expected < 0.98
    moved = fitted_at(without.hypothesis, without.posterior, without.g + shift)
    assert unseen_shares(drift, moved, "zero_point_drift")[0] == pytest.approx(
        expected, abs=0.011
    )  # two of 200 draws


def test_what_had_no_time_is_not_told_to_be_missing_from_the_library(ball) -> None:
    """A wave of the light that nothing examined explains. As long as the effects of the library were not looked at, it may be one of
    them: no more is told than that, and the first line says so."""
    hours = ball[1].seconds / 3600
    search = searched(changed(ball, 0.15 * np.sin(2 * np.pi * hours / 0.7)))
    null = search.visited[Hypothesis()]
    search.strangers(coordinates(null.model, null.theta))
    looked = probabilities(search, 1e-9)
    assert looked.verdict == "unexplained" and looked.unknown > 0.9 and looked.unexamined == 0.0
    search.tell_unexamined()
    late = probabilities(search, 1e-9)
    # two names of two: each is as likely as all others, beside what is in no library at one in twenty
    assert late.unexamined / late.unknown == pytest.approx(2 / 0.05, rel=1e-6)
    assert late.unexplained == pytest.approx(looked.unknown)
    assert late.verdict == "unexplained" and late.told == pytest.approx(looked.told)


def test_a_spent_budget_says_what_it_left_out(ball) -> None:
    found = diagnose(*changed(ball, 0.15 * np.sin(2 * np.pi * ball[1].seconds / 2520)), budget=0.01)
    content = found.to_json()
    assert content["verdict"] == "unexplained" and content["unexamined"]
    assert content["probabilities"]["not_examined"] > 0.5 > content["probabilities"]["not_in_library"]
    assert "may be one of those for which there was no time" in headline(content)
    (terminal,) = [
        line.removeprefix("next: ") for line in lines(content, {}, []) if line.startswith("next: ")
    ]
    assert terminal.startswith("give the diagnosis more time with budget, for ")
    assert words(content, {})[-1] == f"What to do next: {terminal}."
    told = [text for text in found.warnings if "not examined" in text or "no candidate" in text]
    assert sum(text.count("(") for text in told) > 10
    assert any("more, which diagnosis.json lists" in text for text in told)
    for name, cls in registry().items():
        title = rf"{name}(\[[^]]+\])?(@\w+)? \({re.escape(cls.title)}\)"
        assert "_" not in name or not re.search(rf"\b{name}\b", re.sub(title, "", " ".join(told)))


def test_tables_are_made_once_whichever_noise_asks_first(ball) -> None:
    bench = Workbench(*ball)
    first = bench.likelihood(Hypothesis().under("outliers")).model
    tables = first.tables()
    for noise in ((), ("jitter",), ("red_noise",)):
        assert bench.likelihood(Hypothesis().under(*noise)).model.tables() is tables


def test_mass_of_unseen_values_counts_as_nothing_missing(ball) -> None:
    """Whatever is moved, all of it is there; and a clean recording is told as clean."""
    search = searched(ball, "zero_point_drift")
    found = probabilities(search, 0.5)
    assert found.nothing + found.noise + found.unexplained + found.some_effect == pytest.approx(1.0)
    drift = search.visited[Hypothesis(("zero_point_drift",))]
    share = unseen_shares(drift, search.visited[Hypothesis()], "zero_point_drift")[0]
    assert share > 0.5 and found.nothing > 0.7
    assert found.effects.get("zero_point_drift", 0.0) <= 1 - share


def test_what_was_judged_by_its_linear_form_is_not_named(ball) -> None:
    """A set whose linear form is far ahead, and which was not fitted: the answer is among what was."""
    search = searched(ball)
    search.linear[Hypothesis(("background",))] = search.log_odds(search.leader) + 30.0
    odds = probabilities(search, 0.5)
    assert odds.verdict in ("adequate", "noise_model") and not odds.effects


def test_red_noise_in_the_place_of_an_effect_says_nothing_of_how_rows_err_beside_the_effect(ball) -> None:
    """A wave and a drift: rows that err together describe both. The drift is told under each way to err that is of use, and not
    under the robust one alone."""
    hours = ball[1].seconds / 3600
    wave = 0.015 * np.sin(2 * np.pi * hours / 1.5) + 0.006 * hours
    search = searched(changed(ball, wave))
    search.singles(["zero_point_drift"], lambda _: 0.0)
    search.noise_of_leaders()
    assert search.leader == Hypothesis().under("red_noise")
    drift = Hypothesis(("zero_point_drift",))
    assert {drift.under("red_noise"), drift.under(SCALE), drift.under("jitter")} <= set(search.visited)


def test_a_set_whose_members_were_never_fitted_alone_is_tried_with_free_sizes(ball) -> None:
    search = searched(ball)
    appendage = search.extend(search.best(), "appendage", None)
    search.extend(appendage, "zero_point_drift", None)
    search.alternatives([NOMINAL], [("zero_point_drift",)])
    assert Hypothesis(("zero_point_drift",), search.robust, NOMINAL) in search.visited


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_can_only_add_light_promises_nothing_where_light_is_missing(ball, sign) -> None:
    """The change that an appendage makes, and its opposite, which no appendage makes."""
    entry = "appendage"

    def probed(case, known=None):
        search = searched(case)
        at = search.visited[Hypothesis()]
        return at, probe(search.bench, at, search.posterior(Hypothesis((entry,))), entry, 0, known)

    at, quiet = probed(ball)
    off = beyond(quiet.moved, at).norm(dim=1)
    chosen = int((off - 15.0).abs().argmin())  # in errors of a row: seen well, and small beside the ball
    other = changed(ball, sign * (quiet.moved[chosen] * at.sigma).numpy())
    known = replace(quiet, psi=quiet.psi[[chosen]], scores=quiet.scores[[chosen]])
    found = probed(other, known)[1]
    assert torch.equal(found.psi, quiet.psi[[chosen]])
    if sign > 0:
        # the ball's own zero point takes a part of it
        assert math.sqrt(found.score) == pytest.approx(float(off[chosen]), rel=0.5)
    else:
        assert found.score == 0.0


@pytest.mark.parametrize(
    ("entry", "without_opposite"),
    [
        ("earthshine", True),
        ("self_shadowing", True),
        ("background", False),
        ("wing_split", False),
        ("normal_dispersion", False),
    ],
)
def test_only_light_in_proportion_to_a_number_has_no_opposite(entry, without_opposite) -> None:
    """A lobe that was fitted too wide, for want of two glints apart, asks for less of a split though there is much."""
    assert effect_class(entry).one_sided() is without_opposite


def test_values_of_an_effect_are_tried_again_where_they_promised_most(tmp_path) -> None:
    """A box that is turned by 3 deg, beside a scale of the errors: the best of 72 values is the best of the few."""
    scene = BALL.replace('shape = "sphere"\nradius = 1.0', 'shape = "box"\nsize = [1.0, 2.0, 3.0]')
    (tmp_path / "turned.toml").write_text(
        scene.replace("effects = []", 'effects = ["attitude_offset"]').replace(
            "band_sun",
            '"attitude_offset.x" = 3.0\n"attitude_offset.y" = 0.0\n"attitude_offset.z" = -2.0\nband_sun',
        )
    )
    (tmp_path / "scene.toml").write_text(scene)
    curve = torchlc.simulate(
        tmp_path / "turned.toml", start="2026-03-15T19:00:00", hours=5.0, cadence=300, noise=ERROR, seed=1
    )
    case = torchlc.load(tmp_path / "scene.toml", curve.write(tmp_path / "recording.ecsv"))
    search = searched(case)
    first = search.visited[Hypothesis()]
    whole = search.probe_all(first, ["attitude_offset"])["attitude_offset"]
    other = search.visited[Hypothesis().under(*search.robust)]
    again = search.probe_all(other, ["attitude_offset"])["attitude_offset"]
    assert len(again.psi) == AGAIN < len(whole.psi)
    fresh = probe(
        search.bench,
        other,
        search.posterior(other.hypothesis.with_effect("attitude_offset")),
        "attitude_offset",
        0,
    )
    assert again.score == pytest.approx(fresh.score, rel=0.2)


def test_the_evidence_of_a_linear_form_is_that_of_a_linear_model(ball) -> None:
    """A drift beside a free zero point, both with normal priors: by scipy's normal density of all rows."""
    hours = (ball[1].seconds - ball[1].seconds.mean()) / 3600
    search = searched(changed(ball, 0.01 * hours), "zero_point_drift")
    drift = search.visited[Hypothesis(("zero_point_drift",))]
    found = integrated(drift, 500, 0, linear=True)
    assert found.evidence is not None
    covariance = drift.slopes @ drift.slopes.T + ERROR**2 * torch.eye(len(drift.delta))
    left = drift.delta - drift.slopes @ drift.g
    expected = stats.multivariate_normal(cov=covariance.numpy()).logpdf(left.numpy())
    assert found.evidence.log_z == pytest.approx(expected, abs=0.1)


def test_a_descent_by_linear_forms_comes_to_the_same_minimum(monkeypatch, tmp_path) -> None:
    """A box whose attitude is 0.5 deg off, with the geometry taken as slow and as quick."""
    box = BALL.replace('shape = "sphere"\nradius = 1.0', 'shape = "box"\nsize = [2.0, 1.2, 1.6]').replace(
        'mode = "nadir"', 'mode = "inertial"\nspin_axis = [0.57, 0.78, 0.51]\nspin_rate = 1.7'
    )
    (tmp_path / "scene.toml").write_text(box)
    true = box.replace("effects = []", 'effects = ["attitude_offset"]') + '"attitude_offset.x" = 0.5\n'
    (tmp_path / "true.toml").write_text(true)
    curve = torchlc.simulate(
        tmp_path / "true.toml", start="2026-03-15T19:00:00", hours=3.0, cadence=180, noise=ERROR, seed=3
    )
    scene, recording = torchlc.load(tmp_path / "scene.toml", curve.write(tmp_path / "recording.ecsv"))
    peaks = []
    for most in (0.0, math.inf):
        monkeypatch.setattr("torchlc.inference.density.DEAR_S", most)
        bench = Workbench(scene, recording)
        hypothesis = Hypothesis(("attitude_offset",))
        posterior = Posterior(bench.likelihood(hypothesis), scaled=True)
        start = posterior.coordinates(posterior.model.parameter_set.start())
        at = polished(fitted_at(hypothesis, posterior, start), 2)
        assert posterior.slow is (most == 0.0)
        peaks.append(at.peak)
    # each is within LEFT of the maximum
    assert peaks[0] == pytest.approx(peaks[1], abs=2 * LEFT)


@pytest.mark.long
def test_beside_another_law_of_reflection_the_effect_is_still_named(tmp_path) -> None:
    """A box of Cook and Torrance's metal, which the scene takes for Ashikhmin and Shirley's, and a drift: under the wrong law the light of
    the lobe's flanks is blamed on something else."""
    box = (
        BALL.replace('shape = "sphere"\nradius = 1.0', 'shape = "box"\nsize = [2.0, 1.2, 1.6]')
        .replace(
            'mode = "nadir"',
            'mode = "inertial"\nspin_axis = [0.57, 0.78, 0.51]\nspin_rate = 1.7\nspin_phase = 158.0\nx_angle = 103.0',
        )
        .replace("albedo = 0.5", "{material}")
    )
    metal = 'model = "cook-torrance"\nm = 0.25\nf0 = 0.6\nr_diff = 0.02'
    guess = (
        'model = "ashikhmin-shirley"\nn = { value = 50.0, low = 1.0, high = 1e5, prior = "loguniform" }\n'
        "r_spec = { value = 0.3, low = 0.0, high = 1.0 }\nr_diff = { value = 0.3, low = 0.0, high = 1.0 }"
    )
    for name, material in {"truth": metal, "scene": guess}.items():
        (tmp_path / f"{name}.toml").write_text(box.replace('model = "lambert"\n{material}', material))
    curve = torchlc.simulate(
        tmp_path / "truth.toml", start="2026-03-15T19:00:00", hours=5.0, cadence=120.0, noise=ERROR, seed=4
    )
    scene, recording = torchlc.load(tmp_path / "scene.toml", curve.write(tmp_path / "recording.ecsv"))
    hours = (recording.seconds - recording.seconds.mean()) / 3600
    recording = replace(recording, observed=recording.observed + 0.02 * hours)
    found = torchlc.diagnose(scene, recording, effects=["zero_point_drift", "background", "appendage"])
    assert found.named == ("zero_point_drift",)
    assert found.law == "cook-torrance"


def test_tables_of_past_geometries_are_kept_as_far_as_memory_goes(monkeypatch, tmp_path) -> None:
    """Of a turned box: as many as the bound holds, the last ones, and none once a model forgets."""
    scene = BALL.replace('shape = "sphere"\nradius = 1.0', 'shape = "box"\nsize = [1.0, 2.0, 3.0]')
    scene = scene.replace(
        "band_sun", '"attitude_offset.x" = { value = 0.0, low = -9.0, high = 9.0 }\nband_sun'
    )
    (tmp_path / "scene.toml").write_text(scene.replace("effects = []", 'effects = ["attitude_offset"]'))
    (tmp_path / "exact.toml").write_text(BALL)
    curve = torchlc.simulate(
        tmp_path / "exact.toml", start="2026-03-15T19:00:00", hours=5.0, cadence=600, noise=ERROR, seed=1
    )
    model = torchlc.LightCurve(
        *torchlc.load(tmp_path / "scene.toml", curve.write(tmp_path / "recording.ecsv"))
    )
    evaluator = model.evaluator
    assert isinstance(evaluator, exact.ExactGeometry)
    place = model.names.index("attitude_offset.x")
    theta = model.parameter_set.start().repeat(6, 1)
    theta[:, place] = torch.arange(6.0, dtype=torch.float64)

    def kept() -> list[float]:
        with torch.no_grad():
            for one in theta:
                model(one)
        columns = sorted(model.assembly.geometry_columns)
        return [key[1][columns.index(place)] for key in evaluator._recent]

    assert kept() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    size = bytes_of(next(iter(evaluator._recent.values())))
    model.forget()
    assert not evaluator._recent
    monkeypatch.setattr(exact, "LARGEST_MEMORY", 3 * size + size // 2)
    assert kept() == [3.0, 4.0, 5.0]


def test_what_laplace_misses_of_a_set_it_misses_under_another_noise(tmp_path) -> None:
    """A ball whose albedo and zero point are known by their product alone, a bent ridge: against a tempered sequence of its own."""
    ridge = BALL.replace("albedo = 0.5", "albedo = { value = 0.5, low = 0.0, high = 1.0 }")
    ridge = ridge.replace("sigma = 0.02", "sigma = 0.5")
    (tmp_path / "scene.toml").write_text(ridge)
    (tmp_path / "true.toml").write_text(BALL)
    curve = torchlc.simulate(
        tmp_path / "true.toml", start="2026-03-15T19:00:00", hours=5.0, cadence=150, noise=1e-4, seed=3
    )
    search = searched(torchlc.load(tmp_path / "scene.toml", curve.write(tmp_path / "recording.ecsv")))
    quoted, scaled = search.visited[Hypothesis()], search.visited[Hypothesis(noise=(SCALE,))]
    first, alone = search.weighed(quoted, 500), search.weighed(scaled, 500)
    found = search.weighed(scaled, 500, beside=first, moving=False)
    assert found.evidence is None and alone.evidence is not None
    assert abs(found.missed) > 3 * abs(found.log_z - alone.log_z)


def test_materials_are_those_of_all_that_may_be_so(tmp_path) -> None:
    """Two fits that are some twenty standard deviations apart, with probabilities 0.8 and 0.2: quantiles of the two together, by scipy's of each."""
    text = BALL.replace("albedo = 0.5", "albedo = { value = 0.5, low = 0.0, high = 1.0 }")
    (tmp_path / "scene.toml").write_text(text)
    curve = torchlc.simulate(
        tmp_path / "scene.toml", start="2026-03-15T19:00:00", hours=5.0, cadence=150, noise=ERROR, seed=3
    )
    search = searched(torchlc.load(tmp_path / "scene.toml", curve.write(tmp_path / "recording.ecsv")))
    at = search.visited[Hypothesis()]
    (column,) = [k for k, name in enumerate(at.names) if name == "paint.albedo"]
    moved = at.g.clone()
    moved[column] += 20 * at.covariance[column, column].sqrt()
    other = replace(at, g=moved)
    (found,) = materials([(at, 0.8), (other, 0.2)]).values()
    sd = float(at.covariance[column, column].sqrt())

    def albedo(g: float) -> float:
        return float(stats.norm.cdf(g))  # of an albedo that is believed alike from 0 to 1

    here, there = float(at.g[column]), float(moved[column])
    assert found["median"] == pytest.approx(albedo(here + sd * stats.norm.ppf(0.5 / 0.8)), abs=0.2 * sd)
    assert found["q05"] == pytest.approx(albedo(here + sd * stats.norm.ppf(0.05 / 0.8)), abs=0.2 * sd)
    assert found["q95"] == pytest.approx(albedo(there + sd * stats.norm.ppf(0.75)), abs=0.2 * sd)
