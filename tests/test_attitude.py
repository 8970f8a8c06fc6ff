"""Attitude modes against scipy's rotations, astropy's frames, finite differences, and the paper's glints."""

from __future__ import annotations

import math

import astropy.units as u
import numpy as np
import pytest
import torch
from astropy.coordinates import BarycentricMeanEcliptic, SkyCoord
from astropy.time import Time, TimeDelta
from scipy.spatial.transform import Rotation, Slerp

from tests.paper_orbits import ORBIT_1, ORBIT_2, ORBIT_3, ORBIT_4, hours, recording, scene, tle_scene
from torchlc.errors import InputError
from torchlc.geometry.orbit import angle_between, make_track
from torchlc.geometry.rotation.attitude import Attitude, inertial, nadir, sun_pointing, yaw_steering

DAY = "2020-10-10"
START = f"{DAY}T12:00:00"
TORCH_WARNS = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")


def posed(attitude, lines=ORBIT_1, seconds=None, directory=None, values=None, **columns):
    """State and rotation of a scene with this attitude."""
    seconds = np.arange(0.0, 8 * 3600.0, 600.0) if seconds is None else seconds
    rows, ours = recording(START, seconds, **columns), tle_scene(lines, attitude, directory)
    state = make_track(ours, rows).at(0.0, 0.0, 0.0)
    return state, Attitude(ours, rows).rotation(state, values or {})


def unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


@pytest.mark.parametrize(
    "attitude",
    [
        'mode = "nadir"',
        'mode = "yaw-steering"\nspin_axis = [1, 2, 3]\nspin_rate = 4',
        'mode = "sun"\nspin_axis = [0, 0, -2]\nspin_rate = -1\nspin_phase = 30',
        'mode = "inertial"\nx_angle = 77',
        'mode = "spin-pole"\npole = [20, -40]\nperiod = 3\nphase = 10\nepoch = 2459133.0',
    ],
)
def test_every_mode_gives_right_handed_rotations(attitude):
    _, rotation = posed(attitude)
    assert rotation.shape == (48, 3, 3)
    np.testing.assert_allclose(rotation.mT @ rotation, torch.eye(3).expand(48, 3, 3), atol=1e-14)
    np.testing.assert_allclose(torch.linalg.det(rotation), 1.0, atol=1e-14)


# ---------------------------------------------------------------- the modes


def test_nadir_axes():
    """X against the chord of the path, Y against the normal of the plane through places of the orbit."""
    ours, step = tle_scene(ORBIT_4, 'mode = "nadir"'), 1.0
    rows = recording(START, np.arange(0.0, 8 * 3600.0, 600.0))
    track = make_track(ours, rows)
    state = track.at(0.0, 0.0, 0.0)
    x, y, z = Attitude(ours, rows).rotation(state, {}).unbind(-1)
    here = state.position.numpy()
    ahead, behind = (track.at(0.0, offset, 0.0).position.numpy() for offset in (step, -step))
    np.testing.assert_allclose(z, -unit(here), atol=1e-14)
    np.testing.assert_allclose(y, -unit(np.cross(behind, ahead)), atol=1e-8)
    path = unit(ahead - behind)
    np.testing.assert_allclose(
        x, unit(path - unit(here) * np.sum(path * unit(here), -1, keepdims=True)), atol=1e-8
    )


def test_yaw_steering_axes():
    state, rotation = posed('mode = "yaw-steering"', ORBIT_3)
    x, y, z = (axis.numpy() for axis in rotation.unbind(-1))
    sun = unit(state.sun.numpy())
    np.testing.assert_allclose(z, -unit(state.position.numpy()), atol=1e-14)
    np.testing.assert_allclose(np.sum(y * sun, -1), 0.0, atol=1e-14)
    assert (np.sum(x * sun, -1) > 0).all()  # the Sun is on the side of +X


def test_sun_axes():
    state, rotation = posed('mode = "sun"')
    x, _, z = (axis.numpy() for axis in rotation.unbind(-1))
    np.testing.assert_allclose(z, unit(state.sun.numpy()), atol=1e-14)
    # z_gcrs x Z is in the equator, 90 deg east of the Sun's right ascension
    right_ascension = np.arctan2(state.sun[:, 1].numpy(), state.sun[:, 0].numpy())
    expected = np.stack([-np.sin(right_ascension), np.cos(right_ascension), 0 * right_ascension], axis=-1)
    np.testing.assert_allclose(x, expected, atol=1e-12)


def test_inertial_axes():
    _, rotation = posed('mode = "inertial"\nx_angle = 30')
    np.testing.assert_allclose(
        rotation, np.tile(Rotation.from_euler("z", 30, degrees=True).as_matrix(), (48, 1, 1))
    )


