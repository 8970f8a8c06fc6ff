"""Times in files of observers: marks of the exposure, offsets, and the way of light to the Sun."""

from __future__ import annotations

import re

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import get_body_barycentric
from astropy.time import Time

import torchlc
from tests.good_input import SCENE, VECTOR_SCENE
from tests.observers_night import ERROR, EXPORTS, JD, MAG, holds
from torchlc.errors import InputError
from torchlc.geometry.rotation.attitude import epochs_seconds
from torchlc.scene import Scene


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


def test_days_of_a_spreadsheet(read):
    """43831 is 1 January 2020 in every spreadsheet."""
    text = "time,mag\n43831.25,12.1\n43831.50,12.2\n"
    with pytest.raises(InputError) as caught:
        read(text)
    (option,) = re.findall(r'columns="(time_format=jd-241[^"]*)', str(caught.value))
    assert read(text, columns=option).time.isot[0] == "2020-01-01T06:00:00.000"


def test_a_comma_before_the_share_of_a_second(read):
    """As ISO 8601 has it."""
    rows = [
        f"{Time(jd, format='jd').isot.replace('.', ',')}Z;{mag};{error}"
        for jd, mag, error in zip(JD, MAG, ERROR, strict=True)
    ]
    holds(read("time;mag;mag_err\n" + "\n".join(rows) + "\n"))


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


def test_a_julian_date_is_no_second_of_gps(read):
    with pytest.raises(InputError, match=r"A whole Julian date: .*time_format=jd"):
        read(f"GPS time,mag\n{JD[0]},{MAG[0]}\n")


@pytest.mark.parametrize("name", ["GPS time", "gps", "Time (GPS)", "gps_time", "GPSTime", "GPS Date"])
def test_dates_of_gps_are_asked_about_and_both_answers_work(read, name: str):
    """A receiver shows UTC, or GPS's own clock, which has no leap seconds: 18 s ahead in 2026."""
    columns = f'"time={name}"'
    with pytest.raises(InputError, match='Say columns="time_scale=utc", or time_scale=gps'):
        read(of_name(name), columns=columns)
    utc = Time("2026-03-15T20:50:00", scale="utc")
    for scale, ahead in (("utc", 0.0), ("gps", 18.0)):
        recording = read(of_name(name), columns=f"{columns},time_scale={scale}")
        assert abs((utc - recording.time[0]).to_value(u.s) - ahead) < 1e-6
        assert scale.upper() in recording.warnings[0]


@pytest.mark.parametrize(
    ("name", "scale", "ahead"),
    [
        ("TAI", "TAI", 37.0), ("Tai time", "TAI", 37.0), ("date_tai", "TAI", 37.0), ("MJD_TAI", "TAI", 37.0),
        ("TT", "TT", 69.184), ("tt time", "TT", 69.184), ("date_tt", "TT", 69.184), ("JD_TT", "TT", 69.184),
        ("tdt", "TT", 69.184), ("GPST", "GPS", 18.0), ("gpst", "GPS", 18.0),
    ],
)  # fmt: skip
def test_dates_of_a_column_named_after_a_clock_are_read_on_it(read, name: str, scale: str, ahead: float):
    """Differences to UTC since 2017 (IERS Bulletin C); whatever the case of the letters."""
    recording = read(of_name(name), columns=f'"time={name}"')
    utc = Time("2026-03-15T20:50:00", scale="utc")
    assert abs((utc - recording.time[0]).to_value(u.s) - ahead) < 1e-6
    assert f"ISO, {scale}" in recording.warnings[0]


@pytest.mark.parametrize("name", ["lst", "ut1", "tcb", "time_lst"])
def test_a_clock_that_cannot_be_used_is_refused_in_small_letters_too(read, name: str):
    with pytest.raises(InputError, match="one time scale"):
        read(of_name(name), columns=f'"time={name}"')


def of_name(name: str) -> str:
    return f"{name},mag,mag_err\n2026-03-15T20:50:00,14.9,0.02\n2026-03-15T20:52:00,14.8,0.02\n"


@pytest.mark.parametrize(
    "zone", ["MEZ", "MESZ", "NZST", "HST", "SAST", "IST", "WIB", "Wien", "Europe/Vienna", "UT+1", "ET"]
)
def test_a_word_in_brackets_that_may_be_a_zone_is_refused(read, zone: str):
    for name in (f"Time ({zone})", f"Zeit [{zone}]"):
        with pytest.raises(InputError, match=re.escape(name)) as caught:
            read(of_name(name))
        assert "time_zone=+02:00" in str(caught.value)
        found = read(of_name(name), columns="time_zone=+02:00").time[0]
        assert abs((found - Time("2026-03-15T18:50:00")).to_value(u.s)) < 1e-3


