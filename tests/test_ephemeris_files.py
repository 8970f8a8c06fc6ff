"""Ephemerides of an object from a file, an OEM message."""

from __future__ import annotations

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
import torch
from astropy.coordinates import ITRS, TEME, CartesianDifferential, CartesianRepresentation
from astropy.time import Time, TimeDelta
from astropy.utils import iers

from tests.test_orbit_files import HEADER, ISS, message, places, rows, scene_with, sgp4_states, spaced
from torchlc.errors import InputError
from torchlc.geometry.orbit import make_track
from torchlc.geometry.orbit.motion import GM_EARTH


class TestEphemerides:
    def test_states_too_far_apart_are_refused(self, tmp_path: Path):
        """Every 30 minutes is a third of a revolution of this orbit of 93 minutes; every 20 is not a quarter."""
        for step_s, good in ((1200.0, True), (1800.0, False)):
            times = spaced("2020-02-14T00:00:00", 40, step_s)
            (tmp_path / "iss.oem").write_text(message(times, *sgp4_states(ISS, times), "TEME"))
            scene = scene_with(tmp_path, 'oem_file = "iss.oem"')
            recording = rows(tmp_path, scene, spaced("2020-02-14T02:00:00", 30, 61.0))
            if good:
                elements = scene_with(tmp_path, f'tle = ["{ISS[0]}", "{ISS[1]}"]')
                apart = np.linalg.norm(places(scene, recording) - places(elements, recording), axis=-1)
                assert apart.max() < 3.0
            else:
                with pytest.raises(InputError, match=r"states 30 minutes apart, 0\.32 revolutions"):
                    make_track(scene, recording)

    def test_an_ellipse_of_kepler(self, tmp_path: Path):
        """States 10 min apart in a low orbit leave some ten metres to a polynomial of degree 7."""
        axis, e, start = 7500.0, 0.05, "2020-10-17T12:00:00"
        n = np.sqrt(GM_EARTH / axis**3)

        def kepler(seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            mean, anomaly = n * seconds, n * seconds
            for _ in range(30):
                anomaly = anomaly - (anomaly - e * np.sin(anomaly) - mean) / (1 - e * np.cos(anomaly))
            b = axis * np.sqrt(1 - e**2)
            x, y = axis * (np.cos(anomaly) - e), b * np.sin(anomaly)
            rate = n / (1 - e * np.cos(anomaly))
            zero = np.zeros_like(x)
            return (
                np.stack([x, 0.6 * y, 0.8 * y], -1),
                np.stack([-axis * np.sin(anomaly), 0.6 * b * np.cos(anomaly), 0.8 * b * np.cos(anomaly)], -1)
                * rate[:, None]
                + zero[:, None],
            )

        states = np.arange(40) * 600.0
        times = Time(start, scale="utc") + TimeDelta(states, format="sec")
        (tmp_path / "a.oem").write_text(message(times, *kepler(states), "GCRF"))
        scene = scene_with(tmp_path, 'oem_file = "a.oem"')
        seconds = np.array([7300.0, 7512.3, 9999.9, 14000.0])
        recording = rows(tmp_path, scene, Time(start, scale="utc") + TimeDelta(seconds, format="sec"))
        for offset in (0.0, 33.3, -1200.0):
            found, expected = places(scene, recording, offset), kepler(seconds + offset)[0]
            assert np.linalg.norm(found - expected, axis=-1).max() < 0.02
        track = make_track(scene, recording)
        velocity = track.at(0.0, 0.0, 0.0).velocity
        assert velocity is not None
        np.testing.assert_allclose(velocity.numpy(), kepler(seconds)[1], atol=1e-4)
        ahead = track.at(0.0, 0.0, torch.tensor(0.01)).position
        assert ahead is not None
        np.testing.assert_allclose(ahead.numpy(), kepler(seconds + 0.01 / n)[0], atol=0.02)

    @pytest.mark.parametrize("system", ["UTC", "TAI", "TT", "GPS"])
    @pytest.mark.parametrize("frame", ["TEME", "ITRF2014"])
    def test_states_by_sgp4_are_the_elements(self, tmp_path: Path, frame: str, system: str):
        """TEME as SGP4 gives it: its velocities are not quite the rates of its positions, 1e-6 km/s over 2 min.
        ITRF as astropy turns it.
        """
        times = spaced("2020-02-14T00:00:00", 121, 120.0)
        position, velocity = sgp4_states(ISS, times)
        if frame != "TEME":
            place = CartesianRepresentation(
                position.T * u.km, differentials=CartesianDifferential(velocity.T * u.km / u.s)
            )
            with iers.conf.set_temp("auto_download", False):
                turned = TEME(place, obstime=times).transform_to(ITRS(obstime=times)).cartesian
            position, velocity = (
                turned.xyz.to_value(u.km).T,
                turned.differentials["s"].d_xyz.to_value(u.km / u.s).T,
            )
        (tmp_path / "iss.oem").write_text(message(times, position, velocity, frame, system))
        scene = scene_with(tmp_path, 'oem_file = "iss.oem"')
        recording = rows(tmp_path, scene, spaced("2020-02-14T01:13:05.5", 40, 47.0))
        elements = scene_with(tmp_path, f'tle = ["{ISS[0]}", "{ISS[1]}"]')
        for offset in (0.0, 60.0):
            apart = np.linalg.norm(
                places(scene, recording, offset) - places(elements, recording, offset), axis=-1
            )
            assert apart.max() < (5e-4 if frame == "TEME" else 1e-3)

    def test_segments_covariances_and_days_of_the_year(self, tmp_path: Path):
        times = spaced("2020-02-14T00:00:00", 61, 120.0)
        position, velocity = sgp4_states(ISS, times)
        one = message(times[:31], position[:31], velocity[:31], "TEME")
        two = message(times[30:], position[30:], velocity[30:], "TEME").removeprefix(HEADER)
        covariance = "COVARIANCE_START\nEPOCH = 2020-02-14T00:00:00\n1\n1 1\nCOVARIANCE_STOP\n"
        text = (one + covariance + two).replace("2020-02-14T", "2020-045T").replace(".000000 ", ".000000Z ")
        (tmp_path / "iss.oem").write_text(text)
        scene = scene_with(tmp_path, 'oem_file = "iss.oem"')
        recording = rows(tmp_path, scene, spaced("2020-02-14T00:00:00", 25, 300.0))
        elements = scene_with(tmp_path, f'tle = ["{ISS[0]}", "{ISS[1]}"]')
        np.testing.assert_allclose(places(scene, recording), places(elements, recording), atol=5e-4)

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            (
                ("CCSDS_OEM_VERS", "CCSDS_OPM_VERS"),
                "line 1: 'CCSDS_OPM_VERS = 2.0'; expected an Orbit Ephemeris",
            ),
            (("= TEME", "= TOD"), "REF_FRAME: 'TOD'"),
            (("= EARTH", "= MOON"), "CENTER_NAME: 'MOON'"),
            (("= UTC", "= MET"), "TIME_SYSTEM: 'MET'"),
            (("2020-02-14T00:02:00.000000 ", "2020-02-14T00:02:00.000000 1 "), "line 15: 8 values"),
            (("2020-02-14T00:02:00.000000 ", "2020-02-14T00:12:00.000000 "), "line 16: a time not after"),
            (("2020-02-14T00:02:00.000000 ", "2020-02-30T00:02:00.000000 "), "a time that does not exist"),
            (("2020-02-14T00:02:00.000000 ", "today "), "line 15: 'today'"),
            (("2020-02-14T00:02:00.000000 ", "2020-02-14T00:02:00.000000 1_0"), "line 15: .*six numbers"),
            (("ORIGINATOR = TEST", "ORIGINATOR TEST"), "line 3: 'ORIGINATOR TEST'; expected KEYWORD"),
            (
                ("META_STOP", "USEABLE_STOP_TIME = 2020-02-14T01:00:00\nMETA_STOP"),
                "no state at 2020-02-14T01:30",
            ),
            (("2020-02-14", "2020-02-10"), "no states near the recording"),
        ],
    )
    def test_what_is_wrong_is_named(self, tmp_path: Path, change: tuple[str, str], said: str):
        times = spaced("2020-02-14T00:00:00", 61, 120.0)
        text = message(times, *sgp4_states(ISS, times), "TEME")
        assert change[0] in text
        (tmp_path / "iss.oem").write_text(text.replace(*change))
        scene = scene_with(tmp_path, 'oem_file = "iss.oem"')
        with pytest.raises(InputError, match=said):
            make_track(scene, rows(tmp_path, scene, Time(["2020-02-14T00:30:00", "2020-02-14T01:30:00"])))

    def test_outside_the_folder_only_with_trust(self, tmp_path: Path):
        (tmp_path / "in").mkdir()
        (tmp_path / "iss.oem").write_text("x")
        for key in ("oem_file", "tle_file"):
            with pytest.raises(InputError, match=f"orbit.{key}: .*a relative path inside the scene's folder"):
                scene_with(tmp_path / "in", f'{key} = "../iss.oem"')
