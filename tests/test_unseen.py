"""Noise that nobody could see counts as none, and an answer is told with what is too weak to be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from tests.ball import ERROR, changed, searched
from torchlc.diagnosis.coordinates import coordinates
from torchlc.diagnosis.hypotheses import SCALE, Hypothesis
from torchlc.diagnosis.probabilities import probabilities
from torchlc.diagnosis.run import _at_quoted_errors
from torchlc.diagnosis.standing import near_quoted
from torchlc.diagnosis.unseen import SURE, UNSEEN, unseen_noise_share, unseen_shares
from torchlc.inference.density import SCALE_SIGMA
from torchlc.inference.posterior import fitted_at


def scaled(ball, factor: float):
    """A recording whose rows err ``factor`` times as much as it quotes."""
    return ball[0], replace(ball[1], error=ball[1].error / factor)


@pytest.mark.parametrize("factor", [1.0, 1.08, 1.3])
def test_the_unseen_share_of_larger_errors_is_that_of_their_posterior(ball, factor) -> None:
    """ln of the scale about its best value, with its prior, by quadrature in numpy. N rows of errors s times the quoted ones hold
    N ((s^2 - 1) / 2 - ln s) of information on average, half the recordings less than the median of chi-square gives; and the recording itself
    says how much more probable they are."""
    search = searched(scaled(ball, factor))
    quoted = search.visited[Hypothesis()]
    noisy = search.visited[Hypothesis().under(SCALE)]
    squares, count = float((noisy.delta / noisy.quoted).square().sum()), len(noisy.delta)
    log_s = np.linspace(-1.2, 1.2, 4001)
    s = np.exp(log_s)
    density = -0.5 * squares / s**2 - count * log_s - 0.5 * (log_s / SCALE_SIGMA) ** 2
    weight = np.exp(density - density.max())
    typical = stats.chi2.median(count)
    forecast = 0.5 * typical * (s**2 - 1) - count * log_s
    gained = -0.5 * squares / s**2 - count * log_s + 0.5 * squares
    unseen = (forecast < 0.5 * UNSEEN**2) & (gained < 0.5 * UNSEEN**2)
    expected = float((weight * unseen).sum() / weight.sum())
    assert unseen_noise_share(noisy, quoted) == pytest.approx(
        expected, abs=0.3
    )  # of 16 draws: 2.4 sd at one half
    assert (expected > 0.9) if factor == 1.0 else (expected < 0.1 or factor < 1.1)


def test_one_wild_row_is_seen_although_few_recordings_would_have_it(ball) -> None:
    added = np.zeros(len(ball[1].observed))
    clean = searched(ball)
    bad = Hypothesis().under("outliers")
    assert unseen_noise_share(clean.visited[bad], clean.visited[Hypothesis()]) > 0.5
    added[40] = 9 * ERROR
    wild = searched(changed(ball, added))
    assert unseen_noise_share(wild.visited[bad], wild.visited[Hypothesis()]) == 0.0
    assert probabilities(wild, 0.5).verdict == "noise_model"


def test_what_is_too_weak_to_show_is_told_with_nothing_missing(ball) -> None:
    """A drift of four errors: nobody can be sure of it, nor of its absence."""
    hours = (ball[1].seconds - ball[1].seconds.mean()) / 3600
    drift = 4 * ERROR * hours / np.sqrt((hours**2).sum())
    search = searched(changed(ball, drift), "zero_point_drift")
    fits = search.visited[Hypothesis(("zero_point_drift",))], search.visited[Hypothesis()]
    unseen, below = unseen_shares(*fits, "zero_point_drift")
    assert 0.0 < unseen < below < 1.0 and UNSEEN < SURE
    found = probabilities(search, 0.5)
    quiet, noisy = found.too_weak
    # the sets of this search are single drifts: what of them is left is that from UNSEEN to SURE, and above
    assert quiet + noisy == pytest.approx(found.some_effect * (below - unseen) / (1 - unseen), rel=0.15)
    if found.verdict == "adequate":
        assert found.told == pytest.approx(found.nothing + quiet)


def test_a_third_of_the_rows_bad_is_no_noise_to_judge_a_model_by(ball) -> None:
    """Bad rows describe them, and then leave nothing; at the quoted errors they stand out. A few are noise."""
    rows = len(ball[1].observed)
    added = np.where(np.arange(rows) % 3 == 0, 12 * ERROR * np.sin(np.arange(rows)), 0.0)
    many = searched(changed(ball, added))
    assert not near_quoted(many.visited[Hypothesis().under("outliers")])
    assert _at_quoted_errors(many).hypothesis == Hypothesis()
    added[np.arange(rows) % 30 != 0] = 0.0
    few = searched(changed(ball, added))
    assert _at_quoted_errors(few).hypothesis == Hypothesis().under("outliers")


@pytest.mark.parametrize("wave", [0.0, 0.15])
def test_a_leader_beside_which_something_unknown_is_ahead_is_not_clean(ball, wave) -> None:
    """Whatever a gate says of what it leaves: here that there is nothing."""
    hours = ball[1].seconds / 3600
    added = 0.1 * (hours - hours.mean()) + wave * np.sin(2 * np.pi * hours / 0.7)
    search = searched(changed(ball, added))
    search.extend(search.visited[Hypothesis().under(*search.robust)], "zero_point_drift", None)
    for one in [one for one in search.visited if search.correlated(one)]:
        del search.visited[one]  # rows that err together hide a wave as well
    assert search.foremost.added == ("zero_point_drift",)
    assert search.clean(lambda _: 1.0)  # nothing unknown was asked yet
    null = search.visited[Hypothesis()]
    search.strangers(coordinates(null.model, null.theta))
    assert search.clean(lambda _: 1.0) is (wave == 0.0)


def test_an_effect_that_is_begun_far_away_comes_to_no_less_than_without_it(ball) -> None:
    """From a wrong minimum the fit begins anew with the effect at no size."""
    hours = (ball[1].seconds - ball[1].seconds.mean()) / 3600
    search = searched(changed(ball, 0.01 * hours))
    at = search.visited[Hypothesis()]
    entry = "zero_point_drift"
    good = search.extend(at, entry, None)
    astray = fitted_at(good.hypothesis, good.posterior, good.g + torch.tensor([4.0, 0.5]))
    search.visited.pop(good.hypothesis)
    assert astray.peak < at.peak
    assert search.from_no_size(astray, at, entry).peak == pytest.approx(good.peak, abs=0.01)
    assert search.from_no_size(good, at, entry) is good
