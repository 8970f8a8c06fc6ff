"""The diagnosis on recordings of an independent simulator, and its statistics against dense algebra and
draws."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from torchlc.diagnosis.evidence import WHITE, Scorer, make_blocks
from torchlc.diagnosis.gate import Battery, gate, log_tail, runs
from torchlc.diagnosis.plan import next_nights
from torchlc.diagnosis.refit import (
    Hypothesis,
    Workbench,
    gaussian_prior,
    linearised,
    refit,
)
from torchlc.diagnosis.run import diagnose
from torchlc.diagnosis.search import Found, candidate_entries, judged, released, stuck, unaided
from torchlc.files.numbers import Free
from torchlc.inference.optimiser import find_modes, polish
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording
from torchlc.scene import load_scene
from torchlc.stages.effect import Entry

PRACTICE = Path(__file__).parents[2] / "shared" / "practice"
DEMO = Path(__file__).parents[1] / "torchlc" / "demo"

needs_practice = pytest.mark.skipif(not PRACTICE.is_dir(), reason=f"{PRACTICE} is not here")


def found_values(found):
    return dict(zip(found.final.refit.names, found.final.refit.theta.tolist(), strict=True))


def practice(name: str):
    scene = load_scene(PRACTICE / name / "scene.toml")
    recording = load_recording(PRACTICE / name / "recording.ecsv", scene)
    return scene, recording, json.loads((PRACTICE / name / "answer.json").read_text())


@needs_practice
@pytest.mark.parametrize(
    "name", ["control", "jitter", "exposure_smearing", "earth_shadow", "appendage", "panel_offset"]
)
def test_practice_case_is_named(name: str) -> None:
    """Verdict, name and chi-square of the answer; the interval against the true one where there is one."""
    scene, recording, answer = practice(name)
    content = json.loads(json.dumps(diagnose(scene, recording).to_json(), allow_nan=False))
    assert content["verdict"] == answer["verdict"]
    assert content["named"] == answer["effects"]
    if answer["verdict"] != "missing_physics":
        return
    improvement = content["improvement"]
    dof = improvement["dof"]
    assert abs(improvement["chi2_after"] / dof - 1) < 3 * math.sqrt(2 / dof)
    assert improvement["heldout_rms_after"] < improvement["heldout_rms_before"]
    assert overlap(content["where"]["intervals"], answer["where"]["intervals"], recording) > 0.6
    for material, values in answer["materials"].items():
        for short, truth in values.items():
            after = content["materials"]["after"].get(f"{material}.{short}")
            if after is not None and after["sd"] < 0.2 * after["median"]:
                assert abs(after["median"] - truth) < 4 * after["sd"], f"{material}.{short}"


def overlap(found: list[dict], truth: list[list[str]], recording) -> float:
    """Intersection over union of two sets of intervals, counted in rows."""
    times = np.array(recording.time.isot)
    masks = []
    for pairs in ([(one["start"], one["end"]) for one in found], truth):
        mask = np.zeros(len(times), dtype=bool)
        for start, end in pairs:
            mask |= (times >= start) & (times <= end)
        masks.append(mask)
    return float((masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum())


def test_wings_that_point_apart_are_named(tmp_path) -> None:
    """Wings 6 deg apart, by the independent program of the examples: a wobble describes them about as well."""
    maker = Path(__file__).parents[1] / "examples" / "calibration" / "make_injections.py"
    command = [sys.executable, str(maker), str(tmp_path), "--seed", "22", "--only", "wing_split-as_is"]
    subprocess.run(command, check=True, capture_output=True)
    scene = load_scene(tmp_path / "wing_split-as_is" / "scene.toml")
    recording = load_recording(tmp_path / "wing_split-as_is" / "recording.ecsv", scene)
    found = diagnose(scene, recording, quick=True)
    content = found.to_json()
    assert (content["verdict"], content["named"]) == ("missing_physics", ["wing_split"])
    assert found_values(found)["wing_split.deg"] == pytest.approx(3.0, abs=0.2)
    assert content["remaining"]["global_p"] > 0.01
    assert {one["name"] for one in content["where"]["components"][:2]} == {"panel +Y", "panel -Y"}


@needs_practice
def test_quick_makes_at_most_three_refits_and_finds_the_same() -> None:
    scene, recording, answer = practice("exposure_smearing")
    content = diagnose(scene, recording, quick=True).to_json()
    assert content["named"] == answer["effects"]
    refitted = [
        one for one in content["candidates"] if one["chi2_after"] is not None and one["score"] is not None
    ]
    assert len(refitted) <= 3


@needs_practice
def test_only_the_listed_effects_are_candidates() -> None:
    scene, recording, _ = practice("exposure_smearing")
    result = diagnose(scene, recording, effects=["background", "zero_point_drift"])
    content = result.to_json()
    table = result.to_table()
    assert list(table["effect"]) == [one["effect"] for one in content["candidates"]]
    assert table["chi2_after"][0] == content["candidates"][0]["chi2_after"]
    assert content["verdict"] in repr(result) and "<pre>Diagnosis: " in result._repr_html_()
    assert len(result.plot_curve()) % 2 == 0
    assert {one["effect"] for one in content["candidates"]} <= {
        "background", "zero_point_drift", "jitter", "red_noise", "outliers",
    }  # fmt: skip
    assert content["verdict"] != "missing_physics"


@needs_practice
def test_a_faint_effect_beside_a_strong_one_is_named() -> None:
    """A step of the zero point, worth some 30 of chi-square beside 3000, added to what another program saw."""
    scene, recording, answer = practice("exposure_smearing")
    assert recording.error is not None
    later = recording.seconds > np.median(recording.seconds)
    step = 6.0 / math.sqrt(np.sum(recording.error**-2.0) / 4)  # 6 sigma of a difference of halves
    shifted = replace(recording, observed=recording.observed + np.where(later, step, 0.0))
    asked = ["exposure_smearing", "zero_point_step", "background", "saturation"]
    found = diagnose(scene, shifted, effects=asked)
    assert found.named == (*answer["effects"], "zero_point_step")
    assert found_values(found)["zero_point_step.mag"] == pytest.approx(step, rel=0.4)
    assert diagnose(scene, recording, effects=asked).named == tuple(answer["effects"])


@pytest.fixture(scope="module")
def demo_refit():
    scene = load_scene(DEMO / "scene.toml")
    recording = load_recording(DEMO / "recording.ecsv", scene)
    bench = Workbench(assemble(scene, recording))
    likelihood = bench.likelihood(Hypothesis())
    modes, _, _ = find_modes(likelihood, starts=8, adam_steps=40)
    return linearised(likelihood, Hypothesis(), modes[0].theta)


def test_the_scene_s_own_model_is_looked_for_where_effects_left_it(demo_refit) -> None:
    """Begun away from its minimum, found again from the materials of a refit with an effect that does little."""
    bench = Workbench(demo_refit.model.assembly)
    likelihood = bench.likelihood(Hypothesis())
    context = bench.base.context
    scorer = Scorer(context, make_blocks(context.seconds, context.curve))
    wrong = demo_refit.theta.clone()
    wrong[demo_refit.names.index("panel.n")] = 3.0
    null = judged(linearised(likelihood, Hypothesis(), wrong), scorer)
    with_drift = Hypothesis(("zero_point_drift",))
    start = bench.start(with_drift, demo_refit.theta[None], demo_refit.names)
    beside = judged(refit(bench.likelihood(with_drift), with_drift, start), scorer)
    found = unaided(bench, scorer, null, [beside])
    assert found.hypothesis == Hypothesis()
    assert found.log_evidence > null.log_evidence + 5
    assert found.refit.objective == pytest.approx(demo_refit.objective, abs=0.01)
    assert unaided(bench, scorer, found, [beside]).log_evidence == pytest.approx(found.log_evidence, abs=0.01)


def test_a_hypothesis_that_shares_tables_shines_as_one_that_stands_alone() -> None:
    scene = load_scene(DEMO / "scene.toml")
    recording = load_recording(DEMO / "recording.ecsv", scene)
    bench = Workbench(assemble(scene, recording))
    base = bench.likelihood(Hypothesis()).model
    base(base.parameter_set.start())  # its tables are there to be shared
    own = [effect.entry for effect in bench.base.effects]
    generator = torch.Generator().manual_seed(3)
    for entry in candidate_entries(bench, None):
        model = bench.likelihood(Hypothesis((entry,))).model
        alone = LightCurve(scene, recording, assembly=assemble(scene, recording, [*own, entry]))
        theta = model.parameter_set.sample_prior(3, generator)
        with torch.no_grad():
            light = model(theta)
            torch.testing.assert_close(light, alone(theta), msg=entry)
            if entry == "interreflection":
                bare = base(theta[:, [model.names.index(name) for name in base.names]])
                assert float((light - bare).abs().max()) > 1e-6, "it does something here"


@needs_practice
def test_a_size_that_wandered_to_its_bound_for_nothing_is_let_go() -> None:
    """An appendage's area and reflectances are known as products alone: with the area held at the largest there may
    be, the rest makes up for it."""
    scene, recording, _ = practice("appendage")
    bench, hypothesis = Workbench(assemble(scene, recording)), Hypothesis(("appendage",))
    likelihood = bench.likelihood(hypothesis)
    parameters = likelihood.model.parameter_set
    area = likelihood.model.names.index("appendage.area")
    inside = diagnose(scene, recording, quick=True, effects=["appendage"]).final.refit
    theta = bench.start(hypothesis, inside.theta[None], inside.names)
    for name in ("appendage.r_spec", "appendage.r_diff"):
        theta[:, likelihood.model.names.index(name)] *= float(theta[0, area]) / 10.0
    theta[:, area] = 10.0
    with torch.no_grad():
        reached = polish(likelihood, theta, None, held=[area])
    wandered = linearised(likelihood, hypothesis, parameters.from_flat(reached.y[0]))
    assert [size.column for size in stuck(wandered)] == [area]
    let_go = released(wandered)
    assert not stuck(let_go)
    assert let_go.objective < wandered.objective + 1.0
    assert float(let_go.theta[area]) < 9.0


def test_the_weakest_tail_there_can_be_is_no_parameter_at_its_limit() -> None:
    """A tail that is as heavy as may be (g = 1) is at its limit; one as light as can be told (g = 10) is not."""
    scene = load_scene(DEMO / "scene.toml")
    bench = Workbench(assemble(scene, load_recording(DEMO / "recording.ecsv", scene)))
    hypothesis = Hypothesis(("lobe_tail[panel]",))
    likelihood = bench.likelihood(hypothesis)
    theta = likelihood.model.parameter_set.start()
    place = likelihood.model.names.index("lobe_tail.g[panel]")
    for g, held in ((10.0, []), (1.0, [place])):
        theta[place] = g
        refit = linearised(likelihood, hypothesis, theta)
        assert bool(refit.held[place])
        assert [size.column for size in stuck(refit)] == held


def test_nights_are_planned_with_the_exposures_of_the_recording(demo_refit) -> None:
    """The demo's model smears over exposures, and has no night to offer for exposures of none."""
    base = demo_refit.model.assembly
    bench, rival = Workbench(base), Hypothesis(("background",))
    theta = bench.start(rival, demo_refit.theta[None], demo_refit.names)[0]
    theta[bench.likelihood(rival).model.names.index("background.fraction")] = 0.1
    context = base.context
    scorer = Scorer(context, make_blocks(context.seconds, context.curve))
    refits = demo_refit, linearised(bench.likelihood(rival), rival, theta)
    nights = next_nights(*(Found(one, scorer.score(one)) for one in refits))
    assert "exposure_smearing" in [effect.name for effect in base.effects]
    assert nights and nights[0].margin > nights[-1].margin > 0


