"""The brute-force reference against closed forms: it judges the package, so it must be right on its own."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "examples" / "reference"))

import body  # noqa: E402
import bounces  # noqa: E402
import bruteforce as reference  # noqa: E402
import detector  # noqa: E402
import earth  # noqa: E402
import face_light  # noqa: E402
import observe  # noqa: E402
import sampling  # noqa: E402
import sky  # noqa: E402
import surface  # noqa: E402

PRACTICE = ROOT.parent / "shared" / "practice"
GEO = """
    [orbit]
    tle = ["1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993",
           "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966"]
    [[stations]]
    id = "weihai"
    latitude = 37.536
    longitude = 122.05
    height = 110.0
"""
LAMBERT = """
    [materials.white]
    model = "lambert"
    albedo = 0.5
    [model]
    effects = []
"""


def scene(middle: str, materials: str = LAMBERT) -> body.Scene:
    return body.Scene.parse(GEO + middle + materials)


def directions(count: int, seed: int = 3) -> np.ndarray:
    return sky.unit(np.random.default_rng(seed).normal(size=(count, 3)))


# ---------------------------------------------------------------------------------------------- sky


def test_sidereal_angle_of_vallado_example() -> None:
    """Vallado (2013), example 3-5: 1992 August 20, 12:14 UT1 has GMST 152.578 787 886 deg."""
    angle = np.rad2deg(sky.sidereal_angle(np.array(sky.seconds("1992-08-20T12:14:00"))))
    assert angle == pytest.approx(152.578787886, abs=1e-6)


def test_teme_to_gcrs_of_vallado_example() -> None:
    """AIAA 2006-6753, catalogue number 00005 at epoch + 4320 min: TEME and J2000 positions, km."""
    t = np.array(sky.seconds("2000-06-30T18:50:19.733571"))
    teme = np.array([-9060.47373569, 4658.70952502, 813.68673153])
    j2000 = np.array([-9059.9413786, 4659.6972000, 813.9588875])
    assert np.linalg.norm(sky.teme_to_gcrs(t) @ teme - j2000) < 0.005  # 0.1" at 10 000 km


def test_sun_of_meeus_example() -> None:
    """Meeus, Astronomical Algorithms, example 25.b: 1992 October 13.0 TD, apparent Sun of date.

    True longitude and radius 0.99760775 au; right ascension 13h13m30.749s, declination -7 47' 01.74".
    """
    t = np.array(sky.seconds("1992-10-13T00:00:00") - 27.0 - 32.184)  # UTC: 27 leap seconds and TT - TAI
    vector = sky.teme_to_gcrs(t).T @ sky.sun(t)  # equator of date, but mean equinox
    right_ascension = np.rad2deg(np.arctan2(vector[1], vector[0]))
    equation_of_equinoxes = 15.908 * np.cos(np.deg2rad(23.44)) / 3600.0  # dpsi = 15.908", same example
    expected = (13 + 13 / 60 + 30.749 / 3600) * 15.0 - 360.0
    assert right_ascension + equation_of_equinoxes == pytest.approx(expected, abs=0.3 / 3600)
    declination = np.rad2deg(np.arcsin(vector[2] / np.linalg.norm(vector)))
    assert declination == pytest.approx(-(7 + 47 / 60 + 1.74 / 3600), abs=0.3 / 3600)
    assert np.linalg.norm(vector) / sky.AU_KM == pytest.approx(0.99760775, abs=2e-6)


def test_object_1_geometry_of_one_night() -> None:
    """17 October 2020: least phase angle 16.8 deg at 16.52 UT, airmass 1.39-1.46; ranges from astropy."""
    one = scene("""
        [attitude]
        mode = "nadir"
        [[components]]
        name = "body"
        shape = "box"
        size = [2.010, 1.712, 2.189]
        material = "white"
    """)
    hours = np.linspace(14.0, 21.0, 351)
    t = sky.seconds("2020-10-17T00:00:00") + hours * 3600.0
    curve = reference.simulate(one, t, 1.0, "weihai", {})
    assert hours[curve.phase_deg.argmin()] == pytest.approx(16.52, abs=0.03)
    assert curve.phase_deg.min() == pytest.approx(16.8, abs=0.05)
    assert (curve.airmass.min(), curve.airmass.max()) == pytest.approx((1.39, 1.46), abs=0.01)
    assert (curve.range_km.min(), curve.range_km.max()) == pytest.approx((37333.1, 37544.0), abs=0.5)


# ---------------------------------------------------------------------------------------------- surfaces


def hemisphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions over the hemisphere about z, uniform in the squared sine, and mu d(omega) of each."""
    q = sampling.additive_sequence(count, 2)
    sine, angle = np.sqrt(q[:, 0]), 2.0 * np.pi * q[:, 1]
    return np.stack([sine * np.cos(angle), sine * np.sin(angle), np.sqrt(1 - q[:, 0])], -1), np.pi / count