@pytest.mark.parametrize("mode", ["nadir", "yaw-steering", "sun", "inertial"])
@pytest.mark.parametrize(
    ("epoch", "epoch_s"),
    [("", 0.0), ('spin_epoch = "2020-10-10T13:00:00"', 3600.0), ("spin_epoch = 2459133.0", 0.0)],
    ids=["first row", "ISO", "JD"],
)
def test_spin_is_a_right_handed_turn_about_a_body_axis(mode, epoch, epoch_s):
    spin = f'mode = "{mode}"\nspin_axis = [0.4, -0.7, 0.5]\nspin_rate = 1.7\nspin_phase = 25\n{epoch}'
    state, still = posed(f'mode = "{mode}"')
    _, spinning = posed(spin)
    angle = np.radians(25) + 2 * np.pi * 1.7 * (state.time.numpy() - epoch_s) / 3600
    turn = Rotation.from_rotvec(unit(np.array([0.4, -0.7, 0.5])) * angle[:, None])
    # a JD has 4e-5 s, 1e-7 rad at this rate
    np.testing.assert_allclose(spinning, still.numpy() @ turn.as_matrix(), atol=2e-7)


def test_default_epoch_stays_when_the_first_rows_are_dropped():
    ours = tle_scene(ORBIT_1, 'mode = "inertial"\nspin_axis = [0, 0, 1]\nspin_rate = 1')
    rows = recording(START, np.array([0.0, 900.0, 1800.0]))
    late = rows.keep(np.array([False, True, True]), "test")
    rotation = Attitude(ours, late).rotation(make_track(ours, late).at(0.0, 0.0, 0.0), {})
    np.testing.assert_allclose(
        rotation[0] @ torch.tensor([1.0, 0, 0], dtype=torch.float64), [0, 1, 0], atol=1e-9
    )


def test_values_stand_in_for_the_numbers_of_the_scene():
    free = (
        'mode = "inertial"\nspin_axis = [0, 0, 1]\nspin_phase = { value = 5, low = 0, high = 360 }\n'
        "spin_rate = { value = 2, low = 1, high = 3 }"
    )
    plain = 'mode = "inertial"\nspin_axis = [0, 0, 1]\nspin_phase = 40\nspin_rate = 1.5\nx_angle = 20'
    values = {"attitude.spin_phase": 40.0, "attitude.spin_rate": 1.5, "attitude.x_angle": 20.0}
    replaced = {name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()}
    np.testing.assert_allclose(posed(free, values=replaced)[1], posed(plain)[1], atol=1e-14)
    own = posed(free.replace("{ value = 5, low = 0, high = 360 }", "5"))[1]
    np.testing.assert_allclose(posed(free)[1], own, atol=1e-14)


# ---------------------------------------------------------------- where the paper's glints are


@pytest.mark.parametrize(
    ("lines", "angle_deg", "hour"), [(ORBIT_1, 1.13, 16.32), (ORBIT_2, 0.73, 15.48), (ORBIT_4, 5.4, 16.65)]
)
def test_glint_of_the_nadir_face(lines, angle_deg, hour):
    """Smallest angle between the bisector and +Z, and its UT on 10 October 2020, as published with them."""
    state, rotation = posed('mode = "nadir"', lines, np.arange(0.0, 8 * 3600.0, 10.0))
    bisector = unit(state.sun.numpy()) + unit(state.observer.numpy())
    angle = torch.rad2deg(angle_between(rotation[..., 2], torch.from_numpy(bisector)))
    assert float(angle.min()) == pytest.approx(angle_deg, abs=0.06 if angle_deg > 5 else 0.006)
    assert 12 + float(state.time[angle.argmin()]) / 3600 == pytest.approx(hour, abs=0.01)


def test_both_glints_of_object_1():
    """Both come within 2.37 deg on 17 October 2020, the panel's at 16.52 and that of +Z at 16.28 UT."""
    ours = tle_scene(ORBIT_1, 'mode = "nadir"')
    rows = recording("2020-10-17T00:00:00", hours(14.0, 21.0, 10.0))
    state = make_track(ours, rows).at(0.0, 0.0, 0.0)
    rotation = Attitude(ours, rows).rotation(state, {}).numpy()
    sun, y = unit(state.sun.numpy()), rotation[..., 1]
    panel = unit(sun - y * np.sum(sun * y, axis=-1, keepdims=True))
    bisector = torch.from_numpy(sun + unit(state.observer.numpy()))
    for normal, hour in ((panel, 16.52), (rotation[..., 2], 16.28)):
        angle = torch.rad2deg(angle_between(torch.from_numpy(normal.copy()), bisector))
        assert float(angle.min()) == pytest.approx(2.37, abs=0.006)
        assert 14 + float(state.time[angle.argmin()]) / 3600 == pytest.approx(hour, abs=0.01)