def test_fewer_rows_than_parameters_get_a_verdict() -> None:
    scene = load_scene(DEMO / "scene.toml")
    recording = load_recording(DEMO / "recording.ecsv", scene)
    few = recording.keep(np.arange(len(recording)) % 80 == 0, "for a test")
    few = replace(few, observed=few.observed + np.array([-10.0, 10.0, -10.0]))  # no material is so bright
    found = diagnose(scene, few, quick=True)
    assert found.final.refit.likelihood.degrees_of_freedom < 0
    content = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert content["verdict"] == "unexplained"


@pytest.mark.parametrize(
    ("kind", "values"),
    [(None, {}), ("jitter", {"mag": 0.03}), ("red_noise", {"mag": 0.05, "tau_min": 20.0})],
)
def test_evidence_and_heldout_are_those_of_the_dense_normal(demo_refit, kind, values) -> None:
    """log N(r; M (mu - y), C + M V M') and the conditional density of a block, written out with full
    matrices."""
    refit = demo_refit
    context = refit.model.assembly.context
    blocks = make_blocks(context.seconds, context.curve)
    scorer = Scorer(context, blocks)
    noise = WHITE if kind is None else scorer.model(kind, **values)
    free = ~refit.held
    m = refit.slopes[:, free]
    prior = torch.linalg.inv(refit.prior_precision[free][:, free])
    shift = m @ (refit.prior_mean - refit.y)[free]
    gap = (context.seconds[:, None] - context.seconds).abs() / 60
    c = torch.diag(refit.sigma**2 + (0.03**2 if kind == "jitter" else 0.0))
    if kind == "red_noise":
        x = math.sqrt(3) * gap / 20.0
        c = c + 0.05**2 * (1 + x) * torch.exp(-x)
    dense = torch.distributions.MultivariateNormal(shift, c + m @ prior @ m.T)
    assert scorer.log_evidence(refit, noise) == pytest.approx(float(dense.log_prob(refit.delta)), abs=1e-4)
    if kind == "red_noise":
        return
    rows, removed = blocks.rows[2], blocks.removed[2]
    rest = torch.tensor([i for i in range(len(refit.delta)) if i not in set(removed.tolist())])
    k = c + m @ prior @ m.T
    gain = torch.linalg.solve(k[rest][:, rest], k[rest][:, rows]).T
    mean = shift[rows] + gain @ (refit.delta - shift)[rest]
    spread = k[rows][:, rows] - gain @ k[rest][:, rows]
    expected = torch.distributions.MultivariateNormal(mean, 0.5 * (spread + spread.T)).log_prob(
        refit.delta[rows]
    )
    assert float(scorer.heldout(refit, noise)[2]) == pytest.approx(float(expected), abs=1e-3)


