"""A body that turns about no axis of its own, found from light that Euler's equations and flat facets made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import torchlc
from tests.rotating_bodies import Circle, box, pole_frame, recording, scene, tumbling, unit_of
from torchlc.api import usable
from torchlc.inference.rotation import tumble_grid
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import Rows, rows_of
from torchlc.inference.rotation.tumble_refine import TumbleRefiner, nutation_at
from torchlc.inference.rotation.two_frequencies import frequency_pairs
from torchlc.lightcurve.model import LightCurve

BODY = box(2.6, 1.8, 1.2)
MOMENTS = np.array([0.5, 0.85, 1.0])
POLE, RATE, NUTATION = unit_of(75.0, 40.0), 2 * np.pi / 120.0, np.radians(20.0)
START = 1.0
"""Seconds that Euler's equations run before the first row, so that light time does not ask for an earlier state."""


def turned(seconds: np.ndarray) -> np.ndarray:
    return tumbling(seconds + START, POLE, MOMENTS, RATE, NUTATION, 0.37)


def mean_rates() -> tuple[float, float]:
    """Mean turns a second of the long axis about the angular momentum, and of the latter round the body's z, by integration."""
    seconds = np.arange(0.0, 12_000.0, 1.0)
    matrix = turned(seconds)
    long_axis = matrix[:, 0] @ pole_frame(POLE).T
    momentum = matrix @ POLE
    about, way = (np.unwrap(np.arctan2(one[:, 1], one[:, 0])) for one in (long_axis, momentum))
    way = way * np.sign(way[-1] - way[0])
    whole = 2 * np.pi * np.arange(np.ceil(way[0] / (2 * np.pi)), way[-1] / (2 * np.pi))
    first, last = np.interp(whole[[0, -1]], way, seconds)  # whole ways, so that no swing is cut
    turns = abs(np.interp(last, seconds, about) - np.interp(first, seconds, about)) / (2 * np.pi)
    return float(turns / (last - first)), float((len(whole) - 1) / (last - first))


@pytest.fixture(scope="module")
def rates() -> tuple[float, float]:
    return mean_rates()


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory, rates: tuple[float, float]) -> tuple[Rows, FacetLight]:
    """Two passes of 3000 s five hours apart, 160 rows each, errors 0.04 mag, and the body."""
    rng = np.random.default_rng(5)
    passes = []
    for day, (lon, lat) in ((0.0, (30.0, 20.0)), (0.2, (290.0, 35.0))):
        after = np.sort(rng.uniform(0.0, 3000.0, 160))
        passes.append((day * 86400.0, after, Circle.past(lon, lat, 25.0, 3000.0, 18_000.0)))
    folder: Path = tmp_path_factory.mktemp("tumbling")
    period = 1 / rates[0]
    (folder / "scene.toml").write_text(scene(BODY, (period * 1.01, period * 0.97, period * 1.03)))
    (folder / "seen.ecsv").write_text(
        recording(BODY, turned, passes, materials=(45.0, 0.18, 0.4), noise=0.04, rng=rng)
    )
    known = torchlc.load(folder / "scene.toml")
    assert isinstance(known, torchlc.Scene)
    model = LightCurve(known, usable(known, folder / "seen.ecsv"))
    return rows_of(model), FacetLight.of(model.assembly)


def test_the_nutation_of_a_ratio_is_that_of_eulers_equations(rates: tuple[float, float]) -> None:
    """To the 1e-3 rad that steps of 1 s over 100 turns leave."""
    moments = torch.tensor(MOMENTS)[None]
    ratio = torch.tensor([rates[1] / rates[0]], dtype=torch.float64)
    assert float(nutation_at(moments, ratio, True)) == pytest.approx(NUTATION, abs=1e-3)
    assert float(tumble_grid.nutation_of(moments[0], _pair(rates)) or 0.0) == pytest.approx(
        NUTATION, abs=1e-3
    )


