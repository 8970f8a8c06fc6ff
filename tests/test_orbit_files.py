"""Orbits from files: element sets of many epochs, and Orbit Ephemeris Messages against Kepler, SGP4 and astropy."""

from __future__ import annotations

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
import torch
from astropy.coordinates import ITRS, TEME, CartesianDifferential, CartesianRepresentation
from astropy.time import Time, TimeDelta
from astropy.utils import iers
from sgp4.api import WGS72, Satrec

import torchlc
from tests.bad_input_cases import SCENE, TLE
from torchlc.errors import InputError
from torchlc.orbit import make_track
from torchlc.orbit.motion import GM_EARTH
from torchlc.recording import load_recording
from torchlc.scene import Scene, load_scene

ISS = (
    "1 25544U 98067A   20045.18587073  .00000950  00000-0  25302-4 0  9990",
    "2 25544  51.6443 242.0161 0004885 264.6060 207.3845 15.49165514212791",
)
GEO_1 = "1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993"
GEO_2 = "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966"
LATER = GEO_1.replace("20284", "20294").replace("9993", "9994")
HEADER = (
    "CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2020-01-01T00:00:00\nORIGINATOR = TEST\nCOMMENT made by a test\n"
)
STATION = SCENE[SCENE.index("[[stations]]") : SCENE.index("[attitude]")]


def scene_with(folder: Path, orbit: str) -> Scene:
    path = folder / "scene.toml"
    path.write_text(SCENE.replace(TLE, orbit + "\n\n"))
    return load_scene(path)


def rows(folder: Path, scene: Scene, moments: Time):
    text = "time,mag\n" + "".join(f"{one},9\n" for one in moments.utc.isot)
    (folder / "recording.csv").write_text(text)
    return load_recording(folder / "recording.csv", scene)


def places(scene: Scene, recording, offset: float = 0.0) -> np.ndarray:
    """Geocentric positions (T, 3), km, ``offset`` s after the stamps."""
    position = make_track(scene, recording).at(0.0, offset, 0.0).position
    assert position is not None
    return position.numpy()


def message(times: Time, position: np.ndarray, velocity: np.ndarray, frame: str, system: str = "UTC") -> str:
    scale = {"GPS": "tai"}.get(system, system.lower())
    said = getattr(times, scale) - TimeDelta(19.0 if system == "GPS" else 0.0, format="sec")
    said.precision = 6
    meta = f"OBJECT_NAME = X\nOBJECT_ID = 2020-001A\nCENTER_NAME = EARTH\nREF_FRAME = {frame}\nTIME_SYSTEM = {system}"
    head = (
        f"{HEADER}META_START\n{meta}\nSTART_TIME = {said.isot[0]}\nSTOP_TIME = {said.isot[-1]}\nMETA_STOP\n"
    )
    lines = (
        f"{one} " + " ".join(f"{value:.9f}" for value in (*r, *v))
        for one, r, v in zip(said.isot, position, velocity, strict=True)
    )
    return head + "\n".join(lines) + "\n"


def sgp4_states(lines: tuple[str, str], times: Time) -> tuple[np.ndarray, np.ndarray]:
    codes, position, velocity = Satrec.twoline2rv(*lines, WGS72).sgp4_array(times.utc.jd1, times.utc.jd2)
    assert not codes.any()
    return position, velocity


def spaced(start: str, count: int, step_s: float) -> Time:
    return Time(start, scale="utc") + TimeDelta(np.arange(count) * step_s, format="sec")


class TestElementFiles:
    def test_each_night_takes_the_nearest_set(self, tmp_path: Path):
        (tmp_path / "many.txt").write_text(f"0 SAT\n{GEO_1}\n{GEO_2}\n0 SAT\n{LATER}\n{GEO_2}\n")
        many = scene_with(tmp_path, 'tle_file = "many.txt"')
        nights = Time(["2020-10-12T14:00", "2020-10-12T20:00", "2020-10-20T15:00", "2020-10-20T16:00"])
        recording = rows(tmp_path, many, nights)
        for offset in (0.0, 40.0, -3600.0):
            found = places(many, recording, offset)
            for part, line in ((slice(0, 2), GEO_1), (slice(2, 4), LATER)):
                alone = scene_with(tmp_path, f'tle = ["{line}", "{GEO_2}"]')
                np.testing.assert_allclose(found[part], places(alone, recording, offset)[part], atol=1e-4)
        warning = make_track(many, recording).warnings[0]
        assert (
            "many.txt: of 2 element sets the nearest to each night is taken: 2020-10-10T01:45, 2020-10-20"
            in warning
        )

    def test_simulated_and_written_back(self, tmp_path: Path):
        (tmp_path / "many.txt").write_text(f"{GEO_1}\n{GEO_2}\n")
        scene = scene_with(tmp_path, 'tle_file = "many.txt"')
        again = Scene.from_toml(scene.to_toml(), tmp_path)
        assert again.model_dump() == scene.model_dump()
        curve = torchlc.simulate(scene, start="2020-10-17T15:00", hours=1, cadence=600)
        plain = torchlc.simulate(Scene.from_toml(SCENE), start="2020-10-17T15:00", hours=1, cadence=600)
        np.testing.assert_array_equal(curve.mag, plain.mag)

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ("", "no two-line elements"),
            (f"{GEO_1}\n{GEO_2}\n{ISS[0]}\n{ISS[1]}\n", r"elements of 2 objects \(00001, 25544\)"),
            (f"x\n{GEO_1}\n{GEO_2.replace('67.2351', '67.2352')}\n", "line 3: checksum"),
            (None, "orbit.tle_file: no file 'many.txt'"),
        ],
    )
    def test_what_is_wrong_is_named(self, tmp_path: Path, content: str | None, message: str):
        if content is not None:
            (tmp_path / "many.txt").write_text(content)
        with pytest.raises(InputError, match=message):
            scene = scene_with(tmp_path, 'tle_file = "many.txt"')
            make_track(scene, rows(tmp_path, scene, Time(["2020-10-17T15:00:00"])))


class TestEphemerides:
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
