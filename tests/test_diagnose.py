"""The diagnosis on recordings of an independent simulator, and its statistics against dense algebra and
draws."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import special

import torchlc
from tests.good_input import SCENE
from tests.noisy_rows import changed
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import SCALE, Hypothesis, Workbench
from torchlc.diagnosis.joint import ALIKE, joint_sets
from torchlc.diagnosis.plan import Forecast, next_nights, told_by
from torchlc.diagnosis.probabilities import Probabilities, worth_of_p
from torchlc.diagnosis.probes import Probe, beyond
from torchlc.diagnosis.run import _runner_up, diagnose
from torchlc.diagnosis.words import headline
from torchlc.files.numbers import Free
from torchlc.inference.density import Posterior
from torchlc.inference.posterior import fit, fitted_at
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording
from torchlc.scene import Scene, load_scene
from torchlc.stages.entry import Entry

PRACTICE = Path(__file__).parents[2] / "shared" / "practice"
ROOT = Path(__file__).parents[1]
DEMO = ROOT / "torchlc" / "demo"
sys.path.insert(0, str(ROOT / "examples" / "calibration"))

import make_injections  # noqa: E402

needs_practice = pytest.mark.skipif(not PRACTICE.is_dir(), reason=f"{PRACTICE} is not here")


def found_values(found):
    return dict(zip(found.final.names, found.final.theta.tolist(), strict=True))


def practice(name: str):
    scene = load_scene(PRACTICE / name / "scene.toml")
    recording = load_recording(PRACTICE / name / "recording.ecsv", scene)
    return scene, recording, json.loads((PRACTICE / name / "answer.json").read_text())


@pytest.mark.long
@needs_practice
@pytest.mark.parametrize(
    "name", ["control", "jitter", "exposure_smearing", "earth_shadow", "appendage", "panel_offset"]
)
def test_practice_case_is_named(name: str) -> None:
    """Verdict, name and chi-square of the answer; the interval against the true one where there is one. What is missing
    shows within 40 s where a search goes on longer; that nothing is, or that a name stands alone, after all of it."""
    scene, recording, answer = practice(name)
    budget = 40.0 if name in ("earth_shadow", "appendage", "panel_offset") else None
    content = json.loads(json.dumps(diagnose(scene, recording, budget=budget).to_json(), allow_nan=False))
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
                # two surfaces may make the same glint: the posterior has more than one top, and its sd says little
                wide = 0.5 * (after["q95"] - after["q05"])
                assert abs(after["median"] - truth) < 4 * wide, f"{material}.{short}"


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


@pytest.mark.long
def test_wings_that_point_apart_are_named(tmp_path) -> None:
    """Wings 6 deg apart, by the independent program of the examples: a wobble describes them about as well, and what else
    turns panels or the whole. Every second row is enough."""
    name = "wing_split-as_is"
    (number,) = (number for number, other in make_injections.numbered() if other == name)
    make_injections.observed(name, number, seed=22).write(tmp_path)
    scene = load_scene(tmp_path / "scene.toml")
    recording = load_recording(tmp_path / "recording.ecsv", scene)
    recording = recording.keep(np.arange(len(recording)) % 2 == 0, "every second is enough")
    rivals = ["wobble", "panel_cant", "panel_offset", "attitude_offset", "nutation", "axis_tilt"]
    found = diagnose(scene, recording, quick=True, effects=["wing_split", *rivals])
    content = found.to_json()
    assert (content["verdict"], content["named"]) == ("missing_physics", ["wing_split"])
    assert found_values(found)["wing_split.deg"] == pytest.approx(3.0, abs=0.2)
    assert content["remaining"]["global_p"] > 0.01
    assert {one["name"] for one in content["where"]["components"][:2]} == {"panel +Y", "panel -Y"}


@pytest.mark.long
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


@pytest.mark.long
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
    # known to a sixth of itself: within 2.4 standard deviations
    assert found_values(found)["zero_point_step.mag"] == pytest.approx(step, rel=0.4)
    assert diagnose(scene, recording, effects=asked).named == tuple(answer["effects"])


def test_nights_are_planned_with_the_exposures_of_the_recording(demo_search) -> None:
    """The demo's model smears over exposures, and has no night to offer for exposures of none."""
    plain, rival = demo_search.visited[Hypothesis()], Hypothesis(("background",))
    posterior = demo_search.posterior(rival)
    g = torch.zeros(posterior.size, dtype=torch.float64)
    g[[posterior.model.names.index(name) for name in plain.names]] = plain.g
    g[posterior.model.names.index("background.fraction")] = 0.03  # 0.3 % of the median flux
    nights = next_nights([(plain, 0.5), (fitted_at(rival, posterior, g), 0.5)])
    assert "exposure_smearing" in [effect.name for effect in demo_search.bench.base.effects]
    assert nights and nights[0].information > nights[-1].information >= 0
    assert all(night.information < math.log(2) + 1e-9 for night in nights)