def _pair(rates: tuple[float, float]):
    from torchlc.inference.rotation.two_frequencies import FrequencyPair

    return FrequencyPair(rates[0], rates[1], True, 1.0)


def test_both_frequencies_are_in_the_light(seen: tuple[Rows, FacetLight], rates: tuple[float, float]) -> None:
    """The pair is among the first six, both within a quarter of a turn over a pass."""
    rows, _ = seen
    pairs = frequency_pairs(rows, rates[0] * 0.97, rates[0] * 1.03, halves=True, most=6)
    close = 0.25 / 3000.0
    assert any(
        abs(one.long - rates[0]) < close and abs(one.polhode - rates[1]) < close and one.short_axis_mode
        for one in pairs
    )


@pytest.mark.long
def test_the_state_is_found_from_its_frequencies(
    seen: tuple[Rows, FacetLight], rates: tuple[float, float]
) -> None:
    """Grid over the true body, coarsely, and two others, least squares, one count of turns: the angular momentum to 2 deg,
    ratios of inertia to 2 %, both periods to 1e-4, as noise of 0.04 mag in 320 rows allows."""
    rows, body = seen
    bodies = torch.tensor([[0.55, 0.8, 1.0], [0.8, 0.55, 1.0], [1.3, 1.6, 1.0]], dtype=torch.float64)
    states = tumble_grid.search(rows, body, [_pair(rates)], bodies, kept=6)
    refiner = TumbleRefiner(rows, body, 0.05)
    best = refiner.joined(refiner.refined(states[:10])[0])[0]
    assert np.degrees(np.arccos(abs(float(best.pole @ torch.tensor(POLE))))) < 2.0
    assert best.moments.numpy() == pytest.approx(MOMENTS, rel=0.02)
    assert best.long == pytest.approx(rates[0], rel=2e-4)
    assert best.pair.polhode == pytest.approx(rates[1], rel=1e-3)
    assert best.chi2 < len(rows.flux)


LONG_MOMENTS, LONG_NUTATION = np.array([0.45, 0.8, 1.0]), np.radians(60.0)


def long_axis(seconds: np.ndarray) -> np.ndarray:
    return tumbling(seconds + START, POLE, LONG_MOMENTS, RATE, LONG_NUTATION, 0.21)


@pytest.mark.long
def test_the_long_axis_mode_is_found_from_its_light(tmp_path: Path) -> None:
    """Euler's equations with the angular momentum 60 deg from the short axis: beyond the border, which Landau and Lifshitz's section 37
    puts at asin sqrt((1/I2 - 1/I3) / (1/I1 - 1/I3)) = 27 deg. Frequencies counted in the integration are among the eight likeliest
    pairs; from there the search ends at the angular momentum to 2 deg and at the ratios of inertia to 2 %, as noise of 0.04 mag
    in 320 rows allows, although it starts from bodies with their axes exchanged."""
    rng = np.random.default_rng(8)
    seconds = np.arange(0.0, 12_000.0, 1.0)
    matrix = long_axis(seconds)
    momentum, axis = matrix @ POLE, matrix[:, 0] @ pole_frame(POLE).T
    way, about = (
        np.unwrap(np.arctan2(*one)) / (2 * np.pi)
        for one in ((momentum[:, 2], momentum[:, 1]), (axis[:, 1], axis[:, 0]))
    )
    whole = np.interp(np.arange(1, np.floor(np.ptp(way))), np.abs(way - way[0]), seconds)[[0, -1]]
    turns = np.abs(np.diff(np.interp(whole, seconds, about)))[0]
    count = np.floor(np.ptp(way)) - 2
    long, polhode = float(turns / np.ptp(whole)), float(count / np.ptp(whole))

    passes = []
    for start, (lon, lat) in ((0.0, (30.0, 20.0)), (17_000.0, (290.0, 35.0))):
        circle = Circle.past(lon, lat, 25.0, 3000.0, 18_000.0)
        passes.append((start, np.sort(rng.uniform(0.0, 3000.0, 160)), circle))
    (tmp_path / "scene.toml").write_text(scene(BODY, (1.01 / long, 0.97 / long, 1.03 / long)))
    (tmp_path / "seen.ecsv").write_text(
        recording(BODY, long_axis, passes, materials=(45.0, 0.18, 0.4), noise=0.04, rng=rng)
    )
    known = torchlc.load(tmp_path / "scene.toml")
    assert isinstance(known, torchlc.Scene)
    model = LightCurve(known, usable(known, tmp_path / "seen.ecsv"))
    rows, body = rows_of(model), FacetLight.of(model.assembly)
    close = 0.25 / 3000.0
    pair = next(
        one
        for one in frequency_pairs(rows, long * 0.97, long * 1.03, halves=True, most=8)
        if not one.short_axis_mode and abs(one.long - long) < close and abs(one.polhode - polhode) < close
    )
    bodies = torch.tensor([[0.8, 0.45, 1.0], [0.45, 0.8, 1.0], [1.25, 0.56, 1.0]], dtype=torch.float64)
    states = tumble_grid.search(rows, body, [pair], bodies, kept=6)
    refiner = TumbleRefiner(rows, body, 0.01)
    best = refiner.joined(refiner.settled(refiner.refined(states[:14])[0]))[0]
    assert not best.pair.short_axis_mode
    assert np.degrees(np.arccos(float(best.pole @ torch.tensor(POLE)))) < 2.0
    assert best.moments.numpy() == pytest.approx(LONG_MOMENTS, rel=0.02)
    assert [best.long, best.pair.polhode] == pytest.approx([long, polhode], rel=1e-3)


