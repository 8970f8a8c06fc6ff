"""Predictions: passes against Skyfield, magnitudes against closed forms, files against their standards."""

from __future__ import annotations

import json
import math

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Table
from astropy.time import Time
from scipy.stats import norm
from skyfield.api import EarthSatellite, wgs84

import torchlc
from tests.paper_orbits import HEIGHT, LATITUDE, LONGITUDE, LOW, ORBIT_1
from tests.prediction_case import SPAN, SPHERE, STATION, at, scene
from tests.small_case import write_case
from tests.test_predicted_glints import by_the_equinox
from tests.test_predicted_objects import NIGHT, catalogue
from torchlc.cli import run
from torchlc.errors import InputError


@pytest.fixture(scope="module")
def day():
    """Every pass of a day, by night and by day."""
    return torchlc.predict(scene(), **SPAN, sun=90.0)


def test_passes_begin_culminate_and_end_when_skyfield_says(sky, day):
    """Skyfield finds events within 1 s of its own; its station is 20 m off ours, 3 ms of a low orbit. Edges that are
    those of the span are no events."""
    timescale, _ = sky
    satellite, station = EarthSatellite(*LOW, ts=timescale), wgs84.latlon(LATITUDE, LONGITUDE, HEIGHT)
    times, events = satellite.find_events(station, *at(sky, day, [0.0, 86400.0]), altitude_degrees=10.0)
    start = at(sky, day, [0.0])[0]
    seconds = (times.tt - start.tt) * 86400
    expected = [seconds[events == kind] for kind in (0, 1, 2)]
    paths = sorted((one.path for one in day.passes), key=lambda path: path.begin)
    assert len(paths) == len(expected[1]) > 3
    for found, ours in zip(
        expected, ([p.begin for p in paths], [p.top for p in paths], [p.end for p in paths]), strict=True
    ):
        np.testing.assert_allclose(ours, found, atol=1.0)
    # at the edges themselves Skyfield's elevation is the limit: 0.1 s of error is 0.01 deg
    edges = at(sky, day, [*(p.begin for p in paths), *(p.end for p in paths)])
    np.testing.assert_allclose((satellite - station).at(edges).altaz()[0].degrees, 10.0, atol=0.01)
    tops = at(sky, day, [p.top for p in paths])
    elevation, azimuth, _ = (satellite - station).at(tops).altaz()
    np.testing.assert_allclose([p.top_elevation for p in paths], elevation.degrees, atol=0.02)
    turn = (np.array([p.top_azimuth for p in paths]) - azimuth.degrees + 180) % 360 - 180
    # near the zenith a small error is a large turn
    assert np.abs(turn * np.cos(np.radians(elevation.degrees))).max() < 0.3


def test_rows_stand_where_skyfield_has_them(sky, day):
    timescale, _ = sky
    satellite, station = EarthSatellite(*LOW, ts=timescale), wgs84.latlon(LATITUDE, LONGITUDE, HEIGHT)
    table = day.to_table()
    times = timescale.from_astropy(Time(list(table["time"]), format="isot", scale="utc"))
    elevation, azimuth, distance = (satellite - station).at(times).altaz()
    # 20 m of station, and half a millisecond of a printed time
    np.testing.assert_allclose(table["elevation_deg"], elevation.degrees, atol=3e-3)
    turn = (np.asarray(table["azimuth_deg"]) - azimuth.degrees + 180) % 360 - 180
    assert np.abs(turn * np.cos(np.radians(elevation.degrees))).max() < 3e-3
    np.testing.assert_allclose(table["range_km"], distance.km, atol=0.03)


def test_the_umbra_is_where_skyfield_has_no_sun(sky):
    """Skyfield's Earth is a sphere without air, and its Sun a point: our umbra begins 20 km of air, up to 21 km of
    flattening and half of the Sun's disc (4 s) apart from that, 8 s at 7 km/s and up to three times that on a slant."""
    timescale, ephemeris = sky
    satellite = EarthSatellite(*LOW, ts=timescale)
    found = torchlc.predict(scene(), **SPAN, sun=90.0, elevation=0.0)
    seen = 0
    for one in found.passes:
        for seconds, word in one.path.events:
            if "umbra" not in word or "penumbra" in word:
                continue
            before, later = satellite.at(at(sky, found, [seconds - 25.0, seconds + 25.0])).is_sunlit(
                ephemeris
            )
            assert (before, later) == ((True, False) if word.startswith("enters") else (False, True))
            seen += 1
    assert seen >= 2


