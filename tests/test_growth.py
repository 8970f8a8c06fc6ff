"""Sets of effects: which are fitted, in which order, and where their growth ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.ball import METAL, changed, searched, stepped
from torchlc.diagnosis.growth import GROWN
from torchlc.diagnosis.hypotheses import LAW_ODDS, Hypothesis, Workbench


@pytest.mark.parametrize(("step", "refitted"), [(0.3, False), (0.03, True)])
def test_an_effect_that_promises_too_little_beside_the_foremost_is_not_refitted(ball, step, refitted) -> None:
    """A drift of 0.01 mag/h gains some 20 in log density; a step of 0.3 mag gains thousands."""
    search = searched(stepped(ball, step, 0.01), "zero_point_step")
    at = search.visited[Hypothesis().under(*search.robust)]
    search.extend(at, "zero_point_step", None)
    found = search.probe_all(at, ["zero_point_drift"])["zero_point_drift"]
    assert search.within_reach("zero_point_drift", at, found) is refitted
    assert (Hypothesis(("zero_point_drift",), search.robust) in search.linear) is not refitted
    search.probes, search.bench.entries = {"zero_point_drift": found}, ["zero_point_drift"]
    search.tell_unexamined()
    assert ("zero_point_drift" in search.unexamined) is refitted  # here nothing has refitted it


@pytest.mark.parametrize(("step", "hold"), [(0.3, False), (0.03, True)])
def test_promises_bound_nothing_where_the_best_gained_far_more_than_its_own(ball, step, hold) -> None:
    """Beside a step of 0.3 mag that is not in the model errors are fitted fifteen times as large: all probes promise too little."""
    search = searched(stepped(ball, step, 0.01))
    at = search.visited[Hypothesis().under(*search.robust)]
    assert search.promises_hold(at)  # nothing is known yet
    probes = search.probe_all(at, ["zero_point_step", "zero_point_drift"])
    search.extend(at, "zero_point_step", probes["zero_point_step"])
    assert search.promises_hold(at) is hold
    if not hold:
        assert search.within_reach("zero_point_drift", at, probes["zero_point_drift"])
        assert not search.linear


def test_what_promises_most_is_refitted_first_whichever_set_it_grows(ball) -> None:
    """Beside a step of 0.1 mag that is in the model a drift is all that is left; beside a background there is the step."""
    search = searched(stepped(ball, 0.1, 0.02))
    at = search.visited[Hypothesis().under(*search.robust)]
    for entry in ("zero_point_step", "background"):
        search.extend(at, entry, None)
    steps = [
        one
        for stem in ("background", "zero_point_step")
        for one in search.promising(
            Hypothesis((stem,), search.robust), ["zero_point_drift"], GROWN, anew=True
        )
    ]
    assert [one.stem.added for one in steps] == [("background",), ("zero_point_step",)]
    search.take(steps)
    pairs = [one for one in search.visited if len(one.added) == 2]
    assert pairs[0].added == ("zero_point_step", "zero_point_drift")
    search.take(steps)
    assert [one for one in search.visited if len(one.added) == 2] == pairs  # once is enough


@pytest.mark.long
@pytest.mark.parametrize("nothing_left", [True, False])
def test_a_round_ends_where_the_foremost_leaves_nothing(ball, nothing_left) -> None:
    """Two effects of which the first takes the drift that there is: the other is not refitted once nothing is left."""
    hours = (ball[1].seconds - ball[1].seconds.mean()) / 3600
    search = searched(changed(ball, 0.05 * hours))
    null = Hypothesis().under(*search.robust)
    entries = ["zero_point_drift", "zero_point_step"]
    steps = search.promising(null, entries, GROWN, anew=True)
    assert {one.entry for one in steps} == set(entries)
    search.take(steps, lambda at: 0.5 if nothing_left and at.hypothesis.added else 0.001)
    singles = [one for one in search.visited if len(one.added) == 1]
    assert (len(singles) == 1) is nothing_left
    assert search.foremost.added == ("zero_point_drift",)


@pytest.mark.long
@pytest.mark.parametrize("nothing_left", [True, False])
def test_as_long_as_structure_is_left_every_effect_is_refitted(ball, nothing_left) -> None:
    """A step of 0.06 mag gains about what its probe promises; what others promise is less, and is a bound only beside what leaves nothing."""
    search = searched(stepped(ball, 0.06, 0.0))
    search.bench.entries = search.bench.candidates(None)
    assert len(search.bench.entries) > GROWN
    search.singles(search.bench.entries, lambda at: 0.5 if nothing_left and at.hypothesis.added else 0.001)
    visible = {entry for entry, one in search.probes.items() if one.visible}
    refitted = {entry for one in search.visited for entry in one.added}
    assert (visible <= refitted) is not nothing_left


def test_the_last_gain_is_between_the_best_of_two_sizes(ball) -> None:
    search = searched(stepped(ball, 0.1, 0.02))
    at = search.visited[Hypothesis().under(*search.robust)]
    assert search.last_gain(1) == 0.0
    step = search.extend(at, "zero_point_step", None)
    search.extend(at, "background", None)
    both = search.extend(step, "zero_point_drift", None)
    gained = [search.log_odds(step.hypothesis) - search.log_odds(at.hypothesis)]
    gained.append(search.log_odds(both.hypothesis) - search.log_odds(step.hypothesis))
    assert [search.last_gain(1), search.last_gain(2)] == pytest.approx(gained)
    assert gained[0] > gained[1] > 0


def test_one_more_law_of_reflection_makes_none_less_likely_than_the_scene_together(ball) -> None:
    """The odds of other laws are shared; rows that err together are rarer than bad rows."""
    scene, recording = ball
    metal = scene.to_toml().replace('model = "lambert"\nalbedo = 0.5', METAL)
    bench = Workbench(type(scene).from_toml(metal), recording)
    assert len(bench.laws) > 1
    odds = [np.exp(bench.log_odds(Hypothesis(law=law))) for law in bench.laws]
    assert sum(odds) == pytest.approx(LAW_ODDS)
    kinds = bench.kinds
    together = [name for name, kind in kinds.items() if kind.correlates]
    apart = [name for name, kind in kinds.items() if not kind.correlates]
    assert together and apart
    least = min(bench.log_odds(Hypothesis(noise=(name,))) for name in apart)
    assert all(bench.log_odds(Hypothesis(noise=(name,))) < least for name in together)


@pytest.mark.parametrize(
    ("stem", "entry", "drift", "tried"),
    [
        ("zero_point_step", "zero_point_drift", 0.03, True),
        ("zero_point_drift", "background", 0.0, False),
    ],
)
def test_an_effect_beside_one_that_is_behind_is_tried_where_it_may_lift_both_above_the_leader(
    ball, stem, entry, drift, tried
) -> None:
    """A drift takes a part of a step of 0.1 mag, and a background beside it hardly more."""
    search = searched(stepped(ball, 0.1, drift))
    at = search.visited[Hypothesis().under(*search.robust)]
    search.probe_all(at, [entry])
    search.extend(at, "zero_point_step", None)
    search.extend(at, stem, None)
    search.overtake([Hypothesis((stem,), search.robust)], [entry])
    assert any(set(one.plain) == {stem, entry} for one in search.visited) is tried


@pytest.mark.parametrize(("leader", "tried"), [("zero_point_step", True), ("zero_point_drift", False)])
def test_a_leader_of_two_numbers_is_held_against_two_effects_of_one(ball, leader, tried) -> None:
    """A drift beside stray light: a step takes most of both. A leader of one number leaves none for two."""
    scene, recording = ball
    light = 10 ** (-0.4 * recording.observed)
    stray = -2.5 * np.log10(1 + 0.5 * np.median(light) / light)
    hours = recording.seconds / 3600
    search = searched((scene, replace(recording, observed=recording.observed + stray + 0.05 * hours)))
    at = search.visited[Hypothesis().under(*search.robust)]
    entries = [one for one in ("zero_point_drift", "background") if one != leader]
    search.probes = search.probe_all(at, entries)
    for entry in (leader, *entries):
        search.extend(at, entry, search.probes.get(entry))
    # whatever leads here, the rule is about the numbers of what does
    one = Hypothesis((leader,), search.robust)
    behind = search.log_odds(search.leader) - search.log_odds(one)
    search.visited[one] = replace(search.visited[one], peak=search.visited[one].peak + behind + 1.0)
    assert search.foremost == one
    search.of_fewer_numbers(entries)
    pair = {"zero_point_drift", "background"}
    assert any(set(one.plain) == pair for one in search.visited) is tried


@pytest.mark.parametrize("clean", [True, False])
def test_beside_one_number_that_describes_all_no_two_are_begun_together(ball, clean) -> None:
    hours = (ball[1].seconds - ball[1].seconds.mean()) / 3600
    search = searched(changed(ball, 0.05 * hours), "zero_point_drift")
    entries = ["zero_point_drift", "background", "extinction_residual"]
    at = search.visited[Hypothesis().under(*search.robust)]
    search.probes = search.probe_all(at, entries)
    search.extend(at, "zero_point_drift", search.probes["zero_point_drift"])
    assert search.foremost.added == ("zero_point_drift",) and search.as_quoted
    search.jointly(clean)
    assert any(len(one.added) == 2 for one in search.visited) is not clean
