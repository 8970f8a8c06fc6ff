"""Recordings made in memory whose rows have no usable value: one line that names the row, from every verb."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import torchlc
from tests.good_input import SCENE
from tests.small_case import write_case
from torchlc.api import usable
from torchlc.errors import InputError
from torchlc.inference.period import find_period
from torchlc.readers import Recording
from torchlc.scene import Scene

ROWS = 9
VERBS: dict[str, Callable[[Scene, Recording], Any]] = {
    "fit": lambda scene, rows: torchlc.fit(scene, rows, steps=4),
    "diagnose": lambda scene, rows: torchlc.diagnose(scene, rows, quick=True, effects=["background"]),
    "likelihood": lambda scene, rows: torchlc.Likelihood(torchlc.LightCurve(scene, rows)),
    "period": lambda scene, rows: find_period(rows),
}
DAMAGE: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "a value": (
        lambda rows: replace(rows, observed=fourth(rows.observed, np.nan)),
        "row 4 of 9 .*, mag: nan",
    ),
    "an infinity": (
        lambda rows: replace(rows, observed=fourth(rows.observed, np.inf)),
        "row 4 of 9 .*, mag: inf",
    ),
    "an error": (lambda rows: replace(rows, error=fourth(rows.error, np.nan)), "row 4 of 9 .*, mag_err: nan"),
    "no error": (
        lambda rows: replace(rows, error=fourth(rows.error, 0.0)),
        "mag_err: 0; expected .* above 0",
    ),
}


def fourth(column: np.ndarray | None, value: float) -> np.ndarray:
    """The column with another fourth value."""
    assert column is not None
    return np.where(np.arange(len(column)) == 3, value, column)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Recording]:
    return torchlc.load(*write_case(tmp_path_factory.mktemp("case"), rows=ROWS))


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_row_without_a_value_is_named(verb: str, damage: str, case: tuple[Scene, Recording]) -> None:
    scene, recording = case
    change, message = DAMAGE[damage]
    with pytest.raises(InputError, match=rf"recording\.ecsv: .*{message}"):
        VERBS[verb](scene, change(recording))


def test_a_curve_that_nobody_measured_says_what_to_give(case: tuple[Scene, Recording]) -> None:
    """Rows of a simulated curve hold when to look, and no magnitudes; its table has these."""
    scene, _ = case
    curve = torchlc.simulate(scene, start="2020-10-17T15:00:00", hours=3, cadence=600, noise=0.02)
    for verb in VERBS.values():
        with pytest.raises(
            InputError, match=r"mag: nan, as in 19 rows; .*simulate\(\.\.\., noise=0\.02\)\.to_table"
        ):
            verb(scene, curve.recording)
    recording = torchlc.load(scene, curve.to_table())[1]
    np.testing.assert_allclose(recording.observed, curve.mag, rtol=1e-11)
    for verb in VERBS.values():
        verb(scene, recording)


def test_upper_limits_alone_are_said(case: tuple[Scene, Recording]) -> None:
    scene, recording = case
    limits = replace(recording, upper_limit=np.ones(ROWS, dtype=bool))
    headline = torchlc.fit(scene, limits, steps=10).headline()
    assert "upper limits alone" in headline and "nan" not in headline
    with pytest.raises(InputError, match=r"no usable row \(9 upper limit"):
        VERBS["diagnose"](scene, limits)
    with pytest.raises(InputError, match="0 measured rows; expected at least 8"):
        find_period(limits)


def test_a_station_on_the_other_side_of_the_earth_is_said_and_the_advice_works(
    case: tuple[Scene, Recording],
) -> None:
    """The longitude with its sign lost, as of degrees west: every row is below the horizon."""
    scene, recording = case
    west = Scene.from_toml(SCENE.replace("longitude = 122.05", "longitude = -57.95"))
    with pytest.raises(
        InputError, match=r"no usable row \(9 below the horizon\); expected .* with the object above"
    ) as caught:
        usable(west, recording)
    assert "Check that the station has its latitude and longitude in degrees, east positive" in str(
        caught.value
    )
    assert len(usable(scene, recording)) == ROWS