def test_a_block_that_the_rest_predicts_badly_is_improbable(demo_refit) -> None:
    """No held-out density of outliers is above that of a model that meets every row, also where one night lies a
    hundred errors off what the rest says."""
    refit = demo_refit
    context = refit.model.assembly.context
    blocks = make_blocks(context.seconds, context.curve)
    scorer = Scorer(context, blocks)
    share, width = 0.03, 8.0
    noise = scorer.model("outliers", fraction=share, width=width)
    push = torch.zeros_like(refit.delta)
    push[blocks.rows[1]] = 100.0
    far = replace(refit, delta=refit.delta + push * refit.sigma)
    followed = replace(refit, slopes=torch.cat([refit.slopes[:, :-1], (push * refit.sigma)[:, None]], 1))
    chance = torch.randn(len(push), generator=torch.Generator().manual_seed(1), dtype=push.dtype)
    perfect = replace(
        refit, delta=chance * refit.sigma
    )  # residuals of chance alone, that no parameter has followed
    met = torch.log((1 - share + share / width) / (refit.sigma * math.sqrt(2 * math.pi)))
    for one in (refit, far, followed, perfect):
        for rows, density in zip(blocks.rows, scorer.heldout(one, noise), strict=True):
            assert float(density) <= float(met[rows].sum())
    gone = scorer.heldout(refit, noise)[1] - scorer.heldout(far, noise)[1]
    # each row a hundred errors off costs half of (100 / 8)^2, less what the parameters can follow
    assert float(gone) > 0.2 * len(blocks.rows[1]) * (100 / width) ** 2


