"""Files as observers export them: the same numbers as in our own format, what was taken for what said, and hints that
work when they are followed.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import astropy.units as u
import numpy as np
import pandas
import pytest
from astropy.time import Time

from tests.good_input import SCENE, STATION
from tests.observers_night import AIJ, ERROR, EXPORTS, JD, MAG, holds, table
from torchlc.errors import InputError
from torchlc.naming import Replaced
from torchlc.readers import Format, Head, Header, load_recording
from torchlc.readers.format import FORMATS

OBSERVER = Path(__file__).parents[2] / "shared" / "cases" / "observer"


@pytest.mark.parametrize("name", EXPORTS)
def test_exports_are_read(read, name: str):
    recording = read(EXPORTS[name])
    holds(recording)
    assert recording.warnings and re.search(r"as (time|mag)|1 time, 2 mag|read as", recording.warnings[0])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_encodings(read, encoding: str, newline: str):
    text = "# f\u00fcr den Katalog\n" + table(
        "Zeit;Helligkeit;Fehler;Notiz", mark=";", comma=True, more=";sch\u00f6n"
    )
    holds(read(text.replace("\n", newline).encode(encoding)))


@pytest.mark.parametrize("mark", [b"", codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE])
@pytest.mark.parametrize("name", EXPORTS)
def test_two_bytes_a_character(read, name: str, mark: bytes):
    """As the "Unicode text" of Windows programs, with the mark of the order of bytes or without."""
    order = "be" if mark == codecs.BOM_UTF16_BE else "le"
    holds(read(mark + EXPORTS[name].encode(f"utf-16-{order}")))


def test_two_bytes_a_character_that_break_off(read):
    with pytest.raises(InputError, match="UTF-16 text that is damaged"):
        read(table("time,mag,mag_err").encode("utf-16")[:-1])


@pytest.mark.parametrize("rows", [0, 1, 3])
@pytest.mark.parametrize("names", [0, 1])
@pytest.mark.parametrize("name", EXPORTS)
def test_delimiters_at_the_end_of_lines(read, name: str, names: int, rows: int):
    """Of the rows, of the line of names, or of every second row, as spreadsheets and print statements leave them."""
    lines = EXPORTS[name].splitlines()
    mark = next((mark for mark in "\t;,|" if mark in lines[-1]), None)
    if mark is None:
        return
    ends = [names * mark if re.match(r"#?[A-Za-z]", line) else rows * mark for line in lines]
    holds(read("\n".join(line + end for line, end in zip(lines, ends, strict=True))))
    if not names:
        ends[-2] = ""
        holds(read("\n".join(line + end for line, end in zip(lines, ends, strict=True))))


@pytest.mark.parametrize("name", EXPORTS)
def test_a_line_for_a_spreadsheet(read, name: str):
    holds(read(f"sep=;\n{EXPORTS[name]}"))


def test_a_value_too_many_is_refused(read):
    with pytest.raises(InputError, match="row 2: 4 values; expected 3"):
        read(table("JD,Mag,Err").replace(f"{MAG[1]}", f"{MAG[1]},7"))
    with pytest.raises(InputError, match="row 3: 2 values; expected 3"):
        read(table("JD,Mag,Err").replace(f",{ERROR[2]}", ""))


def test_what_was_taken_is_said_in_one_line(read):
    told = read(AIJ).warnings[0]
    assert told == (
        "read as AstroImageJ: JD_UTC as time (Julian date, UTC, mid-exposure), Source_AMag_T1 as mag, "
        "Source_AMag_Err_T1 as mag_err, EXPTIME as exptime"
    )
    assert not read(table("time,mag,mag_err")).warnings


SAID = {
    "ALCDEF": (
        "STARTMETADATA\nOBJECTNAME=Eros\nMAGBAND=V\nENDMETADATA\n" + "".join(f"DATA={jd}|{mag}|0.03\n" for jd, mag in zip(JD, MAG, strict=True))
        + "ENDDATA\n",
        ["1st of DATA as time (Julian date, UTC, mid-exposure)", "2nd as mag", "3rd as mag_err", "MAGBAND or FILTER as band"],
    ),
    "DAMIT": (
        "1\n3 0\n" + "".join(f"{jd} {mag} 1 0.1 0 0.5 0.1 0\n" for jd, mag in zip(JD, MAG, strict=True)),
        ["JD as time (Julian date, UTC, mid-exposure, corrected for light time)", "brightness as flux", "to the Sun x, y, z as sun_x, sun_y, sun_z"],
    ),
    "Mini-MegaTORTORA": (
        "# Date Time StdMag Mag Filter Penumbra Distance Phase Channel\n"
        "2020-11-10 19:12:00.1 4.1 2.1 Clear 0 500 60 2\n2020-11-10 19:12:00.2 4.1 2.2 Clear 0 500 60 2\n",
        ["Date and Time as time (ISO, UTC, mid-exposure)", "Mag as mag", "Channel as curve"],
    ),
    "MPC 80 columns": (
        "     K20A00A  C2020 11 10.80000 01 23 45.67 +12 34 56.7          18.1 V      B01\n"
        "     K20A00A  C2020 11 10.80100 01 23 46.67 +12 34 56.7          18.2 V      B01\n",
        ["columns 16-32 as time (ISO, UTC, mid-exposure)", "66-70 as mag", "78-80 as station"],
    ),
    "SCORE": (EXPORTS["SCORE"], ["observation_time_utc as time", "apparent_magnitude as mag", "observing_filter as band"]),
    "ATLAS": (EXPORTS["ATLAS"], ["MJD as time (modified Julian date", "m as mag", "dm as mag_err", "F as band"]),
    "AAVSO extended": (EXPORTS["AAVSO"], ["DATE as time (Julian date", "MAG as mag", "MERR as mag_err"]),
}  # fmt: skip


@pytest.mark.parametrize("name", SAID)
def test_formats_say_what_they_took(read, name: str):
    text, parts = SAID[name]
    (told,) = [one for one in read(text).warnings if one.startswith(f"read as {name}: ")]
    assert all(part in told for part in parts), told


def test_magnitudes_of_the_minor_planet_center(read):
    """Of the example of the MPC's page on the format: columns 16 to 32 are the date, 66 to 70 the magnitude."""
    found = read(SAID["MPC 80 columns"][0])
    assert found.observed.tolist() == [18.1, 18.2] and found.error is None and found.station_ids == ("B01",)
    assert (
        np.abs((found.time - Time(["2020-11-10T19:12:00", "2020-11-10T19:13:26.4"])).to_value(u.s)).max()
        < 1e-5
    )
    assert found.object_ids == ("K20A00A",)