def test_information_of_a_night_is_that_of_two_normal_hypotheses() -> None:
    """Two forecasts 2 d sigma apart in one direction: the mutual information of a sign and a normal variable, by an integral;
    none where the forecasts are alike, all of it where they are far apart. What a free number takes up tells nothing."""
    rows, sigma = 20, torch.full((20,), 0.1, dtype=torch.float64)
    unit = torch.ones(rows, dtype=torch.float64) / math.sqrt(rows)
    nothing = torch.zeros(rows, 1, dtype=torch.float64), torch.eye(1, dtype=torch.float64)

    def told(d: float, slopes=nothing):
        pair = [Forecast(sign * d * 0.1 * unit, *slopes) for sign in (1, -1)]
        found = told_by(pair, torch.tensor([0.5, 0.5], dtype=torch.float64), sigma, 0)
        assert found is not None
        return found

    for d in (0.0, 0.5, 1.0, 2.0, 6.0):
        x = np.linspace(-12, 12, 4001) + d
        density = np.exp(-0.5 * (x - d) ** 2) / math.sqrt(2 * math.pi)
        after = 1 / (1 + np.exp(-2 * d * x))
        left = -np.trapezoid(density * (special.xlogy(after, after) + special.xlogy(1 - after, 1 - after)), x)
        assert told(d)[0] == pytest.approx(math.log(2) - left, abs=0.04), d  # 400 draws
    assert told(6.0)[1] > 0.99 and told(0.0)[1] == 0.0
    absorbed = unit[:, None] * 100.0, torch.eye(1, dtype=torch.float64)
    assert told(2.0, absorbed)[0] < 0.01


@pytest.mark.long
@pytest.mark.parametrize("offsets", [(-10.0, 10.0, -10.0), (0.0, 0.0)])
def test_no_row_to_spare_cannot_tell(offsets: tuple[float, ...]) -> None:
    """Three rows that no material explains, and two that many do, for four free numbers and more."""
    scene = load_scene(DEMO / "scene.toml")
    recording = load_recording(DEMO / "recording.ecsv", scene)
    few = recording.keep(np.arange(len(recording)) % 80 == 0, "for a test")
    few = few.keep(np.arange(len(few)) < len(offsets), "for a test")
    few = replace(few, observed=few.observed + np.array(offsets))
    found = diagnose(scene, few, quick=True, effects=["background", "panel_offset"])
    free = len(LightCurve(scene, few).names)
    assert free > len(few) and found.final.likelihood.degrees_of_freedom < 0
    content = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert (content["verdict"], content["named"], content["where"]) == ("adequate", [], None)
    assert headline(content) == (
        f"These data cannot tell whether anything is missing: {free} free numbers leave none of the "
        f"{len(few)} measured rows to spare."
    )


