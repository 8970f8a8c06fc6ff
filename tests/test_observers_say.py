"""What a user says of a file, and hints that work when they are followed."""

from __future__ import annotations

import re
import zoneinfo
from datetime import UTC, datetime, timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from tests.good_input import SCENE
from tests.observers_night import ERROR, EXPORTS, JD, MAG, holds, table
from torchlc.errors import InputError
from torchlc.scene import Scene


class TestUserSays:
    def test_columns(self, read):
        text = "when,brightness,spread,other\n" + table("").strip().replace("\n", ",1\n") + ",1\n"
        with pytest.raises(InputError, match='columns="time=when'):
            read(text)
        holds(read(text, columns="time=when,mag=brightness,mag_err=spread"))
        holds(read(text, columns={"time": "when", "mag": "brightness", "mag_err": "spread"}))
        scene = SCENE + '[recording]\ncolumns = { time = "when", mag = "brightness", mag_err = "spread" }\n'
        holds(read(text, scene))
        assert Scene.from_toml(Scene.from_toml(scene).to_toml()) == Scene.from_toml(scene)

    def test_places_of_a_table_without_names(self, read):
        text = "\n".join(f"{row},{mag},{jd:.6f}" for row, (jd, mag) in enumerate(zip(JD, MAG, strict=True)))
        holds(read(text, columns="time=3,mag=2"), error=False)

    def test_a_column_of_errors_that_is_not_known_is_told(self, read):
        text = table("time,mag,e_V")
        without = read(text)
        assert without.error is None
        (told,) = [one for one in without.warnings if "columns=" in one]
        assert (
            told
            == 'no column is taken for the errors. Not used: e_V. If one holds them: columns="mag_err=e_V"'
        )
        holds(read(text, columns=told.partition('columns="')[2].rstrip('"')))

    def test_a_comment_on_the_barycentre_is_answered_by_what_it_says(self, read):
        (told,) = [
            one for one in read("# Times are BJD_TDB\n" + table("time,mag,mag_err")).warnings if "BJD" in one
        ]
        assert told.endswith('columns="light_path=barycentric,time_scale=tdb"')

    @pytest.mark.parametrize("mark", [",", ";", "\t", " "])
    def test_date_and_time_apart_without_names_lose_no_row(self, read, mark: str):
        """The advice names both columns of the time, and the first row stays one."""
        rows = [
            mark.join([*Time(jd, format="jd").isot.split("T"), f"{mag}", f"{error}"])
            for jd, mag, error in zip(JD, MAG, ERROR, strict=True)
        ]
        text = "\n".join(rows) + "\n"
        with pytest.raises(InputError, match="no names of columns") as caught:
            read(text)
        (option,) = re.findall(r'columns="(time=\S+?)";', str(caught.value))
        assert option == "time=1+2,mag=3,mag_err=4"
        holds(read(text, columns=option))

    def test_names_that_nobody_knows_are_no_row_beside_numbers_of_columns(self, read):
        text = table("Augenblick,Wert,Streuung")
        holds(read(text, columns="time=1,mag=2,mag_err=3"))
        holds(read(text.split("\n", 1)[1], columns="time=1,mag=2,mag_err=3"))

    @pytest.mark.parametrize(
        ("names", "role", "places"),
        [("time,mag,mag,mag_err", "mag", (2, 3)), ("JD,JD,V mag,err", "time", (1, 2))],
    )
    def test_of_two_columns_of_one_name_the_user_says_which(self, read, names: str, role: str, places):
        """Either way of the advice works: a new name for one of them, or the number of the one that is meant."""
        rows = [[f"{jd:.6f}", f"{mag}", f"{error}"] for jd, mag, error in zip(JD, MAG, ERROR, strict=True)]
        for row in rows:
            row.insert(places[0] - 1, "2459000.5" if role == "time" else "9.5")
        text = "\n".join([names, *(",".join(row) for row in rows)]) + "\n"
        with pytest.raises(
            InputError, match=f"appears twice, as columns {places[0]} and {places[1]}"
        ) as caught:
            read(text)
        (way,) = re.findall(r'Rename one of them, or .* columns="(.*)"', str(caught.value))
        assert way == f"{role}={places[1]}"
        holds(read(text, columns=way))
        holds(read(text.replace(names.split(",")[places[0] - 1], "other", 1)))

    def test_columns_of_one_name_without_a_use_are_no_hindrance(self, read):
        holds(read(table("time,mag,mag_err,remark,remark", more=",9.5,8.5")))

    def test_score_refuses_two_columns_of_one_name(self, read):
        text = EXPORTS["SCORE"].replace("limiting_magnitude", "apparent_magnitude")
        with pytest.raises(InputError, match="'apparent_magnitude' appears twice, as columns 5 and 10"):
            read(text)

    def test_the_user_outranks_the_name(self, read):
        text = table("time,mag,mag_err,V", more=",9.5")
        assert read(text, columns="mag=V").observed.tolist() == [9.5] * 3

    def test_units_and_exposures(self, read):
        scene = SCENE + '[recording]\nunits = { mag_err = "mmag" }\nexptime = 20.0\n'
        recording = read(
            table("time,mag,mag_err").replace("0.03", "30").replace("0.02", "20").replace("0.04", "40"), scene
        )
        np.testing.assert_allclose(recording.error, ERROR)
        assert recording.exptime is not None and recording.exptime.tolist() == [20.0] * 3

    @pytest.mark.parametrize(("mark", "moved"), [("start", 5.0), ("middle", 0.0), ("end", -5.0)])
    def test_marks_of_exposures(self, read, mark: str, moved: float):
        text = table("time,mag,mag_err")
        found = read(text, columns=f"time_mark={mark},exptime=10").time
        assert (found[0] - read(text).time[0]).to_value(u.s) == pytest.approx(moved, abs=1e-4)

    def test_dates_of_fits_are_those_of_the_start(self, read):
        text = "DATE-OBS,mag,exptime\n2020-10-17T15:00:00,12.0,60\n"
        assert read(text).time[0].isot == "2020-10-17T15:00:30.000"
        with pytest.raises(InputError, match="the start of the exposures"):
            read("DATE-OBS,mag\n2020-10-17T15:00:00,12.0\n")

    @pytest.mark.parametrize(
        "zone", ["+02:00", "-0930", "UTC+5", "Europe/Vienna", "America/St_Johns", "Asia/Kolkata"]
    )
    @pytest.mark.parametrize("julian", [False, True])
    def test_civil_times_of_a_zone(self, read, zone: str, julian: bool):
        """Against the standard library."""
        offsets = {"+02:00": 120, "-0930": -570, "UTC+5": 300}
        for clock in (datetime(2026, 1, 15, 20, 30), datetime(2026, 7, 15, 3, 15)):
            if zone in offsets:
                expected = clock - timedelta(minutes=offsets[zone])
            else:
                expected = clock.replace(tzinfo=zoneinfo.ZoneInfo(zone)).astimezone(UTC).replace(tzinfo=None)
            cell = f"{Time(clock).jd:.8f}" if julian else clock.isoformat()
            recording = read(f"time,mag\n{cell},12.0\n", columns=f"time_zone={zone}")
            assert abs((recording.time[0] - Time(expected)).to_value(u.s)) < 1e-3
            assert f"zone {zone}" in " ".join(recording.warnings)

    @pytest.mark.parametrize("name", ["time", "Local Time"])
    def test_an_offset_in_some_rows_only_is_refused(self, read, name: str):
        """The others may be of the same zone, or UTC."""
        times = ["2020-10-17T17:00:00+02:00", "2020-10-17T17:10:00"]
        for order in (times, times[::-1]):
            with pytest.raises(
                InputError, match=r"an offset from UTC, as other times|local time; expected UTC"
            ):
                read(f"{name},mag,mag_err\n" + "".join(f"{time},14.9,0.02\n" for time in order))

    def test_a_time_that_clocks_show_twice_is_refused(self, read):
        with pytest.raises(InputError, match="show once"):
            read("time,mag\n2026-10-25T02:30:00,12\n", columns="time_zone=Europe/Vienna")
        with pytest.raises(InputError, match="no offset beside time_zone"):
            read("time,mag\n2026-10-25T02:30:00+01:00,12\n", columns="time_zone=Europe/Vienna")

    @pytest.mark.parametrize(("said", "message"), [
        ("time=", "name=column"), ("tme=JD", "one of time, mag"), ("time=JDD", "no column 'JDD'"), ("time_format=stardate", "time_format"),
        ("time_zone=Mars/Olympus", "time_zone"), ("decimal=dash", "point or comma"), ("time=JD,time=JD", "twice"), ("exptime=-1", "exptime"),
    ])  # fmt: skip
    def test_what_cannot_be(self, read, said: str, message: str):
        with pytest.raises(InputError, match=message) as caught:
            read(table("JD,Mag,Err"), columns=said)
        assert "\n" not in str(caught.value)


