"""What a file says of its own columns: those that astropy writes in parts, what its times are, units of flux."""

from __future__ import annotations

import re
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable, Table
from astropy.time import Time, TimeDelta
from astropy.utils import iers
from astropy.utils.masked import Masked

from tests.good_input import RECORDING
from torchlc.errors import InputError
from torchlc.readers import Recording, load_recording


def plain_ecsv(columns: str, *rows: str, meta: str = "{}") -> str:
    """An ECSV of lines ``- {name: ..., datatype: ...}``."""
    declared = [f"# - {{{one}}}\n" for one in columns.split("; ")]
    names = " ".join(one.split(",")[0].removeprefix("name: ") for one in columns.split("; "))
    head = (
        "# %ECSV 1.0\n# ---\n# datatype:\n" + "".join(declared) + f"# meta: {meta}\n# schema: astropy-2.0\n"
    )
    return head + names + "\n" + "".join(f"{row}\n" for row in rows)


NOON = "2020-10-17T12:00:00"
LATER = "2020-10-17T12:01:00"


class TestSerializedColumns:
    """Columns that astropy takes apart to write, in every way it does, come back as astropy has them."""

    def write(self, table: Table, tmp_path: Path) -> Recording:
        table.write(tmp_path / "r.ecsv", format="ascii.ecsv", overwrite=True)
        return load_recording(tmp_path / "r.ecsv")

    @pytest.mark.parametrize("method", ["formatted_value", "jd1_jd2"])
    @pytest.mark.parametrize(
        "form", ["jd", "mjd", "unix", "gps", "cxcsec", "datetime", "yday", "fits", "jyear"]
    )
    def test_times_in_any_format(self, tmp_path: Path, form: str, method: str):
        """A number of days resolves 40 us, a Julian year 0.1 ms."""
        times = Time([NOON, LATER], scale="utc")
        times.format = form
        times.info.serialize_method["ecsv"] = method
        recording = self.write(QTable({"time": times, "mag": [1.0, 2.0]}), tmp_path)
        assert abs((recording.time - Time([NOON, LATER])).to_value(u.s)).max() < 1e-3
        np.testing.assert_array_equal(recording.observed, [1, 2])

    @pytest.mark.parametrize("scale", ["tai", "tt", "tdb", "tcb", "tcg", "ut1"])
    def test_times_in_any_scale(self, tmp_path: Path, scale: str):
        times = Time([NOON, LATER], scale=scale)
        with iers.conf.set_temp("auto_download", False):
            recording = self.write(QTable({"time": times, "mag": [1.0, 2.0]}), tmp_path)
            assert recording.time.scale == ("tdb" if scale in ("tdb", "tcb") else "utc")
            assert abs((getattr(recording.time, scale) - times).to_value(u.s)).max() < 2e-9

    def test_local_times_and_durations_are_refused(self, tmp_path: Path):
        with pytest.raises(InputError, match="scale local"):
            self.write(QTable({"time": Time([NOON], scale="local"), "mag": [1.0]}), tmp_path)
        with pytest.raises(InputError, match="column time: durations"):
            self.write(QTable({"time": TimeDelta([1.0] * u.d), "mag": [1.0]}), tmp_path)

    @pytest.mark.parametrize("masked", [
        MaskedColumn([10, 88, 12], mask=[False, True, False]),
        MaskedColumn([10.0, 88.0, 12.0], mask=[False, True, False], unit="mag"),
        Masked([10.0, 88.0, 12.0] * u.mag, mask=[False, True, False]),
    ], ids=["whole numbers", "magnitudes", "quantity"])  # fmt: skip
    @pytest.mark.parametrize("apart", [True, False])
    def test_masked_values_are_missing(self, tmp_path: Path, masked, apart: bool):
        table = QTable({"time": [NOON, LATER, "2020-10-17T12:02:00"], "mag": masked})
        if apart and isinstance(masked, MaskedColumn):
            table["mag"].info.serialize_method["ecsv"] = "data_mask"
        recording = self.write(table, tmp_path)
        assert recording.dropped == {"non-finite": 1}
        np.testing.assert_array_equal(recording.observed, [10, 12])

    def test_masked_names_and_flags(self, tmp_path: Path):
        table = Table({"time": [NOON, LATER], "mag": [1.0, 2.0]})
        for name, values in (("band", ["V", "R"]), ("upper_limit", [True, True])):
            table[name] = MaskedColumn(values, mask=[False, True])
            table[name].info.serialize_method["ecsv"] = "data_mask"
        recording = self.write(table, tmp_path)
        assert recording.band is not None and list(recording.band) == ["V", ""]
        np.testing.assert_array_equal(recording.upper_limit, [True, False])

    def test_coordinates_beside_are_left(self, tmp_path: Path):
        places = SkyCoord([1, 2] * u.deg, [3, 4] * u.deg)
        table = QTable({"time": Time([NOON, LATER]), "mag": u.Magnitude([12, 13], u.ABmag), "place": places})
        np.testing.assert_array_equal(self.write(table, tmp_path).observed, [12, 13])

    def test_damage_is_an_input_error(self, read):
        text = plain_ecsv("name: time.jd1, datatype: float64; name: mag, datatype: float64", "2459140.0 1",
                          meta="{__serialized_columns__: {time: {__class__: os.system, jd1: 1}}}")  # fmt: skip
        with pytest.raises(InputError, match="astropy cannot read it"):
            read(text)