@pytest.mark.parametrize(
    "material",
    [
        {"n": 30.0, "r_spec": 0.5, "r_diff": 0.5},
        {"n": 300.0, "r_spec": 0.8, "r_diff": 0.2},
        {"model": "ggx", "alpha": 0.3, "f0": 0.9, "r_diff": 0.0},
        {"model": "beckmann", "alpha": 0.3, "f0": 0.9, "r_diff": 0.0},
    ],
)
def test_no_surface_reflects_more_than_it_gets(material: dict[str, float]) -> None:
    out, weight = hemisphere(40000)
    axes = [np.broadcast_to(a, out.shape) for a in np.eye(3)]
    for zenith in (0.0, 40.0, 70.0):
        sun = np.broadcast_to([np.sin(np.deg2rad(zenith)), 0.0, np.cos(np.deg2rad(zenith))], out.shape)
        light = surface.reflected(material, {}, axes[2], axes[0], axes[1], sun, out)
        reflectance = (light / out[:, 2]).sum() * weight / sun[0, 2]
        assert 0.0 < reflectance < 1.005


def test_diffuse_term_has_its_hemispherical_reflectance() -> None:
    """Integrating eq. 6 over the hemisphere: r_diff (1 - r_spec) [1 - (1 - mu0/2)^5] exactly."""
    out, weight = hemisphere(40000)
    axes = [np.broadcast_to(a, out.shape) for a in np.eye(3)]
    for mu0 in (0.2, 0.7, 1.0):
        sun = np.broadcast_to([np.sqrt(1 - mu0**2), 0.0, mu0], out.shape)
        both = [
            surface.reflected({"n": 9.0, "r_spec": 0.2, "r_diff": r}, {}, axes[2], axes[0], axes[1], sun, out)
            for r in (0.7, 0.0)
        ]
        reflectance = ((both[0] - both[1]) / out[:, 2]).sum() * weight / mu0
        assert reflectance == pytest.approx(0.7 * 0.8 * (1.0 - (1.0 - mu0 / 2.0) ** 5), rel=1e-3)


def test_polished_surface_reflects_r_spec() -> None:
    """A narrow lobe is a mirror: its reflectance at normal incidence is r_spec, less terms of order 1/n."""
    n = 3000.0
    q = sampling.additive_sequence(20000, 2)
    sine, angle = np.sqrt(q[:, 0]) * 0.3, 2.0 * np.pi * q[:, 1]
    out = np.stack([sine * np.cos(angle), sine * np.sin(angle), np.sqrt(1 - sine**2)], -1)
    axes = [np.broadcast_to(a, out.shape) for a in np.eye(3)]
    material = {"n": n, "r_spec": 0.6, "r_diff": 0.0}
    light = surface.reflected(material, {}, axes[2], axes[0], axes[1], axes[2], out)
    assert (light / out[:, 2]).mean() * np.pi * 0.09 == pytest.approx(0.6, rel=5e-3)


@pytest.mark.parametrize("n", [20.0, 2000.0])
@pytest.mark.parametrize("g", [1.5, 2.0, 5.0])
def test_tailed_lobe_has_the_half_width_and_the_integral(n: float, g: float) -> None:
    slope, constant = surface.tail_lobe(n, g)
    cos_half = 0.5 ** (1.0 / n)
    peak = constant * (1.0 + slope) ** -g
    assert constant * (1.0 + slope * cos_half**2) ** -g == pytest.approx(peak / 2.0, rel=1e-9)
    if g == 2.0:  # int_0^1 dx/(1 + s x^2)^2 = [x/(1 + s x^2) + artanh(k x)/k]/2 at 1, k^2 = -s
        k = np.sqrt(-slope)
        assert 1.0 / constant == pytest.approx(np.pi * (1.0 / (1.0 + slope) + np.arctanh(k) / k), rel=1e-6)


# ------------------------------------------------------------------------------------------ shape and light


