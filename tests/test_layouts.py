"""Recordings in the layouts of others, and recordings as time series: the same numbers, whichever way they came."""

from __future__ import annotations

import math
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Table
from astropy.time import Time

from tests.good_input import SCENE
from torchlc.errors import InputError
from torchlc.readers import Recording, load_recording
from torchlc.scene import Scene, load_scene

SHARED = Path(__file__).parents[2] / "shared" / "data"
MMT = """\
# satellite: 12345 SOMETHING 1 / XX
# catalogue: 1 NORAD
# track: 777
# npoints: 3
#
# Date Time StdMag Mag Filter Penumbra Distance Phase Channel
2021-01-02 15:29:22.895000 6.809 5.18095 Clear 0.0 609.517 48.039 5
2021-01-02 15:29:22.995000 6.793 5.16497 Clear 0.0 609.823 47.983 5
2021-01-02 15:29:22.995000 6.700 5.20000 Clear 0.0 609.823 47.983 6
"""
ALCDEF = """\
# a session that is calibrated, one reduced by a known amount
STARTMETADATA
OBJECTNUMBER=433
OBJECTNAME=Eros
SESSIONDATE=2011-09-13
FILTER=C
MAGBAND=V
DIFFERMAGS=FALSE
LTCAPP=NONE
REDUCEDMAGS=NONE
DELIMITER=PIPE
ENDMETADATA
DATA=2455817.735937|+7.328|+0.004|2.224
DATA=2455817.736235|+7.331|+0.005|2.220   # a remark
ENDDATA
STARTMETADATA
OBJECTNAME=Eros
SESSIONDATE=2011-09-14
FILTER=R
REDUCEDMAGS=AVERAGE
UCORMAG=-1.500
DELIMITER=TAB
ENDMETADATA
DATA=2455818.735937\t+5.828\t+0.004
ENDDATA
"""
SIMPLE = """\
STARTBLOCK
STARTDATA
2457210.698517|+18.377|+0.121
2457210.700769|+18.489|+0.136
ENDDATA
ENDBLOCK
"""
DAMIT = """\
2
2 0
2441533.847920805  0.9490716   -1.43005756 0.99141282 -0.11769266   -0.74564757 0.24255588 -0.11774641
2441533.852378805  0.9172741   -1.43008148 0.99136742 -0.11770136   -0.74561614 0.24256193 -0.1177551

1 1
2441534.0          0.25        2.0 0.0 0.0                          0.0 3.0 0.0
"""


@pytest.fixture
def read(tmp_path: Path):
    def load(text: str, scene: Scene | None = None) -> Recording:
        (tmp_path / "recording.txt").write_text(text)
        return load_recording(tmp_path / "recording.txt", scene)

    return load


def jd(recording: Recording) -> np.ndarray:
    return np.asarray(recording.time.jd)


class TestMiniMegaTortora:
    def test_a_track(self, read):
        recording = read(MMT, Scene.from_toml(SCENE))
        assert recording.kind == "mag" and recording.error_source == "fitted"
        np.testing.assert_array_equal(recording.observed, [5.18095, 5.16497, 5.2])
        np.testing.assert_allclose(recording.seconds, [0, 0.1, 0.1], atol=1e-9)
        assert [recording.curve_ids[one] for one in recording.curve] == [
            "channel 5",
            "channel 5",
            "channel 6",
        ]
        assert recording.band is not None and set(recording.band) == {"clear"}
        assert recording.time.isot[0] == "2021-01-02T15:29:22.895"

    def test_all_tracks_of_a_satellite(self, read):
        lines = MMT.replace("Channel", "Channel Track").splitlines()
        text = "\n".join([*lines[:6], lines[6] + " 777", lines[7] + " 778", lines[8] + " 778"])
        assert read(text).curve_ids == ("track 777 channel 5", "track 778 channel 5", "track 778 channel 6")

    def test_a_row_too_short_is_named(self, read):
        with pytest.raises(InputError, match="line 8: 8 values; expected 9"):
            read(MMT.replace("Clear 0.0 609.823 47.983 5", "0.0 609.823 47.983 5"))

    @pytest.mark.skipif(not (SHARED / "mmt9").is_dir(), reason="needs ../shared/data/mmt9")
    @pytest.mark.parametrize("track", ["18904424", "18942920"])
    def test_a_published_table_holds_what_its_conversion_holds(self, track: str):
        found = load_recording(SHARED / "mmt9" / f"track_{track}.csv")
        scene = load_scene(SHARED / "mmt9" / f"scene_{track}.toml")
        expected = load_recording(SHARED / "mmt9" / f"track_{track}.ecsv", scene)
        np.testing.assert_array_equal(found.observed, expected.observed)
        np.testing.assert_allclose(found.seconds, expected.seconds, atol=1e-6)
        np.testing.assert_array_equal(found.curve, expected.curve)


