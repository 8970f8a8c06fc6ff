"""Probes: what an effect promises beside a fit against least squares by NumPy, and what a probe takes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.ball import BALL, ERROR, drift_and_wave, even, grown
from tests.noisy_rows import changed
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import SCALE, Hypothesis, Workbench
from torchlc.diagnosis.probes import (
    FEWEST,
    GRID,
    Probe,
    beyond,
    least_seconds,
    probe,
    rescored,
    seconds_a_geometry,
    turns,
)
from torchlc.inference.density import SCALE_SIGMA, Fitted, Posterior
from torchlc.inference.posterior import fitted_at
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.tensors.work import Work

NULL, DRIFT = Hypothesis(), Hypothesis(("zero_point_drift",))
TOTAL, SHARE = 600.0, 0.64
"""Squares of a drift and a wave together, in errors of a row, and what part of them the drift has."""


@pytest.fixture(scope="module")
def waved(ball) -> Search:
    """A drift and a wave in the rows, and a fit of the drift."""
    drift, wave = drift_and_wave(ball)
    added = math.sqrt(TOTAL) * (math.sqrt(SHARE) * drift + math.sqrt(1 - SHARE) * wave)
    return grown(even(ball, added), "zero_point_drift")


def probed(search: Search, entry: str, at: Fitted | None = None) -> Probe:
    at = search.visited[NULL] if at is None else at
    return probe(search.bench, at, search.posterior(at.hypothesis.with_effect(entry)), entry, 0)


def taken_off(columns: np.ndarray, left: np.ndarray) -> np.ndarray:
    """What each of columns (T, n) takes off the sum of squares of ``left`` (T,), in errors of a row. A constant is fitted beside it, whose
    prior weighs as one row."""

    def squares(design: np.ndarray) -> float:
        prior = np.eye(1, design.shape[1])
        solution = np.linalg.lstsq(np.vstack([design, prior]), np.append(left, 0.0), rcond=None)[0]
        return float(((left - design @ solution) ** 2).sum() + solution[0] ** 2)

    constant = np.ones((len(left), 1))
    without = squares(constant)
    return np.array([without - squares(np.column_stack([constant, column])) for column in columns.T])


# ------------------------------------------------------------------ scores


def test_a_linear_effect_scores_what_least_squares_takes_off(waved) -> None:
    """Whatever its size in a trial: the drift has its share of the squares. The size that suits it is the slope that was put in."""
    at, drifts = waved.visited[NULL], probed(waved, "zero_point_drift")
    assert len(drifts.psi) == GRID and drifts.psi.unique().numel() == GRID
    assert drifts.scores.numpy() == pytest.approx(np.full(GRID, SHARE * TOTAL), rel=1e-3)
    # the prior of the zero point has next to nothing of a change that is none on average
    assert drifts.signatures.norm(dim=1).numpy() == pytest.approx(np.ones(GRID), abs=1e-3)
    hours = at.model.assembly.context.seconds.numpy() / 3600
    slope = ERROR * math.sqrt(SHARE * TOTAL) / np.linalg.norm(hours - hours.mean())
    best = float(drifts.psi[int(drifts.scores.argmax()), 0])
    assert drifts.best_size(at) * best == pytest.approx(slope, rel=1e-3)
    assert drifts.best_size(changed(at, -at.delta / at.wide)) == pytest.approx(-drifts.best_size(at))
    assert drifts.best_change(at).numpy() == pytest.approx(best * (hours - hours.mean()), abs=1e-9)


def test_a_step_is_tried_between_all_rows(waved) -> None:
    """A constant before and another after, by least squares at each of the places; its own width is a tenth of the cadence."""
    at, steps = waved.visited[NULL], probed(waved, "zero_point_step")
    hours = at.model.assembly.context.seconds.numpy() / 3600
    instants = steps.psi[:, 1].numpy()
    assert instants == pytest.approx(0.5 * (hours[1:] + hours[:-1]))
    # with the zero point at its prior's mean
    left = ((at.delta - at.slopes @ at.g) / at.sigma).numpy()
    expected = taken_off((hours[:, None] > instants).astype(float), left)
    # beside the first instant the one row before it tells a step from a constant, and has 0.007 of it
    assert steps.scores[1:].numpy() == pytest.approx(expected[1:], rel=1e-6)
    assert float(steps.scores[0]) == pytest.approx(expected[0], rel=0.05)


def test_a_drift_of_each_curve_promises_the_sum_of_theirs(ball) -> None:
    """Two halves with slopes of five and twelve errors, up and down: 25 + 144, less the one that each has in pure noise."""
    rows = len(ball[1].observed)
    curve = (np.arange(rows) >= 60).astype(int)
    lines = np.where(curve == [[0], [1]], ball[1].seconds, 0.0)
    for half in (0, 1):
        lines[half, curve == half] -= lines[half, curve == half].mean()
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    noise = lines @ (-1.0) ** np.arange(rows)  # what errors of one have of each slope
    scene, recording = even(ball, (np.array([5.0, -12.0]) - noise) @ lines)
    search = grown((scene, replace(recording, curve=curve, curve_ids=("a", "b"))))
    at, entry = search.visited[NULL], "zero_point_drift@curve"
    divided = probed(search, entry)
    assert divided.score == divided.together == pytest.approx(25.0 + 144.0 - 2.0)
    assert divided.part is not None and divided.part.tolist() == [0, 1] and not len(divided.scores)
    assert rescored(divided, at, at).together == pytest.approx(divided.together)
    steeper = changed(at, at.delta / at.wide + torch.as_tensor(5.0 * lines[0]))
    assert rescored(divided, at, steeper).together == pytest.approx(100.0 + 144.0 - 2.0)


@pytest.mark.parametrize(("largest", "visible"), [(0.31, True), (0.29, False)])
def test_what_changes_all_rows_together_by_a_third_of_an_error_is_visible(
    ball, waved, largest, visible
) -> None:
    """Errors are so large that the steepest drift that is tried changes rows by so many of them, as a root sum of squares."""
    scene, recording = ball
    steepest = float(probed(waved, "zero_point_drift").psi.abs().max())
    changes = steepest * (recording.seconds - recording.seconds.mean()) / 3600
    error = np.full(len(changes), np.linalg.norm(changes) / largest)
    search = grown((scene, replace(recording, error=error)))
    assert probed(search, "zero_point_drift").visible is visible


# ------------------------------------------------------------------ beside another fit


def test_a_probe_held_against_another_fit_is_as_made_beside_it(waved) -> None:
    """A drift changes magnitudes alike beside every fit. Errors are half of those before here."""
    at, known = waved.visited[NULL], probed(waved, "zero_point_drift")
    same = rescored(known, at, at)
    torch.testing.assert_close(same.scores, known.scores)
    torch.testing.assert_close(same.signatures, known.signatures)
    posterior = Posterior(waved.bench.likelihood(NULL), scaled=True)
    scale_g = torch.cat([at.g, at.g.new_tensor([-math.log(2.0) / SCALE_SIGMA])])
    other = fitted_at(NULL.under(SCALE), posterior, scale_g)
    assert float(other.sigma[0]) == pytest.approx(0.5 * ERROR)
    fresh, held = probed(waved, "zero_point_drift", other), rescored(known, at, other)
    assert float(fresh.score) > 3.9 * known.score
    torch.testing.assert_close(held.scores, fresh.scores)
    torch.testing.assert_close(held.moved, fresh.moved)
    assert held.best_size(other) == pytest.approx(fresh.best_size(other))


def test_beside_a_fit_that_has_the_effect_already_its_probe_promises_nothing(waved) -> None:
    known = probed(waved, "zero_point_drift")
    held = rescored(known, waved.visited[NULL], waved.visited[DRIFT])
    # but what its prior of 0.02 mag/h costs that fit
    assert held.score == pytest.approx(float(waved.visited[DRIFT].theta[-1] / 0.02) ** 2, rel=0.01)
    assert held.score < 0.01 * known.score
    step = probed(waved, "zero_point_step")
    after = rescored(step, waved.visited[NULL], waved.visited[DRIFT])
    assert 0.0 < after.score < 0.2 * step.score, "of drift and wave the wave alone is left"


@pytest.mark.parametrize(("entry", "back"), [("earthshine", 0.0), ("background", 1.0)])
def test_only_what_has_an_opposite_promises_something_where_its_light_is_missing(ball, entry, back) -> None:
    """Residuals that are the change of the light itself, and its opposite."""
    search = grown(ball)
    at, known = search.visited[NULL], probed(search, entry)
    chosen = int(known.moved.norm(dim=1).argmax())
    change = known.moved[chosen]
    assert known.visible
    zero = replace(at, g=torch.zeros_like(at.g))
    squares = float(beyond(change[None], at).square().sum())
    for sign, share in ((1.0, 1.0), (-1.0, back)):
        held = rescored(known, at, changed(zero, sign * change))
        assert float(held.scores[chosen]) == pytest.approx(share * squares, rel=1e-6)


def test_a_probe_without_values_is_held_against_any_fit_as_it_is(waved) -> None:
    empty = torch.zeros(0, dtype=torch.float64)
    none = Probe("wobble", empty[:, None], empty[:, None], empty, empty.bool(), empty[:, None], False)
    assert rescored(none, waved.visited[NULL], waved.visited[DRIFT]) is none
    assert none.score == 0.0


# ------------------------------------------------------------------ what it takes


@pytest.fixture(scope="module")
def box(ball) -> tuple[Scene, Recording]:
    """A box that spins, in two curves."""
    scene = Scene.from_toml(
        BALL.replace('shape = "sphere"\nradius = 1.0', 'shape = "box"\nsize = [1.0, 2.0, 3.0]').replace(
            'mode = "nadir"', 'mode = "inertial"\nspin_axis = [0.57, 0.78, 0.51]\nspin_rate = 1.7'
        )
    )
    curve = (np.arange(len(ball[1])) >= 60).astype(int)
    return scene, replace(ball[1], curve=curve, curve_ids=("a", "b"))


@pytest.mark.parametrize(
    ("entry", "geometries"), [("attitude_offset", FEWEST), ("start_phase@curve", GRID + 1)]
)
def test_a_probe_takes_no_less_than_is_foreseen(monkeypatch, box, entry, geometries) -> None:
    """Where each value is a geometry that takes long: by the elements of tensors that are worked out, beside those of one geometry."""
    monkeypatch.setattr("torchlc.inference.density.AFFORDED_S", 0.0)
    monkeypatch.setattr("torchlc.diagnosis.probes.MOST_S", 0.0)
    search = grown(box)
    posterior = search.posterior(Hypothesis((entry,)))
    least = least_seconds(posterior, entry) / posterior.geometry_seconds

    def elements(count: int) -> int:
        g = torch.rand(count, posterior.size, generator=torch.Generator().manual_seed(1)).double()
        with Work() as work:
            posterior.residuals(g)
        return work.elements

    elements(1)  # what all geometries share is made here
    each = (elements(11) - elements(1)) / 10
    with Work() as made:
        probed(search, entry)
    assert least == pytest.approx(geometries)
    assert least < made.elements / each < least + 3  # changes and scores are little beside light


def test_what_leaves_the_geometry_as_it_is_takes_nothing(monkeypatch, box) -> None:
    """Even where the scene's own is free and slow. A drift of each curve has as many values, and none of them turns anything."""
    monkeypatch.setattr("torchlc.inference.density.AFFORDED_S", 0.0)
    scene, recording = box
    bench = Workbench(scene, recording)
    for entry, turning in (
        ("zero_point_drift", False),
        ("zero_point_drift@curve", False),
        ("attitude_offset", True),
    ):
        posterior = Posterior(bench.likelihood(Hypothesis(("start_phase", entry))), scaled=False)
        assert posterior.seconds_each > 0.0
        assert turns(posterior, entry) is turning
        assert (least_seconds(posterior, entry) > 0.0) is turning
        assert seconds_a_geometry(posterior, entry) == (posterior.seconds_each if turning else 0.0)