@pytest.mark.parametrize(
    "said", ["UTC", "UT", "ISO 8601", "YYYY-MM-DDThh:mm:ss", "UTC, mid-exposure", "isot", "d"]
)
def test_scales_formats_and_units_in_brackets_are_no_zones(read, said: str):
    found = read(of_name(f'"Time ({said})"')).time[0]
    assert abs((found - Time("2026-03-15T20:50:00")).to_value(u.s)) < 1e-3


@pytest.mark.parametrize(
    "name",
    ["Time UTC-7", "UTC+2", "Time_CET", "Ortszeit", "Uhrzeit (Sommerzeit)", "LST", "Time_Europe/Vienna"],
)
def test_the_advice_on_a_name_of_local_time_is_never_silently_wrong(read, name: str):
    """First the name is offered, and then the zone is asked for."""
    with pytest.raises(InputError) as caught:
        read(of_name(name))
    (option,) = re.findall(r'columns="(time=.*?)"$', str(caught.value))
    with pytest.raises(InputError, match=r"local time|one time scale"):
        read(of_name(name), columns=option)


@pytest.mark.parametrize(
    "name", ["JD (2400000+)", "JD 2400000+", "JD (+2400000)", "JD [2400000 +]", "JD (-2400000)"]
)
def test_what_was_taken_off_a_julian_date_may_stand_in_brackets(read, name: str):
    found = read(f"{name},mag\n61115.25,14.0\n").time[0]
    assert found.jd == pytest.approx(2461115.25, abs=1e-9)


def test_the_start_and_the_middle_of_exposures_of_astroimagej(read):
    """The start is half of EXPTIME before the middle."""
    rows = [
        f"{k}\t{jd - 10 / 86400:.7f}\t{jd:.7f}\t{mag}\t{error}\t20.0"
        for k, (jd, mag, error) in enumerate(zip(JD, MAG, ERROR, strict=True))
    ]
    names = "\tJD_SOBS\tJD_MOBS\tSource_AMag_T1\tSource_AMag_Err_T1\tEXPTIME\n"
    holds(read(names + "\n".join(rows) + "\n"))
    start = read((names + "\n".join(rows) + "\n").replace("JD_MOBS", "other"))
    holds(start)
    assert "start of exposure" in start.warnings[0]


def test_the_dates_of_atlas_are_the_start_of_exposures_of_30_s(read):
    """fallingstar-data.com/forcedphot/resultdesc."""
    recording = read(EXPORTS["ATLAS"])
    holds(recording)
    assert recording.exptime is not None and recording.exptime.tolist() == [30.0] * 3
    assert "start of exposures of 30 s" in " ".join(recording.warnings)
    moved = recording.time[0] - read(EXPORTS["ATLAS"], columns="time_mark=middle").time[0]
    assert moved.to_value(u.s) == pytest.approx(15.0, abs=1e-3)


def test_reduced_dates_of_a_table_without_names_are_asked_for_in_full(read):
    """Both readings can be typed as they stand, and differ by half a day."""
    text = "61115.25,14.0,0.02\n61115.26,14.1,0.02\n"
    with pytest.raises(InputError, match="no names of columns") as caught:
        read(text)
    options = re.findall(r'columns="(\w+=[\w-]+(?:,\w+=[\w-]+)*)"', str(caught.value))
    days = {option.rpartition("=")[2]: read(text, columns=option).time[0].jd for option in options[:2]}
    assert days == {"jd-2400000": pytest.approx(2461115.25), "mjd": pytest.approx(2461115.75)}


@pytest.mark.parametrize(
    ("name", "scale"),
    [("time tdb", "tdb"), ("Time_TDB", "tdb"), ("TDB", "tdb"), ("tt time", "tt"), ("time_jd_tdb", "tdb")],
)
def test_a_scale_beside_the_word_time_is_taken(read, name: str, scale: str):
    recording = read(of_name(name))
    assert abs((recording.time[0] - Time("2026-03-15T20:50:00", scale=scale)).to_value(u.s)) < 1e-3
    assert scale.upper() in recording.warnings[0]