class TestAlcdef:
    def test_apparent_magnitudes_of_every_session(self, read):
        """UCORMAG is what was added to reduce a magnitude to unit distances."""
        recording = read(ALCDEF)
        np.testing.assert_allclose(recording.observed, [7.328, 7.331, 7.328], atol=1e-12)
        assert recording.error is not None
        np.testing.assert_array_equal(recording.error, [0.004, 0.005, 0.004])
        np.testing.assert_allclose(jd(recording), [2455817.735937, 2455817.736235, 2455818.735937], atol=1e-9)
        assert recording.time.scale == "utc" and not recording.light_time_corrected
        assert recording.curve_ids == ("1 2011-09-13", "2 2011-09-14")
        assert recording.band is not None and list(recording.band) == ["V", "V", "R"]
        assert recording.meta["object"] == "Eros"

    @pytest.mark.parametrize("change", [("DIFFERMAGS=FALSE", "DIFFERMAGS=TRUE"), ("=AVERAGE", "=POINT")])
    def test_differential_magnitudes_are_relative_flux(self, read, change: tuple[str, str]):
        recording = read(ALCDEF.replace(*change))
        assert recording.kind == "flux" and recording.error is not None
        ratio = recording.observed[1] / recording.observed[0]
        assert -2.5 * math.log10(ratio) == pytest.approx(0.003, abs=1e-12)
        relative = recording.error[1] / recording.observed[1]
        assert relative == pytest.approx(0.005 * math.log(10) / 2.5, rel=1e-12)

    @pytest.mark.parametrize(
        ("said", "added"),
        [
            ("REDUCEDMAGS=NONE\nUCORMAG=-1.8\n", 0.0),
            ("UCORMAG=-1.8\n", 0.0),
            ("REDUCEDMAGS=\nUCORMAG=\n", 0.0),
            ("REDUCEDMAGS=AVERAGE\nUCORMAG=-1.8\n", 1.8),
            ("reducedmags=average\nucormag=+0.4\n", -0.4),
            ("MAGADJUST=0.5\n", 0.5),
            ("MAGADJUST=\n", 0.0),
            ("MAGADJUST=-0.25\nREDUCEDMAGS=AVERAGE\nUCORMAG=-1\n", 0.75),
        ],
    )
    def test_what_is_added_to_a_magnitude(self, read, said: str, added: float):
        """The standard: MAGADJUST is the value to add; UCORMAG was added if REDUCEDMAGS says so, else it only
        tells what would be. A keyword without a value is absent.
        """
        recording = read(ALCDEF.replace("REDUCEDMAGS=NONE\n", said))
        np.testing.assert_allclose(recording.observed, [7.328 + added, 7.331 + added, 7.328], atol=1e-12)
        assert (f"{added:+g} mag are added" in " ".join(recording.warnings)) == (added != 0)

    @pytest.mark.parametrize(
        "said", ["AVERAGE\nUCORMAG=", "AVERAGE\nUCORMAG=0.00", "AVERAGE", "POINT\nUCORMAG=-1"]
    )
    def test_reduced_by_an_amount_that_is_not_told(self, read, said: str):
        recording = read(ALCDEF.replace("REDUCEDMAGS=NONE", f"REDUCEDMAGS={said}"))
        assert recording.kind == "flux"
        assert -2.5 * math.log10(recording.observed[1] / recording.observed[0]) == pytest.approx(0.003)
        assert "reduced to unit distances by amounts that it does not tell" in " ".join(recording.warnings)

    @pytest.mark.parametrize(("mark", "moved_s"), [("START", 30.0), ("END", -30.0), ("MID", 0.0), ("", 0.0)])
    def test_dates_of_the_start_or_end_of_exposures(self, read, mark: str, moved_s: float):
        recording = read(ALCDEF.replace("FILTER=C", f"FILTER=C\nEXPOSURE=60\nEXPJD={mark}"))
        assert (jd(recording)[0] - 2455817.735937) * 86400 == pytest.approx(moved_s, abs=1e-4)  # JD: 40 us

    @pytest.mark.parametrize("name", ["COMMA", "SEMICOLON", "SPACE", "TAB", "PIPE"])
    def test_delimiters(self, read, name: str):
        mark = {"COMMA": ",", "SEMICOLON": ";", "SPACE": " ", "TAB": "\t", "PIPE": "|"}[name]
        text = ALCDEF.replace("DELIMITER=PIPE", f"DELIMITER={name}").replace("|", mark)
        np.testing.assert_allclose(read(text).observed, [7.328, 7.331, 7.328], atol=1e-12)

    @pytest.mark.parametrize("differential", [False, True])
    @pytest.mark.parametrize("marker", ["99.0", "-99.9", "nan"])
    def test_a_marker_of_a_missing_value_loses_its_row_only(self, read, marker: str, differential: bool):
        text = ALCDEF.replace("+7.328", marker)
        recording = read(text.replace("DIFFERMAGS=FALSE", "DIFFERMAGS=TRUE") if differential else text)
        assert len(recording) == 2 and sum(recording.dropped.values()) == 1

    def test_latin_1(self, tmp_path: Path):
        path = tmp_path / "a.txt"
        path.write_bytes(ALCDEF.replace("FILTER=C", "FILTER=C\nCONTACTNAME=P. Mu\u00f1oz").encode("latin-1"))
        np.testing.assert_allclose(load_recording(path).observed, [7.328, 7.331, 7.328], atol=1e-12)

    def test_simple(self, read):
        recording = read(SIMPLE)
        np.testing.assert_array_equal(recording.observed, [18.377, 18.489])
        assert recording.curve_ids == ("1",)

    def test_light_time(self, read):
        """LTCAPP tells whether it was applied, LTCTYPE only where LTCAPP is silent."""
        silent = ALCDEF.replace("LTCAPP=NONE\n", "").replace("REDUCEDMAGS", "LTCTYPE=POINT\nREDUCEDMAGS")
        assert read(silent).light_time_corrected
        denied = read(ALCDEF.replace("LTCAPP=NONE", "LTCAPP=NONE\nLTCTYPE=POINT\nLTCDAYS=-0.01"))
        assert not denied.light_time_corrected
        assert any("whatever LTCTYPE says" in warning for warning in denied.warnings)
        with pytest.raises(InputError, match="with and without light-time correction"):
            read(ALCDEF.replace("LTCAPP=NONE", "LTCAPP=AVERAGE"))

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (("+7.331", "bright"), "line 14: 'bright'; expected a number"),
            (("2455817.736235|+7.331|+0.005|2.220", "2455817.736235"), "line 14: .* expected a Julian date"),
            (("OBJECTNAME=Eros\nSESSIONDATE=2011-09-14", "OBJECTNAME=Ida"), "2 objects"),
            (("OBJECTNUMBER=433", "OBJECTNUMBER"), "expected KEYWORD=value"),
            (("+0.004|2.224", "0|2.224"), "row 1, column mag_err: 0; expected > 0"),
            (("+7.331", "7_3.31"), "line 14: '7_3.31'; expected a number. Leave out the underscores"),
            (("REDUCEDMAGS=NONE", "MAGADJUST=some"), "line 10, MAGADJUST: 'some'"),
            (("FILTER=C", "EXPJD=START"), "line 6, EXPJD: START, and no EXPOSURE"),
            (("FILTER=C", "EXPJD=WHEN"), "line 6, EXPJD: 'WHEN'"),
            (("DELIMITER=PIPE", "DELIMITER=BAR"), "DELIMITER: 'BAR'"),
            (("ENDMETADATA\n", ""), "line 12: DATA outside a session's data"),
            (("ENDDATA\n", ""), "inside the data of a session; expected ENDDATA"),
            (("FILTER=C", "MAGADJUST=0.5\nmagadjust = 0.7\nFILTER=C"), "MAGADJUST again, 0.5 in line "),
            (
                (
                    "OBJECTNUMBER=433",
                    "OBJECTNUMBER=433\nENDBLOCK\nSTARTMETADATA\nOBJECTNAME=Ida\nENDMETADATA\nENDDATA\nSTARTMETADATA",
                ),
                "2 objects",
            ),
        ],
    )
    def test_damage_is_named(self, read, change: tuple[str, str], message: str):
        with pytest.raises(InputError, match=message):
            read(ALCDEF.replace(*change, 1))


