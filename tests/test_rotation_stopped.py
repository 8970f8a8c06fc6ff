"""A search for a rotation that is cut short: what it kept, and what it says."""

from __future__ import annotations

from pathlib import Path

import pytest
from astropy.table import Table

import torchlc
from tests.rotating_bodies import write_turning


def test_what_was_kept_of_rows_seen_from_elsewhere_is_not_gone_on_from(tmp_path: Path) -> None:
    """The same magnitudes at the same times, the observer mirrored: the poles are others, so the grid is worked out again; a third
    run, of the same rows as the second, knows it."""
    scene, recording = write_turning(tmp_path)
    stages: list[tuple[str, float]] = []

    def stop(stage: str, share: float) -> None:
        stages.append((stage, share))
        if stage == "least squares":
            raise KeyboardInterrupt

    def worked_out() -> bool:
        stages.clear()
        with pytest.raises(KeyboardInterrupt):
            torchlc.rotation(
                scene, recording, shortest=29.0, longest=31.0, out=tmp_path / "out", progress=stop
            )
        return any(stage == "poles" and share for stage, share in stages)

    assert worked_out()
    table = Table.read(recording, format="ascii.ecsv")
    table["obs_z"] *= -1
    table.write(recording, format="ascii.ecsv", overwrite=True)
    assert [worked_out(), worked_out()] == [True, False]


@pytest.mark.long
def test_a_spent_budget_decides_nothing_and_says_what_was_left_out(tmp_path: Path) -> None:
    """A budget that is spent at once leaves the first of several fits of the model."""
    scene, recording = write_turning(tmp_path)
    fits: list[float] = []

    def note(stage: str, share: float) -> None:
        if stage == "model" and share:
            fits.append(share)

    short = torchlc.rotation(scene, recording, budget=1e-3, progress=note).to_json()
    assert len(fits) == 1 and fits[0] < 1
    assert not short["decided"]
    assert short["verdict"].startswith("cannot tell: the budget of 0.001 CPU s left out fits of the model")
    assert len(short["modes"]) == 1
