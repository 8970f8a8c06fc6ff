"""What is left of a model, beside bad rows and beside effects: its course in its best coordinate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.ball import changed, searched
from torchlc.diagnosis.discrepancy import EVENT, REPEATING, course, discrepancies
from torchlc.diagnosis.hypotheses import Hypothesis
from torchlc.diagnosis.run import _gate


def test_a_run_of_bad_rows_is_no_structure_and_a_slow_wave_beside_it_is(ball) -> None:
    """A cloud of four rows and two bright ones leave nothing once they are known as bad; a wave of two errors does."""
    recording = ball[1]
    added = np.zeros(len(recording.observed))
    added[40:44], added[[80, 100]] = 0.6, -0.5
    hours = recording.seconds / 3600
    p = []
    for wave in (0.0, 0.04):
        case = changed(ball, added + wave * np.sin(2 * np.pi * hours / 1.3))
        search = searched(case)
        at = max(
            (one for one in search.visited.values() if "outliers" in one.hypothesis.noise),
            key=lambda one: one.log_z,
        )
        assert (at.outlying() > 0.5)[[40, 41, 42, 43, 80, 100]].all()
        p.append(_gate(at, {}, {}, 0, level=False).global_p)
    assert p[0] > 0.01 > p[1]


def test_errors_that_are_too_large_leave_no_structure(ball) -> None:
    """Quoted errors twice the true ones: chi-square says so as quoted, the structure under a fitted level does not."""
    scene, recording = ball
    search = searched((scene, replace(recording, error=2 * recording.error)))
    at = search.visited[Hypothesis()]
    assert _gate(at, {}, {}, 0).global_p < 1e-3
    assert _gate(at, {}, {}, 0, level=False).global_p > 0.01


def test_a_curve_is_in_magnitudes_where_rows_are_compared_in_flux(ball) -> None:
    """A wave of 0.6 mag in 3 to 60 photons a row, whose errors come from what was counted: rows are compared in a power of the
    flux, whose unit moves with the datum. A free factor of all light and a curve that is the same for all rows, together, are
    no way to explain the noise: what a curve adds to a row has the unit of the row."""
    recording = ball[1]
    rng = np.random.default_rng(5)
    share = np.linspace(0, 1, len(recording))
    wave = 0.6 * np.cos(3 * np.pi * share)
    expected = 14 * 10 ** (-0.4 * wave)
    counted = rng.poisson(expected).clip(1)
    photons = replace(
        recording,
        observed=recording.observed - 2.5 * np.log10(counted / 14),
        error=2.5 / math.log(10) / np.sqrt(counted),
    )
    search = searched((ball[0], photons))
    null = search.visited[Hypothesis().under(*search.robust)]
    assert null.likelihood.power is not None and float(null.scale.std()) > 0.05
    along = {"time": torch.from_numpy(share)}
    curve = next(one for one in discrepancies(null, along, search.bench) if one.coordinate == "time")
    assert curve.log_gain > 10
    off = curve.curve.numpy() - curve.curve.numpy().mean() - wave
    assert float(np.std(off)) < 0.05  # 0.036; 0.07 by a curve in the unit of the rows


def test_an_event_that_comes_quickly_and_goes_slowly_is_found_where_it_is(ball) -> None:
    """A dip of 0.15 mag that decays within half an hour: its window, and its course, to three bands."""
    recording = ball[1]
    order = np.argsort(recording.seconds)
    minutes = (recording.seconds - recording.seconds[order[50]]) / 60
    dip = np.where(minutes >= 0, 0.15 * np.exp(-minutes / 15), 0.0)
    search = searched(changed(ball, dip))
    null = search.visited[Hypothesis().under(*search.robust)]
    coordinates = {"time": torch.from_numpy(recording.seconds - recording.seconds.min())}
    found = {one.coordinate: one for one in discrepancies(null, coordinates, search.bench)}
    event = found[EVENT]
    assert event.log_gain > 10  # beyond bad rows, which take the dip row by row
    strong = torch.from_numpy(dip > 0.05)
    assert float(event.rows[strong].double().mean()) > 0.8  # windows are half of each apart
    strong &= event.rows
    off = (event.curve.abs() - torch.from_numpy(dip)).abs()[strong]
    assert float((off / event.band[strong]).max()) < 4


def test_what_repeats_with_a_period_of_its_own_is_found(ball) -> None:
    """Flashes of 0.3 mag, each an eighth of their 23 minutes long at half height: the period, and the flash to four bands."""
    minutes = (ball[1].seconds - ball[1].seconds.min()) / 60
    cycle = np.mod(minutes / 23.0 + 0.2, 1.0) - 0.5
    flash = -0.3 * np.exp(-0.5 * (cycle / 0.055) ** 2)
    search = searched(changed(ball, flash))
    null = search.visited[Hypothesis().under(*search.robust)]
    seconds = torch.from_numpy(60 * minutes)
    found = {one.coordinate: one for one in discrepancies(null, {"time": seconds}, search.bench)}
    again = found[REPEATING]
    # it beats bad rows, and a curve of time, which would need a hump for each flash
    assert again.log_gain > 10
    assert all(again.log_gain > 10 + one.log_gain for name, one in found.items() if name != REPEATING)
    assert again.period / 60 == pytest.approx(23.0, rel=0.01)
    assert "every 2" in again.course(seconds)
    off = again.curve - again.curve.mean() - torch.from_numpy(flash - flash.mean())
    assert float((off.abs() / again.band).max()) < 4


def test_what_ends_at_an_instant_follows_its_coordinate_until_then(ball) -> None:
    """A wave of 0.15 mag along a phase for the first 60 % of the rows: a part that then flies off."""
    minutes = (ball[1].seconds - ball[1].seconds.min()) / 60
    phase = np.mod(minutes / 31.0, 1.0)
    until = minutes < np.quantile(minutes, 0.62)
    wave = np.where(until, 0.15 * np.cos(2 * np.pi * phase), 0.0)
    search = searched(changed(ball, wave))
    null = search.visited[Hypothesis().under(*search.robust)]
    along = {"spin_phase": torch.from_numpy(phase)}
    best = max(discrepancies(null, along, search.bench), key=lambda one: one.log_gain)
    assert best.coordinate == "spin_phase" and best.log_gain > 10
    # between the eight parts of the rows that an instant may lie between
    assert np.mean(best.rows.numpy() == until) > 1 - 0.5 / 8
    assert "until" in best.course(torch.from_numpy(60 * minutes))


def test_the_course_of_an_event_has_unit_variance() -> None:
    columns = course(torch.linspace(0, 100, 2001, dtype=torch.float64))
    assert float(columns.square().sum(1)[0]) == pytest.approx(1.0)
    gram = columns.T @ columns / len(columns)
    assert torch.allclose(gram, torch.diag(torch.diagonal(gram)), atol=2e-3)
