"""What of a hypothesis counts as unseen, as unexamined, or as standing in for something else: each against numbers worked by hand."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from tests.ball import ERROR, drift_and_wave, even, grown, searched
from torchlc.diagnosis.discrepancy import FAR, Discrepancy
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import SCALE, Hypothesis
from torchlc.diagnosis.probabilities import (
    LEAST_TAKEN,
    WEIGHED,
    less_unseen,
    part_of_the_answer,
    share_of_unexamined,
    share_taken,
    stands_for_something_else,
)
from torchlc.diagnosis.unseen import SURE, UNSEEN

NULL, DRIFT = Hypothesis(), Hypothesis(("zero_point_drift",))
PAIR = DRIFT.with_effect("zero_point_step")
THREE = PAIR.with_effect("background")
EXCESS = 600.0
"""Squares of a drift and a wave together, in errors of a row: no row is then farther off than FAR."""


@pytest.fixture(scope="module")
def parted(ball) -> dict[float, Search]:
    """By the share of the excess that a drift has, beside a wave that has the rest. Two and three effects are fitted to it."""
    drift, wave = drift_and_wave(ball)
    more = {0.4: (), 0.6: (), 0.95: ("background",)}
    return {
        share: grown(
            even(ball, np.sqrt(EXCESS) * (np.sqrt(share) * drift + np.sqrt(1 - share) * wave)),
            *("zero_point_drift", "zero_point_step", *third),
        )
        for share, third in more.items()
    }


@pytest.fixture(scope="module")
def faint(ball) -> Search:
    """A drift of 3.2 errors, which is between UNSEEN and SURE, under the quoted errors and under the robust noise."""
    search = searched(even(ball, 3.2 * drift_and_wave(ball)[0]), "zero_point_drift")
    search.extend(search.visited[NULL.under(*search.robust)], "zero_point_drift", None)
    search.extend(search.visited[DRIFT], "zero_point_step", None)
    return search


def summed(rows: Sequence[tuple[str, Hypothesis, float, float]]) -> dict[tuple[str, Hypothesis], float]:
    """Mass by kind and hypothesis, to which it may have come in several parts."""
    total: dict[tuple[str, Hypothesis], float] = defaultdict(float)
    for kind, hypothesis, p, _ in rows:
        total[kind, hypothesis] += p
    return dict(total)


def taken(search: Search, hypothesis: Hypothesis) -> float:
    """Share of the scene's own misfit that a hypothesis takes."""
    at = search.visited[hypothesis]
    return share_taken(search.best(), at, at.wide)


def stands(search: Search, hypothesis: Hypothesis) -> bool:
    """Whether a set by itself, in the errors that it has, stands for something else."""
    errors = search.visited[hypothesis].wide
    return stands_for_something_else(search, hypothesis, len(hypothesis.added), errors)


# ------------------------------------------------------------------ what was not examined


@pytest.mark.parametrize(
    ("unexamined", "share"),
    [
        ([], 0.0),
        (["background"], 20 / 23),  # 1/3 against 1/20
        (["saturation", "background"], 40 / 43),
        (["zero_point_drift@night"], 10 / 13),  # one of two divisions, which share their name's third
        (["zero_point_drift@night", "zero_point_drift@curve"], 20 / 23),
        (["attitude_jump"], 2 / 5),  # of prior odds 1 in 10: 1/30 against 1/20
        (["lambert"], 0.0),  # a law of reflection is no effect
    ],
)
def test_what_was_not_examined_has_its_prior_odds_beside_something_unknown(faint, unexamined, share) -> None:
    """Of four names each has odds of one in three, and something unknown of one in twenty."""
    entries = [
        "background",
        "zero_point_drift@night",
        "zero_point_drift@curve",
        "saturation",
        "attitude_jump",
    ]
    search = Search(faint.bench, faint.clock, 0, unexamined=dict.fromkeys(unexamined, "there was no time"))
    usual = search.bench.entries
    for order in (entries, entries[::-1]):
        search.bench.entries = order
        assert share_of_unexamined(search) == pytest.approx(share)
    search.bench.entries = usual


# ------------------------------------------------------------------ what nobody could see


