"""Recordings: the file's numbers in our units, every row accounted for, InputErrors from broken files."""

from __future__ import annotations

import datetime
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.table import MaskedColumn, QTable, Table
from astropy.time import Time
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.good_input import (
    ALTAZ_RECORDING,
    ALTAZ_SCENE,
    ECSV,
    ECSV_VECTORS,
    RECORDING,
    SCENE,
    STATION,
    VECTOR_RECORDING,
    VECTOR_SCENE,
)
from torchlc.errors import InputError
from torchlc.readers import load_recording
from torchlc.readers.groups import repeats
from torchlc.readers.table import MAX_ROWS
from torchlc.scene import Scene, load_scene

SHARED = Path(__file__).parents[2] / "shared"
AU_KM = 149597870.7
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is not there")


def real_pairs() -> list[tuple[Path, Path]]:
    pairs = [(path, path.with_name("recording.ecsv")) for path in sorted(SHARED.glob("*/*/scene.toml"))]
    pairs += [(path, path.with_name("recording.ecsv")) for path in sorted(SHARED.glob("data/*/scene.toml"))]
    tracks = sorted(SHARED.glob("data/mmt9/scene_*.toml"))
    return pairs + [(path, path.with_name(path.stem.replace("scene", "track") + ".ecsv")) for path in tracks]