# ---------------------------------------------------------------- spin-pole


def asteroid(attitude, frame="ecliptic", seconds=None, distance_km=1.5e8, **columns):
    seconds = np.linspace(0.0, 20000.0, 9) if seconds is None else seconds
    direction = np.tile([0.6, 0.0, 0.8], (len(seconds), 1))
    columns = {"sun": direction * 2e8, "obs": direction * distance_km} | columns
    rows, ours = recording(START, seconds, **columns), scene(f'vectors = "{frame}"', attitude)
    return Attitude(ours, rows).rotation(make_track(ours, rows).at(0.0, 0.0, 0.0), {}), seconds


SPIN_POLE = 'mode = "spin-pole"\npole = [17, 11]\nperiod = 5.27\nphase = 203.7\nepoch = "2020-10-10T11:00:00"'


def test_spin_pole_is_the_euler_sequence_z_y_z():
    rotation, seconds = asteroid(SPIN_POLE, "icrs", light_time_corrected=True)
    turn = 203.7 + 360 * (seconds + 3600) / 3600 / 5.27
    angles = np.stack([np.full(9, 17.0), np.full(9, 90.0 - 11), turn], axis=-1)
    np.testing.assert_allclose(
        rotation, Rotation.from_euler("ZYZ", angles, degrees=True).as_matrix(), atol=1e-12
    )


def test_spin_pole_is_in_the_frame_of_the_vectors():
    """0.1 arcsec: astropy's ecliptic is the IAU 2006 one and has the frame bias."""
    rotation, _ = asteroid(SPIN_POLE, light_time_corrected=True)
    pole = SkyCoord(17 * u.deg, 11 * u.deg, frame=BarycentricMeanEcliptic(equinox="J2000")).icrs
    np.testing.assert_allclose(rotation[0, :, 2], pole.cartesian.xyz.value, atol=0.1 / 206265)


def test_spin_pole_takes_off_the_light_time():
    """1 au is 499.005 s: the body is seen as it was, 9.47 deg of phase earlier."""
    now, _ = asteroid(SPIN_POLE, light_time_corrected=True, distance_km=149597870.7)
    seen, _ = asteroid(SPIN_POLE, distance_km=149597870.7)
    back = Rotation.from_matrix(now.numpy()).inv() * Rotation.from_matrix(seen.numpy())
    expected = -2 * np.pi * 499.004784 / 3600 / 5.27
    np.testing.assert_allclose(back.as_rotvec(), np.tile([0, 0, expected], (9, 1)), atol=1e-9)


def test_spin_pole_epoch_far_away_loses_no_phase():
    """30 years, 5e4 turns; times in TDB, so no leap second counts."""
    n, epoch = 5, Time(2451545.0, format="jd", scale="tdb")
    rows_at = epoch + TimeDelta(30 * 365.25 + np.arange(n) * 0.01, format="jd")
    seconds = np.arange(n) * 864.0
    direction = np.tile([1.0, 0.0, 0.0], (n, 1))
    rows = recording(
        rows_at[0], seconds, "tdb", sun=direction * 2e8, obs=direction * 1e8, light_time_corrected=True
    )
    ours = scene(
        'vectors = "icrs"', 'mode = "spin-pole"\npole = [0, 90]\nperiod = 5.27\nphase = 0\nepoch = 2451545.0'
    )
    rotation = Attitude(ours, rows).rotation(make_track(ours, rows).at(0.0, 0.0, 0.0), {})
    turns = (30 * 365.25 * 24 + seconds / 3600) / 5.27
    expected = np.stack([np.cos(2 * np.pi * (turns % 1)), np.sin(2 * np.pi * (turns % 1))], axis=-1)
    np.testing.assert_allclose(rotation[:, :2, 0], expected, atol=1e-7)


# ---------------------------------------------------------------- quaternions


def quaternion_file(folder, knots, rotations, signs=None, header="time,q0,q1,q2,q3", times=None):
    """Scalar-first rows at seconds ``knots`` after START."""
    signs = np.ones(len(knots)) if signs is None else signs
    texts = (Time(START, scale="utc") + TimeDelta(knots, format="sec")).isot if times is None else times
    q = rotations.as_quat(scalar_first=True) * signs[:, None]
    lines = [
        header,
        *(f"{text},{a:.17g},{b:.17g},{c:.17g},{d:.17g}" for text, (a, b, c, d) in zip(texts, q, strict=True)),
    ]
    (folder / "q.csv").write_text("\n".join(lines) + "\n")
    return 'mode = "quaternions"\nfile = "q.csv"'


