"""What a search asks first, what it does not begin, and where it looks for the law of reflection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.ball import BALL, METAL, searched, stepped
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench
from torchlc.diagnosis.probabilities import probabilities
from torchlc.diagnosis.promises import first_steps_seconds
from torchlc.inference.density import Posterior
from torchlc.readers import Recording
from torchlc.scene import Scene

WINGED = BALL.replace('model = "lambert"\nalbedo = 0.5', METAL).replace(
    """[[components]]
name = "ball"
shape = "sphere"
radius = 1.0
centre = [0, 0, 0]
""",
    """[[components]]
name = "wing"
shape = "plate"
size = [3.0, 2.0]
centre = [0, 3.0, 0]
u = [0, 1, 0]
v = [-1, 0, 0]
material = "paint"
[[components]]
name = "body"
shape = "box"
size = [1.0, 1.0, 1.0]
centre = [0, 0, 0]
""",
)


@pytest.fixture(scope="module")
def winged(ball) -> tuple[Scene, Recording]:
    scene = Scene.from_toml(WINGED)
    rough = Workbench(scene, ball[1]).likelihood(Hypothesis()).model
    with torch.no_grad():
        lit = torch.isfinite(rough(rough.parameter_set.start())).numpy()
    return scene, ball[1].keep(lit, "behind the plate")


@pytest.fixture(scope="module")
def search(winged) -> Search:
    search = Search(Workbench(*winged), Clock(None), 0)
    search.null()
    return search


def posterior(case, *entries: str) -> Posterior:
    return Posterior(Workbench(*case).likelihood(Hypothesis(entries)), scaled=True)


def test_light_between_facets_takes_longer_to_begin_from_many_places(winged) -> None:
    seconds = {}
    for entries in ((), ("interreflection",)):
        begun = posterior(winged, *entries)
        starts = begun.model.parameter_set.start().repeat(32, 1)
        seconds[entries] = first_steps_seconds(begun, starts)
        assert first_steps_seconds(begun, starts[:16]) == pytest.approx(seconds[entries] / 2)
    assert seconds[("interreflection",)] > 3 * seconds[()]


@pytest.mark.parametrize(("budget", "begun"), [(900.0, True), (0.5, False)])
def test_what_would_take_more_than_half_of_what_is_left_is_not_begun_afresh(search, budget, begun) -> None:
    at = search.visited[Hypothesis().under(*search.robust)]
    search.extend(at, "interreflection", None)
    search.clock = Clock(budget)
    search.begun_afresh.clear()
    search.afresh()
    assert bool(search.begun_afresh) is begun


def test_light_from_many_directions_is_probed_last(search) -> None:
    entries = ["interreflection", "earthshine", "time_offset", "background"]
    search.clock = Clock(None)
    probes = search.probe_all(search.visited[Hypothesis().under(*search.robust)], entries)
    assert list(probes)[:2] == ["background", "time_offset"]
    assert set(probes) == set(entries)


@pytest.mark.parametrize(("leader", "asked"), [("zero_point_step", True), ("background", False)])
def test_a_leader_of_several_numbers_is_held_against_another_law_with_one(winged, leader, asked) -> None:
    """Rows of microfacets that drift: whatever leads beside the wrong law, the rule is about the numbers of what does."""
    scene, recording = winged
    rough = Workbench(scene, recording).likelihood(Hypothesis(law="ggx-lambert")).model
    with torch.no_grad():
        light = rough(rough.parameter_set.start()).numpy()
    noise = recording.error * np.random.default_rng(5).normal(size=len(light))
    hours = (recording.seconds - recording.seconds.mean()) / 3600
    search = Search(
        Workbench(scene, replace(recording, observed=light + 0.1 * hours + noise)), Clock(None), 0
    )
    search.null()
    null = search.visited[Hypothesis().under(*search.robust)]
    leading = search.extend(null, leader, None)
    behind = search.log_odds(search.leader) - search.log_odds(leading.hypothesis)
    search.visited[leading.hypothesis] = replace(leading, peak=leading.peak + behind + 5.0)
    assert search.foremost == leading.hypothesis
    search.laws(["zero_point_drift"], clean=True)
    beside_laws = [hypothesis for hypothesis in search.visited if hypothesis.law and hypothesis.added]
    assert bool(beside_laws) is asked


def late(ball, step: float, drift: float, *probed: str) -> tuple[Search, dict[str, float]]:
    """A search that found a step (mag) beside a drift (mag/h), and had no time for two more; what it tells of effects."""
    search = searched(stepped(ball, step, drift))
    null = search.visited[Hypothesis().under(*search.robust)]
    search.probes = search.probe_all(null, ["zero_point_step", *probed])
    search.extend(null, "zero_point_step", search.probes["zero_point_step"])
    search.bench.entries = ["zero_point_step", "zero_point_drift", "background"]
    search.tell_unexamined()
    assert set(search.unexamined) == {"zero_point_drift", "background"}
    return search, dict(probabilities(search, 0.5).effects)


def test_what_there_was_no_time_for_counts_as_far_as_its_probe_promises(ball) -> None:
    """A drift takes most of a step, and more of a drift: it is told with what was fitted, and never before it. Stray light is nothing like it."""
    search, effects = late(ball, 0.1, 0.0, "zero_point_drift", "background")
    assert 0.01 < effects["zero_point_drift"] < effects["zero_point_step"]
    odds = probabilities(search, 0.5)
    assert odds.best == ("zero_point_step",) and odds.told > 0.9
    assert late(ball, 0.04, 0.0, "zero_point_drift", "background")[1].get("background", 0.0) < 0.01
    assert late(ball, 0.1, 0.2, "zero_point_drift", "background")[1]["zero_point_drift"] > 0.2


def test_what_was_not_even_probed_is_as_likely_as_something_unknown(ball) -> None:
    _, effects = late(ball, 0.04, 0.0)
    assert effects["zero_point_drift"] == pytest.approx(0.02 * effects["zero_point_step"], rel=0.05)
    assert effects["background"] == pytest.approx(effects["zero_point_drift"])


def test_where_nothing_is_missing_no_effect_gains_from_a_want_of_time(ball) -> None:
    search = searched(ball)
    search.bench.entries = ["zero_point_step", "zero_point_drift", "background"]
    search.tell_unexamined()
    odds = probabilities(search, 0.5)
    assert odds.verdict == "adequate" and not odds.effects


@pytest.mark.parametrize(("score", "first"), [(52.0, "zero_point_drift"), (80.0, "zero_point_step")])
def test_of_two_that_promise_alike_that_of_fewer_numbers_is_refitted_first(ball, score, first) -> None:
    """A step has an instant beside its size, which the rows have to tell too: of 52 it promises less evidence than a drift of 50."""
    entries = ["zero_point_step", "zero_point_drift"]
    known = searched(stepped(ball, 0.1, 0.05))
    probes = known.probe_all(known.visited[Hypothesis().under(*known.robust)], entries)
    promised = {"zero_point_step": score, "zero_point_drift": 50.0}
    probes = {
        entry: replace(one, scores=one.scores * (promised[entry] / one.score))
        for entry, one in probes.items()
    }

    class Promised(Search):
        def probe_all(self, *_, **__):
            return probes

    search = Promised(known.bench, Clock(None), 0)
    search.null()
    search.singles(entries, lambda at: 1.0)
    assert next(hypothesis.added for hypothesis in search.visited if hypothesis.added) == (first,)