@needs_shared
@pytest.mark.parametrize("scene_path, path", real_pairs(), ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_real_recordings_hold_what_astropy_reads(scene_path: Path, path: Path):
    recording = load_recording(path, load_scene(scene_path), min_rows=2)
    table = Table.read(path, format="ascii.ecsv")
    unique = list(dict.fromkeys(map(tuple, table)))
    assert len(recording) + recording.dropped.get("duplicate", 0) == len(table)
    assert len(recording) == len(unique)
    table = Table(rows=unique, names=table.colnames, units=[column.unit for column in table.columns.values()])
    scale = "tdb" if recording.light_time_corrected else "utc"
    times = Time(list(table["time"]), format="jd" if scale == "tdb" else "isot", scale=scale)
    order = np.argsort(times.jd1 + times.jd2, kind="stable")
    times, table = times[order], table[order]
    assert abs((recording.time - times).to_value(u.s)).max() < 1e-6
    np.testing.assert_allclose(
        recording.seconds, (times - times[0]).to_value(u.s), atol=5e-5
    )  # JD resolves 40 us
    np.testing.assert_array_equal(recording.observed, table[recording.kind])
    if "mag_err" in table.colnames:
        assert recording.error is not None and recording.error_source == "recording"
        np.testing.assert_array_equal(recording.error, table["mag_err"])
    else:
        assert recording.error is None and recording.error_source == "fitted"
    if "sun_x" in table.colnames:
        assert recording.sun is not None and recording.obs is not None
        for prefix, vector in (("sun", recording.sun), ("obs", recording.obs)):
            expected = np.stack([table[f"{prefix}_{axis}"].quantity.to_value("km") for axis in "xyz"], -1)
            np.testing.assert_allclose(vector, expected, rtol=1e-14)
    if "curve" in table.colnames:
        assert [recording.curve_ids[code] for code in recording.curve] == [
            str(name) for name in table["curve"]
        ]


@needs_shared
def test_what_is_known_of_the_real_recordings():
    eros = load_recording(SHARED / "data/eros/recording.ecsv", load_scene(SHARED / "data/eros/scene.toml"))
    assert (len(eros.curve_ids), len(eros) + eros.dropped["duplicate"]) == (73, 5430)
    assert (eros.frame, eros.light_time_corrected, eros.time.scale, eros.kind) == (
        "ecliptic",
        True,
        "tdb",
        "flux",
    )
    starlink = load_recording(
        SHARED / "data/starlink_v15/recording.ecsv", load_scene(SHARED / "data/starlink_v15/scene.toml")
    )
    assert (len(starlink), len(starlink.night_ids)) == (720, 55)  # as its README says


class TestTimes:
    def seconds(self, read, *times: str) -> np.ndarray:
        return read("time,mag\n" + "".join(f"{time},1\n" for time in times)).seconds

    def test_leap_second_counts(self, read):
        seconds = self.seconds(read, "2016-12-31T23:59:59", "2016-12-31T23:59:60.25", "2017-01-01T00:00:01")
        np.testing.assert_allclose(seconds, [0, 1.25, 3], atol=1e-6)

    def test_no_leap_second_in_tdb(self, read):
        rows = "2016-12-31T23:59:59 1 1\n2017-01-01T00:00:01 1 1\n"
        header = ECSV.replace("time_scale: utc", "time_scale: tdb")
        recording = read(header[: header.index("2020-10")] + rows)
        assert recording.time.scale == "tdb"
        np.testing.assert_allclose(recording.seconds, [0, 2], atol=1e-6)

    @given(
        moment=st.datetimes(datetime.datetime(1975, 1, 1), datetime.datetime(2025, 1, 1)),
        minutes=st.integers(-12 * 60, 14 * 60),
        separator=st.sampled_from("T "),
        colon=st.booleans(),
    )
    @settings(
        deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
    )
    def test_offsets_are_converted(self, read, moment, minutes: int, separator: str, colon: bool):
        """Against the standard library."""
        zone = datetime.timezone(datetime.timedelta(minutes=minutes))
        local = moment.replace(tzinfo=zone)
        text = local.isoformat(separator)
        text = text if colon else text[:-3] + text[-2:]
        recording = read(f"time,mag\n{text},1\n")
        expected = local.astimezone(datetime.UTC).replace(tzinfo=None)
        assert abs((recording.time[0] - Time(expected, scale="utc")).to_value(u.s)) < 1e-5

    @pytest.mark.parametrize(
        "text", ["2020-10-17 15:00", "2020-10-17T15:00:00Z", "2020-10-17T15:00:00 UTC", "2459140.125"]
    )
    def test_forms_of_one_instant(self, read, text: str):
        recording = read(f"time,mag\n{text},1\n")
        assert abs((recording.time[0] - Time("2020-10-17T15:00:00")).to_value(u.s)) < 1e-4

    def test_years_ahead_of_the_leap_second_table_raise_no_warning(self, read):
        np.testing.assert_allclose(
            self.seconds(read, "2049-10-17T15:00:00", "2049-10-17T16:00:00"), [0, 3600]
        )

    def test_modified_julian_date(self, read):
        header = ECSV.replace("datatype: string", "unit: d, datatype: float64").replace(
            "time_scale: utc", "time_format: mjd"
        )
        recording = read(header[: header.index("2020-10")] + "59139.625 1 1\n")
        assert abs((recording.time[0] - Time("2020-10-17T15:00:00")).to_value(u.s)) < 1e-4

    def test_the_bad_row_among_many_is_named(self, read):
        rows = [f"2020-10-17T15:{index // 60:02d}:{index % 60:02d},1" for index in range(3000)]
        rows[1717] = "2020-10-17T15:28:99,1"
        with pytest.raises(InputError, match="row 1718, column time: '2020-10-17T15:28:99'"):
            read("time,mag\n" + "\n".join(rows))


class TestAstropyFiles:
    """Tables that astropy itself writes."""

    def write(self, table: Table, tmp_path: Path) -> Path:
        table.write(tmp_path / "r.ecsv", format="ascii.ecsv")
        return tmp_path / "r.ecsv"

    def test_time_and_quantity_columns(self, tmp_path: Path):
        times = Time(["2020-10-17T15:00:00", "2020-10-17T15:00:01"], scale="tdb")
        table = QTable(
            {"time": times, "mag": [12, 13] * u.mag, "mag_err": [20, 30] * u.mmag, "exptime": [1, 2] * u.min}
        )
        recording = load_recording(self.write(table, tmp_path))
        assert recording.time.scale == "tdb"
        np.testing.assert_allclose(recording.seconds, [0, 1], atol=1e-6)
        np.testing.assert_allclose(recording.error, [0.02, 0.03])
        np.testing.assert_allclose(recording.exptime, [60, 120])

    def test_julian_date_columns(self, tmp_path: Path):
        times = Time([2459140.125, 2459140.25], format="jd", scale="utc")
        recording = load_recording(self.write(QTable({"time": times, "flux": [1.0, 2.0]}), tmp_path))
        np.testing.assert_allclose(recording.seconds, [0, 10800], atol=1e-4)

    def test_masked_values(self, tmp_path: Path):
        table = Table({"time": [f"2020-10-17T15:00:0{index}" for index in range(4)]})
        table["flux"] = MaskedColumn([1.0, 2.0, 3.0, 4.0], mask=[False, True, False, False])
        table["flux_err"] = MaskedColumn([0.1, 0.1, 0.1, 0.1], mask=[False, False, True, False])
        table["band"] = ["V", "a b", 'quoted "R"', "V"]
        recording = load_recording(self.write(table, tmp_path))
        assert recording.dropped == {"non-finite": 2}
        np.testing.assert_array_equal(recording.observed, [1.0, 4.0])

    def test_flux_errors_in_another_unit(self, tmp_path: Path):
        table = QTable({"time": ["2020-10-17T15:00:00"], "flux": [1.0] * u.Jy, "flux_err": [5.0] * u.mJy})
        assert load_recording(self.write(table, tmp_path)).error == pytest.approx([0.005])

    def test_simulated_curve(self, tmp_path: Path):
        """The columns of simulate's curve.ecsv, names with blanks included."""
        times = ["2020-10-17T15:00:00.000", "2020-10-17T15:10:00.000"]
        table = Table(
            {"time": times, "station": ["weihai"] * 2, "mag": [12.5, 12.4], "flux": [1e-16, 1.1e-16]}
        )
        table["airmass"] = MaskedColumn([1.4, 1.5], mask=True)
        table["share panel +Y"] = [0.4, 0.5]
        path = self.write(table, tmp_path)
        scene = Scene.from_toml(SCENE)
        recording = load_recording(path, scene)
        assert (recording.kind, recording.error_source, recording.station_ids) == (
            "mag",
            "fitted",
            ("weihai",),
        )
        assert load_recording(path, scene, use="flux").observed == pytest.approx([1e-16, 1.1e-16])


class TestRows:
    def test_rows_are_sorted_with_all_their_columns(self, read):
        lines = RECORDING.strip().split("\n")
        shuffled = read("\n".join([lines[0], lines[3], lines[1], lines[5], lines[2], lines[4]]))
        assert shuffled.warnings == ("the rows were not in order of time and have been sorted",)
        np.testing.assert_array_equal(shuffled.observed, read(RECORDING).observed)
        np.testing.assert_array_equal(shuffled.seconds, read(RECORDING).seconds)

    def test_equal_times_with_other_values_are_distinct(self, read):
        recording = read("time,mag\n" + "2020-10-17T15:00:00,1\n2020-10-17T15:00:00,2\n" * 2)
        np.testing.assert_array_equal(recording.observed, [1, 2])
        assert recording.dropped == {"duplicate": 2}

    @given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 1), st.integers(0, 1)), max_size=12))
    def test_repeats_against_a_set(self, rows: list[tuple[int, int, int]]):
        rows = sorted(rows, key=lambda row: row[0])
        table = np.array(rows, dtype=float).reshape(-1, 3)
        columns = {
            "time": np.stack([np.full(len(rows), 2459140.0), table[:, 0]], -1),
            "a": table[:, 1],
            "b": table[:, 2],
        }
        expected = [row in rows[:index] for index, row in enumerate(rows)]
        np.testing.assert_array_equal(repeats(columns), expected)

    def test_keep_counts_what_it_drops(self, read):
        recording = read(
            RECORDING.replace("mag_err", "mag_err,curve")
            .replace("0.02\n", "0.02,a\n", 2)
            .replace("0.02\n", "0.02,b\n")
        )
        assert recording.curve_ids == ("a", "b")
        kept = recording.keep(recording.seconds > 1199, "below the horizon")
        assert kept.dropped == {"below the horizon": 2} and not recording.dropped
        assert kept.curve_ids == ("b",) and set(kept.curve) == {0}
        np.testing.assert_allclose(kept.seconds, [0, 600, 1200])
        assert kept.first_time == recording.time[0]
        assert kept.keep(np.ones(3, dtype=bool), "no reason") is kept
        with pytest.raises(InputError, match=r"no usable row \(2 below the horizon, 3 eclipsed\)"):
            kept.keep(np.zeros(3, dtype=bool), "eclipsed")

    def test_upper_limits_may_lack_an_error(self, read):
        recording = read(
            "time,mag,mag_err,upper_limit\n2020-10-17T15:00:00,12,0.1,false\n2020-10-17T15:01:00,12,0.3,False\n"
            "2020-10-17T15:02:00,16,,true\n2020-10-17T15:03:00,12,,false\n"
        )
        np.testing.assert_array_equal(recording.upper_limit, [False, False, True])
        np.testing.assert_allclose(recording.error, [0.1, 0.3, 0.2])
        assert recording.dropped == {"non-finite": 1}

    def test_a_blank_optional_column_is_absent(self, read):
        recording = read("time,mag,exptime\n2020-10-17T15:00:00,12,\n2020-10-17T15:01:00,12,\n")
        assert recording.exptime is None and recording.warnings == ("no number in exptime, taken as absent",)

    def test_more_than_the_most_rows(self, tmp_path: Path):
        path = tmp_path / "long.csv"
        path.write_bytes(b"time,mag\n" + b"2459140.5,12\n" * (MAX_ROWS + 1))
        with pytest.raises(InputError, match="more than 5,000,000 rows"):
            load_recording(path)


