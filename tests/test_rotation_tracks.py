"""Real tracks of rocket bodies at 10 Hz: their turns, by the times of their glints and as published."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import torchlc
from tests.paper_orbits import SHARED

TRACKS = SHARED / "data" / "tumbling"
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not TRACKS.is_dir(), reason=f"the recorded tracks are not here: {TRACKS}"),
]


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("track", "turn"), [("10025_10419535", 11.815), ("10025_21881793", 12.356), ("10025_27890120", 12.409)]
)
def test_the_whole_turn_of_a_stage_is_that_of_its_glints(track: str, turn: float, tmp_path: Path) -> None:
    """Every mode, in a range that also holds the half and the double turn. One pass has a pole for each; that one of paints would
    rather turn twice as fast is no reason to drop what the scene's own paint says."""
    torchlc.rotation(
        TRACKS / f"scene_{track}.toml",
        TRACKS / f"track_{track}.ecsv",
        shortest=4.0,
        longest=40.0,
        out=tmp_path,
    )
    found = json.loads((tmp_path / "rotation.json").read_text())
    assert not found["decided"]
    assert all(mode["period_s"] == pytest.approx(turn, abs=0.05) for mode in found["modes"])


@pytest.mark.timeout(600)
def test_two_passes_nine_years_apart_have_one_pole_and_a_turn_each(tmp_path: Path) -> None:
    """The published periods of the light, which this light tells to 0.1 and 0.3 %, are half a turn of a cylinder against the bisector of
    Sun and observer. One turn for both passes would be 2 % from either."""
    tracks = ("1863_10198570", "1863_32164168")
    found = torchlc.rotation(
        TRACKS / f"scene_{tracks[1]}.toml",
        *(TRACKS / f"track_{track}.ecsv" for track in tracks),
        shortest=1.3,
        longest=3.6,
        out=tmp_path,
    )
    best = found.told(found.modes[0])
    assert [one["synodic_s"] for one in best["passes"]] == pytest.approx(
        [2 * 1.4973012, 2 * 1.630147841], rel=4e-3
    )
    assert [one["period_s"] for one in best["nights"]] == pytest.approx([2.99, 3.25], abs=0.01)
    assert best["probability"] > 0.9 and not found.search.decided
