"""Orbits that a recording brings itself: vectors, ranges, altitude and azimuth."""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest
import torch

from tests.paper_orbits import (
    LOW,
    ORBIT_4,
    SHARED,
    hours,
    recording,
    scene,
)
from tests.test_orbit import MMT9, needs_shared, night
from torchlc.errors import InputError
from torchlc.geometry.orbit import (
    angle_between,
    earth,
    make_track,
    shadow_coordinate,
)
from torchlc.readers import load_recording
from torchlc.scene import load_scene


def test_vectors_give_the_geometry_of_the_elements_they_were_made_of():
    """Also an hour off the stamps: two bodies differ from SGP4 by the Earth's flattening, some km at MEO."""
    elements = night(ORBIT_4, step_s=600.0)
    state = elements.at(0.0, 0.0, 0.0)
    columns = {
        "sun": state.sun,
        "obs": state.observer,
        "position": state.position,
        "velocity": state.velocity,
    }
    rows = recording(
        "2020-10-10T00:00:00",
        hours(12, 20, 600.0),
        **{name: array.numpy() for name, array in columns.items()},
    )
    track = make_track(scene('vectors = "icrs"'), rows)
    for what in ("position", "velocity", "motion", "along_track", "elevation"):
        assert track.supports(what)
    for field in ("range_km", "phase_angle_deg", "elevation_deg", "airmass"):
        np.testing.assert_allclose(getattr(track, field), getattr(elements, field), rtol=1e-9)
    ours, theirs = track.at(3600.0, 1800.0, 0.01), elements.at(3600.0, 1800.0, 0.01)
    np.testing.assert_allclose(ours.position, theirs.position, atol=5.0)
    np.testing.assert_allclose(ours.observer + ours.position, theirs.observer + theirs.position, atol=1e-6)
    np.testing.assert_allclose(ours.sun, theirs.sun, rtol=1e-6)


def test_ecliptic_vectors_are_turned():
    """The pole of the ecliptic J2000 is at right ascension 18 h, declination 66 deg 33' 38.55"."""
    n = 3
    pole = np.tile([0.0, 0.0, 1.5e8], (n, 1))
    equinox = np.tile([1.0e8, 0.0, 0.0], (n, 1))
    rows = recording("2020-10-10T00:00:00", np.arange(n) * 60.0, sun=pole, obs=equinox)
    state = make_track(scene('vectors = "ecliptic"'), rows).at(0.0, 0.0, 0.0)
    declination = math.radians(66 + 33 / 60 + 38.55 / 3600)
    np.testing.assert_allclose(
        state.sun[0] / 1.5e8, [0, -math.cos(declination), math.sin(declination)], atol=1e-7
    )
    np.testing.assert_allclose(state.observer[0], [1e8, 0, 0])
    assert state.position is None and state.velocity is None


def test_positions_without_velocities_move_by_the_neighbouring_rows():
    state = night(LOW, "2006-06-27", 12.0, 12.1, 1.0).at(0.0, 0.0, 0.0)
    columns = {"sun": state.sun.numpy(), "obs": state.observer.numpy(), "position": state.position.numpy()}
    rows = recording("2006-06-27T00:00:00", hours(12.0, 12.1, 1.0), **columns)
    track = make_track(scene('vectors = "icrs"'), rows)
    assert track.supports("motion") and not track.supports("velocity") and not track.supports("along_track")
    moved = track.at(20.0, 20.0, 0.0)
    # central differences of rows 1 s apart are good to 1e-6 in the middle, two bodies to 2 m in 20 s
    np.testing.assert_allclose(moved.position[5:-25], state.position[25:-5], atol=0.02)
    np.testing.assert_allclose(moved.observer[5:-25], state.observer[25:-5], atol=0.02)
    lonely = recording(
        "2006-06-27T00:00:00", hours(12.0, 12.1, 1.0)[::300], **{k: v[::300] for k, v in columns.items()}
    )
    assert not make_track(scene('vectors = "icrs"'), lonely).supports("motion")


@needs_shared
@pytest.mark.parametrize("path", MMT9, ids=lambda path: path.stem)
def test_ranges_and_phases_as_published_with_the_tracks(path):
    """The vectors were fitted to these columns, to 6 m and 0.0004 deg rms at worst: three times that."""
    columns = load_scene(path.with_name(path.stem.replace("track", "scene") + ".toml"))
    rows = load_recording(path, columns)
    with path.with_suffix(".csv").open() as stream:
        table = {row["Date"][:23] + row["Channel"] + row["Mag"]: row for row in csv.DictReader(stream)}
    iso = [text.replace("T", " ") for text in rows.time.isot]
    found = [
        table[f"{text}{rows.curve_ids[curve].removeprefix('ch')}{magnitude!s}"]
        for text, curve, magnitude in zip(iso, rows.curve, rows.observed, strict=True)
    ]
    track = make_track(columns, rows)
    distance = np.array([float(row["Distance"]) for row in found])
    phase = np.array([float(row["Phase"]) for row in found])
    sun = np.array([float(row["SunDistance"]) for row in found])
    assert np.sqrt(np.mean((track.range_km.numpy() - distance) ** 2)) < 0.018
    assert np.sqrt(np.mean((track.phase_angle_deg.numpy() - phase) ** 2)) < 0.0012
    state = track.at(0.0, 0.0, 0.0)
    np.testing.assert_allclose(torch.linalg.norm(state.sun, dim=-1), sun, rtol=5e-5)  # its origin varies
    assert track.supports("elevation") and float(track.elevation_deg.min()) > 15
    assert float(shadow_coordinate(state.position, state.sun).t.min()) > 1  # "every row in sunlight"
    assert not track.warnings
    # the observatory stays at 43.6499 N, 41.4315 E, 2030 m
    place = earth.station_itrs(np.array([43.6499]), np.array([41.4315]), np.array([2030.0]))
    frame = earth.orientation(rows.time)
    observer = np.einsum("tji,tj->ti", frame.gcrs_from_itrs, (state.observer + state.position).numpy())
    np.testing.assert_allclose(observer, np.broadcast_to(place, observer.shape), atol=0.05)