class TestText:
    """What editors and spreadsheets do to a table."""

    @pytest.mark.parametrize("content", [
        RECORDING.replace("\n", "\r\n"),
        RECORDING.replace("\n", "\r"),
        "\ufeff" + RECORDING,
        "# a comment\n\n" + RECORDING + "\n# the end\n\n",
        RECORDING.replace(",", ";"),
        RECORDING.replace(",", "\t"),
        RECORDING.replace(",", " , ").replace(" , ", " ,"),
        '"' + RECORDING.replace(",", '","').strip().replace("\n", '"\n"') + '"',
        RECORDING.strip(),
    ])  # fmt: skip
    def test_same_recording(self, read, content: str):
        recording, expected = read(content), read(RECORDING)
        np.testing.assert_array_equal(recording.observed, expected.observed)
        np.testing.assert_array_equal(recording.seconds, expected.seconds)
        np.testing.assert_array_equal(recording.error, expected.error)


class TestGroups:
    def test_curves_without_a_column_are_stations_and_bands(self, read):
        scene = SCENE.replace("[attitude]", STATION.replace("weihai", "karoo") + "[attitude]")
        rows = ["weihai,V", "karoo,V", "weihai,R", "karoo,V"]
        lines = [f"2020-10-17T15:0{index}:00,12,{row}" for index, row in enumerate(rows)]
        recording = read("time,mag,station,band\n" + "\n".join(lines), scene)
        assert [recording.curve_ids[code] for code in recording.curve] == [
            "weihai V",
            "karoo V",
            "weihai R",
            "karoo V",
        ]
        assert list(recording.station) == [0, 1, 0, 1]
        assert recording.band is not None and list(recording.band) == ["V", "V", "R", "V"]
        assert recording.night_ids == ("weihai 2020-10-17", "karoo 2020-10-17")

    @pytest.mark.parametrize(
        "time, evening",
        [
            ("2020-10-17T03:51:00", "2020-10-16"),  # local mean noon of 122.05 E is 03:51:48 UTC
            ("2020-10-17T03:53:00", "2020-10-17"),
            ("2020-10-17T20:00:00", "2020-10-17"),  # early morning of the 18th there
        ],
    )
    def test_a_night_runs_from_local_noon_to_noon(self, read, time: str, evening: str):
        assert read(f"time,mag\n{time},12\n", SCENE).night_ids == (evening,)

    def test_nights_without_a_station_end_at_gaps(self, read):
        times = ["2020-10-17T15:00:00", "2020-10-17T20:59:59", "2020-10-18T03:00:00", "2020-10-18T03:01:00"]
        recording = read("time,mag\n" + "".join(f"{time},12\n" for time in times))
        assert list(recording.night) == [0, 0, 1, 1]
        assert recording.night_ids == ("2020-10-17T15:00", "2020-10-18T03:00")