def test_of_a_drift_counts_what_its_normal_posterior_has_above_what_is_seen(faint) -> None:
    """Its size in errors is normal about 3.2, for the prior of 16 takes next to nothing: by scipy."""
    sd = 1 / np.sqrt(1 + 1 / 16**2)
    below = {
        limit: np.diff(stats.norm.cdf([-limit, limit], 3.2 * sd**2, sd)).item() for limit in (UNSEEN, SURE)
    }
    rows = less_unseen(faint, [("", DRIFT, 0.5), ("", NULL, 0.2), ("odd", NULL, 0.3)])
    mass = summed(rows)
    error = 0.08  # 200 draws: two and a half standard deviations at one half
    assert mass["", DRIFT] == pytest.approx(0.5 * (1 - below[UNSEEN]), abs=0.5 * error)
    assert mass["", NULL] == pytest.approx(0.2 + 0.5 * below[UNSEEN], abs=0.5 * error)
    assert mass["odd", NULL] == 0.3
    (unsure,) = (unsure for _, hypothesis, _, unsure in rows if hypothesis == DRIFT)
    assert unsure == pytest.approx((below[SURE] - below[UNSEEN]) / (1 - below[UNSEEN]), abs=error)
    assert all(unsure == 0.0 for _, hypothesis, _, unsure in rows if hypothesis == NULL)


def test_mass_moves_to_smaller_sets_and_none_is_lost(faint) -> None:
    """Whatever the order of the hypotheses. A step that is not there is unseen beside the drift, more likely than not."""
    noisy = DRIFT.under(*faint.robust)
    masses = [("", PAIR, 0.4), ("", DRIFT, 0.1), ("", noisy, 0.3), ("", NULL, 0.15), ("odd", DRIFT, 0.05)]
    mass = summed(less_unseen(faint, masses))
    assert sum(mass.values()) == pytest.approx(1.0)
    step = Hypothesis(("zero_point_step",))
    # the step alone was not fitted, so that a drift beside it has nowhere to go
    assert set(mass) == {
        ("", PAIR), ("", DRIFT), ("", noisy), ("", noisy.without("zero_point_drift")), ("", NULL), ("odd", DRIFT)
    }  # fmt: skip
    assert ("", step) not in mass and mass["odd", DRIFT] == 0.05
    assert mass["", PAIR] < 0.2 < mass["", DRIFT]
    assert summed(less_unseen(faint, masses[::-1])) == pytest.approx(mass)


def test_what_leaves_an_effect_is_weighed_as_noise_then(faint) -> None:
    """Errors are as quoted here: most of a scale of them, and of bad rows, nobody could see."""
    robust = NULL.under(*faint.robust)
    mass = summed(less_unseen(faint, [("", DRIFT.under(*faint.robust), 1.0)]))
    left = mass["", robust] + mass["", NULL]
    assert mass["", NULL] > 0.5 * left > 0
    alone = summed(less_unseen(faint, [("", robust, 1.0)]))
    assert mass["", robust] / left == pytest.approx(alone["", robust])


def test_what_is_improbable_or_was_not_fitted_stays_where_it_is(faint) -> None:
    rows = [("", DRIFT, 0.9 * WEIGHED), ("", Hypothesis(("background",)), 0.5), ("odd", DRIFT, 0.4)]
    assert summed(less_unseen(faint, rows)) == {(kind, hypothesis): p for kind, hypothesis, p in rows}


# ------------------------------------------------------------------ what stands in for something else


@pytest.mark.parametrize("share", [0.4, 0.6, 0.95])
def test_a_drift_takes_its_own_part_of_the_misfit(parted, share) -> None:
    """Of squares that are known: the wave has the rest. The prior of the drift keeps less than 1 in 1000 of it."""
    assert taken(parted[share], DRIFT) == pytest.approx(share, abs=1e-3)
    assert taken(parted[share], NULL) == pytest.approx(0.0, abs=1e-3)


def test_errors_are_those_of_the_hypothesis(parted) -> None:
    """A scale of the errors takes up most of a wave of 240, beside a drift of 360: 121 rows then hold more of it as noise."""
    search, scaled = parted[0.6], DRIFT.under(SCALE)
    search = replace(search, visited=dict(search.visited))
    at = search.renoise(search.visited[DRIFT], (SCALE,))
    square = float((at.wide / ERROR).square().mean())
    assert 2.0 < square < 3.0
    assert taken(search, scaled) == pytest.approx(360.0 / (600.0 - 121.0 * (square - 1.0)), rel=1e-3)