def test_a_target_without_magnitudes_is_relative_flux(read):
    recording = read("JD_UTC,rel_flux_T1,rel_flux_err_T1\n2459140.1,1.01,0.01\n2459140.2,0.98,0.01\n")
    assert recording.kind == "flux" and recording.observed.tolist() == [1.01, 0.98]


class TestLimitsAndMarkers:
    def test_a_limit_in_front_of_a_number(self, read):
        recording = read(table("JD,Mag,Err") + "2459140.2,>18.5,\n2459140.3,> 17.5,0.1\n")
        assert recording.upper_limit.tolist() == [False] * 3 + [True] * 2
        assert recording.observed[3:].tolist() == [18.5, 17.5]
        flux = read("JD,flux,flux_err\n2459140.1,1.0,0.1\n2459140.2,<0.3,\n")
        assert flux.upper_limit.tolist() == [False, True]

    @pytest.mark.parametrize(
        ("said", "mark"),
        [
            ("excel", ","),
            ("EXCEL", ";"),
            ("EXCEL", "\t"),
            ("44", ","),
            ("124", "|"),
            ("59", ";"),
            ("EXCEL,,", ","),
        ],
    )
    def test_delimiters_of_the_aavso(self, read, said, mark):
        """The format allows a sign's code, 32 to 126; a spreadsheet leaves the word excel."""
        head, rows = EXPORTS["AAVSO"].split("CHART,NOTES\n")
        found = read(head.replace("#DELIM=,", f"#DELIM={said}") + "CHART,NOTES\n" + rows.replace(",", mark))
        np.testing.assert_array_equal(found.observed, MAG)
        np.testing.assert_array_equal(found.error, ERROR)

    @pytest.mark.parametrize("between", [" ± ", "±", " +/- ", "+-"])
    def test_a_value_and_its_error_in_one_cell_get_a_hint(self, read, between):
        text = "time,mag\n2020-10-17T15:00:00,12.5" + between + "0.1\n"
        with pytest.raises(InputError, match="column of its own, such as mag_err"):
            read(text)

    def test_fainter_than_in_the_format_of_the_aavso(self, read):
        recording = read(
            EXPORTS["AAVSO"] + "SAT 1,2459140.3,<15.0,na,V,NO,STD,ENSEMBLE,na,na,na,na,na,na,na\n"
        )
        assert recording.upper_limit.tolist() == [False] * 3 + [True] and recording.observed[3] == 15.0

    @pytest.mark.parametrize(("names", "missing"), [("jd,magpsf,sigmapsf,diffmaglim", ","), ("JD,mag,magerr,limiting_mag", "nan,nan"), ("JD,mag,err,mag5sig", "99.0,99.0")])  # fmt: skip
    def test_a_limiting_magnitude_beside_a_missing_one(self, read, names: str, missing: str):
        found = read(f"{names}\n2459140.1,18.1,0.1,20.5\n2459140.2,{missing},20.4\n2459140.3,18.3,0.1,-99\n")
        assert found.observed.tolist() == [18.1, 20.4, 18.3] and found.upper_limit.tolist() == [
            False,
            True,
            False,
        ]
        assert any("1 row without a magnitude is taken as fainter than" in one for one in found.warnings)

    def test_fainter_than_in_a_download_of_the_aavso(self, read):
        found = read(EXPORTS["AAVSO download"] + "2459140.3,<15.1,,,V,XYZ\n")
        assert found.observed[-1] == 15.1 and found.upper_limit.tolist() == [False, False, False, True]

    def test_a_limit_of_score(self, read):
        recording = read(
            EXPORTS["SCORE"] + "SAT 1,12345,2020-10-17T18:00:00Z,0.1,,,37.54,122.05,110,16.5,cam,V\n"
        )
        assert recording.upper_limit.tolist() == [False] * 3 + [True] and recording.observed[3] == 16.5

    @pytest.mark.parametrize(
        "marker",
        ["99", "99.0", "99.999", "-99", "-99.9", "-99.99", "999", "-999.0", "9999", "nan", "INDEF", ""],
    )
    @pytest.mark.parametrize("column", [1, 2])
    def test_a_marker_loses_its_row_only(self, read, marker: str, column: int):
        row = ["2459140.2", "15.0", "0.05"]
        row[column] = marker
        recording = read(table("JD,Mag,Err") + ",".join(row) + "\n")
        holds(recording)
        assert sum(recording.dropped.values()) == 1

    @pytest.mark.parametrize("row", ["-99,-99", "1.0,-99.9", "-999.0,0.1", "-9999,-9999"])
    def test_markers_of_a_flux(self, read, row: str):
        recording = read(f"JD,flux,flux_err\n2459140.1,100.0,2.0\n2459140.2,{row}\n2459140.3,110.0,2.0\n")
        assert recording.observed.tolist() == [100.0, 110.0] and recording.dropped == {"marked as missing": 1}

    def test_fluxes_about_nothing_keep_what_looks_like_a_marker(self, read):
        recording = read("JD,flux,flux_err\n2459140.1,-12.0,50.0\n2459140.2,-99,50.0\n2459140.3,30,50.0\n")
        assert recording.observed.tolist() == [-12.0, -99.0, 30.0]