class TestDamit:
    def test_vectors_times_and_gains(self, read):
        """The calibrated curve, reduced to 1 au from Sun and Earth, is put back to 2 and 3 au: over 36."""
        recording = read(DAMIT)
        assert recording.kind == "flux" and recording.light_time_corrected and recording.frame == "ecliptic"
        np.testing.assert_allclose(recording.observed, [0.9490716, 0.9172741, 0.25 / 36], rtol=1e-15)
        assert recording.curve_ids == ("001", "calibrated")
        assert recording.sun is not None and recording.obs is not None
        expected = np.array([-1.43005756, 0.99141282, -0.11769266]) * u.au.to(u.km)
        np.testing.assert_allclose(recording.sun[0], expected, rtol=1e-14)
        np.testing.assert_allclose(recording.obs[2], [0, 3 * u.au.to(u.km), 0], rtol=1e-14)
        assert recording.time.scale == "utc"
        assert read("# time_scale: tdb\n" + DAMIT).time.scale == "tdb"

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (("2 0\n", "3 0\n"), "line 6: 2 values"),
            (("1 1\n", "1 2\n"), "points and 0 or 1 of curve 2"),
            (("2\n2 0", "3\n2 0"), "points and 0 or 1 of curve 3"),
            (("0.9490716", "x"), "row 1, column flux: 'x'"),
            (("0.9490716", "0.94_9"), "Leave out the underscores"),
            (("2 0\n", "1 0\n"), "line 4: '2441533.852378805"),
            (("2\n2 0", "1\n2 0"), "line 6: '1 1' after the last point that the file announces"),
        ],
    )
    def test_damage_is_named(self, read, change: tuple[str, str], message: str):
        with pytest.raises(InputError, match=message):
            read(DAMIT.replace(*change, 1))

    @pytest.mark.skipif(not (SHARED / "eros").is_dir(), reason="needs ../shared/data/eros")
    def test_eros_written_out_and_read_again(self, read):
        table = Table.read(SHARED / "eros" / "recording.ecsv", format="ascii.ecsv")
        lines = ["# time_scale: tdb", str(len(set(table["curve"])))]
        for curve in table.group_by("curve").groups:
            lines.append(f"{len(curve)} 0")
            lines += [" ".join(str(cell) for name, cell in zip(curve.colnames, row, strict=True) if name != "curve")
                      for row in curve.iterrows()]  # fmt: skip
        scene = load_scene(SHARED / "eros" / "scene.toml")
        expected = load_recording(SHARED / "eros" / "recording.ecsv", scene)
        found = read("\n".join(lines), scene)
        assert len(found) == len(expected) and len(found.curve_ids) == len(expected.curve_ids)
        assert sorted(found.observed) == sorted(expected.observed)
        np.testing.assert_array_equal(found.seconds, expected.seconds)