def test_a_row_far_off_counts_as_far_and_a_bad_row_not_at_all(ball) -> None:
    """Two rows beside the middle are a hundred errors off, one up and one down: neither constant nor slope follows."""
    drift, wave = drift_and_wave(ball)
    added = np.sqrt(0.6 * EXCESS) * drift + np.sqrt(0.4 * EXCESS) * wave
    added[59], added[61] = 100.0, -100.0
    search = grown(even(ball, added), "zero_point_drift")
    # each has FAR^2, of which 1 is no excess
    assert taken(search, DRIFT) == pytest.approx(0.6 * EXCESS / (EXCESS + 2 * (FAR**2 - 1)), abs=0.01)
    robust = DRIFT.under("outliers")
    search.extend(search.renoise(search.visited[NULL], ("outliers",)), "zero_point_drift", None)
    assert int((search.visited[robust].outlying() > 0.5).sum()) == 2
    assert taken(search, robust) == pytest.approx(0.6, abs=0.01)


def test_where_rows_err_less_than_they_say_there_is_no_misfit_to_take(ball) -> None:
    rows = len(ball[1].observed)
    added = 4.0 * drift_and_wave(ball)[0] - 0.5 * (-1.0) ** np.arange(rows)
    assert taken(grown(even(ball, added), "zero_point_drift"), DRIFT) == 0.0


def test_effects_that_take_too_little_or_are_too_many_stand_for_something_else(parted) -> None:
    """One has to take half of the misfit, two three quarters, and three are not asked how much they take."""
    assert LEAST_TAKEN == 0.5
    judged = {
        (share, len(hypothesis.added)): stands(parted[share], hypothesis)
        for share in parted
        for hypothesis in (NULL, DRIFT, PAIR)
    }
    assert judged == {
        (0.4, 0): False, (0.4, 1): True, (0.4, 2): True,
        (0.6, 0): False, (0.6, 1): False, (0.6, 2): True,
        (0.95, 0): False, (0.95, 1): False, (0.95, 2): False,
    }  # fmt: skip
    assert taken(parted[0.95], THREE) > 0.95
    assert stands(parted[0.95], THREE)


@pytest.mark.parametrize(("share", "of_pair"), [(0.4, NULL), (0.6, NULL), (0.95, DRIFT)])
def test_of_a_set_that_leaves_structure_counts_what_takes_half_of_what_others_leave(
    parted, share, of_pair
) -> None:
    """A step beside a drift takes little of a wave, and so does a background. The drift then has to take what the whole set has to: three
    quarters beside one, seven eighths beside two."""
    search = parted[share]
    assert share_taken(search.visited[DRIFT], search.visited[PAIR], search.visited[PAIR].wide) < LEAST_TAKEN
    assert part_of_the_answer(search, DRIFT) == (DRIFT if share > LEAST_TAKEN else NULL)
    assert part_of_the_answer(search, PAIR) == of_pair
    if THREE in search.visited:
        assert part_of_the_answer(search, THREE) == of_pair


def test_two_effects_that_each_take_half_of_what_the_other_leaves_are_both_part(ball) -> None:
    """A step of 900 in the middle and a drift of 900, at right angles to it, above a wave of 60; a background takes nothing of it."""
    drift, wave = drift_and_wave(ball)
    step = np.sign(np.arange(len(drift)) - 0.5 * len(drift) + 0.5)
    step -= (step @ drift) * drift
    added = np.sqrt(900) * (drift + step / np.linalg.norm(step)) + np.sqrt(60) * wave
    search = grown(even(ball, added), "zero_point_step", "zero_point_drift", "background")
    pair = Hypothesis(("zero_point_step", "zero_point_drift"))
    assert part_of_the_answer(search, pair.with_effect("background")) == pair


@pytest.mark.parametrize(
    ("beside", "ahead", "expected"), [(NULL, 0.1, True), (NULL, -0.1, False), (DRIFT, 9.0, False)]
)
def test_something_unknown_that_is_likelier_alone_has_the_place_of_an_effect(
    parted, beside, ahead, expected
) -> None:
    search, at = parted[0.95], parted[0.95].visited[beside]
    none, rows = torch.zeros(len(at.delta)), torch.ones(len(at.delta), dtype=torch.bool)
    gain = search.log_odds(DRIFT) - search.log_odds(beside) + ahead
    odd = Discrepancy(beside, at.log_z, "time", gain, 0.0, none, none, rows)
    known = replace(search, odd=[odd])
    assert stands(known, DRIFT) is expected
    assert not stands(known, NULL)


def test_without_errors_nothing_says_how_much_of_a_misfit_is_taken(ball, parted) -> None:
    """They are fitted to what is left: three effects are as good as one."""
    quoted = parted[0.95]
    assert stands(quoted, THREE)
    unquoted = grown((quoted.bench.scene, replace(quoted.bench.recording, error=None)), *THREE.added)
    assert unquoted.visited[THREE].likelihood.fitted_errors
    assert not stands(unquoted, THREE)