@needs_shared
def test_rows_of_a_track_follow_from_its_first_row():
    path = MMT9[0]
    rows = load_recording(path, load_scene(path.with_name(path.stem.replace("track", "scene") + ".toml")))
    track = make_track(scene('vectors = "icrs"'), rows)
    state = track.at(0.0, 0.0, 0.0)
    offset = track.seconds[100] - track.seconds[0]
    moved = track.at(offset, offset, 0.0)
    assert 5 < float(offset) < 30
    np.testing.assert_allclose(moved.position[0], state.position[100], atol=0.005)
    np.testing.assert_allclose(moved.observer[0], state.observer[100], atol=0.005)
    np.testing.assert_allclose(moved.sun[0], state.sun[100], atol=2.0)


@needs_shared
def test_asteroid_rows_move_like_their_neighbours():
    folder = SHARED / "data" / "eros"
    columns = load_scene(folder / "scene.toml")
    rows = load_recording(folder / "recording.ecsv", columns)
    track = make_track(columns, rows)
    assert track.supports("motion") and not track.supports("position") and track.airmass is None
    assert 1.0 < float(track.phase_angle_deg.min()) < 1.2 and 56 < float(track.phase_angle_deg.max()) < 58
    long = np.argmax(np.bincount(rows.curve))
    here, there = np.flatnonzero(rows.curve == long)[[20, 21]]
    step = rows.seconds[there] - rows.seconds[here]
    moved, state = track.at(step, step, 0.0), track.at(0.0, 0.0, 0.0)
    # the columns are rounded to 1e-8 au, 1.5 km
    for field in ("sun", "observer"):
        change = getattr(state, field)[there] - getattr(state, field)[here]
        np.testing.assert_allclose(getattr(moved, field)[here], getattr(state, field)[there], atol=10.0)
        assert float(torch.linalg.norm(change)) > 50


@needs_shared
def test_altitude_azimuth_and_height_as_in_the_source_of_the_recording():
    """Positions on the ellipsoid and on the published model's sphere agree to 0.01 mag, 0.05 at worst."""
    folder = SHARED / "data" / "starlink_v15"
    columns = load_scene(folder / "scene.toml")
    rows = load_recording(folder / "recording.ecsv", columns)
    track = make_track(columns, rows)
    np.testing.assert_allclose(track.elevation_deg, rows.alt, atol=1e-9)
    radius, altitude = 6371.0, np.radians(rows.alt)
    sphere = np.sqrt(
        (radius * np.sin(altitude)) ** 2 + rows.height * (2 * radius + rows.height)
    ) - radius * np.sin(altitude)
    difference = np.abs(5 * np.log10(track.range_km.numpy() / sphere))
    assert np.median(difference) < 0.02 and difference.max() < 0.06
    state = track.at(0.0, 0.0, 0.0)
    shadow = shadow_coordinate(state.position, state.sun).t  # "all satellites are lit", two of them just
    assert float(shadow.min()) > 0.5 and int((shadow < 1).sum()) <= 2
    below = 90 - torch.rad2deg(angle_between(track.zenith, state.sun + state.position))
    assert (
        float(below.min()) > -32 and float(below.max()) < -9.5
    )  # "the Sun is 10 to 31 degrees below the horizon"
    assert not track.supports("motion") and state.velocity is None


def test_an_object_below_its_station_is_bad_input():
    rows = recording(
        "2020-10-10T00:00:00", np.zeros(1), alt=np.array([40.0]), az=np.array([10.0]), height=np.array([0.05])
    )
    with pytest.raises(InputError, match=r"column height: .*below the station"):
        make_track(scene("altaz = true"), rows)


def test_vectors_must_be_there():
    with pytest.raises(InputError, match="no sun_x"):
        make_track(scene('vectors = "icrs"'), recording("2020-10-10T00:00:00", np.zeros(2)))
    with pytest.raises(InputError, match="no alt, az and height"):
        make_track(scene("altaz = true"), recording("2020-10-10T00:00:00", np.zeros(2)))