def test_gaussian_prior_is_the_density_of_reflectances_known_to_a_few_per_cent() -> None:
    """Normal in r_spec and r_diff, though the fit's own coordinate is r_diff's share of what r_spec leaves: the
    same odds of two points near the centre, and the same mean and spread as draws."""
    scene = load_scene(DEMO / "scene.toml")
    panel = scene.materials["panel"]
    known = {
        "n": panel.parameters["n"],
        "r_spec": Free(value=0.3, low=0.0, high=1.0, sigma=0.02, prior="normal"),
        "r_diff": Free(value=0.2, low=0.0, high=1.0, sigma=0.01, prior="normal"),
    }
    materials = {**scene.materials, "panel": panel.model_copy(update={"preset": None, "parameters": known})}
    scene = scene.model_copy(update={"materials": materials})
    model = LightCurve(scene, load_recording(DEMO / "recording.ecsv", scene))
    parameters = model.parameter_set
    pair = [model.names.index("panel.r_spec"), model.names.index("panel.r_diff")]
    theta = parameters.start()
    mean, precision, _ = gaussian_prior(parameters, parameters.to_flat(theta))
    draws = parameters.sample_prior(40_000, torch.Generator().manual_seed(1))
    flat = parameters.to_flat(draws)[:, pair]
    spread = torch.linalg.inv(precision)[pair][:, pair]
    torch.testing.assert_close(flat.mean(0), mean[pair], rtol=2e-3, atol=0)
    torch.testing.assert_close(torch.cov(flat.T), spread, rtol=0.04, atol=1e-6)