OLD = 2433800.5
"""1951-06-03."""
DAMIT_1951 = "1\n12 1\n" + "".join(
    f"{OLD + k * 0.02:.5f} {1 + 0.2 * np.cos(k / 2):.4f} -2.5 1.0 0.1 -1.5 1.0 0.1\n" for k in range(12)
)
ROCK = """\
format = "torchlc-scene/1"
name = "rock"
[orbit]
vectors = "ecliptic"
[attitude]
mode = "inertial"
spin_rate = 0.004
spin_axis = [0.0, 0.0, 1.0]
[[components]]
name = "body"
shape = "box"
size = [2.0, 1.7, 1.2]
centre = [0, 0, 0]
material = "rock"
[materials.rock]
model = "lambert"
albedo = { value = 0.1, low = 0.0, high = 1.0 }
"""


class TestTimesBeforeUtc:
    """Old light curves of asteroids: UT of before 1960 is taken as astropy takes it, TT less 32.184 s."""

    @pytest.mark.parametrize(
        "text",
        [
            DAMIT_1951,
            "JD,mag\n" + "".join(f"{OLD + k * 0.02:.5f},12.5\n" for k in range(12)),
            "# time_format: jd\ntime,mag\n" + "".join(f"{OLD + k * 0.02:.5f},12.5\n" for k in range(12)),
            "STARTMETADATA\nOBJECTNAME=Eros\nDIFFERMAGS=FALSE\nENDMETADATA\n"
            + "".join(f"DATA={OLD + k * 0.02:.5f}|12.5|0.01\n" for k in range(12))
            + "ENDDATA\n",
        ],
        ids=["DAMIT", "JD", "time_format", "ALCDEF"],
    )
    def test_julian_dates_are_read_in_one_scale_and_told(self, read, text: str):
        recording = read(text)
        assert recording.time.scale == "tdb"
        # TT is UT and 32.184 s; TDB is within 2 ms of it, far above what two-part dates and five decimals of a day lose
        seconds = 86400 * ((recording.time.jd1 - OLD) + recording.time.jd2 - 0.02 * np.arange(12))
        np.testing.assert_allclose(seconds, 32.184, atol=2e-3)
        (warning,) = [text for text in recording.warnings if "1960" in text]
        assert "times before it are taken as UT" in warning and len(warning.split()) <= 30

    def test_later_rows_of_the_file_keep_their_distance(self, read):
        recording = read(f"JD,mag\n{OLD},12.5\n2459140.125,12.4\n")
        later = Time(2459140.125, format="jd", scale="utc")
        assert abs((recording.time[1] - later).to_value(u.s)) < 1e-4

    def test_a_file_without_old_rows_stays_in_utc(self, read):
        recording = read("JD,mag\n2436934.5,12.5\n2436934.6,12.4\n")
        assert recording.time.scale == "utc" and not [text for text in recording.warnings if "1960" in text]

    def test_the_epoch_of_a_fit_is_the_first_row_in_the_scale_of_the_rows(self, tmp_path):
        (tmp_path / "rock.toml").write_text(ROCK)
        (tmp_path / "curve.txt").write_text(DAMIT_1951)
        result = torchlc.fit(tmp_path / "rock.toml", tmp_path / "curve.txt")
        epoch = result.fitted_scene.attitude.spin_epoch
        again = torchlc.load(result.fitted_scene, tmp_path / "curve.txt")[1]
        (seconds,) = epochs_seconds(result.fitted_scene, again, "spin_epoch")
        assert str(epoch).startswith("1951-06-03T00:00:32") and abs(seconds) < 1e-3  # text to the millisecond

    def test_others_are_refused_with_the_reason_and_a_way_that_works(self, read):
        rows = "1951-06-03T00:00:00,12.5\n1951-06-03T00:30:00,12.4\n"
        with pytest.raises(
            InputError, match=r"1960-2200 .UTC., for UTC begins in 1960. .* in a column JD"
        ) as refused:
            read("time,mag\n" + rows)
        (way,) = re.findall(r'columns="(time_scale=\w+)"', str(refused.value))
        assert read("time,mag\n" + rows, columns=way).time.scale == "tdb"
        with pytest.raises(InputError, match="for UTC begins in 1960"):
            read("time,mag\n2433800.5,12.5\n2433800.6,12.4\n")

    def test_a_satellite_has_no_such_times(self, read):
        with pytest.raises(InputError, match="1960-2200"):
            read("JD,mag\n2433800.5,12.5\n2433800.6,12.4\n", SCENE)