class TestWhatTimesAre:
    """The middle of the exposure in UTC, or a refusal; what was done is said."""

    COLUMNS = "name: time, datatype: string, description: '{}'; name: mag, datatype: float64"

    def load(self, read, description: str = "", *, exposed: bool = False, meta: str = "{}") -> Recording:
        columns = self.COLUMNS.format(description) + "; name: exptime, datatype: float64" * exposed
        return read(
            plain_ecsv(columns, f"{NOON} 1" + " 30" * exposed, f"{LATER} 2" + " 30" * exposed, meta=meta)
        )

    @pytest.mark.parametrize("said, moved", [
        ("start of exposure (UTC)", 15), ("UTC at the beginning of the exposure", 15), ("exposure start", 15),
        ("shutter open", 15), ("end of exposure", -15), ("exposure end, UTC", -15), ("shutter closed", -15),
        ("obs start", 15), ("t_start", 15), ("start time", 15), ("UTC at start", 15), ("time_end", -15), ("end of obs", -15),
        ("start of the list", 0), ("time since start", 0),
        ("mid-exposure", 0), ("middle of the exposure", 0), ("UTC (clock kept by GPS)", 0), ("", 0),
        ("TAI", -37), ("TT", -69.184), ("terrestrial time (TT)", -69.184),
        ("Terrestrial Time at mid-exposure", -69.184), ("International Atomic Time", -37), ("universal time", 0),
    ])  # fmt: skip
    def test_descriptions(self, read, said: str, moved: float):
        """TAI - UTC was 37 s in 2020 (IERS Bulletin C 60), TT - TAI is 32.184 s."""
        recording = self.load(read, said, exposed=True)
        assert recording.time.scale == "utc"
        assert (recording.time[0] - Time(NOON)).to_value(u.s) == pytest.approx(moved, abs=1e-6)
        assert bool(recording.warnings) == (moved != 0)

    @pytest.mark.parametrize("seconds", ["3_0", "\uff13\uff10"])
    def test_numbers_of_the_option_are_written_as_in_a_file(self, read, seconds: str):
        """Python reads both as 30."""
        text = plain_ecsv(self.COLUMNS.format("start of exposure"), f"{NOON} 1", f"{LATER} 2")
        with pytest.raises(InputError, match=seconds):
            read(text, columns=f"exptime={seconds}")

    @pytest.mark.parametrize("meta, moved", [
        ("{TIMESYS: TT}", -69.184), ("{time_scale: tai}", -37), ("{time_reference: start of exposure}", 15),
        ("{timestamp: end}", -15), ("{TIMEREF: LOCAL, TIMESYS: UTC}", 0), ("{date: '2020-10-17'}", 0),
    ])  # fmt: skip
    def test_metadata(self, read, meta: str, moved: float):
        recording = self.load(read, exposed=True, meta=meta)
        assert (recording.time[0] - Time(NOON)).to_value(u.s) == pytest.approx(moved, abs=1e-6)

    @pytest.mark.parametrize("said, message", [
        ("HJD", "HJD'; expected times at the observer"), ("BJD_TDB", "BJD_TDB"), ("heliocentric", "heliocentric"),
        ("GPS time", "one time scale"), ("UT1", "one time scale"), ("LST", "one time scale"),
        ("TT, not UTC", "one time scale"), ("local time", "local time"), ("CET", "local time"),
        ("Barycentric Coordinate Time", "one time scale"), ("UTC+8", "local time"), ("UTC +05:30", "local time"), ("start of exposure", "Add a column exptime"),
    ])  # fmt: skip
    def test_what_cannot_be_converted_is_refused(self, read, said: str, message: str):
        with pytest.raises(InputError) as caught:
            self.load(read, said)
        assert message in str(caught.value)

    @pytest.mark.parametrize(
        "said", ["TDB", "Barycentric Dynamical Time (TDB)", "barycentric dynamical time"]
    )
    def test_a_scale_of_the_solar_system_is_no_reduction_to_its_centre(self, read, said: str):
        assert self.load(read, said).time.scale == "tdb"

    def test_contradictions_are_refused(self, read):
        with pytest.raises(InputError, match="'TAI', but time_scale is utc"):
            self.load(read, "TAI", meta="{time_scale: utc}")
        with pytest.raises(InputError, match="metadata timezone: 'Europe/Vienna'"):
            self.load(read, meta="{timezone: Europe/Vienna}")

    def test_the_middle_needs_every_exposure_time(self, read):
        columns = self.COLUMNS.format("start of exposure") + "; name: exptime, datatype: float64"
        recording = read(plain_ecsv(columns, f"{NOON} 1 60", f'{LATER} 2 ""'))
        assert recording.dropped == {"non-finite": 1}
        with pytest.raises(InputError, match="column exptime: no number"):
            read(plain_ecsv(columns, f'{NOON} 1 ""', f'{LATER} 2 ""'))

    def test_a_comment_of_a_csv_is_said(self, read):
        recording = read("# the time is the start of exposure\n" + RECORDING)
        assert "a comment says 'the time is the start of exposure'" in recording.warnings[0]

    @pytest.mark.parametrize("line, number, jd", [
        ("# time_format: mjd", "59139.5", 2459140.0), ("# time_format = jd-2400000", "59140.0", 2459140.0),
        ("# Time_Scale: TDB", "2459140.0", 2459140.0),
    ])  # fmt: skip
    def test_comments_of_a_csv_are_metadata(self, read, line: str, number: str, jd: float):
        recording = read(f"{line}\ntime,mag\n{number},12\n")
        assert recording.time.jd[0] == jd and recording.time.scale == ("tdb" if "TDB" in line else "utc")

    def test_the_hint_of_a_reduced_date_works(self, read):
        """61115.368056 is a night in March as JD - 2400000, and the morning after it as a modified Julian date."""
        text = "time,mag\n61115.368056,14.9\n"
        with pytest.raises(
            InputError, match=r"JD - 2400000, say time_format: jd-2400000 in a line"
        ) as caught:
            read(text)
        options = re.findall(r'columns="time_format=([^"]+)"', str(caught.value))
        assert options == ["jd-2400000", "mjd"]
        for form, expected in (("mjd", "2026-03-16T08:50:00"), ("jd-2400000", "2026-03-15T20:50:00")):
            found = read(f"# time_format: {form}\n" + text).time
            assert abs((found[0] - Time(expected)).to_value(u.s)) < 0.1  # six decimals of a day are 0.09 s
            assert read(text, columns=f"time_format={form}").time[0] == found[0]
        with pytest.raises(InputError, match="BJD'; expected times at the observer"):
            read(text.replace("time", "BJD"))