class TestGeometry:
    def test_vectors_without_unit_are_km(self, read):
        recording = read(VECTOR_RECORDING, VECTOR_SCENE)
        assert recording.sun is not None and recording.velocity is not None and recording.position is not None
        np.testing.assert_array_equal(recording.sun[0], [1.3e8, -6e7, -2e7])
        np.testing.assert_array_equal(recording.velocity[1], [-0.13, 3.07, 0])
        assert recording.frame == "icrs"

    def test_vectors_in_au(self, read):
        recording = read(ECSV_VECTORS.replace("ecliptic J2000", "icrs"))
        assert recording.sun == pytest.approx(np.array([[AU_KM, 0, 0]]))

    def test_only_what_the_scene_uses_is_read(self, read):
        broken = VECTOR_RECORDING.replace("-36000", "none")
        assert len(read(broken, SCENE)) == 2
        recording = read(VECTOR_RECORDING, SCENE)
        assert recording.sun is None and recording.frame is None

    def test_altaz(self, read):
        recording = read(ALTAZ_RECORDING, ALTAZ_SCENE)
        assert recording.alt is not None and recording.az is not None and recording.height is not None
        assert (recording.alt[2], recording.az[2], recording.height[2]) == (39, 59, 550)

    def test_below_the_horizon_of_altaz_rows(self, read):
        recording = read(ALTAZ_RECORDING.replace("35.0", "-0.1"), ALTAZ_SCENE)
        assert len(recording) == 2 and recording.dropped == {"below the horizon": 1}