KNOTS = np.array([-60.0, 0.0, 500.0, 900.0, 1500.0, 3700.0])
ROWS = np.array([0.0, 1.0, 499.0, 500.0, 800.0, 2000.0, 3600.0])


def test_quaternions_against_scipy(tmp_path):
    """Signs at will, rows in any order: the same rotations as scipy's Slerp."""
    rng = np.random.default_rng(7)
    rotations = Rotation.random(len(KNOTS), rng=rng)
    expected = Slerp(KNOTS, rotations)(ROWS).as_matrix()
    order, signs = rng.permutation(len(KNOTS)), rng.choice([-1.0, 1.0], len(KNOTS))
    attitude = quaternion_file(tmp_path, KNOTS[order], rotations[order], signs)
    np.testing.assert_allclose(posed(attitude, seconds=ROWS, directory=tmp_path)[1], expected, atol=1e-9)


def test_quaternion_of_a_quarter_turn_about_z(tmp_path):
    """v_gcrs = q v_body q*: with q = (cos 45, 0, 0, sin 45) body X is seen along y_gcrs."""
    attitude = quaternion_file(tmp_path, KNOTS, Rotation.from_euler("z", np.full((6, 1), 90.0), degrees=True))
    _, rotation = posed(attitude, seconds=ROWS, directory=tmp_path)
    np.testing.assert_allclose(rotation[:, :, 0], np.tile([0, 1, 0], (7, 1)), atol=1e-12)


def test_quaternion_times_may_be_julian_dates(tmp_path):
    rotations = Rotation.from_euler("z", KNOTS[:, None] * 0.05, degrees=True)
    jd = [f"{2459133.0 + knot / 86400:.10f}" for knot in KNOTS]
    attitude = quaternion_file(tmp_path, KNOTS, rotations, times=jd)
    _, rotation = posed(attitude, seconds=ROWS, directory=tmp_path)
    expected = Rotation.from_euler("z", ROWS[:, None] * 0.05, degrees=True).as_matrix()
    np.testing.assert_allclose(rotation, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"knots": KNOTS[1:] + 2.0}, "2 rows of the recording outside, the first at 2020-10-10T12:00:00"),
        ({"header": "time,w,x,y,z"}, "no column q0"),
        ({"header": "# time_scale: tai\ntime,q0,q1,q2,q3"}, "metadata time_scale: 'tai'; expected utc"),
        ({"times": ["2020-10-10T12:00:00"] * 6}, "time of another row"),
        ({"times": ["now"] * 6}, "row 1, column time.*ISO"),
        ({"signs": np.array([1, 1, 3, 1, 1, 1.0])}, "row 3, column q0.*length 3"),
    ],
)
def test_quaternion_files_that_cannot_be_used(tmp_path, change, message):
    knots = change.pop("knots", KNOTS)
    attitude = quaternion_file(tmp_path, knots, Rotation.from_euler("z", knots[:, None]), **change)
    with pytest.raises(InputError, match=message):
        posed(attitude, seconds=ROWS, directory=tmp_path)


# ---------------------------------------------------------------- derivatives, batches, corners


@TORCH_WARNS
@pytest.mark.parametrize(
    ("attitude", "values"),
    [
        ('mode = "sun"\nspin_axis = [1, 1, 0]\nspin_rate = 1', {"spin_rate": 2.0, "spin_phase": 10.0}),
        ('mode = "inertial"', {"x_angle": 12.0}),
        (SPIN_POLE, {"pole_lon": 10.0, "pole_lat": -35.0, "period": 6.0, "phase": 100.0}),
    ],
)
def test_derivatives_and_batches(attitude, values):
    ours = tle_scene(ORBIT_1, attitude)
    rows = recording(START, np.arange(0.0, 3600.0, 900.0))
    track, turned = make_track(ours, rows), Attitude(ours, rows)
    names = [f"attitude.{name}" for name in values]

    def outcome(theta, offset=0.0):
        return turned.rotation(track.at(0.0, offset, 0.0), dict(zip(names, theta, strict=True)))

    start = torch.tensor(list(values.values()), dtype=torch.float64)
    gradient = torch.func.jacfwd(outcome)(start)
    for index in range(len(start)):
        shift = torch.zeros_like(start)
        shift[index] = 1e-5
        difference = (outcome(start + shift) - outcome(start - shift)) / 2e-5
        np.testing.assert_allclose(gradient[..., index], difference, atol=1e-7)
    batch = start * torch.linspace(0.9, 1.1, 5, dtype=torch.float64)[:, None]
    np.testing.assert_allclose(
        torch.vmap(outcome)(batch), torch.stack([outcome(row) for row in batch]), atol=1e-13
    )
    # the same by broadcasting, as instants (Q, T) within exposures come in
    offsets = torch.tensor([[-5.0], [0.0], [5.0]], dtype=torch.float64)
    together = outcome(start, offsets)
    np.testing.assert_allclose(
        together, torch.stack([outcome(start, float(x)) for x in offsets[:, 0]]), atol=1e-13
    )