@pytest.mark.parametrize("kind", ["one instant", "no light"])
def test_nothing_that_varies_gets_a_verdict(kind: str, tmp_path: Path) -> None:
    """Rows of one moment have no shape in time, and fluxes of 0 leave no residual that an attitude could explain."""
    rows = [f"2020-10-17T15:{10 * k:02}:00,12.{k},0.02" for k in range(5)]
    if kind == "one instant":
        rows = [f"2020-10-17T15:00:00,12.{k},0.02" for k in range(5)]
    elif kind == "no light":
        rows = [f"2020-10-17T15:{10 * k:02}:00,0,1" for k in range(5)]
    names = "time,flux,flux_err" if kind == "no light" else "time,mag,mag_err"
    (tmp_path / "r.csv").write_text("\n".join([names, *rows, ""]))
    effects = ["wobble"] if kind == "no light" else ["background"]
    found = torchlc.diagnose(Scene.from_toml(SCENE), tmp_path / "r.csv", quick=True, effects=effects)
    content = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert content["verdict"] in ("adequate", "noise_model", "unexplained") and set(content["named"]) <= {
        "jitter"
    }


@pytest.mark.long
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


def test_outlying_rows_are_found_and_the_rest_is_fitted(demo) -> None:
    """Seven rows of the demo moved by 0.5 to 1 mag: these are told, no other, and materials are as without them."""
    scene, recording = demo
    clean = Search(Workbench(scene, recording), Clock(None), 0)
    clean.null()
    observed = recording.observed.copy()
    bad = np.linspace(5, len(observed) - 5, 7).astype(int)
    observed[bad] += np.where(np.arange(7) % 2, 1.0, -0.6)
    search = Search(Workbench(scene, replace(recording, observed=observed)), Clock(None), 0)
    search.null()
    at = search.best()
    assert any(kind != SCALE for kind in at.hypothesis.noise)
    assert torch.nonzero(at.outlying() > 0.5)[:, 0].tolist() == bad.tolist()
    before, after = clean.best(), at
    sd = torch.sqrt(torch.diagonal(before.covariance))[: len(before.names)]
    assert float(((before.g - after.g[: len(before.g)]).abs()[: len(sd)] / sd).max()) < 1.0


def test_a_free_size_is_recovered_with_outliers_in_the_rows(demo) -> None:
    """The body's height is free within 10 % about 4 % too small: found again within three standard deviations."""
    scene, recording = demo
    body = scene.components[0]
    true = float(body.size[2])
    free = Free(value=0.96 * true, sigma=0.1 * true, prior="normal")
    first = body.model_copy(update={"size": (*body.size[:2], free)})
    nominal = scene.model_copy(update={"components": [first, *scene.components[1:]]})
    likelihood = Workbench(nominal, recording).likelihood(Hypothesis())
    posterior = Posterior(likelihood, scaled=True)
    found = fit(Hypothesis(noise=(SCALE,)), posterior, torch.zeros(1, posterior.size, dtype=torch.float64))
    column = found.names.index(next(name for name in found.names if "size_z" in name))
    low, high = (
        posterior.theta(found.g + shift * torch.sqrt(torch.diagonal(found.covariance)))[column]
        for shift in (-3, 3)
    )
    assert float(low) < true < float(high)


def weighed(**changes) -> Probabilities:
    usual = {
        "nothing": 0.2, "noise": 0.0, "unknown": 0.0, "effects": {}, "kinds": {}, "leftover": 0.0, "spare": 9,
        "sets": [(("a", "b"), 0.5), (("a", "c[x]"), 0.2), (("a",), 0.05), (("d", "b"), 0.05)],
    }  # fmt: skip
    return Probabilities(**(usual | changes))


def test_names_families_and_their_probability_are_read_off_one_object() -> None:
    told = weighed()
    assert (told.verdict, told.named) == ("missing_physics", ("a", "b"))
    assert told.families == (("a", "d"), ("b", "c"))
    assert told.told == pytest.approx(0.75)  # both sets and the one with d in the place of a
    assert weighed(nothing=0.6, sets=[(("a",), 0.4)]).verdict == "adequate"
    assert weighed(noise=0.3, nothing=0.25, unknown=0.45, sets=[]).verdict == "adequate"
    assert weighed(unknown=0.75, nothing=0.05, sets=[(("a",), 0.2)]).verdict == "unexplained"
    assert weighed(unknown=0.9, nothing=0.1, sets=[], spare=0).verdict == "adequate", "too few rows"
    noisy = weighed(noise=0.9, nothing=0.1, sets=[], kinds={"jitter": 0.7, "outliers": 0.2})
    assert (noisy.verdict, noisy.named, noisy.told) == ("noise_model", ("jitter",), 0.9)


