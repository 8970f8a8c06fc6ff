"""What a refit takes by the numbers that it moves, and when a probe's promise bounds what its effect may gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.ball import BALL, grown, searched, stepped
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import SCALE, Hypothesis, Workbench
from torchlc.diagnosis.probes import Probe
from torchlc.diagnosis.promises import DEAR_STEPS, refit_seconds
from torchlc.inference.density import Fitted, Posterior
from torchlc.inference.posterior import LONGEST
from torchlc.scene import Scene

STEP, DRIFT = "zero_point_step", "zero_point_drift"

# ------------------------------------------------------------------ what a refit takes


@pytest.mark.parametrize(
    ("entries", "geometries"),
    [
        ((), 2),  # one, and one more for the zero point
        ((DRIFT,), 3),
        ((STEP, DRIFT), 5),
        ((f"{DRIFT}@curve",), 3),  # no row belongs to two curves: one geometry tells the slopes of all
        ((f"{DRIFT}@curve", "background@curve"), 4),
    ],
)
@pytest.mark.parametrize("noise", [(), (SCALE, "outliers")])
@pytest.mark.parametrize("curves", [2, 5])
def test_a_refit_takes_a_geometry_for_each_number_that_moves_light(
    ball, entries, geometries, noise, curves
) -> None:
    """In every step. Numbers of the noise need none, and those of single curves need one together, however many they are."""
    scene, recording = ball
    curve = np.arange(len(recording)) % curves
    recording = replace(recording, curve=curve, curve_ids=tuple("abcde"[:curves]))
    hypothesis = Hypothesis(entries, noise)
    posterior = Posterior(Workbench(scene, recording).likelihood(hypothesis), SCALE in noise)
    assert refit_seconds(posterior, 1.0) == geometries * DEAR_STEPS
    assert refit_seconds(posterior, 0.25) == 0.25 * refit_seconds(posterior, 1.0)
    assert refit_seconds(posterior) == 0.0, "none of them moves the geometry"


def test_a_geometry_takes_what_it_is_counted_to_take_unless_so_few_facets_are_afforded(
    monkeypatch, ball
) -> None:
    """A box of six facets that is turned: by the afforded geometry's own seconds, as where nothing is afforded."""
    box = BALL.replace('shape = "sphere"\nradius = 1.0', 'shape = "box"\nsize = [1.0, 2.0, 3.0]')
    bench = Workbench(Scene.from_toml(box), ball[1])
    posterior = Posterior(bench.likelihood(Hypothesis(("attitude_offset",))), False)
    each = posterior.geometry_seconds
    assert each > 0.0 == refit_seconds(posterior)
    monkeypatch.setattr("torchlc.inference.density.AFFORDED_S", 0.0)
    # three angles and the zero point
    assert refit_seconds(posterior) == pytest.approx(5 * DEAR_STEPS * each)


# ------------------------------------------------------------------ what a promise bounds


@pytest.fixture(scope="module")
def promised(ball) -> tuple[Search, Fitted]:
    """A search whose step was probed and fitted beside the scene's own model."""
    search = searched(stepped(ball, 0.03, 0.01))
    at = search.visited[Hypothesis().under(*search.robust)]
    probes = search.probe_all(at, [STEP])
    search.extend(at, STEP, probes[STEP])
    return search, at


def with_gain(promised: tuple[Search, Fitted], hypothesis: Hypothesis, gain: float, score: float) -> Search:
    """The search as if a hypothesis had gained so much in log evidence over the scene's own model, and its step's probe had scored so much."""
    search, at = promised
    known = search.latest[STEP][0]
    fitted = search.visited[Hypothesis((STEP,), search.robust)]
    lifted = replace(fitted, hypothesis=hypothesis, peak=fitted.peak + gain - (fitted.log_z - at.log_z))
    scores = known.scores * score / known.score
    own = {key: other for key, other in search.visited.items() if not key.added}
    return replace(
        search,
        visited={**own, hypothesis: lifted},
        latest={STEP: (replace(known, scores=scores), at)},
    )


@pytest.mark.parametrize(
    ("gain", "score", "hold"),
    [(39.9, 20.0, True), (40.1, 20.0, False), (79.9, 40.0, True), (40.1, 0.1, False), (-5.0, 0.1, True)],
)
def test_a_gain_of_four_times_what_was_promised_is_the_most_that_is_believed(
    promised, gain, score, hold
) -> None:
    """A score of 20 promises 10 in log density."""
    assert LONGEST == 4.0
    search = with_gain(promised, Hypothesis((STEP,), promised[0].robust), gain, score)
    assert search.promises_hold(promised[1]) is hold


@pytest.mark.parametrize("other", ["law", "noise", "two more", "no value", "beside another", "never probed"])
def test_what_says_nothing_of_probes_beside_this_fit_is_not_held_against_them(promised, other) -> None:
    """A gain of 100 where 5 were promised: under another law or noise, of two effects together, or of what was not probed here."""
    search, at = promised
    robust = search.robust
    assert not with_gain(promised, Hypothesis((STEP,), robust), 100.0, 10.0).promises_hold(at)
    hypothesis = {
        "law": Hypothesis((STEP,), robust, "another"),
        "noise": Hypothesis((STEP,)),
        "two more": Hypothesis((STEP, DRIFT), robust),
    }.get(other, Hypothesis((STEP,), robust))
    changed = with_gain(promised, hypothesis, 100.0, 10.0)
    known = changed.latest[STEP][0]
    if other == "no value":
        empty = Probe(
            STEP,
            known.psi[:0],
            known.signatures[:0],
            known.scores[:0],
            known.aimed[:0],
            known.moved[:0],
            True,
        )
        changed.latest[STEP] = empty, at
    elif other == "beside another":
        changed.latest[STEP] = known, search.visited[Hypothesis()]
    elif other == "never probed":
        changed.latest.clear()
    assert changed.promises_hold(at)


def test_a_larger_set_is_held_against_the_fit_that_it_has_one_effect_more_than(ball) -> None:
    """Beside a drift that is fitted, its own step: beside the scene's own model the drift alone is asked, and was not probed."""
    search = grown(stepped(ball, 0.3, 0.0))
    null = search.visited[Hypothesis()]
    search = replace(
        search, visited={Hypothesis().under(*search.robust): search.renoise(null, search.robust)}
    )
    at = search.extend(search.visited[Hypothesis().under(*search.robust)], DRIFT, None)
    probes = search.probe_all(at, [STEP])
    search.extend(at, STEP, probes[STEP])
    none = search.visited[Hypothesis().under(*search.robust)]
    assert search.promises_hold(none)
    assert not search.promises_hold(at), "errors beside a step of 0.3 mag are fitted far too large"
    # two effects of which the drift is none have not one more than it, however much they gained
    best = search.best(DRIFT, STEP)
    others = replace(best, hypothesis=Hypothesis((STEP, "background"), search.robust), peak=best.peak + 50.0)
    search.visited[others.hypothesis] = others
    assert not search.promises_hold(at)