def test_derivative_in_time_through_quaternions(tmp_path):
    rotations = Rotation.random(len(KNOTS), rng=np.random.default_rng(2))
    ours = tle_scene(ORBIT_1, quaternion_file(tmp_path, KNOTS, rotations), tmp_path)
    rows = recording(START, np.array([100.0, 1000.0]))
    track, turned = make_track(ours, rows), Attitude(ours, rows)

    def outcome(offset):
        return turned.rotation(track.at(0.0, offset, 0.0), {})

    offset = torch.tensor(7.0, dtype=torch.float64)
    _, slope = torch.func.jvp(outcome, (offset,), (torch.ones_like(offset),))
    np.testing.assert_allclose(slope, (outcome(offset + 0.1) - outcome(offset - 0.1)) / 0.2, atol=1e-8)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sun_along_the_nadir_leaves_a_finite_attitude_and_gradient(sign):
    position = torch.tensor(
        [[42164.0, 0.0, 0.0], [0.0, -42164.0, 0.0]], dtype=torch.float64, requires_grad=True
    )
    rotation = yaw_steering(position, sign * position.detach() * 3000)
    np.testing.assert_allclose((rotation.mT @ rotation).detach(), torch.eye(3).expand(2, 3, 3), atol=1e-14)
    np.testing.assert_allclose(rotation[..., 2].detach(), [[-1, 0, 0], [0, 1, 0]])
    (gradient,) = torch.autograd.grad(rotation.sum(), position)
    assert torch.isfinite(gradient).all()


def test_other_aligned_directions_are_safe_too():
    pole = torch.tensor([[0.0, 0.0, 1.5e8]], dtype=torch.float64)
    for rotation in (sun_pointing(pole), nadir(pole, -pole), inertial(torch.zeros(1, dtype=torch.float64))):
        np.testing.assert_allclose(torch.linalg.det(rotation), 1.0, atol=1e-14)


def test_a_mode_that_needs_what_the_recording_lacks():
    direction = np.tile([1e5, 2e5, 3e5], (2, 1))
    bare = recording(START, np.array([0.0, 1.0]), sun=direction, obs=direction)
    with pytest.raises(InputError, match=r"nadir.*no position.*v_x v_y v_z"):
        Attitude(scene('vectors = "icrs"', 'mode = "nadir"'), bare)
    with pytest.raises(InputError, match=r"yaw-steering.*no position.*r_x r_y r_z"):
        Attitude(scene('vectors = "icrs"', 'mode = "yaw-steering"'), bare)
    placed = recording(START, np.array([0.0, 1.0]), sun=direction, obs=direction, position=direction)
    with pytest.raises(InputError, match=r"nadir.*no velocity"):
        Attitude(scene('vectors = "icrs"', 'mode = "nadir"'), placed)
    Attitude(scene('vectors = "icrs"', 'mode = "yaw-steering"'), placed)
    with pytest.raises(InputError, match=r"nadir.*no velocity"):
        Attitude(scene("altaz = true", 'mode = "nadir"'), recording(START, np.zeros(1)))


def test_paper_attitude_1_turns_once_an_hour_against_the_orbital_frame():
    """Nadir with a turn about Y: after an hour the axes of the orbital frame are back, 15 deg on in space."""
    state, rotation = posed(
        'mode = "nadir"\nspin_axis = [0, 1, 0]\nspin_rate = 1', seconds=np.array([0.0, 3600.0])
    )
    still = nadir(state.position, state.velocity)
    np.testing.assert_allclose(rotation, still, atol=1e-9)
    turned = float(torch.rad2deg(angle_between(rotation[0, :, 0], rotation[1, :, 0])))
    assert turned == pytest.approx(15.04, abs=0.1)
    assert math.isclose(float(rotation[0, :, 1] @ rotation[1, :, 1]), 1.0, abs_tol=1e-6)