def test_what_two_columns_explain_is_what_scipys_least_squares_leaves() -> None:
    """Columns at an angle of more than 10 deg, so that neither is taken for the other; never more than there is."""
    from scipy.optimize import nnls

    rng = np.random.default_rng(2)
    for _ in range(6):
        columns, target = rng.random((40, 2)) * [1.0, 3.0], rng.normal(0.3, 1.0, 40)
        products, aims = columns.T @ columns, columns.T @ target
        numbers = [products[0, 0], products[0, 1], products[1, 1], *aims]
        gain = tumble_grid._gain(*(torch.tensor([one]) for one in numbers))
        left = nnls(columns, target)[1] ** 2
        assert float(target @ target) - float(gain) == pytest.approx(left, rel=1e-6)


def test_pairs_are_the_frequencies_of_a_series_made_by_hand() -> None:
    """A sum of cosines of even j f + k g on 300 uneven instants, noise of a fifth of it: the pair is among the three that explain
    most, which differ by less than the noise in that, and is right to a tenth of a turn."""
    rng = np.random.default_rng(4)
    f, g, span = 1 / 71.0, 1 / 230.0, 1500.0
    seconds = np.sort(rng.uniform(0.0, span, 300))
    terms = {(0, 2): 0.3, (2, 0): 0.8, (1, 1): 0.5, (1, -1): 0.4, (2, 2): 0.2, (3, 1): 0.15, (4, 0): 0.2}
    light = sum(
        a * np.cos(2 * np.pi * ((j * f + k * g) * seconds + rng.random())) for (j, k), a in terms.items()
    )
    flux = torch.tensor(np.exp(0.5 * light + 0.1 * rng.normal(size=300)))
    empty = torch.zeros(0, dtype=torch.float64)
    whole = torch.tensor([span], dtype=torch.float64)
    number = torch.zeros(300, dtype=torch.long)
    rows = Rows(
        number, torch.tensor(seconds), empty, empty, flux, empty, number, torch.tensor([span / 2]).to(whole), whole, False
    )  # fmt: skip
    pairs = frequency_pairs(rows, 0.97 * f, 1.03 * f, halves=True, most=3)
    assert any(
        one.short_axis_mode and max(abs(one.long - f), abs(one.polhode - g)) * span < 0.1 for one in pairs
    )