def test_the_night_begins_and_ends_with_the_sun(sky):
    """A geostationary object is up all night: the pass is the night, to 0.01 deg of the Sun's elevation (4 s)."""
    _, ephemeris = sky
    found = torchlc.predict(scene(ORBIT_1), date="2020-10-10", sun=-12.0, cadence=60.0)
    (one,) = found.passes
    assert (one.path.begins, one.path.ends) == ("the night begins", "the night ends")
    station = ephemeris["earth"] + wgs84.latlon(LATITUDE, LONGITUDE, HEIGHT)
    sun = station.at(at(sky, found, [one.path.begin, one.path.end])).observe(ephemeris["sun"]).apparent()
    np.testing.assert_allclose(sun.altaz()[0].degrees, -12.0, atol=0.01)
    local = found.iso(one.path.begin)[:10], found.iso(one.path.end)[:10]
    assert local == ("2020-10-10", "2020-10-10")  # 18 h and 6 h at 122 deg east


def test_a_white_ball_is_as_bright_as_the_textbook_says(day):
    """Lambert sphere: Phi = 2/3 albedo (R/d)^2 (sin a + (pi - a) cos a)/pi (Russell 1916). A sphere of facets: 1 mmag."""
    table = day.to_table()
    table = table[~table["mag"].mask & (table["eclipse_fraction"] == 0)]
    phase = np.radians(np.asarray(table["phase_angle_deg"]))
    shape = (np.sin(phase) + (math.pi - phase) * np.cos(phase)) / math.pi
    flux = 2 / 3 * 0.6 * (0.5 / (1e3 * np.asarray(table["range_km"]))) ** 2 * shape
    expected = -26.76 - 2.5 * np.log10(flux)
    bright = phase < np.radians(140)  # the crescent of a faceted ball is coarser
    assert bright.sum() > 50
    np.testing.assert_allclose(np.asarray(table["mag"])[bright], expected[bright], atol=5e-3)
    assert day.uncertainty == "none"


def test_intervals_are_those_of_prior_and_scatter():
    """A log-normal albedo of sigma 0.3 is a normal of 0.326 mag; with a scatter of 0.4 mag, 0.516 mag. Of 4000 draws a
    quantile at 2.5 % is off by 0.042 sigma (1 sigma of it): 5 sigma of that is 0.2 sigma."""
    free = SPHERE.replace("albedo = 0.6", 'albedo = { value = 0.1, sigma = 0.3, prior = "lognormal" }')
    found = torchlc.predict(scene(parts=free), **SPAN, scatter=0.4, draws=4000, seed=2)
    assert found.uncertainty == "priors"
    table = found.to_table()
    table = table[~table["mag"].mask & (table["eclipse_fraction"] == 0)]
    sigma = math.hypot(1.0857362 * 0.3, 0.4)
    centre = torchlc.predict(scene(parts=SPHERE.replace("0.6", "0.1")), **SPAN).to_table()
    centre = centre[~centre["mag"].mask & (centre["eclipse_fraction"] == 0)]
    np.testing.assert_allclose(table["mag"], centre["mag"], atol=0.1 * sigma)
    for name, share in (("mag_q025", 0.025), ("mag_q16", 0.16), ("mag_q84", 0.84), ("mag_q975", 0.975)):
        offset = np.asarray(table[name]) - np.asarray(centre["mag"])
        np.testing.assert_allclose(offset, sigma * norm.ppf(share), atol=0.2 * sigma)


def test_extinction_is_added_for_the_air():
    """k X, X by Kasten & Young (1989): 38 at the horizon, 1 in the zenith, 1.995 at 30 deg."""
    found = torchlc.predict(scene(), **SPAN, extinction=0.2)
    table = found.to_table()
    known = ~table["mag"].mask
    height = np.radians(np.asarray(table["elevation_deg"]))
    plane = 0.2 / np.sin(height)
    steep = known & (np.degrees(height) > 30)
    added = np.asarray(table["apparent_mag"]) - np.asarray(table["mag"])
    # a plane-parallel air is 0.3 % too thick at 30 deg
    np.testing.assert_allclose(added[steep], plane[steep], rtol=4e-3)