class TestUnitsOfFlux:
    COLUMNS = (
        "name: time, datatype: string; name: flux, datatype: float64{}; name: flux_err, datatype: float64{}"
    )

    def load(self, read, flux: str, error: str) -> Recording:
        units = [f", unit: '{unit}'" if unit else "" for unit in (flux, error)]
        return read(plain_ecsv(self.COLUMNS.format(*units), f"{NOON} 100 2", f"{LATER} 110 2"))

    @pytest.mark.parametrize("flux, error, expected", [
        ("Jy", "mJy", 0.002), ("mJy", "Jy", 2000.0), ("%", "%", 2.0), ("ct", "ct", 2.0), ("AB", "AB", 2.0),
        ("", "", 2.0), ("counts of ours", "counts of ours", 2.0),
    ])  # fmt: skip
    def test_errors_come_to_the_unit_of_the_flux(self, read, flux: str, error: str, expected: float):
        assert self.load(read, flux, error).error == pytest.approx([expected] * 2)

    @pytest.mark.parametrize("flux, error", [
        ("", "%"), ("", "mag"), ("", "Jy"), ("Jy", "%"), ("Jy", "mag"), ("adu", "electron"),
        ("mag", "mag"), ("mag(AB)", ""), ("dex", "dex"),
    ])  # fmt: skip
    def test_what_is_no_error_of_that_flux_is_refused(self, read, flux: str, error: str):
        with pytest.raises(InputError, match="unit"):
            self.load(read, flux, error)

    def test_an_error_without_unit_is_said(self, read):
        assert "flux_err has no unit" in self.load(read, "Jy", "").warnings[0]


@pytest.mark.parametrize(
    "said", ["instrumental magnitude", "differential, V - C", "reduced to unit distances"]
)
def test_magnitudes_that_are_not_apparent_are_told_of(read, said: str):
    text = plain_ecsv(f"name: time, datatype: string; name: mag, datatype: float64, description: '{said}'",
                      "2020-10-17T15:00:00 1", "2020-10-17T15:01:00 2")  # fmt: skip
    (warning,) = read(text).warnings
    assert "takes apparent magnitudes" in warning
