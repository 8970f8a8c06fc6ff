"""Rows that are left out are told in one sentence: how many, why, and in which lines of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas
import pytest

from tests.good_input import SCENE
from torchlc.cli import run
from torchlc.diagnosis.words import bad_rows
from torchlc.errors import InputError
from torchlc.readers import load_recording, recording_of
from torchlc.readers.measurements import left_out, places

TABLE = """# a night
# of an observer
mjd,mag,magerr,filter
59139.625,12.50,0.02,r
59139.626,99.0,0.02,r
59139.627,12.50,nan,r

59139.629,12.51,,r
59139.630,12.51,0.02,r
59139.630,12.51,0.02,r
59139.640,12.4,0.02,r
"""
SENTENCE = (
    "4 rows are left out: 1 beyond 90 mag, which stands for no measurement (line 5), 2 without a number (lines 6 and 8), "
    "1 the same as another (line 10)"
)


def test_the_terminal_says_how_many_why_and_which_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "s.toml").write_text(SCENE)
    (tmp_path / "r.csv").write_text(TABLE)
    assert (
        run(
            ["simulate", *(str(tmp_path / name) for name in ("s.toml", "r.csv")), "-o", str(tmp_path / "out")]
        )
        == 0
    )
    assert f"torchlc: warning: {SENTENCE}\n" in capsys.readouterr().err


def test_every_row_knows_its_line(tmp_path: Path):
    """Blank lines, comments and cells of two lines count as the editor counts them; rows in memory count from 1."""
    text = TABLE.replace(",filter", ",filter,note")
    text = "".join(f"{line},\n" if ",r" in line else f"{line}\n" for line in text.splitlines())
    text = text.replace(
        "59139.640,12.4,0.02,r,", '59139.640,12.4,0.02,r,"two\nlines"\n59139.641,12.4,0.02,r,'
    )
    (tmp_path / "r.csv").write_text(text)
    recording = load_recording(tmp_path / "r.csv")
    assert recording.place is not None and recording.place.tolist() == [4, 9, 12, 13]
    assert {reason: where.tolist() for reason, where in recording.dropped_at.items()} == {
        "beyond 90 mag": [5], "non-finite": [6, 8], "duplicate": [10],
    }  # fmt: skip
    later = recording.keep(np.array([True, False, True, True]), "below the horizon")
    assert "1 below the horizon (line 9)" in left_out(later)[0]
    frame = pandas.DataFrame({"time": [2459140.1, 2459140.2, 2459140.3], "mag": [12.0, np.nan, 12.1]})
    assert left_out(recording_of(frame)) == ["1 row is left out: 1 without a number (row 2)"]


def test_formats_of_their_own_know_their_lines(tmp_path: Path):
    lines = [
        "#TYPE=EXTENDED",
        "#DELIM=,",
        "#DATE=JD",
        "#NAME,DATE,MAG,MERR,FILT,TRANS,MTYPE,CNAME,CMAG,KNAME,KMAG,AMASS,GROUP,CHART,NOTES",
    ]
    for day, mag in enumerate(("12.1", "99.9", "12.3")):
        lines.append(f"BIRD,245914{day}.5,{mag},0.02,V,NO,STD,na,na,na,na,1.2,na,na,na")
    (tmp_path / "r.txt").write_text("\n".join(lines) + "\n")
    (told,) = left_out(load_recording(tmp_path / "r.txt"))
    assert told.endswith("(line 6)")


def test_flags_of_ztf_leave_rows_out(tmp_path: Path):
    """catflags other than 0 mark a row as bad; a column of another name is told."""
    rows = [
        "59139.625,12.5,0.02,0",
        "59139.626,12.5,0.02,32768",
        "59139.627,12.5,0.02,2",
        "59139.628,12.5,0.02,",
    ]
    (tmp_path / "r.csv").write_text("\n".join(["mjd,mag,magerr,catflags", *rows]) + "\n")
    recording = load_recording(tmp_path / "r.csv")
    assert len(recording) == 2 and recording.dropped == {"flagged as bad": 2}
    assert left_out(recording) == ["2 rows are left out: 2 flagged as bad (lines 3 to 4)"]
    assert "catflags as bad" in recording.warnings[0]
    (tmp_path / "r.csv").write_text(
        "\n".join(["mjd,mag,magerr,clouds", *rows]).replace("32768", "true") + "\n"
    )
    assert len(load_recording(tmp_path / "r.csv")) == 4
    assert len(load_recording(tmp_path / "r.csv", columns="bad=clouds")) == 2


ATLAS = """###MJD m dm uJy duJy F err chi/N RA Dec x y maj min phi apfit mag5sig Sky Obs
59139.625 15.1 0.05 3000 100 o 0 1.1 10 20 1 1 2 2 0 -.4 19.1 20.1 a
59139.626 15.2 0.05 3000 100 o 1 1.1 10 20 1 1 2 2 0 -.4 19.1 20.1 b
"""


def test_flags_of_atlas_leave_rows_out_where_the_user_says_so(tmp_path: Path):
    (tmp_path / "r.txt").write_text(ATLAS)
    assert len(load_recording(tmp_path / "r.txt")) == 2
    assert left_out(load_recording(tmp_path / "r.txt", columns="bad=err")) == [
        "1 row is left out: 1 flagged as bad (line 3)"
    ]


@pytest.mark.parametrize(
    ("flags", "columns", "told"),
    [
        (("3", "1"), "bad=a", "2 flagged as bad.*whose flag is 0.*give the column another name"),
        (("ok", "no"), "bad=a", "row 1, column bad: 'ok'; expected true, false, or a number: 0 for a good row$"),
        (("0", "0"), "bad=a+mag", r"column of bad: 2 columns: 'a\+mag'; expected one column"),
    ],
)  # fmt: skip
def test_flags_that_cannot_be_used_are_told_with_what_a_flag_is(
    tmp_path: Path, flags, columns: str, told: str
):
    rows = [f"59139.{place},12.5,0.02,{flag}\n" for place, flag in enumerate(flags, 1)]
    (tmp_path / "r.csv").write_text("mjd,mag,magerr,a\n" + "".join(rows))
    with pytest.raises(InputError, match=told):
        load_recording(tmp_path / "r.csv", columns=columns)


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ([], ""), ([7], "line 7"), ([3, 4], "lines 3 to 4"), ([3, 5, 6, 7, 12], "lines 3, 5 to 7 and 12"),
        (range(1, 40, 2), "lines 1, 3, 5, 7, 9, 11 and 14 more"),
    ],
)  # fmt: skip
def test_lines_in_words(numbers, told: str):
    assert places(np.array(numbers, dtype=int), "line") == told


def test_rows_that_a_diagnosis_calls_bad_are_told_with_their_lines():
    row = {"time": "2020-10-17T15:20:00.000000", "station": "weihai", "place": "line 14", "probability": 0.98}
    assert bad_rows({"outliers": []}) == ""
    assert bad_rows({"outliers": [row]}) == (
        "1 row is probably bad, further from the model than the errors allow: line 14 (2020-10-17 15:20:00, 98 %)."
    )
    unknown = bad_rows({"outliers": [row | {"place": None}, row]})
    assert unknown.startswith("2 rows are") and ": 2020-10-17 15:20:00, 98 %, line 14" in unknown