def test_an_eclipse_between_two_rows_parts_them_too():
    """At a step of 600 s rows are further apart than a short umbra is long: the same night, its umbra cut to one step."""
    from dataclasses import replace

    from torchlc.prediction.glints import lit_runs

    path = by_the_equinox("150.0", cadence=600.0).passes[0].path
    shining = replace(path, shadow=np.full(len(path.index), 2.0))
    seconds = 600.0 * path.index
    assert [run.rows for run in lit_runs(replace(shining, events=()), seconds)] == [slice(0, len(seconds))]
    short = ((seconds[20] + 10.0, "enters umbra"), (seconds[20] + 200.0, "leaves umbra"))
    runs = lit_runs(replace(shining, events=short), seconds)
    assert [(run.rows.start, run.rows.stop) for run in runs] == [(0, 21), (21, len(seconds))]
    assert [run.begins for run in runs] == ["the night begins", "it leaves the umbra"]
    assert [run.ends for run in runs] == ["it enters the umbra", "the night ends"]


@pytest.mark.long
def test_a_fit_predicts_from_its_posterior(tmp_path):
    """The true object, of which the fitted recording was made, lies within three standard deviations on another night, from
    folder and result alike; intervals are narrower than those of the priors."""
    text, recording = write_case(tmp_path)
    result = torchlc.fit(text, recording, steps=300, out=tmp_path / "fit")
    later = {"start": "2020-10-19T13:00:00", "hours": 5.0, "cadence": 120.0}
    found = torchlc.predict(tmp_path / "fit", **later)
    assert found.uncertainty == "posterior"
    again = torchlc.predict(result, **later)
    np.testing.assert_array_equal(found.passes[0].mag, again.passes[0].mag)
    stored = torchlc.predict(torchlc.load_fit(tmp_path / "fit"), **later)
    np.testing.assert_array_equal(found.passes[0].mag, stored.passes[0].mag)
    path, mag = found.passes[0].path, found.passes[0].mag
    truth = torchlc.simulate(text, start=later["start"], hours=5.0, cadence=120.0).mag[path.index]
    # the zero point is shared by all rows, so that they are one draw, which three standard deviations hold in 99.7 %
    deviation = (mag[4] - mag[0]) / (2 * 1.96)
    assert (np.abs(truth - mag[2]) < 3 * deviation).mean() > 0.95
    wide = torchlc.predict(text, **later).passes[0].mag
    assert np.median(mag[4] - mag[0]) < 0.3 * np.median(wide[4] - wide[0])


