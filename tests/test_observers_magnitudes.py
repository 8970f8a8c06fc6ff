"""Magnitudes and errors in files of observers that are not what torchlc takes."""

from __future__ import annotations

import pytest

from tests.observers_night import table
from torchlc.errors import InputError

ROWS = table("time,mag,mag_err")
SAID = "torchlc takes apparent magnitudes"


@pytest.mark.parametrize(
    "name",
    ["stdmag", "StdMag", "std_mag", "mag_1000km", "absolute_magnitude", "AbsMag", "mag_inst", "relative_mag"],
)
def test_the_name_of_a_magnitude_that_is_not_apparent_is_told(read, name: str):
    """Such a column is taken only where the user says so, and then it is told."""
    text = table(f"time,{name},mag_err")
    try:
        recording = read(text)
    except InputError as error:
        assert f"--columns mag={name}" in str(error)
        recording = read(text, columns=f"mag={name}")
    assert f"the column of mag is called {name!r}: {SAID}" in " ".join(recording.warnings)


@pytest.mark.parametrize(
    "comment",
    ["reduced to 1000 km", "Sun distance corrected, reduced to 1000 km", "mag are instrumental", "Magnitudes: differential", "normalised to a standard range"],
)  # fmt: skip
def test_a_comment_on_magnitudes_that_are_not_apparent_is_told(read, comment: str):
    assert f"a comment says {comment!r}: {SAID}" in " ".join(read(f"# {comment}\n{ROWS}").warnings)


@pytest.mark.parametrize(
    "comment",
    [
        "reduced by A. B. with a script, mag zero point of Gaia",
        "distance 1000 km",
        "absolute encoder",
        "apparent mag",
    ],
)
def test_other_comments_are_not(read, comment: str):
    assert SAID not in " ".join(read(f"# {comment}\n{ROWS}").warnings)


@pytest.mark.parametrize("name", ["mag", "magnitude", "apparent_mag", "mag_auto", "Vmag"])
def test_names_of_apparent_magnitudes_are_not_told(read, name: str):
    assert SAID not in " ".join(read(table(f"time,{name},mag_err")).warnings)
