"""A period that changes, from phases and periods of nights as the model fits them to light that numpy made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import torchlc
from tests.rotating_bodies import Circle, box, recording, scene, steady, unit_of
from torchlc.api import usable
from torchlc.inference.rotation.connect import connections
from torchlc.inference.rotation.model_fit import fitted, sharpened
from torchlc.inference.rotation.passes import rows_of
from torchlc.inference.rotation.refine import Local
from torchlc.inference.rotation.trials import loose_trial
from torchlc.inference.rotation.turn_fits import period_at
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import iso_times

DAY_S = 86400.0
PERIOD_S, RATE_MS, POLE, PHASE = 51.2, 9.0, unit_of(46.0, -36.0), 0.21
STARTS = (0.0, 1.2 * DAY_S, 2.9 * DAY_S)


def test_nights_as_the_model_has_them_say_which_counts_of_turns_are_possible(tmp_path: Path) -> None:
    """A box whose turn of 51.2 s grows by 9 ms a day, on three nights of 215 s. Turns and frequencies are those of the law P + p t,
    ln(1 + p t / P) / p and 1 / (P + p t). The fit starts 1 deg, 0.01 turns and 1e-5/s off; in its own covariance the six numbers are off
    by a chi-square below 22.5, which one of 1000 draws exceeds. The true count is possible, gives the rate to 1 % and the period at the epoch to 1e-5, and by the rate of all
    that are possible, weighted by their probabilities, 9 ms is within 3 standard deviations. With the error that phases of flat facets
    have of themselves, 2e-3 turns, more counts are possible."""
    rng = np.random.default_rng(5)
    body, slowing = box(1.9, 2.2, 1.6), RATE_MS * 1e-3 / DAY_S
    passes = []
    for start, (lon, lat) in zip(STARTS, ((30.0, 20.0), (15.0, -40.0), (55.0, 40.0)), strict=True):
        passes.append(
            (start, np.sort(rng.uniform(0.0, 215.0, 110)), Circle.past(lon, lat, 30.0, 215.0, 1500.0))
        )
    (tmp_path / "scene.toml").write_text(scene(body, (PERIOD_S, 49.7, 52.7)))
    (tmp_path / "seen.ecsv").write_text(
        recording(
            body,
            lambda seconds: steady(seconds, POLE, PERIOD_S, PHASE, slowing),
            passes,
            materials=(45.0, 0.18, 0.4),
            noise=0.02,
            rng=rng,
        )
    )
    known = torchlc.load(tmp_path / "scene.toml")
    assert isinstance(known, torchlc.Scene)
    seen = usable(known, tmp_path / "seen.ecsv")
    rows = rows_of(LightCurve(known, seen))
    # rows count seconds from the first of them, the law from the epoch
    first = (np.datetime64(iso_times(seen)[0]) - np.datetime64("2023-03-01")) / np.timedelta64(1, "us") / 1e6
    since = rows.middle + float(first)
    turns = torch.log1p(slowing * since / PERIOD_S) / slowing + PHASE
    frequencies = 1 / (PERIOD_S + slowing * since)
    start = Local(
        torch.from_numpy(unit_of(46.8, -35.2)), frequencies + 1e-5, turns % 1.0 + 0.01, torch.zeros(3, dtype=torch.float64),
        torch.tensor([40.0], dtype=torch.float64), torch.tensor([0.4, 0.2], dtype=torch.float64), 400.0,
        torch.diag(torch.tensor([1e-5] * 3 + [2e-3] * 3, dtype=torch.float64).square()),
    )  # fmt: skip
    fit = fitted(loose_trial(known, seen, rows, start, periods=True, tilted=False), seen)
    sharp = sharpened(seen, rows, start, fit)
    assert sharp is not None
    halves = 2 * (sharp.phases - turns)  # a box looks the same after half a turn
    off = torch.cat([sharp.frequencies - frequencies, (halves - halves.round()) / 2]).numpy()
    assert off @ np.linalg.solve(sharp.covariance.numpy(), off) < 22.5
    bounds = (1 / 52.7, 1 / 49.7)
    possible = connections(rows, sharp, 2, changing=True, bounds=bounds)
    whole = torch.round(2 * (turns - sharp.phases)).long()
    near = [one for one in possible.found if one.distance < possible.found[0].distance + 25]
    rates = np.array([-one.change / one.frequency**2 * DAY_S * 1e3 for one in near])
    true = [
        k
        for k, one in enumerate(near)
        if [n - one.counts[0] for n in one.counts] == (whole - whole[0]).tolist()
    ]
    assert len(true) == 1 and abs(rates[true[0]] / RATE_MS - 1) < 0.01
    assert abs(period_at(near[true[0]], -float(first)) / PERIOD_S - 1) < 1e-5
    chances = np.exp(-0.5 * np.array([one.distance for one in near]))
    chances /= chances.sum()
    mean = chances @ rates
    assert abs(mean - RATE_MS) < 3 * np.sqrt(chances @ (rates - mean) ** 2)
    coarse = torch.diag(torch.tensor([3e-4 / 215] * 3 + [2e-3] * 3, dtype=torch.float64).square())
    by_facets = connections(
        rows, replace(sharp, covariance=sharp.covariance + coarse), 2, changing=True, bounds=bounds
    )
    assert len(near) < len(
        [one for one in by_facets.found if one.distance < by_facets.found[0].distance + 25]
    )