FOLLOWED = [
    table("time,mag,mag_err", zero=2400000.0),
    table("when,V,err_of_it"),
    table("MJD,mag,err"),  # whole Julian dates under that name
    "# local time\nDATE-OBS,mag\n2020-10-17T15:00:00,12.0\n2020-10-17T15:01:00,12.1\n",
    "HJD,mag\n2459140.2,12.0\n2459140.3,12.0\n",
    table("JD;mag;err", mark=";", comma=True) + "2459140,2;12.5;0,1\n",
    "2459140.1,0.98,0.01\n2459140.2,1.02,0.01\n",
    EXPORTS["SCORE"] + EXPORTS["SCORE"].splitlines()[1].replace("SAT 1,12345", "BIRD-7,54321") + "\n",
    "Time (local),mag\n2020-10-17T15:00:00,12.0\n2020-10-17T15:01:00,12.1\n",
    table("JD,gmag,rmag"),
    "time,mag\n10/11/2020 19:12:00,5.1\n10/11/2020 19:12:20,5.2\n",
    "time,mag\n1605035520.5,5.1\n1605035521.5,5.1\n",
    "timestamp,mag\n1605035520500,5.1\n1605035521500,5.1\n",
    "time,mag\n9164.3,5.1\n9164.4,5.1\n",
    "mjd,psfFlux,psfFluxErr\n59163.8,1000.2,12\n59163.9,1010.2,12\n",
    "index, field, jd, filter, zpdiff, forcediffimflux, forcediffimfluxunc, diffmaglim\n"
    "0, 300, 2459164.3, ZTF_r, 26.2, 100.2, 10.0, 20.5\n1, 300, 2459164.4, ZTF_r, 26.2, 110.2, 10.0, 20.5\n",
    "Session: 3   Object: 25544\nUT Date,UT Time,JD,V-C,Err\n11/10/2020,19:12:00,2459164.3,0.4,0.02\n11/10/2020,19:14:00,2459164.301,0.5,0.02\n",
    "Label,JD_UTC,Source_AMag_T2,Source_AMag_Err_T2\na,2459164.3,12.1,0.02\nb,2459164.4,12.2,0.02\n",
    "Date,Local Time,mag\n2020-11-10,19:12:00,12.1\n2020-11-10,19:13:00,12.1\n",
    "LocalTime,mag\n2020-11-10 19:12:00,12.1\n2020-11-10 19:13:00,12.1\n",
]


