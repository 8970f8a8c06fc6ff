"""Where a named effect acts: rows, stretches of time, components, and the coordinate that its trace follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.ball import changed, drift_and_wave, even, grown, searched
from torchlc.diagnosis.discrepancy import Discrepancy
from torchlc.diagnosis.hypotheses import Hypothesis
from torchlc.diagnosis.where import (
    FOLDS,
    Where,
    as_json,
    best_coordinate,
    component_shares,
    held_out_r2,
    intervals,
    joined,
    locate,
    refitted,
    rows_of_unknown,
)


@pytest.fixture(scope="module")
def stepped_pair(ball):
    """A step of 0.3 mag in the last twentieth of the recording: the scene's own model, and that with the step, each fitted."""
    hours = ball[1].seconds / 3600
    late = hours > hours.min() + 0.95 * np.ptp(hours)
    search = searched(changed(ball, 0.3 * late), "zero_point_step")
    robust = search.robust
    search.extend(search.visited[Hypothesis().under(*robust)], "zero_point_step", None)
    return search, torch.as_tensor(late)


def test_a_step_is_located_in_the_rows_after_it(stepped_pair):
    """The scene's own zero point takes up a twentieth of the step, which is fifteen errors of a row: less than is located."""
    search, late = stepped_pair
    before, after = search.visited[Hypothesis()], search.visited[Hypothesis(("zero_point_step",))]
    seconds = torch.as_tensor(search.bench.recording.seconds)
    where = locate(before, after, before, {"time": seconds, "noise": torch.sin(1e3 * seconds)})
    assert float((where.rows & late).sum()) >= 0.95 * float(late.sum())
    assert float((where.rows & ~late).sum()) <= 0.05 * float((~late).sum())
    ((first, last, sigma),) = where.intervals
    assert late[first] and not late[first - 1] and last == len(late) - 1
    assert sigma == pytest.approx(0.95 * 0.3 / 0.02 * float(late.sum()) ** 0.5, rel=0.1)
    assert where.coordinate is not None and where.coordinate[0] == "time"
    assert where.ranking["time"] > 0.5 > 0.1 > where.ranking["noise"]
    assert where.components == [("ball", 1.0)]
    content = as_json(where, [str(number) for number in range(len(late))], ["roof"] * len(late))
    assert content["intervals"][0]["start"] == str(first)
    assert content["components"] == [{"name": "ball", "share": 1.0}]


def test_the_model_without_the_step_is_fitted_to_rows_that_err_as_beside_it(stepped_pair):
    """Least squares of one constant with its prior: 0.3 mag of the rows after the step over their errors and the prior."""
    search, late = stepped_pair
    before, after = search.visited[Hypothesis()], search.visited[Hypothesis(("zero_point_step",))]
    left = refitted(before, after)
    rows, share = len(late), late.double().mean()
    expected = 0.3 * float(share) * rows / (rows + 1)  # the prior of 0.02 mag weighs as one row
    assert float(left[~late].mean()) == pytest.approx(-expected, abs=0.01)
    assert float(left[late].mean()) == pytest.approx(0.3 - expected, abs=0.01)


def test_runs_are_joined_over_short_gaps_within_a_station(ball):
    assert joined([(0, 3), (5, 6), (9, 9), (13, 14)]) == [(0, 9), (13, 14)]
    search = searched(ball)
    at = search.visited[Hypothesis()]
    context = at.model.assembly.context
    station = torch.arange(len(context.seconds)) % 2
    assembly = replace(at.model.assembly, context=replace(context, station=station))
    rows = (torch.arange(len(station)) >= 10) & (torch.arange(len(station)) < 20)

    class Of:
        model = type("Model", (), {"assembly": assembly})

    found = intervals(rows, torch.full((len(rows),), 3.0), Of)  # pyright: ignore[reportArgumentType]
    assert found == [(10, 18, pytest.approx(3 * 5**0.5)), (11, 19, pytest.approx(3 * 5**0.5))]


def test_shares_of_components_are_none_where_nothing_changes(ball):
    at = searched(ball).visited[Hypothesis()]
    rows = torch.ones(len(at.delta), dtype=torch.bool)
    assert component_shares(at, at, rows) == []


def test_a_curve_of_a_coordinate_is_foreseen_and_noise_is_not():
    """A parabola is 1 less what twelve straight pieces miss of it; what no coordinate says is not foreseen."""
    x = torch.linspace(-1, 1, 240, dtype=torch.float64)
    mixed = x[torch.randperm(len(x), generator=torch.Generator().manual_seed(1))]
    noise = torch.randn(len(x), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    assert held_out_r2(mixed**2, mixed) > 0.99
    assert held_out_r2(noise, mixed) < 0.1
    assert FOLDS > 1
    marked = mixed.abs() < 0.5
    best, ranking = best_coordinate(mixed**2, {"other": noise, "x": mixed}, marked)
    assert best is not None and best[0] == "x" and list(ranking) == ["x", "other"]
    assert best[1:] == pytest.approx((-0.45, 0.45), abs=0.02)  # the middle nine tenths of the marked
    assert best_coordinate(noise, {}, marked) == (None, {})
    assert Where(marked, [], [], None, {}).coordinate is None


def test_where_something_unknown_is_there_are_the_effects_that_stand_in_for_a_part_of_it(ball) -> None:
    """A drift of 17 errors stands in for a part of a drift and a wave of 17: rows where both together are over two errors."""
    drift, wave = (np.sqrt(300.0) * one for one in drift_and_wave(ball))
    search = grown(even(ball, drift + wave), "zero_point_drift")
    null, beside = search.visited[Hypothesis()], search.visited[Hypothesis(("zero_point_drift",))]
    curve, none = torch.as_tensor(0.02 * wave), torch.zeros(len(wave), dtype=torch.float64)
    odd = Discrepancy(beside.hypothesis, beside.log_z, "time", 9.0, 0.0, curve, none, none > 1)
    rows = rows_of_unknown(odd, beside, null, null).numpy()
    sure = np.abs(np.abs(drift + wave) - 2.0) > 0.02
    assert sure.mean() > 0.95 and (rows == (np.abs(drift + wave) > 2.0))[sure].all()
    assert (rows != (np.abs(wave) > 2.0)).any()