CSV = """\
time,mag,mag_err,exptime,band,curve,upper_limit
2016-12-31T23:59:58.25,12.5,0.02,1.5,V,a,false
2016-12-31T23:59:60.75,12.3,0.03,1.5,V,a,true
2017-01-01T00:00:00.123456789,12.1,0.02,1.5,R,b,false
"""
FIELDS = ("observed", "error", "station", "curve", "night", "upper_limit", "exptime", "sun", "obs", "position", "velocity", "alt", "az", "height")  # fmt: skip


def same(found: Recording, expected: Recording) -> None:
    for name in FIELDS:
        one, other = getattr(found, name), getattr(expected, name)
        assert (one is None) == (other is None), name
        if one is not None:
            np.testing.assert_array_equal(one, other, err_msg=name)
    for name in ("kind", "station_ids", "curve_ids", "night_ids", "frame", "light_time_corrected"):
        assert getattr(found, name) == getattr(expected, name), name
    np.testing.assert_allclose(found.seconds, expected.seconds, atol=2e-9)  # written to the nanosecond
    assert abs((found.time - expected.time).to_value(u.s)).max() < 2e-9


def test_a_recording_and_a_scene_tell_what_they_are(read):
    told = repr(recording := read(CSV))
    assert told.startswith(
        "Recording: 3 rows of mag, 2016-12-31T23:59:58 to 2017-01-01T00:00:00 UTC, 2 curves"
    )
    assert "errors of 0.02" in told and "errors to be fitted" in repr(read(MMT))
    scene = Scene.from_toml(SCENE.replace("box-wing", "<b>box</b>"))
    assert "free        panel.n, panel.r_spec, panel.r_diff, zero_point" in repr(scene)
    assert "&lt;b&gt;box&lt;/b&gt;" in scene._repr_html_() and "<pre>" in recording._repr_html_()