class TestNumbers:
    @pytest.mark.parametrize(
        "text",
        [
            "1_2.5",
            "\uff11\uff12.5",
            "\u0663",
            "0x1F",
            "1d1",
            "nan(7)",
            "\u22121.5",
            "1e",
            "1 2",
            "<18.5",
            "12,5",
        ],
    )
    @pytest.mark.parametrize("column", ["time", "mag", "mag_err", "exptime"])
    def test_only_plain_digits(self, read, text: str, column: str):
        cells = {"time": "2459140.5", "mag": "12", "mag_err": "0.1", "exptime": "1"} | {column: f'"{text}"'}
        good = "2459140.4,12,0.1,1\n"
        with pytest.raises(InputError, match=f"row 2, column {column}: "):
            read("time,mag,mag_err,exptime\n" + good + ",".join(cells.values()) + "\n")

    @pytest.mark.parametrize(
        "text, expected",
        [("+12.5", 12.5), (" 12.5 ", 12.5), ("\u00a012.5", 12.5), ("1.25E+1", 12.5), (".5", 0.5)],
    )
    def test_forms_of_a_number(self, read, text: str, expected: float):
        assert read(f"time,mag\n2459140.5,{text}\n").observed[0] == expected

    @pytest.mark.parametrize("rows, dropped", [
        (["99.0,0.1"], 1), (["99.999,0"], 1), (["-99.9,-1"], 1), (["12,99.9"], 1), (["12,1e7"], 1), (["999,999", "88,0.1"], 1),
    ])  # fmt: skip
    def test_markers_of_missing_values_are_dropped(self, read, rows: list[str], dropped: int):
        lines = [f"2459140.{k},{row}" for k, row in enumerate(["12,0.1", *rows])]
        recording = read("time,mag,mag_err\n" + "\n".join(lines))
        assert recording.dropped == {"beyond 90 mag": dropped} and len(recording) == len(lines) - dropped

    def test_the_error_of_a_limit_may_be_a_marker(self, read):
        recording = read("time,mag,mag_err,upper_limit\n2459140.5,12,0.1,false\n2459140.6,16,99.9,true\n")
        assert recording.error is not None and list(recording.error) == [0.1, 0.1]

    @pytest.mark.parametrize("error", ["1e-300", "1e-13", "0", "-0.1"])
    def test_an_error_that_is_none_is_refused(self, read, error: str):
        with pytest.raises(InputError, match=r"row 2, column mag_err: .*expected > 0: 1e-12 to 90 mag"):
            read(f"time,mag,mag_err\n2459140.4,12,0.1\n2459140.5,12,{error}\n")

    def test_an_error_whose_weight_is_infinite_is_refused(self, read):
        """Beside a flux as small, for which 1 % is no small error: 1 / error^2 has no number."""
        with pytest.raises(
            InputError, match=r"row 1, column flux_err: 1e-300; expected > 0: 1e-60 to 1e\+30"
        ):
            read("time,flux,flux_err\n2459140.4,1e-298,1e-300\n2459140.5,2e-298,1e-300\n")

    @pytest.mark.parametrize("scale", [1.0, 1e-16, 1e6])
    def test_errors_of_a_flux_are_measured_by_it(self, read, scale: float):
        text = "time,flux,flux_err\n2459140.4,{0},{1}\n2459140.5,{0},{2}\n"
        recording = read(text.format(scale, 0.1 * scale, 1e-9 * scale))
        assert recording.error == pytest.approx([0.1 * scale, 1e-9 * scale])
        for error in (1e-14 * scale, 1e14 * scale):
            with pytest.raises(InputError, match="row 2, column flux_err"):
                read(text.format(scale, 0.1 * scale, error))


class TestEncodings:
    def test_latin_1_is_read_and_said(self, read):
        text = "# f\u00fcr\ntime,mag,band\n2459140.5,12,gr\u00fcn\n"
        recording = read(text.encode("latin-1"))
        assert recording.band is not None and list(recording.band) == ["gr\u00fcn"]
        assert "not UTF-8 text" in recording.warnings[0]
        assert not read(text).warnings


pieces = st.binary(max_size=4) | st.sampled_from(
    [b"\n", b"\r", b'"', b",", b" ", b"#", b"nan", b"-1e999", b"\xef\xbb\xbf", b"\x00", b": {"]
)