@pytest.mark.parametrize("text", FOLLOWED, ids=range(len(FOLLOWED)))
def test_hints_work_when_they_are_followed(read, text: str):
    """The option that the message offers is typed as it stands there; an example value is left as the example."""
    with pytest.raises(InputError) as caught:
        read(text)
    options = re.findall(r"""columns=(?:"([^"]+)"|'([^']+)')""", str(caught.value))
    assert options, str(caught.value)
    answers = {"exptime=SECONDS": "exptime=10", "time=1,mag=2,mag_err=3": "time=1,flux=2,flux_err=3"}
    option = "".join(options[-1])
    assert len(read(text, columns=answers.get(option, option))) >= 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<?xml version='1.0'?><VOTABLE/>", "looks like XML or HTML"),
        ("<html><table></table></html>", "looks like XML or HTML"),
        ('[{"time": "2020-10-17T15:00:00", "mag": 14.9}]', "looks like JSON"),
        ('{"mag": [14.9]}', "looks like JSON"),
        (b"PK\x03\x04" + bytes(200), "Export the table as CSV"),
        (b"\x1f\x8b\x08" + bytes(200), "a compressed file"),
        ("SIMPLE  =                    T" + " " * 2850, "a FITS file"),
        ("JD,Mag\n2459140.1,14.9 V\n", "Write the number alone"),
        ("JD,Mag\n'2459140.1,14.9\n", "Leave out the apostrophe"),
        ("JD;Mag\n2 459 140.1;14.9\n", "Leave out what parts the thousands"),
        ("JD,Mag\n2459140.1,[14.9\n", "as in >18.5"),
        ("JD,Mag\n2459140.1,14.9\nEnd of report\n", "may go or begin with #"),
        ("JD,Mag,Err\n2459140.1,14.9,0\n2459140.2,14.9,0.1\n", "Leave an error blank that is not known"),
    ],
    ids=lambda value: str(value)[:30],
)  # fmt: skip
def test_what_to_do_about_a_file_that_is_none(content: str | bytes, message: str, read):
    with pytest.raises(InputError, match=re.escape(message)):
        read(content)


