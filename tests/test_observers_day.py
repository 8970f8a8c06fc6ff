"""Recordings whose times or station put them in the middle of the day."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, get_sun

import torchlc
from torchlc.api import usable
from torchlc.readers import Recording
from torchlc.scene import Scene

DEMO = Path(torchlc.__file__).parent / "demo"


@pytest.fixture(scope="module")
def demo() -> tuple[Scene, Recording]:
    """A geostationary satellite, above the horizon at any hour, recorded in one night."""
    return torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")


def by_day(recording: Recording) -> list[str]:
    return [text for text in recording.warnings if "the Sun is above" in text]


def test_a_night_is_no_day(demo: tuple[Scene, Recording]):
    assert not by_day(usable(*demo))


def test_times_that_are_half_a_day_off_are_told(demo: tuple[Scene, Recording]):
    """The Sun's elevation against astropy, whose refraction is off: both are geometric."""
    scene, recording = demo
    late = replace(
        recording, time=recording.time + 12 * u.hour, first_time=recording.first_time + 12 * u.hour
    )
    (told,) = by_day(usable(scene, late))
    place = scene.stations[0]
    where = EarthLocation.from_geodetic(place.longitude, place.latitude, place.height)
    high = get_sun(late.time).transform_to(AltAz(obstime=late.time, location=where)).alt.to_value(u.deg)
    count, rows, degrees = map(int, re.findall(r"-?\d+", told)[:3])
    assert (count, rows) == (np.count_nonzero(high > 0), len(late))
    assert degrees == pytest.approx(np.median(high), abs=0.6)
    assert len(by_day(usable(scene, usable(scene, late)))) == 1


def test_what_is_seen_beside_the_sun_is_not(demo: tuple[Scene, Recording]):
    scene, recording = demo
    late = replace(recording, time=recording.time + 12 * u.hour, observed=recording.observed - 20.0)
    assert not by_day(usable(scene, late))