def with_the_station(message: str, numbers: Mapping[str, str] = MappingProxyType({})) -> str:
    """The scene with the lines that a message says to add, numbers in place of words in brackets."""
    lines = message.split("each on a line of its own: ")[1]
    for words, number in numbers.items():
        lines = lines.replace(words, number)
    lines = re.sub(r", (?=(?:id|latitude|longitude|height) = )", "\n", lines)
    return SCENE.replace("[attitude]", f"{lines}\n[attitude]")


class TestManyObjects:
    def test_one_of_many_is_chosen(self, read):
        other = EXPORTS["SCORE"].splitlines()[1].replace("SAT 1,12345", "BIRD-7,54321")
        text = EXPORTS["SCORE"] + other + "\n"
        with pytest.raises(InputError, match="2 objects"):
            read(text)
        for wanted in ("12345", "SAT 1", "sat"):
            holds(read(text, columns=f"object={wanted}"))
        assert len(read(text, columns="object=BIRD")) == 1
        with pytest.raises(InputError, match="no object"):
            read(text, columns="object=PLANE")

    def test_the_place_of_an_observer_has_to_be_a_station(self, read):
        assert read(EXPORTS["SCORE"], SCENE).station_ids == ("weihai",)
        elsewhere = EXPORTS["SCORE"].replace("37.54,122.05", "-30.0,20.0")
        with pytest.raises(InputError, match="an observer at -30, 20") as refused:
            read(elsewhere, SCENE)
        holds(read(elsewhere, with_the_station(str(refused.value))))

    @pytest.mark.parametrize("name", ["perth", 'the "old" dome, 2nd floor'])
    def test_a_station_that_the_scene_lacks_is_added_as_the_message_says(self, read, name: str):
        quoted = name.replace('"', '""')
        text = f'time,mag,station\n2020-10-17T15:00:00,12.5,weihai\n2020-10-17T15:10:00,12.4,"{quoted}"\n'
        with pytest.raises(InputError, match=r"row 2, column station: .*If weihai has been meant") as refused:
            read(text, SCENE)
        numbers = {"(deg north)": "-31.95", "(deg east)": "115.86", "(m)": "20"}
        found = read(text, with_the_station(str(refused.value), numbers))
        assert found.station_ids == ("weihai", name) and list(found.station) == [0, 1]

    def test_a_row_without_a_station_among_several_is_told_what_it_lacks(self, read):
        scene = SCENE.replace("[attitude]", STATION.replace("weihai", "karoo") + "[attitude]")
        with pytest.raises(
            InputError, match=r"row 2, column station: ''.*Write into every row which of them"
        ):
            read("time,mag,station\n2020-10-17T15:00:00,12,karoo\n2020-10-17T15:10:00,12,\n", scene)

    def test_magnitudes_of_several_filters(self, read):
        text = table("JD,gmag,rmag")
        with pytest.raises(InputError, match="no column mag"):
            read(text)
        assert read(text, columns="mag=gmag").observed.tolist() == MAG