def test_names_in_errors_are_those_of_the_file_each_once(read):
    with pytest.raises(InputError, match="no column time among when, mag, V, mag_err;"):
        read(table("when,mag,V,mag_err", more=",9"), columns="mag_err=V")
    with pytest.raises(InputError, match="expected one of") as caught:
        read(table("JD,Mag,Err"), columns="tme=JD")
    listed = str(caught.value).partition("expected one of ")[2].partition(".")[0].split(", ")
    assert len(listed) == len(set(listed)) > 10


def test_decimal_commas_between_quotes_are_read_as_the_advice_says(read):
    rows = [
        f'"{jd:.6f}","{mag}","{error}"'.replace(".", ",")
        for jd, mag, error in zip(JD, MAG, ERROR, strict=True)
    ]
    text = "JD,Mag,Err\n" + "\n".join(rows) + "\n"
    with pytest.raises(InputError, match='columns="decimal=comma"'):
        read(text)
    holds(read(text, columns="decimal=comma"))


@pytest.mark.parametrize("cell", [">18.5", ">=18.5", "> 18.5", ">= 18.5"])
def test_signs_of_an_upper_limit(read, cell: str):
    recording = read(f"JD,Mag,Err\n2459140.125,14.908,0.03\n2459140.135,{cell},\n")
    assert recording.upper_limit.tolist() == [False, True] and recording.observed.tolist() == [14.908, 18.5]
    assert read(f"2459140.125,14.908\n2459140.135,{cell}\n").upper_limit.tolist() == [False, True]


@pytest.mark.parametrize("name", ["± mag", "mag ±", "+/- V mag", "±"])
def test_a_sign_of_an_error_makes_no_magnitude(read, name: str):
    holds(read(table(f"Time (UTC),V mag,{name}")))


@pytest.mark.parametrize("cell", ["Mean", ""])
def test_a_line_without_a_time_may_go_or_begin_with_a_mark(read, cell: str):
    text = table("JD,mag,mag_err")
    with pytest.raises(InputError, match="may go or begin with #"):
        read(f"{text}{cell},9.0,0.02\n")
    holds(read(f"{text}#{cell},9.0,0.02\n"))


@pytest.mark.parametrize("first", [True, False])
def test_a_row_whose_time_is_not_a_number_is_counted_wherever_it_stands(read, first: bool):
    names, rows = table("JD,mag,mag_err").split("\n", 1)
    row = "nan,9.0,0.02\n"
    recording = read(f"{names}\n{row}{rows}" if first else f"{names}\n{rows}{row}")
    holds(recording)
    assert recording.dropped == {"non-finite": 1}


def test_a_remark_below_the_names_may_go_or_begin_with_a_mark(read):
    """C-Munipack writes one below the names of its columns."""
    with pytest.raises(InputError, match="may go or begin with #"):
        read("JD V-C s1\nAperture: 2, JD: geocentric\n2461115.36 0.5 0.03\n", columns="mag=V-C")


def test_a_year_with_decimals_is_not_taken_for_days_in_silence(read):
    with pytest.raises(InputError, match="If it is a year with decimals, write dates"):
        read("time,mag\n2026.20,9.0\n")