def test_a_runner_up_was_refitted(demo_search) -> None:
    """A set that was judged by its linear form alone has no fit that could be shown unseen rows."""
    assert _runner_up(demo_search, weighed(sets=[(("a",), 0.6), (("b",), 0.3)])) is None


@pytest.mark.parametrize(("p", "factor"), [(0.05, 2.46), (0.01, 7.99), (0.001, 53.3), (0.5, 1.0)])
def test_what_a_p_value_can_stand_for_is_the_published_bound(p: float, factor: float) -> None:
    """Sellke, Bayarri & Berger (2001), table 1, whose numbers are of the null's odds: 0.407, 0.125, 0.0188."""
    assert math.exp(worth_of_p(p)) == pytest.approx(factor, rel=0.01)


@pytest.mark.parametrize(
    "text", ["earth_shadow", "color_term[panel +Y]", "time_offset@curve", "time_offset@curve~210"]
)
def test_entries_read_as_they_are_written(text: str) -> None:
    assert str(Entry.parse(text)) == text


def test_two_effects_are_found_together_that_neither_a_third_nor_their_sizes_hide(demo_refit) -> None:
    """Residuals are made of two changes of the light; a third, half of each, explains more of them than either alone does."""
    refit = demo_refit
    generator = torch.Generator().manual_seed(5)
    first, second = torch.randn(2, len(refit.delta), generator=generator, dtype=torch.float64)
    between = first + second + 0.8 * torch.randn(len(refit.delta), generator=generator, dtype=torch.float64)
    at = changed(refit, 3 * first + 3 * second)
    unit = refit.wide / refit.sigma

    def made(entry: str, change: torch.Tensor) -> Probe:
        moved = (change * unit)[None]
        score = float((moved[0] @ (at.delta / at.sigma)) ** 2 / moved[0].square().sum())
        one = torch.ones(1, dtype=torch.bool)
        return Probe(
            entry, torch.ones(1, 1, dtype=torch.float64), moved, moved.new_tensor([score]), ~one, moved, True
        )

    probes = {
        one.entry: one
        for one in (made("background", first), made("saturation", second), made("wobble", between))
    }
    assert max(probes, key=lambda entry: probes[entry].score) == "wobble"
    (best, promised), *_ = joint_sets(probes, at, 2, lambda entries: 0.0, 3)
    assert set(best) == {"background", "saturation"}
    left = beyond(torch.stack([first, second]) * unit, at)
    squares = float(at.residual_rows.square().sum())
    unfitted = np.linalg.lstsq(left.numpy().T, at.residual_rows.numpy(), rcond=None)[1].item()
    # a little less, for what keeps two that are alike from being one
    assert (1 - 2 * ALIKE) * 0.5 * (squares - unfitted) < promised < 0.5 * (squares - unfitted)
    apart = joint_sets(probes, at, 2, lambda entries: -math.inf if "background" in entries else 0.0, 3)
    assert [set(one) for one, _ in apart] == [{"saturation", "wobble"}]
    assert joint_sets(probes, at, 4, lambda entries: 0.0, 3) == []
    # an appendage adds light: beside a background that is there, no less of it explains anything
    probes["appendage"] = made("appendage", -second)
    assert all(
        set(one) != {"background", "appendage"}
        for one, _ in joint_sets(probes, at, 2, lambda entries: 0.0, 9)
    )
    probes["appendage"] = made("appendage", second)
    assert any(
        set(one) == {"background", "appendage"}
        for one, _ in joint_sets(probes, at, 2, lambda entries: 0.0, 9)
    )