class TestFormatsOfOthers:
    def test_a_format_defined_elsewhere_is_known_at_once(self, read):
        class Diary(Format):
            name = "diary of a test"

            @classmethod
            def recognises(cls, head: Head) -> bool:
                return head.first.startswith("Dear diary")

            @classmethod
            def read(cls, head: Head) -> Header:
                def rows():
                    for number, text in head.lines[1:]:
                        mag, _, date = text.partition(" at ")
                        yield number, [date, mag.removeprefix("I saw ")]

                return Header(head.path, ("time", "mag"), ",", ecsv=False, rows=rows, format=cls.name)

        try:
            recording = read(
                "Dear diary\n" + "".join(f"I saw {m} at {jd}\n" for jd, m in zip(JD, MAG, strict=True))
            )
            holds(recording, error=False)
            assert recording.warnings[0].startswith("read as diary of a test")
        finally:
            FORMATS.pop("diary of a test")

    def test_a_second_format_of_a_name_replaces_the_first_with_a_word(self):
        with FORMATS.restored():
            with pytest.warns(Replaced, match=r"format 'AstroImageJ' is now elsewhere\.Other, in place of "):
                type("Other", (FORMATS["AstroImageJ"],), {"name": "AstroImageJ", "__module__": "elsewhere"})
            assert FORMATS["AstroImageJ"].__name__ == "Other"


@pytest.mark.skipif(not OBSERVER.is_dir(), reason="needs ../shared/cases/observer")
@pytest.mark.parametrize(
    "name", ["aij.csv", "aij.tbl", "europe.csv", "home.csv", "night_jdred.csv", "night_badrow.csv"]
)
def test_one_night_in_six_forms(name: str):
    """Read by pandas, without torchlc, or told by name as in the message."""
    options = {"columns": "time_format=jd-2400000"} if name == "night_jdred.csv" else {}
    recording = load_recording(OBSERVER / name, **options)
    reading = {
        "comment": "#",
        "encoding": "latin-1",
        "sep": {"aij.tbl": "\t", "europe.csv": ";"}.get(name, ","),
        "decimal": "," if name == "europe.csv" else ".",
    }
    frame = pandas.read_csv(OBSERVER / name, **reading)
    first = next(one for one in ("JD_UTC", "Zeit", "time") if one in frame)
    second = next(one for one in ("Source_AMag_T1", "Helligkeit", "mag") if one in frame)
    frame = frame[frame[second] < 90].drop_duplicates().sort_values(first, kind="stable")
    np.testing.assert_array_equal(recording.observed, frame[second])
    if name != "home.csv":
        expected = frame[first] + (2400000 if name == "night_jdred.csv" else 0)
        np.testing.assert_allclose(np.asarray(recording.time.jd), expected, rtol=0, atol=1e-9)


