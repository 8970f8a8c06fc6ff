"""Geometry against Skyfield with the JPL ephemeris DE421: other code, other series, other constants."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch
from skyfield.api import EarthSatellite, Loader, wgs84
from skyfield_data import get_skyfield_data_path

from tests.paper_orbits import (
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    LOW,
    MOLNIYA,
    ORBIT_1,
    ORBIT_3,
    ORBIT_4,
    hours,
    recording,
    scene,
    tle_scene,
)
from torchlc.geometry.orbit import make_track

ARCSEC = np.pi / 180 / 3600
CASES = {
    "geo": (ORBIT_1, "2020-10-10"),
    "meo": (ORBIT_4, "2020-10-11"),
    "old meo": (ORBIT_3, "2019-02-25"),
    "molniya": (MOLNIYA, "2006-06-26"),
    "low": (LOW, "2006-06-28"),
}


@pytest.fixture(scope="module")
def sky():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # its table of the Earth's rotation ends before today
        load = Loader(get_skyfield_data_path(), verbose=False)
    ephemeris = load("de421.bsp")
    yield load.timescale(builtin=True), ephemeris["earth"], ephemeris["sun"]
    ephemeris.close()


@pytest.fixture(params=CASES, scope="module")
def both(request, sky):
    """Our state and track, and Skyfield's satellite, station and times."""
    lines, day = CASES[request.param]
    timescale, _, _ = sky
    rows = recording(f"{day}T00:00:00", hours(0, 24, 613.0))
    track = make_track(tle_scene(lines), rows)
    satellite = EarthSatellite(*lines, ts=timescale)
    station = wgs84.latlon(LATITUDE, LONGITUDE, HEIGHT)
    return track, satellite, station, timescale.from_astropy(rows.time)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


def test_object_in_gcrs(both):
    track, satellite, _, times = both
    expected = satellite.at(times)
    state = track.at(0.0, 0.0, 0.0)
    assert angle(state.position.numpy(), expected.position.km.T).max() < 0.1 * ARCSEC
    distance = np.linalg.norm(expected.position.km, axis=0)
    np.testing.assert_allclose(torch.linalg.norm(state.position, dim=-1), distance, atol=1e-3)
    # SGP4's printed velocity is not quite the derivative of its position
    np.testing.assert_allclose(state.velocity.numpy(), expected.velocity.km_per_s.T, atol=3e-3)


def test_station_in_gcrs(both):
    """20 m: Skyfield's bundled UT1 is a daily table of its own, and it leaves out polar motion (10 m)."""
    track, _, station, times = both
    state = track.at(0.0, 0.0, 0.0)
    assert np.abs((state.observer + state.position).numpy() - station.at(times).position.km.T).max() < 0.020


def test_elevation_and_range(both):
    track, satellite, station, times = both
    altitude, _, distance = (satellite - station).at(times).altaz()
    # 20 m of station seen from the nearest rows, and polar motion, which also turns the vertical
    tolerance_deg = np.degrees(0.020 / distance.km.min()) + 0.6 / 3600
    np.testing.assert_allclose(track.elevation_deg.numpy(), altitude.degrees, atol=tolerance_deg)
    np.testing.assert_allclose(track.range_km.numpy(), distance.km, atol=0.020)


def test_sun_seen_from_the_object(both, sky):
    _, earth, sun = sky
    track, satellite, _, times = both
    state = track.at(0.0, 0.0, 0.0)
    apparent = earth.at(times).observe(sun).apparent().position.km.T
    geocentric = (state.sun + state.position).numpy()
    assert angle(geocentric, apparent).max() < 0.1 * ARCSEC
    np.testing.assert_allclose(
        np.linalg.norm(geocentric, axis=-1), np.linalg.norm(apparent, axis=-1), rtol=1e-7
    )
    parallax = angle(state.sun.numpy(), apparent - satellite.at(times).position.km.T)
    assert parallax.max() < 0.1 * ARCSEC


def test_offsets_up_to_an_hour(both, sky):
    """Stamps an hour early, put right by offsets, are rows at the right time: all motions at once."""
    timescale, earth, sun = sky
    track, satellite, station, _ = both
    seconds = track.seconds
    offset = 3600.0 * torch.cos(torch.arange(len(seconds), dtype=torch.float64))
    state = track.at(offset, offset, 0.0)
    start = timescale.from_datetime(both[3][0].utc_datetime())
    times = timescale.tt_jd(start.tt + (seconds + offset).numpy() / 86400)
    # 1 ms of rounding in the Julian date is 8 m in a low orbit
    np.testing.assert_allclose(state.position.numpy(), satellite.at(times).position.km.T, atol=0.03)
    place = (state.observer + state.position).numpy()
    np.testing.assert_allclose(place, station.at(times).position.km.T, atol=0.021)
    apparent = earth.at(times).observe(sun).apparent().position.km.T
    assert angle((state.sun + state.position).numpy(), apparent).max() < 0.2 * ARCSEC


def test_altitude_and_azimuth_place_the_object(sky):
    """Skyfield's altitude, azimuth and height of a low satellite lead back to where Skyfield has it."""
    timescale, _, _ = sky
    satellite, station = EarthSatellite(*LOW, ts=timescale), wgs84.latlon(LATITUDE, LONGITUDE, HEIGHT)
    seconds = hours(0, 24, 20.0)
    times = timescale.from_astropy(recording("2006-06-28T00:00:00", seconds).time)
    up = (satellite - station).at(times).altaz()[0].degrees > 5
    rows = recording("2006-06-28T00:00:00", seconds[up])
    times = timescale.from_astropy(rows.time)
    altitude, azimuth, distance = (satellite - station).at(times).altaz()
    seen = recording(
        "2006-06-28T00:00:00",
        seconds[up],
        alt=altitude.degrees,
        az=azimuth.degrees,
        height=wgs84.height_of(satellite.at(times)).km,
    )
    track = make_track(scene("altaz = true"), seen)
    assert len(seen) > 50
    np.testing.assert_allclose(track.elevation_deg.numpy(), altitude.degrees, atol=1e-9)
    np.testing.assert_allclose(track.range_km.numpy(), distance.km, atol=1e-3)
    position = track.at(0.0, 0.0, 0.0).position.numpy()
    # the station's 20 m, and polar motion, which turns our horizon by 0.3 arcsec
    np.testing.assert_allclose(position, satellite.at(times).position.km.T, atol=0.030)
