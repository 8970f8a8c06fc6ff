"""Magnitudes and errors in files of observers that are not what torchlc takes."""

from __future__ import annotations

import pytest

from tests.good_input import SCENE
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
        assert f'columns="mag={name}"' in str(error)
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


def rows_of(values: list[float], errors: list[float], name: str = "mag_err") -> str:
    rows = (
        f"2026-03-15T20:{k:02}:00,{mag},{error}"
        for k, (mag, error) in enumerate(zip(values, errors, strict=True))
    )
    return f"time,mag,{name}\n" + "\n".join(rows) + "\n"


NIGHT = [4.31, 4.52, 4.77, 4.35, 4.12, 4.48, 4.66, 4.19, 4.91, 4.27, 4.3, 4.6]


def test_errors_in_another_unit_are_told_and_the_advice_works(read):
    said = "half of the errors in mag_err are above 20 mag"
    recording = read(rows_of(NIGHT, [20.0] * 12))
    assert said in " ".join(recording.warnings)
    named = read(rows_of(NIGHT, [20.0] * 12, "mag_err (mmag)"))
    scene = read(rows_of(NIGHT, [20.0] * 12), SCENE + '[recording]\nunits = { mag_err = "mmag" }\n')
    for mended in (named, scene):
        assert mended.error is not None and mended.error.tolist() == pytest.approx([0.02] * 12)
        assert said not in " ".join(mended.warnings)
    assert "half of the errors" not in " ".join(read(rows_of(NIGHT, [0.9] * 12)).warnings)


def test_one_number_in_many_rows_apart_from_all_others_is_told(read):
    """2.00 is less than 5 mag from the others, as a measurement may be; six times it is none."""
    values = [value if k % 2 else 2.0 for k, value in enumerate(NIGHT)]
    told = " ".join(read(rows_of(values, [0.02] * 12)).warnings)
    assert (
        "row 1, column mag: 2 mag stands in 6 rows, 2.2 mag from all others" in told
        and "leave it blank" in told
    )
    for fine in (NIGHT, [round(value) for value in NIGHT], [2.0, *NIGHT[1:]], [4.3] * 12):
        assert "stands in" not in " ".join(read(rows_of(list(fine), [0.02] * 12)).warnings)