ODD = {
    "files joined, header and all": (lambda whole: whole + whole.split("\n", 1)[0] + "\n"),
    "a preamble that comes again": (
        lambda whole: "Telescope 0.3 m\n\n" + whole + "Telescope 0.3 m\n\n" + whole.split("\n", 1)[0] + "\n"
    ),
    "cells of marks alone": (lambda whole: whole + "2459140.2,****,0.1\n2459140.3,...,0.1\n"),
    "an error named by its sign": (lambda whole: whole.replace("Err", "+/-")),
    "an error that shares the kind of its magnitude": (
        lambda whole: whole.replace("Mag,Err", "cal_mag,cal_err,inst_err").replace("\n", ",1.0\n").replace("err,1.0", "err", 1)
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", ODD)
def test_the_same_numbers_from_files_that_were_pasted_together(kind: str, read):
    holds(read(ODD[kind](table("JD,Mag,Err"))))


def test_errors_that_are_all_markers_are_absent(read):
    recording = read("JD,Mag,Err\n" + "".join(f"{jd},{mag},99.0\n" for jd, mag in zip(JD, MAG, strict=True)))
    holds(recording, error=False)
    assert recording.error is None and not recording.dropped
    assert any("mag_err is 99 in all rows" in warning for warning in recording.warnings)


PARTS = {
    "hours, minutes, seconds": ("year,month,day,hour,minute,second", "2020,10,17,15,0,0", "2020,10,17,15,14,24.0", "2020,10,17,15,28,48"),
    "no seconds": ("yyyy,mon,dd,hh,mn", "2020,10,17,15,0", "2020,10,17,15,14", "2020,10,17,15,28"),
    "a share of the day": ("Year,Month,Day", "2020,10,17.625", "2020,10,17.635", "2020,10,17.645"),
}  # fmt: skip


@pytest.mark.parametrize("name", PARTS)
def test_parts_of_a_date_in_columns_of_their_own(read, name: str):
    """Against the instants written out as ISO texts."""
    names, *moments = PARTS[name]
    rows = [f"{moment},{mag},0.02" for moment, mag in zip(moments, MAG, strict=True)]
    recording = read("\n".join([f"{names},mag,mag_err", *rows]))
    whole = ["2020-10-17T15:00:00", "2020-10-17T15:14:24", "2020-10-17T15:28:48"]
    if name == "no seconds":
        whole = [f"{moment[:17]}00" for moment in whole]
    np.testing.assert_allclose((recording.time - Time(whole)).sec, 0, atol=1e-4)
    assert recording.observed.tolist() == MAG
    same = read(
        "\n".join([f"{names},mag,mag_err".lower(), *rows]), columns=f"time={names.lower().replace(',', '+')}"
    )
    assert (same.time == recording.time).all()


def test_a_date_without_its_time_of_day_is_no_time(read):
    """Else all rows of a night would be at midnight."""
    with pytest.raises(InputError, match="no column time"):
        read("year,month,day,hours since sunset,mag\n2020,10,17,1.5,14.9\n2020,10,17,1.6,14.8\n")


def test_a_table_of_vizier_with_units_and_a_ruler(read):
    rows = "\n".join(
        f"{jd - 2400000.5:.6f}\t{mag}\t{error}" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)
    )
    recording = read(
        f"#RESOURCE=yCat\n#Name: J/A+A\nMJD\tVmag\te_Vmag\nd\tmag\tmag\n-----\t----\t----\n{rows}\n"
    )
    holds(recording)


@pytest.mark.parametrize("name", ["RJD", "reduced JD", "JD-2400000"])
def test_reduced_julian_dates_by_name(read, name: str):
    holds(read(table(f"{name},mag,mag_err", zero=2400000.0)))
