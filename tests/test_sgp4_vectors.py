"""SGP4 against the vectors of Vallado et al. (2006), AIAA 2006-6753; TEME against astropy's chain."""

from __future__ import annotations

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
import sgp4
import torch
from astropy.coordinates import GCRS, TEME, CartesianRepresentation
from astropy.time import Time, TimeDelta

from tests.paper_orbits import LOW, MOLNIYA, ORBIT_1, ORBIT_3, recording, tle_scene
from torchlc.errors import InputError
from torchlc.geometry.orbit import make_track
from torchlc.geometry.orbit.elements import ElementSet

FILES = Path(sgp4.__file__).parent
FAILS_BY_DESIGN = {"28872", "33333", "33334"}  # decayed, or elements that are no orbit
GIVEN_TWICE = {"20413"}  # with different elements
SATELLITE_5 = (
    "1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753",
    "2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667",
)


def published() -> dict[str, list[tuple[float, np.ndarray]]]:
    """Minutes since epoch and position, km, by catalogue number, as in tcppver.out."""
    vectors: dict[str, list[tuple[float, np.ndarray]]] = {}
    number = ""
    for line in (FILES / "tcppver.out").read_text().splitlines():
        words = line.split()
        if words[-1] == "xx":
            number = words[0].zfill(5)
            vectors.setdefault(number, [])
        else:
            vectors[number].append((float(words[0]), np.array(words[1:4], dtype=float)))
    return vectors


def element_sets() -> dict[str, tuple[str, str]]:
    lines = [
        line[:69] for line in (FILES / "SGP4-VER.TLE").read_text().splitlines() if line[:2] in ("1 ", "2 ")
    ]
    return {one[2:7]: (one, two) for one, two in zip(lines[::2], lines[1::2], strict=True)}


def epoch_of(line: str) -> Time:
    year, day = int(line[18:20]), float(line[20:32])
    new_year = Time(f"{1900 + year if year > 56 else 2000 + year}-01-01", scale="utc")
    return Time(new_year.jd1, new_year.jd2 + day - 1, format="jd", scale="utc")


@pytest.mark.parametrize("number", sorted(set(element_sets()) - FAILS_BY_DESIGN - GIVEN_TWICE))
def test_positions_are_the_published_ones(number):
    """To 1e-5 km: the file has 8 decimals, the epoch 8 decimals of a day, which is 6 mm in a low orbit."""
    lines = element_sets()[number]
    minutes = np.array([minute for minute, _ in published()[number]])
    expected = np.array([position for _, position in published()[number]])
    position, codes = ElementSet(lines, None).positions(
        epoch_of(lines[0]) + TimeDelta(minutes * 60, format="sec")
    )
    good = codes == 0
    assert good.sum() >= len(good) - 1
    np.testing.assert_allclose(position[good], expected[good], atol=1e-5)


def test_two_vectors_printed_in_the_report():
    elements = ElementSet(SATELLITE_5, None)
    time = epoch_of(SATELLITE_5[0]) + TimeDelta(np.array([0.0, 360.0 * 60]), format="sec")
    expected = [[7022.46529266, -1400.08296755, 0.03995155], [-7154.03120202, -3783.17682504, -3536.19412294]]
    np.testing.assert_allclose(elements.positions(time)[0], expected, atol=1e-6)


def test_track_turns_the_published_vectors_into_gcrs_as_astropy_does():
    """The whole path, interpolation included, against astropy's frames: 1 m at 8000 km is 0.03 arcsec."""
    epoch = epoch_of(SATELLITE_5[0])
    minutes = np.array([minute for minute, _ in published()["00005"]])[:5]
    teme = np.array([position for _, position in published()["00005"]])[:5]
    rows = recording(epoch, minutes * 60)
    frame = TEME(CartesianRepresentation(teme.T * u.km), obstime=rows.time)
    expected = frame.transform_to(GCRS(obstime=rows.time)).cartesian.xyz.to_value(u.km).T
    state = make_track(tle_scene(SATELLITE_5), rows).at(0.0, 0.0, 0.0)
    np.testing.assert_allclose(state.position.numpy(), expected, atol=1e-3)
    published_velocity = np.array([1.893841015, 6.405893759, 4.534807250])
    # SGP4's printed velocity is not quite the derivative of its position, which is what a track gives
    speed = float(torch.linalg.norm(state.velocity[0]))
    assert speed == pytest.approx(np.linalg.norm(published_velocity), abs=2e-3)


@pytest.mark.parametrize("lines", [ORBIT_1, ORBIT_3, MOLNIYA, LOW], ids=["geo", "meo", "molniya", "low"])
def test_interpolation_is_far_below_a_metre(lines):
    """Offsets of an hour and 10 deg along the track must be as good as SGP4 at that instant."""
    rng = np.random.default_rng(3)
    elements, start = ElementSet(lines, None), epoch_of(lines[0])
    seconds = np.sort(rng.uniform(0, 86400, 300))
    time = start + TimeDelta(seconds, format="sec")
    unturned = np.broadcast_to(np.eye(3), (300, 3, 3)).copy()
    motion = elements.motion(time, seconds - seconds[0], unturned, exposure_s=60.0)
    offset = rng.uniform(-3600, 3600, 300) + np.radians(10) / elements.mean_motion * rng.choice([-1, 1], 300)
    expected, codes = elements.positions(time + TimeDelta(offset, format="sec"))
    assert not codes.any()
    position, velocity = motion(torch.from_numpy(offset))
    np.testing.assert_allclose(position.numpy(), expected, atol=1e-6)
    step = 0.5
    later, _ = elements.positions(time + TimeDelta(offset + step, format="sec"))
    earlier, _ = elements.positions(time + TimeDelta(offset - step, format="sec"))
    np.testing.assert_allclose(velocity.numpy(), (later - earlier) / (2 * step), atol=2e-6)


def test_a_year_of_nights_needs_no_grid_over_the_days_between():
    lines, seconds = (
        ORBIT_1,
        np.concatenate([day * 86400.0 + np.arange(0, 7200, 60.0) for day in range(0, 360, 30)]),
    )
    time = epoch_of(lines[0]) + TimeDelta(seconds, format="sec")
    unturned = np.broadcast_to(np.eye(3), (len(seconds), 3, 3)).copy()
    elements = ElementSet(lines, None)
    motion = elements.motion(time, seconds, unturned, exposure_s=0.0)
    assert len(motion.coefficients) < 0.05 * 360 * 400
    np.testing.assert_allclose(
        motion(torch.zeros(len(seconds), dtype=torch.float64))[0].numpy(),
        elements.positions(time)[0],
        atol=1e-6,
    )


def test_failure_of_sgp4_names_the_time():
    lines = element_sets()["28872"]  # re-enters 50 minutes after its epoch
    rows = recording(epoch_of(lines[0]), np.array([0.0, 3600.0, 7200.0]))
    with pytest.raises(InputError, match=r"SGP4 fails at 2005-11-29T01:2.*decayed"):
        make_track(tle_scene(lines), rows)


def test_elements_that_are_no_orbit_are_bad_input():
    with pytest.raises(InputError, match="eccentricity"):
        ElementSet(element_sets()["33334"], None)


def test_catalogue_number_may_be_blanked_out():
    blank = tuple(line.replace("00001", "xxxxx", 1) for line in ORBIT_1)
    time = epoch_of(ORBIT_1[0]) + TimeDelta([0.0, 1000.0], format="sec")
    np.testing.assert_array_equal(
        ElementSet(blank, None).positions(time)[0], ElementSet(ORBIT_1, None).positions(time)[0]
    )