def test_files_are_read_by_others(tmp_path, capsys):
    """ECSV by astropy, JSON without NaN, a calendar by the rules of RFC 5545: CRLF, at most 75 octets a line, pairs of
    BEGIN and END, text escaped."""
    path = catalogue(tmp_path, 8)
    path.write_text(path.read_text().replace("SHELL", "SHELL, Größe; ★"))
    out = tmp_path / "out"
    arguments = [
        "predict",
        str(path),
        "--preset",
        "starlink-v2-mini",
        "--station",
        STATION,
        "--date",
        "2023-04-10",
    ]
    assert run([*arguments, "-o", str(out), "--extinction", "0.2"]) == 0
    capsys.readouterr()
    told = json.loads((out / "prediction.json").read_text(), parse_constant=pytest.fail)
    assert told["schema"] == "torchlc-prediction/1"
    assert told["scatter_mag"] == 0.4
    rows, passes = Table.read(out / "prediction.ecsv"), Table.read(out / "passes.ecsv")
    assert len(passes) == len(told["passes"]) == len(set(rows["pass"]))
    objects = {one["object"] for one in told["passes"]}
    assert set(rows["object"]) == set(passes["object"]) == objects
    # dark rows are blank, and the others what the object itself gives
    dark = np.asarray(rows["eclipse_fraction"]) == 1
    assert np.asarray(rows["mag"].mask)[dark].all()
    best = rows[rows["pass"] == 1]
    assert float(best["mag"].min()) == pytest.approx(told["passes"][0]["mag"], abs=0.3)
    assert (out / "passes.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    content = (out / "passes.ics").read_bytes()
    assert content.endswith(b"END:VCALENDAR\r\n") and b"\n" not in content.replace(b"\r\n", b"")
    lines = content.split(b"\r\n")
    assert max(map(len, lines)) <= 75
    whole = content.decode().replace("\r\n ", "").split("\r\n")
    visible = [one for one in told["passes"] if one["visible"]]
    assert whole.count("BEGIN:VEVENT") == whole.count("END:VEVENT") == len(visible) > 0
    starts = [line.removeprefix("DTSTART:") for line in whole if line.startswith("DTSTART:")]
    assert starts == [one["begin"][:19].replace("-", "").replace(":", "") + "Z" for one in visible]
    summaries = [line for line in whole if line.startswith("SUMMARY:")]
    assert summaries[0].startswith("SUMMARY:SHELL\\, Größe\\; ★ ")
    assert len({line for line in whole if line.startswith("UID:")}) == len(visible)
    # a figure is named where there is one
    assert run([*arguments, "-o", str(tmp_path / "none"), "--faintest", "-30"]) == 0
    assert "passes.ics and prediction.json" in capsys.readouterr().out
    assert not (tmp_path / "none" / "passes.png").exists()
    # a second run replaces its own files
    assert run([*arguments, "-o", str(out), "-q"]) == 0


def test_the_faintest_are_left_out_and_counted(tmp_path):
    path = catalogue(tmp_path, 8)
    whole = torchlc.predict(scene(), elements=path, **NIGHT)
    limit = float(np.median([one.brightest[2] for one in whole.passes if one.visible]))
    found = torchlc.predict(scene(), elements=path, **NIGHT, faintest=limit)
    assert 0 < len(found.passes) < len(whole.passes)
    assert any(
        f"{len(whole.passes) - len(found.passes)} passes left out: fainter" in text for text in found.warnings
    )


def test_a_midsummer_night_without_darkness_says_so():
    north = torchlc.scene.Station(id="north", latitude=69.0, longitude=20.0, height=0.0)
    found = torchlc.predict(scene(), stations=[north], date="2006-06-21")
    assert not found.passes
    assert any("the Sun is never below -6 deg" in text for text in found.warnings)


def test_times_cross_a_leap_second():
    """2016-12-31 ended with 23:59:60: rows 10 s apart in elapsed time are stamped 1 s early after it."""
    found = torchlc.predict(scene(), start="2016-12-31T23:59:00", hours=0.05, sun=90.0, elevation=0.0)
    assert found.iso(50.0) == "2016-12-31T23:59:50.000"
    assert found.iso(60.0) == "2016-12-31T23:59:60.000"
    assert found.iso(70.0) == "2017-01-01T00:00:09.000"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["--date", "2023-13-40"], "a night as YYYY-MM-DD"),
        (["--date", "2023-04-10", "--start", "2023-04-10T00:00"], "both a night and a start"),
        (["--start", "2023-04-10T00:00"], "--hours"),
        (["--start", "2023-04-10T00:00", "--hours", "1e9"], "at most 744 h"),
        (["--date", "2023-04-10", "--cadence", "0"], "0.1 to 600 s"),
        (["--date", "2023-04-10", "--elevation", "95"], "0 to 89 deg"),
        (["--date", "2023-04-10", "--scatter", "-1"], "0 to 10 mag"),
        (["--date", "2023-04-10", "--station", "nowhere"], "ID,LAT,LON,HEIGHT"),
        (["--date", "2023-04-10", "--station", "a,99,0,0"], "-90 to 90"),
        (["--date", "2023-04-10", "--preset", "starlonk"], "did you mean"),
        (["--date", "2023-04-10", "--like", "nothing.toml"], "both of them"),
    ],
)
def test_bad_requests_are_one_line_and_write_nothing(changes, message, tmp_path, capsys):
    path = catalogue(tmp_path, 1)
    given = {"--preset": "box-wing", "--station": STATION}
    arguments = [
        "predict",
        str(path),
        *(part for key, value in given.items() if key not in changes for part in (key, value)),
    ]
    assert run([*arguments, *changes, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert message.lower() in said.lower()
    assert "\n" not in said
    assert not (tmp_path / "out").exists()


def test_intervals_hold_recorded_magnitudes_of_starlinks():
    """Presets and scatter against satellites and nights that they were not fitted to: 85 to 95 % of the recorded magnitudes
    lie in the 95 % intervals."""
    from examples import predicted_against_recorded as example

    if not example.DATA.exists():
        pytest.skip(f"{example.DATA} is not here")
    for held in (example.starlink_v15(), example.starlink_v2_mini()):
        assert held.rows > 300
        assert 0.85 <= held.inside_95 <= 0.95, held
        assert abs(held.median_mag) < 0.2


def test_a_station_is_typed_as_text_and_a_start_may_be_a_time():
    """As the message for a scene without stations has it."""
    typed = torchlc.predict(
        scene(), stations=f"here,{LATITUDE},{LONGITUDE},{HEIGHT}", start=Time(SPAN["start"]), hours=1 * u.h
    )
    plain = torchlc.predict(scene(), start=SPAN["start"], hours=1)
    assert [one.path.top for one in typed.passes] == [one.path.top for one in plain.passes]
    with pytest.raises(InputError, match="stations: 'here,1'; expected id,latitude,longitude,height"):
        torchlc.predict(scene(), stations="here,1", **SPAN)