def light_of(
    one: body.Scene, to_sun: list[float], to_observer: list[float], effects: dict, samples: int = 20000
) -> np.ndarray:
    """Sum of A f mu0 mu V of each face of fixed parts, (faces,), with both directions in the body frame."""
    parts, faces = body.build(one.components, 720)
    q = np.mod(sampling.additive_sequence(samples, 6)[None, :, 2:] + 0.37, 1.0)
    source, target = (
        np.broadcast_to(sky.unit(np.asarray(d, float)), (1, samples, 3)) for d in (to_sun, to_observer)
    )
    weight = np.full((1, samples), 1.0 / samples)
    poses = [None] * len(parts)
    return face_light.face_light(faces, parts, poses, one, effects, source, weight, target, q)[0]


ATTITUDE = """
    [attitude]
    mode = "nadir"
"""


def plate(
    name: str, centre: list[float], u: str = "[1, 0, 0]", v: str = "[0, 1, 0]", size: str = "[1, 1]"
) -> str:
    return f"""
    [[components]]
    name = "{name}"
    shape = "plate"
    size = {size}
    centre = {centre}
    u = {u}
    v = {v}
    material = "white"
    """


def test_white_cylinder_follows_the_closed_form() -> None:
    """Lambert wall: albedo R L sin(s) sin(o) [sin psi + (pi - psi) cos psi]/(2 pi), angles from the axis."""
    one = scene(
        ATTITUDE
        + """
    [[components]]
    name = "tank"
    shape = "cylinder"
    radius = 1.5
    length = 4.0
    axis = [0, 0, 1]
    material = "white"
    """
    )
    for psi in np.deg2rad([0.0, 50.0, 120.0]):
        wall = light_of(one, [1, 0, 0.5], [np.cos(psi), np.sin(psi), -0.3], {}, 1)[:-2].sum()
        across = 1.0 / np.sqrt(1.25) / np.sqrt(1.09)
        closed = 0.5 * 1.5 * 4.0 * across * (np.sin(psi) + (np.pi - psi) * np.cos(psi)) / (2.0 * np.pi)
        assert wall == pytest.approx(closed, rel=1e-4)


def test_a_plate_shades_half_of_another() -> None:
    """Unit plates a unit apart, light and sight along (1/2, 0, 1): half of the lower one is lost, once."""
    one = scene(ATTITUDE + plate("low", [0, 0, 0]) + plate("high", [0, 0, 1]))
    bare = light_of(one, [0.5, 0, 1], [0.5, 0, 1], {})
    shaded = light_of(one, [0.5, 0, 1], [0.5, 0, 1], {"self_shadowing": {}})
    assert shaded[0] / bare[0] == pytest.approx(0.5, abs=2e-3)
    assert shaded[2] == pytest.approx(bare[2])
    opposite = light_of(one, [0.5, 0, 1], [-0.5, 0, 1], {"self_shadowing": {}})
    assert opposite[0] / bare[0] < 1e-3  # one half lost to the Sun, the other half to the observer


def test_a_box_and_a_cylinder_stop_rays() -> None:
    """Rays of known impact parameter against a box and a tank of half width 1."""
    y = np.linspace(-3.0, 3.0, 601)
    origin = np.stack([np.full_like(y, -5.0), y, np.full_like(y, 0.2)], -1)
    along = np.broadcast_to([1.0, 0.0, 0.0], origin.shape)
    for hit in (body.hits_box(np.array([1.0, 1.0, 1.0])), body.hits_cylinder(1.0, 1.0)):
        assert np.array_equal(hit(origin, along), np.abs(y) < 1.0 - 1e-12)
        assert not hit(origin, -along).any()
        assert not hit(origin + np.array([0.0, 0.0, 1.0]), along).any()


