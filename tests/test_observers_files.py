"""Files as observers export them: the same numbers as in our own format, what was taken for what said, and hints that
work when they are followed.
"""

from __future__ import annotations

import codecs
import json
import re
import zoneinfo
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import ClassVar

import astropy.units as u
import numpy as np
import pandas
import pytest
from astropy.coordinates import get_body_barycentric
from astropy.table import Table
from astropy.time import Time

import torchlc
from tests.bad_input_cases import SCENE, VECTOR_SCENE
from tests.small_case import write_case
from tests.test_layouts import same
from torchlc.campaigns.manifest import read_manifest
from torchlc.cli import run
from torchlc.errors import InputError
from torchlc.naming import Replaced
from torchlc.readers import Format, Head, Header, Recording, load_recording
from torchlc.readers.format import FORMATS
from torchlc.scene import Scene, load_scene

JD = [2459140.125, 2459140.135, 2459140.145]
MAG, ERROR = [14.908, 14.793, 14.732], [0.03, 0.02, 0.04]
OBSERVER = Path(__file__).parents[2] / "shared" / "cases" / "observer"


@pytest.fixture
def read(tmp_path: Path):
    def load(content: str | bytes, scene: str | None = None, **options) -> Recording:
        path = tmp_path / "night.txt"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return load_recording(path, None if scene is None else Scene.from_toml(scene), **options)

    return load


def table(names: str, *, zero: float = 0.0, mark: str = ",", more: str = "", comma: bool = False) -> str:
    """A table of the three measurements with these names, Julian dates from ``zero``; ``more`` ends each row."""
    rows = [
        f"{jd - zero:.6f}{mark}{mag}{mark}{error}{more}"
        for jd, mag, error in zip(JD, MAG, ERROR, strict=True)
    ]
    text = "\n".join(rows)
    return names + "\n" + (text.replace(".", ",") if comma else text) + "\n"


def holds(recording: Recording, *, error: bool = True) -> None:
    """The three measurements; a date of six decimals is good to 0.05 s."""
    assert recording.kind == "mag" and recording.observed.tolist() == MAG
    assert not error or (recording.error is not None and recording.error.tolist() == ERROR)
    assert np.abs((recording.time - Time(JD, format="jd", scale="utc")).to_value(u.s)).max() < 0.05