def test_a_scene_without_anything_free_gets_a_verdict() -> None:
    """The demo's recording with every number of its materials and its zero point given as known."""
    scene = load_scene(DEMO / "scene.toml")
    materials = {
        name: material.model_copy(
            update={
                "preset": None,
                "parameters": {
                    key: number.value if isinstance(number, Free) else number
                    for key, number in material.parameters.items()
                },
            }
        )
        for name, material in scene.materials.items()
    }
    model = scene.model.model_copy(update={"parameters": {**scene.model.parameters, "zero_point": 0.0}})
    scene = scene.model_copy(update={"materials": materials, "model": model})
    recording = load_recording(DEMO / "recording.ecsv", scene)
    assert LightCurve(scene, recording).names == []
    found = diagnose(scene, recording, quick=True, effects=["background", "interreflection", "finite_sun"])
    assert found.gate.global_p < 0.01, "where the priors begin is not what was recorded"


def test_gate_is_uniform_when_nothing_is_missing(demo_refit) -> None:
    """Residuals drawn off the baseline's tangent: p-values uniform by Kolmogorov and Smirnov at 1 %."""
    refit = demo_refit
    context = refit.model.assembly.context
    battery = Battery(context.seconds, context.curve, {"time": context.seconds}, {}, True)
    generator = torch.Generator().manual_seed(1)
    m = refit.slopes[:, ~refit.held] / refit.sigma[:, None]
    q = torch.linalg.qr(m)[0]
    found = []
    for number in range(60):
        z = torch.randn(len(refit.delta), generator=generator, dtype=torch.float64)
        z = z - q @ (q.T @ z)
        found.append(gate(replace(refit, delta=z * refit.sigma), battery, seed=number, draws=400).global_p)
    ordered = np.sort(found)
    steps = np.arange(1, 61) / 60
    distance = max(np.abs(ordered - steps).max(), np.abs(ordered - steps + 1 / 60).max())
    assert distance < 1.63 / math.sqrt(60)


def test_gate_sees_a_short_dip_that_chi_square_does_not(demo_refit) -> None:
    refit = demo_refit
    context = refit.model.assembly.context
    battery = Battery(context.seconds, context.curve, {}, {}, True)
    generator = torch.Generator().manual_seed(4)
    z = torch.randn(len(refit.delta), generator=generator, dtype=torch.float64)
    quiet = gate(replace(refit, delta=z * refit.sigma), battery)
    dipped = z.clone()
    dipped[100:112] += 1.5
    loud = gate(replace(refit, delta=dipped * refit.sigma), battery)
    assert loud.marginal["chi2"] > 0.001
    assert loud.global_p < 0.01 < quiet.global_p
    assert any(a <= 112 and b >= 100 for a, b, _ in loud.windows)


def test_tail_of_exponential_draws_is_the_exponential() -> None:
    draws = torch.sort(
        torch.distributions.Exponential(torch.tensor(1.0, dtype=torch.float64)).sample((40000,))
    ).values
    value = torch.tensor([0.5, 2.0, 8.0, 20.0], dtype=torch.float64)
    assert torch.allclose(log_tail(draws, value), -value, rtol=0.08, atol=0.02)


def test_runs_of_a_mask() -> None:
    assert runs(torch.tensor([1, 1, 0, 0, 1, 0, 1], dtype=torch.bool)) == [(0, 1), (4, 4), (6, 6)]
    assert runs(torch.zeros(3, dtype=torch.bool)) == []


@pytest.mark.parametrize(
    "text", ["earth_shadow", "color_term[panel +Y]", "time_offset@curve", "time_offset@curve~210"]
)
def test_entries_read_as_they_are_written(text: str) -> None:
    assert str(Entry.parse(text)) == text