class TestTimeSeries:
    @pytest.mark.parametrize("text", [CSV, MMT, ALCDEF, DAMIT, "# time_scale: tdb\n" + DAMIT])
    def test_there_and_back(self, read, text: str):
        recording = read(text)
        same(Recording.from_timeseries(recording.to_timeseries()), recording)

    def test_astropy_finds_the_same_times_and_units(self, read):
        series = read(CSV).to_timeseries()
        assert series["mag"].unit == u.mag and series["exptime"].unit == u.s
        steps = np.diff(series.time.tai.unix_tai)  # a leap second lies between the first two rows
        np.testing.assert_allclose(steps, [2.5, 0.373456789], atol=1e-6)

    def test_a_series_in_other_units_and_scales(self):
        from astropy.timeseries import TimeSeries

        time = Time([2459140.5, 2459140.6], format="jd", scale="tai")
        series = TimeSeries(
            time=time, data={"flux": [1.0, 2.0] * u.ct, "exptime": [1, 2] * u.min, "note": ["a", "b"]}
        )
        recording = Recording.from_timeseries(series)
        assert recording.time.scale == "utc" and recording.exptime is not None
        np.testing.assert_array_equal(recording.exptime, [60, 120])
        assert abs((recording.time - time).to_value(u.s)).max() < 1e-6
        assert Recording.from_timeseries(TimeSeries(time=time.tcb, data=series["flux",])).time.scale == "tdb"

    def test_masked_cells_are_blank(self, read):
        series = read(CSV).to_timeseries()
        from astropy.table import MaskedColumn

        series["mag"] = MaskedColumn(series["mag"], mask=[False, True, False])
        assert Recording.from_timeseries(series).dropped == {"non-finite": 1}

    def test_what_is_wrong_is_an_input_error(self, read):
        series = read(CSV).to_timeseries()
        with pytest.raises(InputError, match="TimeSeries: header: no column mag"):
            Recording.from_timeseries(series["time", "exptime"])
        series["mag_err"] = [-1.0, 0.1, 0.1] * u.mag
        with pytest.raises(InputError, match="TimeSeries: row 1, column mag_err: -1"):
            Recording.from_timeseries(series)

    def test_lightkurve(self, read):
        lightkurve = pytest.importorskip("lightkurve", reason="needs lightkurve")
        for text in (CSV, DAMIT):
            recording = read(text)
            curve = recording.to_lightkurve()
            assert isinstance(curve, lightkurve.LightCurve)
            same(Recording.from_timeseries(curve), recording)
        kepler = lightkurve.LightCurve(
            time=Time([120.5, 120.6, 120.7], format="bkjd", scale="tdb"),
            flux=[1.0, 1.1, np.nan] * u.electron / u.s,
            flux_err=[0.1, 0.1, 0.1] * u.electron / u.s,
        )
        recording = Recording.from_timeseries(kepler)
        assert recording.time.scale == "tdb" and recording.dropped == {"non-finite": 1}
        np.testing.assert_allclose(jd(recording), [2454833 + 120.5, 2454833 + 120.6], atol=1e-9)