AIJ = "\tLabel\tslice\tJD-2400000\tJD_UTC\tBJD_TDB\tAIRMASS\tEXPTIME\tSource_AMag_T1\tSource_AMag_Err_T1\tSource_AMag_C2\n" + "".join(
    f"{k}\timg_{k}.fits\t1\t{jd - 2400000:.6f}\t{jd:.6f}\t{jd + 0.005:.6f}\t1.3\t10.0\t{mag}\t{error}\t12.0\n"
    for k, (jd, mag, error) in enumerate(zip(JD, MAG, ERROR, strict=True), 1)
)  # fmt: skip
EXPORTS = {
    "AstroImageJ, tabs": AIJ,
    "AstroImageJ, commas": AIJ.replace("\t", ","),
    "ZTF": table("mjd,mag,magerr,filter", zero=2400000.5, more=",zr"),
    "reduced dates": table("JD-2400000,Mag,Err", zero=2400000.0),
    "blanks": table("JD     Mag    Err", mark="   "),
    "semicolons": table("JD;Mag;Err", mark=";"),
    "semicolons, decimal commas": table("Zeit;Helligkeit;Fehler", mark=";", comma=True),
    "tabs, decimal commas": table("JD\tmagnitude\tmag_error", mark="\t", comma=True),
    "bars": table("JD|Mag|MagErr", mark="|"),
    "names in a comment": table("# JD Mag Err", mark=" "),
    "comments with ;": "; Observer: A. B.\n; Filter: V\n" + table("JD,Mag,Err"),
    "comments with %": "% made by a script\n" + table("JD,Mag,Err"),
    "prose above": "Light curve of the object\nTelescope 0.3 m, f/5\n\n" + table("Julian Date,Magnitude,Uncertainty"),
    "units below the names": table("JD,Mag,Err\n(d),(mag),(mag)"),
    "brackets in names": table("JD (UTC),Mag [mag],Mag Err [mag]"),
    "no names": table("# of last night"),
    "capitals": table("TIME,MAG,MAG_ERR"),
    "MPO Canopus": table("JD;ObjMag;ObjErr;CompMag", mark=";", more=";12.0"),
    "MPO Canopus, lines above the names": "Object: SAT 1\nFilter: V\n\n" + table("JD   ObjMag   ObjErr", mark="   "),
    "ZTF alerts": table("jd,magpsf,sigmapsf,fid", more=",2"),
    "ZTF of a broker": table("MJD,unforced_mag,unforced_mag_error,filter", zero=2400000.5, more=",g"),
    "French": table("Jour Julien;Magnitude;Erreur", mark=";", comma=True),
    "Italian": table("Giorno Giuliano;Magnitudine;Errore", mark=";", comma=True),
    "Spanish": table("Fecha juliana;Magnitud;Error", mark=";", comma=True),
    "German dates": "Datum;Zeit;Helligkeit;Fehler\n"
    + "".join(f"17.10.2020;{Time(jd, format='jd').isot[11:]};{mag};{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "Tycho Tracker": table("JD,Target Mag,Target Mag Err,SNR", more=",40"),
    "AAVSO": "#TYPE=Extended\n#OBSCODE=ABC\n#SOFTWARE=x\n#DELIM=,\n#DATE=JD\n#OBSTYPE=CCD\n"
    "#NAME,DATE,MAG,MERR,FILT,TRANS,MTYPE,CNAME,CMAG,KNAME,KMAG,AMASS,GROUP,CHART,NOTES\n"
    + "".join(f"SAT 1,{jd:.6f},{mag},{error},V,NO,STD,ENSEMBLE,na,na,na,1.2,na,na,na\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "SCORE": "satellite_name,norad_cat_id,observation_time_utc,observation_time_uncertainty_sec,apparent_magnitude,"
    "apparent_magnitude_uncertainty,observer_latitude_deg,observer_longitude_deg,observer_altitude_m,limiting_magnitude,"
    "instrument,observing_filter\n"
    + "".join(f"SAT 1,12345,{Time(jd, format='jd').isot}Z,0.1,{mag},{error},37.54,122.05,110,,cam,V\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "ATLAS": "###MJD m dm uJy duJy F err chi/N RA Dec x y maj min phi apfit mag5sig Sky Obs\n"
    + "".join(f"{jd - 2400000.5:.6f} {mag} {error} 100 2 o 0 1 1 1 1 1 3 3 1 -0.4 19.5 20 x\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "SExtractor": table("JD,MAG_AUTO,MAGERR_AUTO"),
    "ADES": "# version=2017\n# observatory\n! mpcCode B01\npermID|mode|stn|obsTime|ra|dec|mag|rmsMag|band\n"
    + "".join(f"433|CCD|B01|{Time(jd, format='jd').isot}Z|10.1|20.2|{mag}|{error}|V\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "AAVSO download": table("JD,Magnitude,Uncertainty,HQuncertainty,Band,Observer Code", more=",,V,XYZ"),
    "dates with strokes, no names": "".join(f"{Time(jd, format='jd').strftime('%d/%m/%Y %H:%M:%S')},{mag},{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "a date with a share of the day": "UT Date;Mag;Err\n"
    + "".join(f"2020-10-{17 + jd - 2459139.5:.6f};{mag};{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "dates and times in digits": "date;time;mag;err\n"
    + "".join(f"{Time(jd, format='jd').strftime('%Y%m%d;%H%M%S')};{mag};{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "date and time in German": "Datum/Zeit UT;Helligkeit (mag);Fehler (mag)\n"
    + "".join(f"{Time(jd, format='jd').strftime('%d.%m.%Y %H:%M:%S')};{mag};{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "local times with their offset": "Local Time,Mag,Err\n"
    + "".join(f"{Time(jd + 2 / 24, format='jd').isot}+02:00,{mag},{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "date and time apart": "Date,UT,Mag,Err\n"
    + "".join(f"{Time(jd, format='jd').isot.replace('T', ',')},{mag},{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
}  # fmt: skip


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


def test_reduced_and_modified_dates_are_never_confused(read):
    """They differ by 12 h; against astropy."""
    for text, form in (
        ("JD-2400000", 2400000.0),
        ("JD-2400000.5", 2400000.5),
        ("MJD", 2400000.5),
        ("RJD", 2400000.0),
        ("JD-2400000.0", 2400000.0),
    ):
        found = read(f"{text},mag\n61115.25,14.0\n").time[0]
        assert found.jd == pytest.approx(61115.25 + form, abs=1e-9)
    for zero in (2450000, 2457000):
        for text, options in ((f"JD-{zero}", {}), ("time", {"columns": f"time_format=jd-{zero}"})):
            found = read(f"{text},mag\n{2459140.125 - zero},14.0\n", **options)
            assert found.time[0].jd == pytest.approx(2459140.125, abs=1e-9)
    with pytest.raises(InputError, match="jd- and a Julian date"):
        read("time,mag\n9140.125,14.0\n", columns="time_format=jd-12")
    modified = Time(61115.25, format="mjd", scale="utc")
    assert read("MJD,mag\n61115.25,14.0\n").time[0].isot == modified.isot


class TestUserSays:
    def test_columns(self, read):
        text = "when,brightness,spread,other\n" + table("").strip().replace("\n", ",1\n") + ",1\n"
        with pytest.raises(InputError, match="--columns time=when"):
            read(text)
        holds(read(text, columns="time=when,mag=brightness,mag_err=spread"))
        holds(read(text, columns={"time": "when", "mag": "brightness", "mag_err": "spread"}))
        scene = SCENE + '[recording]\ncolumns = { time = "when", mag = "brightness", mag_err = "spread" }\n'
        holds(read(text, scene))
        assert Scene.from_toml(Scene.from_toml(scene).to_toml()) == Scene.from_toml(scene)

    def test_places_of_a_table_without_names(self, read):
        text = "\n".join(f"{row},{mag},{jd:.6f}" for row, (jd, mag) in enumerate(zip(JD, MAG, strict=True)))
        holds(read(text, columns="time=3,mag=2"), error=False)

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


def path_of_light(jd: np.ndarray, direction: tuple[float, float], centre: str) -> np.ndarray:
    """Days that the way of light from the geocentre adds, from the place of the Earth and plain trigonometry."""
    time = Time(jd, format="jd", scale="tdb")
    earth = get_body_barycentric("earth", time).xyz.to_value(u.km).T
    if centre == "heliocentric":
        earth = earth - get_body_barycentric("sun", time).xyz.to_value(u.km).T
    lon, lat = np.radians(direction)
    towards = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    return earth @ towards / 299792.458 / 86400.0


class TestTimesAtTheSun:
    DIRECTION = (150.0, -12.0)

    @pytest.mark.parametrize(("name", "centre"), [("HJD", "heliocentric"), ("BJD_TDB", "barycentric")])
    def test_a_direction_puts_the_light_back(self, read, name: str, centre: str):
        """The observer stands within 21 ms of the geocentre, and dates of eight decimals are good to 1 ms."""
        jd = np.array([2459140.25, 2459145.75])
        added = path_of_light(jd, self.DIRECTION, centre)
        text = f"{name},mag\n" + "".join(f"{one:.8f},14.0\n" for one in jd + added)
        with pytest.raises(InputError, match="times at the observer"):
            read(text)
        recording = read(text, columns='direction="150 -12"')
        found = np.asarray(getattr(recording.time, "tdb" if "TDB" in name else "utc").jd)
        assert np.abs(added).max() * 86400 > 100
        np.testing.assert_allclose((found - jd) * 86400, 0, atol=0.025)
        assert "brought back to the observer" in " ".join(recording.warnings)

    @pytest.mark.parametrize("centre", ["heliocentric", "barycentric"])
    @pytest.mark.parametrize("frame", ["icrs", "ecliptic"])
    def test_vectors_put_the_light_back(self, read, centre: str, frame: str):
        jd = np.array([2459140.25])
        added = path_of_light(jd, self.DIRECTION, centre)
        time = Time(jd, format="jd", scale="tdb")
        earth, sun = (get_body_barycentric(body, time).xyz.to_value(u.km).T[0] for body in ("earth", "sun"))
        lon, lat = np.radians(self.DIRECTION)
        body = earth + 2e8 * np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        turn = np.eye(3)
        if frame == "ecliptic":
            obliquity = np.radians(23.4392911)
            turn[1:, 1:] = [[np.cos(obliquity), np.sin(obliquity)], [-np.sin(obliquity), np.cos(obliquity)]]
        cells = ",".join(f"{one:.3f}" for one in (*(turn @ (sun - body)), *(turn @ (earth - body))))
        name = "BJD_TDB" if centre == "barycentric" else "HJD"
        text = f"# frame: {frame}\n{name},mag,sun_x,sun_y,sun_z,obs_x,obs_y,obs_z\n{(jd + added)[0]:.8f},14.0,{cells}\n"
        recording = read(text)
        found = np.asarray(getattr(recording.time, "tdb" if "TDB" in name else "utc").jd)
        np.testing.assert_allclose((found - jd) * 86400, 0, atol=0.01)

    def test_a_satellite_is_refused(self, read):
        with pytest.raises(InputError, match="Give UTC at the telescope"):
            read("BJD_TDB,mag\n2459140.2,12\n", SCENE, columns='direction="150 -12"')
        assert Scene.from_toml(VECTOR_SCENE).orbit.vectors == "icrs"


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
        with pytest.raises(InputError, match=r"Add to the scene: \[\[stations\]\].*latitude = -30"):
            read(EXPORTS["SCORE"].replace("37.54,122.05", "-30.0,20.0"), SCENE)

    def test_magnitudes_of_several_filters(self, read):
        text = table("JD,gmag,rmag")
        with pytest.raises(InputError, match="no column mag"):
            read(text)
        assert read(text, columns="mag=gmag").observed.tolist() == MAG


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
    options = re.findall(r"--columns ((?:[\w]+=(?:\"[^\"]*\"|[^\s,;()]+),?)+)", str(caught.value))
    assert options, str(caught.value)
    answers = {"exptime=SECONDS": "exptime=10", "time=1,mag=2,mag_err=3": "time=1,flux=2,flux_err=3"}
    option = options[-1].rstrip(",")
    assert len(read(text, columns=answers.get(option, option))) >= 2


def test_days_of_a_spreadsheet(read):
    """43831 is 1 January 2020 in every spreadsheet."""
    text = "time,mag\n43831.25,12.1\n43831.50,12.2\n"
    with pytest.raises(InputError) as caught:
        read(text)
    (option,) = re.findall(r"--columns (time_format=jd-241\S*)", str(caught.value))
    assert read(text, columns=option).time.isot[0] == "2020-01-01T06:00:00.000"


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
                    for _, text in head.lines[1:]:
                        mag, _, date = text.partition(" at ")
                        yield [date, mag.removeprefix("I saw ")]

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


class TestRowsInMemory:
    COLUMNS: ClassVar = {
        "time": Time(JD, format="jd", scale="utc"),
        "mag": np.array(MAG),
        "mag_err": np.array(ERROR),
    }

    @pytest.mark.parametrize("rows", [
        COLUMNS,
        {**COLUMNS, "mag": MAG * u.mag, "mag_err": 1000 * np.array(ERROR) * u.mmag},
        {"JD": JD, "Mag": MAG, "Err": ERROR},
        {**COLUMNS, "time": Time(JD, format="jd", scale="utc").tai},
        Table({"time": JD, "mag": MAG, "mag_err": ERROR}),
        Table(COLUMNS),
        pandas.DataFrame({"jd": JD, "mag": MAG, "mag_err": ERROR}),
        pandas.DataFrame({"time": pandas.to_datetime([Time(one, format="jd").isot for one in JD]), "mag": MAG, "mag_err": ERROR}),
        pandas.DataFrame({"mag": MAG, "mag_err": ERROR}, index=pandas.to_datetime([Time(one, format="jd").isot for one in JD], utc=True)),
    ], ids=["arrays and Time", "quantities", "names of others", "TAI", "Table", "Table with Time", "DataFrame", "instants", "index"])  # fmt: skip
    def test_every_kind(self, rows):
        recording = Recording.from_table(rows)
        np.testing.assert_allclose(recording.observed, MAG, rtol=1e-15)
        np.testing.assert_allclose(recording.error, ERROR, rtol=1e-14)
        assert np.abs((recording.time - Time(JD, format="jd", scale="utc")).to_value(u.s)).max() < 1e-4

    def test_instants_with_a_zone(self):
        frame = pandas.DataFrame({"time": pandas.to_datetime(["2020-10-17T17:00:00+02:00"]), "mag": [12.0]})
        assert Recording.from_table(frame).time[0].isot == "2020-10-17T15:00:00.000"

    @pytest.mark.parametrize("way", ["to_table", "to_pandas", "to_timeseries"])
    def test_there_and_back(self, read, way: str):
        recording = read(AIJ)
        same(Recording.from_table(getattr(recording, way)()), recording)

    def test_what_cannot_be(self):
        for rows, message in (
            ({"time": JD, "mag": MAG[:2]}, "different lengths"),
            ({"time": JD, "mag": 12.0}, "column mag is one number"),
            (12.0, "a path, a Recording"),
            ({}, "no columns"),
        ):
            with pytest.raises(InputError, match=message):
                Recording.from_table(rows)


def test_pictures_of_a_notebook(read):
    shown = read(AIJ)._repr_html_()
    assert shown.count("<circle") == 3 and "</svg>" in shown
    heights = [float(one) for one in re.findall(r'cy="([\d.]+)"', shown)]
    assert heights == sorted(heights, reverse=True)  # it brightens: the dots rise, y counts downwards
    assert (
        Scene.from_toml(SCENE)._repr_html_().count("<polygon") >= 4
    )  # three faces of the box, one of the plate


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


class TestCommands:
    TWO = (
        "0 BIRD 7\n1 37834U 11045A   26074.51234567 -.00000155  00000-0  00000+0 0  9999\n"
        "2 37834   0.0213  85.4012 0002513 210.1123  30.2201  1.00271810 53325\n"
        "TEST SATELLITE\n1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993\n"
        "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966\n"
    )

    @pytest.fixture(autouse=True)
    def folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.chdir(tmp_path)
        Path("two.txt").write_text(self.TWO)

    def test_an_object_of_many(self, capsys: pytest.CaptureFixture[str]):
        assert run(["init", "s.toml", "--tle", "two.txt"]) == 2
        told = capsys.readouterr().err
        assert "1 TEST SATELLITE, 37834 BIRD 7" in told and not Path("s.toml").exists()
        followed = re.search(r"--object (\w+)", told)
        assert followed is not None
        for wanted, number in (
            (followed[1], "00001"),
            ("bird", "37834"),
            ("BIRD 7", "37834"),
            ("00001", "00001"),
        ):
            assert run(["init", "s.toml", "--tle", "two.txt", "--object", wanted, "--force"]) == 0
            assert f'"1 {number}U' in Path("s.toml").read_text()
        assert run(["init", "t.toml", "--tle", "two.txt", "--object", "plane"]) == 2
        assert run(["init", "t.toml", "--tle", "two.txt", "--object", "I"]) == 2  # both names have an i
        assert "2 objects for 'I'" in capsys.readouterr().err

    def test_a_campaign_from_a_folder(self, capsys: pytest.CaptureFixture[str]):
        nights = Path("nights")
        nights.mkdir()
        (nights / "37834_2026-03-15.csv").write_text(table("JD,Mag,Err"))
        (nights / "test-satellite 2.txt").write_text(EXPORTS["ZTF"])
        (nights / "inside.csv").write_text("# object: BIRD 7\n" + table("JD,Mag,Err"))
        (nights / "nobody.csv").write_text(table("JD,Mag,Err"))
        (nights / "bird-7-but.csv").write_text("# object: TEST SATELLITE\n" + table("JD,Mag,Err"))
        assert run(["campaign", "init", "two.txt", "nights", "--station", "weihai,37.5,122.1,110"]) == 0
        told = capsys.readouterr()
        assert "nobody.csv: left out" in told.err and "bird-7-but.csv: left out" in told.err
        jobs = list(read_manifest(nights / "manifest.csv"))
        numbers = {job.recording.name: load_scene(job.scene).orbit.tle[0][2:7] for job in jobs}
        assert numbers == {
            "37834_2026-03-15.csv": "37834",
            "inside.csv": "37834",
            "test-satellite 2.txt": "00001",
        }
        assert run(["campaign", "init", "two.txt", "nights"]) == 2
        assert "--force" in capsys.readouterr().err
        assert run(["campaign"]) == 2 and run(["campaign", "nights/manifest.csv"]) == 2  # no -o

    def test_columns_of_every_command(self, capsys: pytest.CaptureFixture[str]):
        rows = "".join(f"{2459140.125 + k / 288:.6f} {12 + 0.1 * np.sin(k):.4f} 0.02\n" for k in range(40))
        Path("r.txt").write_text("when light spread\n" + rows)
        Path("s.toml").write_text(SCENE)
        columns = ["--columns", "time=when,mag=light,mag_err=spread"]
        assert run(["simulate", "s.toml", "r.txt", "-o", "out", *columns]) == 0
        assert "when as time (Julian date, UTC, mid-exposure)" in capsys.readouterr().err
        assert run(["period", "r.txt", *columns]) == 0
        assert run(["period", "r.txt"]) == 2
        assert "--columns" in capsys.readouterr().err

    def test_a_fit_is_read_back(self):
        scene, recording = write_case(Path())
        result = torchlc.fit(scene, recording, steps=20, out="fit")
        stored = torchlc.load_fit("fit")
        assert stored.parameters() == json.loads(Path("fit/fit.json").read_text())["parameters"]
        assert result.posterior is not None and stored.names == result.names
        for k, name in enumerate(result.names):
            np.testing.assert_array_equal(stored.draws[name], result.posterior.theta[..., k].numpy())
        assert stored.to_pandas()["median"].tolist() == result.to_pandas()["median"].tolist()
        (Path("fit") / "posterior.nc").write_bytes(b"nothing")
        with pytest.raises(InputError, match=r"posterior\.nc: cannot be read"):
            torchlc.load_fit("fit")
        with pytest.raises(InputError, match="no such file"):
            torchlc.load_fit("nowhere")


def test_all_missing_keys_of_a_scene_are_told_at_once():
    with pytest.raises(InputError) as caught:
        Scene.from_toml('format = "torchlc-scene/1"\n[attitude]\n')
    assert all(
        key in str(caught.value) for key in ("name", "orbit", "attitude.mode", "components", "materials")
    )


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_scenes_and_manifests_of_windows(tmp_path: Path, encoding: str):
    text = SCENE.replace("\n", "\r\n")
    (tmp_path / "scene.toml").write_bytes(text.encode(encoding))
    assert load_scene(tmp_path / "scene.toml").to_toml() == Scene.from_toml(SCENE).to_toml()
    (tmp_path / "rows.csv").write_bytes(table("time,mag,mag_err").encode(encoding))
    (tmp_path / "all.csv").write_bytes("scene,recording,task\r\nscene.toml,rows.csv,fit\r\n".encode(encoding))
    jobs = list(read_manifest(tmp_path / "all.csv"))
    assert [job.recording.name for job in jobs] == ["rows.csv"]


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


def test_a_comma_before_the_share_of_a_second(read):
    """As ISO 8601 has it."""
    rows = [
        f"{Time(jd, format='jd').isot.replace('.', ',')}Z;{mag};{error}"
        for jd, mag, error in zip(JD, MAG, ERROR, strict=True)
    ]
    holds(read("time;mag;mag_err\n" + "\n".join(rows) + "\n"))


def test_errors_that_are_all_markers_are_absent(read):
    recording = read("JD,Mag,Err\n" + "".join(f"{jd},{mag},99.0\n" for jd, mag in zip(JD, MAG, strict=True)))
    holds(recording, error=False)
    assert recording.error is None and not recording.dropped
    assert any("mag_err is 99 in all rows" in warning for warning in recording.warnings)


def test_the_date_of_the_fits_standard_is_the_start_of_the_exposure_in_both_spellings(read):
    """MJD-OBS is DATE-OBS in another format (FITS standard 4.0, 9.5)."""
    rows = [f"{jd - 2400000.5:.8f},20.0,{mag},{error}" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)]
    recording = read("MJD-OBS,EXPTIME,MAG,MAGERR\n" + "\n".join(rows) + "\n")
    np.testing.assert_allclose(
        (recording.time - Time(JD, format="jd", scale="utc")).to_value(u.s), 10.0, atol=1e-3
    )


def test_seconds_of_a_week_are_not_those_since_1980_and_the_advice_works(read):
    moment = Time(JD[0], format="jd").gps
    week, rest = divmod(moment, 604800)
    with pytest.raises(InputError, match="those of a week come if its number times 604800 is added"):
        read(f"gps_week,gps_seconds,mag\n{week:.0f},{rest:.3f},{MAG[0]}\n")
    recording = read(f"gps_seconds,mag\n{rest + week * 604800:.3f},{MAG[0]}\n")
    assert abs((recording.time[0] - Time(JD[0], format="jd", scale="utc")).to_value(u.s)) < 0.01


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