def test_white_squares_exchange_light_by_their_view_factor() -> None:
    """Perpendicular unit squares with a common edge: view factor 0.20004 (textbook value)."""
    one = scene(
        ATTITUDE + plate("floor", [0, 0, 0]) + plate("wall", [-0.5, 0, 0.5], "[0, 1, 0]", "[0, 0, 1]")
    )
    parts, faces = body.build(one.components, 8)
    twice = bounces.two_bounces(
        faces, parts, [None, None], one, np.array([[1e-9, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]), 65536,
        np.random.default_rng(1),
    )  # fmt: skip
    view_factor = twice.sum() / (0.5 * 0.5 / np.pi)
    assert view_factor == pytest.approx(0.20004, rel=0.02)


def test_earth_light_of_a_full_and_a_half_earth() -> None:
    """Far away: (2/3) albedo (R/r)^2 [sin b + (pi - b) cos b]/pi."""
    r = 1.0e6
    for b in (0.0, np.pi / 2, 2.0):
        sun = np.array([[np.cos(b), np.sin(b), 0.0]]) * sky.AU_KM
        _, weight = earth.earth_light(np.array([[r, 0.0, 0.0]]), sun, 20000, 0.3)
        closed = (
            (2 / 3) * 0.3 * (earth.MEAN_RADIUS_KM / r) ** 2 * (np.sin(b) + (np.pi - b) * np.cos(b)) / np.pi
        )
        assert weight.sum() == pytest.approx(closed, rel=0.015)


def test_the_solar_disc_dulls_a_glint() -> None:
    """1/n_eff = 1/n + 0.90 (theta/4)^2, limb-darkened, to first order: 11 % off at n = 1e5, 1.3 % at 1e4."""
    for n in (1e4, 1e5):
        q = sampling.additive_sequence(20000, 2)
        up = np.broadcast_to([0.0, 0.0, 1.0], (20000, 3))
        theta = np.full(20000, sky.SUN_RADIUS_KM / sky.AU_KM)
        sun = sampling.disc_point(up, theta, *q.T)
        limb = sampling.limb(q[:, 0])
        material = {"n": n, "r_spec": 1.0, "r_diff": 0.0}
        axes = [np.broadcast_to(a, up.shape) for a in np.eye(3)]
        light = surface.reflected(material, {}, axes[2], axes[0], axes[1], sun, up)
        point = surface.reflected(material, {}, *(a[:1] for a in (axes[2], axes[0], axes[1], up, up)))
        closed = 1.0 / (1.0 + n * 0.9 * (theta[0] / 4.0) ** 2)
        assert (light * limb).mean() / point[0] == pytest.approx(closed, abs=0.3 * (1.0 - closed) ** 2 + 1e-4)


# ------------------------------------------------------------------------------------------ Earth's shadow


def test_earth_hides_by_its_polar_and_equatorial_radius() -> None:
    """Parallel rays over the pole and over the equator: hidden exactly below b + h0 and a + h0."""
    along = np.array([1.0, 0.0, 0.0])
    a, b, h0 = 6378.137, 6356.7523, 30.0
    for axis, limb in ((1, a + h0), (2, b + h0)):
        for sign in (-1.0, 1.0):
            place = np.array([-42164.0, 0.0, 0.0])
            place[axis] = limb + sign * 0.1
            assert bool(earth.behind_earth(place, along, h0)) == (sign < 0)
    assert not earth.behind_earth(np.array([42164.0, 0.0, 0.0]), along, h0)


def test_penumbra_of_a_straight_limb() -> None:
    """Sunlit share by depth: none, half (the limb's curvature takes 0.6 %), all; falling on the way in."""
    sun = np.array([sky.AU_KM, 0.0, 0.0])
    limb = np.arcsin(6378.137 / 42164.0)
    angle = limb + np.linspace(0.3, -0.3, 13) * np.pi / 180.0
    place = 42164.0 * np.stack([-np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    share = earth.sunlit_fraction(place, sun - place, 0.0)
    assert share[0] == 1.0 and share[-1] == 0.0
    assert share[6] == pytest.approx(0.5, abs=0.01)
    assert np.all(np.diff(share) <= 0)


def test_umbra_of_one_night() -> None:
    """10 October 2020: penumbra 16.199-16.648 UT; the grazing umbra of the flattened Earth lasts 9.8 min."""
    one = scene(ATTITUDE + plate("a", [0, 0, 0]))
    hours = np.arange(16.1, 16.75, 0.004)
    t = sky.seconds("2020-10-10T00:00:00") + 3600.0 * hours
    share = reference.simulate(one, t, 1.0, "weihai", {"earth_shadow": {"h0": 0.0}}).sunlit
    dark, partly = hours[share == 0], hours[share < 1]
    assert (partly[0], partly[-1]) == pytest.approx((16.199, 16.648), abs=0.02)
    assert (dark[-1] - dark[0]) * 60.0 == pytest.approx(9.8, abs=0.8)


# ---------------------------------------------------------------------------------------------- pointing


def test_nadir_axes() -> None:
    orbit = sky.Orbit(
        ("1 00003U 14026A   20284.37504348 -.00000027  00000-0  00000-0 0  9996",
         "2 00003  56.2287  52.2835 0020597 291.4800  68.3069  2.00569053 46908")
    )  # fmt: skip
    position, velocity = orbit.state(sky.seconds("2020-10-10T12:00:00") + np.arange(5) * 4000.0)
    axes = body.body_axes({"mode": "nadir"}, position, velocity, directions(5))
    np.testing.assert_allclose(axes[..., 2], -sky.unit(position), atol=1e-12)
    np.testing.assert_allclose(axes[..., 1], -sky.unit(np.cross(position, velocity)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)


def test_wing_follows_the_sun_and_its_errors_are_what_they_say() -> None:
    one = scene(ATTITUDE + plate("wing", [0, 3, 0]) + '    tracks = { target = "sun", axis = [0, 1, 0] }\n')
    part = body.build(one.components, 8)[0][0]
    to_sun = directions(50)
    nominal, ahead, canted = (
        body.wing_pose(part, to_sun, *np.deg2rad(errors)) @ part.front for errors in ((0, 0), (2, 0), (0, 3))
    )
    np.testing.assert_allclose((nominal * to_sun).sum(-1), np.sqrt(1.0 - to_sun[:, 1] ** 2), atol=1e-12)
    turned = np.cross(nominal, ahead)  # right-handed about +Y by 2 deg
    np.testing.assert_allclose(turned[:, 1], np.sin(np.deg2rad(2.0)), atol=1e-12)
    np.testing.assert_allclose(canted[:, 1], np.sin(np.deg2rad(3.0)), atol=1e-12)


def test_clock_error_reads_the_curve_elsewhere() -> None:
    one = scene(ATTITUDE + plate("a", [0, 0, 0]))
    t = sky.seconds("2020-10-17T15:00:00") + np.arange(20) * 300.0
    late = reference.simulate(one, t, 1.0, "weihai", {"time_offset": {"s": 300.0}}).flux
    np.testing.assert_allclose(late[:-1], reference.simulate(one, t, 1.0, "weihai", {}).flux[1:], rtol=1e-9)


def test_where_all_is_does_not_depend_on_materials() -> None:
    """A bright plate, from where a dark one was, gives the same light to the last bit as from the beginning; and 3.2 times the dark one's."""
    dark = scene(ATTITUDE + plate("a", [0, 0, 0])).with_materials(
        {"white": {"model": "lambert", "albedo": 0.25}}
    )
    bright = dark.with_materials({"white": {"model": "lambert", "albedo": 0.8}})
    t = sky.seconds("2020-10-17T15:00:00") + np.arange(20) * 300.0
    effects = {"exposure_smearing": {}, "time_offset": {"s": 3.0}, "self_shadowing": {}}
    times = (t, 30.0, "weihai", effects)
    known = reference.placed(dark, *times, instants=4)
    anew, again = (reference.simulate(bright, *times, instants=4, known=one).flux for one in (None, known))
    assert (anew == again).all()
    of_dark = reference.simulate(dark, *times, instants=4, known=known).flux
    np.testing.assert_allclose(again, 0.8 / 0.25 * of_dark, rtol=1e-12)


CASES = sorted(p.parent.name for p in PRACTICE.glob("*/answer.json"))


@pytest.mark.parametrize("case", CASES or ["none"])
def test_practice_recordings_are_reproduced(case: str) -> None:
    """Recordings of another generator, at true materials and effects: chi2 is that of the noise."""
    folder = PRACTICE / case
    if not folder.is_dir():
        pytest.skip("../shared/practice is not here")
    answer = json.loads((folder / "answer.json").read_text())
    if "true_numbers" in answer or "pole" in answer:
        pytest.skip("the scene is not that of the truth: sizes, pointing or rotation are to be found")
    one = body.Scene.read(folder / "scene.toml").with_materials(answer["materials"])
    t, mag, error, exptime, station = observe.read_recording(folder / "recording.ecsv")
    effects = {**reference.scene_effects(one), **answer["parameters"]}
    if "appendage" in effects:  # that generator gives the plate's sides and place
        made = effects["appendage"]["plates"][0]
        x, y, z = sky.unit(np.cross(made["u"], made["v"]))
        effects["appendage"] = {
            "area": made["size"][0] * made["size"][1],
            "lon": np.rad2deg(np.arctan2(y, x)),
            "lat": np.rad2deg(np.arcsin(z)),
            **effects["appendage"]["material"],
        }
    model = detector.photometry(
        reference.simulate(one, t, exptime, station, effects, samples=2048), one, effects
    )
    sigma = np.hypot(error, effects.get("jitter", {}).get("mag", 0.0))
    chi2 = (((mag - model) / sigma) ** 2).mean()
    assert abs(chi2 - 1.0) < 3.0 * np.sqrt(2.0 / len(t))
