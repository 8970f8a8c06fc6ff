"""Glints of predictions: when a mirror bisects Sun and observer, not in the umbra, and every turn of a spinner."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skyfield.api import EarthSatellite, wgs84

import torchlc
from tests.paper_orbits import HEIGHT, LATITUDE, LONGITUDE, LOW
from tests.prediction_case import SPAN, at, scene


def test_a_mirror_glints_when_it_bisects_sun_and_observer(sky):
    """A plate at rest among the stars whose normal is Skyfield's bisector at one instant: the glint is at that instant. 20 m
    of station and 0.3" of the Sun move the bisector by 5", the grid of 10 s is interpolated: within 0.5 s."""
    timescale, ephemeris = sky
    satellite, station = EarthSatellite(*LOW, ts=timescale), wgs84.latlon(LATITUDE, LONGITUDE, HEIGHT)
    plain = torchlc.predict(scene(), **SPAN, sun=90.0)
    path = next(one.path for one in plain.passes if one.path.lit.all() and one.path.top_elevation > 40)
    moment = path.begin + 0.37 * (path.end - path.begin)
    when = at(sky, plain, [moment])[0]
    place = satellite.at(when).position.km
    sun = ephemeris["earth"].at(when).observe(ephemeris["sun"]).apparent().position.km - place
    observer = station.at(when).position.km - place
    normal = sun / np.linalg.norm(sun) + observer / np.linalg.norm(observer)
    normal /= np.linalg.norm(normal)
    u = np.cross(normal, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    plate = f"""
[[components]]
name = "mirror"
shape = "plate"
size = [1.0, 1.0]
centre = [0, 0, 0]
u = {u.tolist()}
v = {v.tolist()}
material = "m"
[materials.m]
n = 5000.0
r_spec = 0.5
r_diff = 0.1
[model]
effects = []
"""
    found = torchlc.predict(scene(parts=plate, attitude='mode = "inertial"'), **SPAN, sun=90.0)
    glints = [glint for one in found.passes for glint in one.glints]
    (glint,) = [one for one in glints if abs(one.seconds - moment) < 300]
    assert glint.seconds == pytest.approx(moment, abs=0.5)
    # the bisector passes the normal within what 10 s of a parabola leave
    assert glint.degrees < 0.1
    assert glint.width_deg == pytest.approx(math.degrees(1 / math.sqrt(5000)), rel=1e-6)
    assert (glint.component, glint.face, glint.probability) == ("mirror", "front", 1.0)
    # an hour from the epoch the elements are 0.02 to 0.02 deg off along an orbit of 100.3 min: 0.33 s
    assert glint.time_sd_s == pytest.approx(0.02 / 360 * 86400 / 14.35478, rel=0.02)
    brightest = min((one for one in found.passes), key=lambda one: one.brightest[2])
    row = found.span.seconds[brightest.path.index[brightest.row]]
    assert abs(row - moment) < found.span.cadence_s


BOX_WING = """
[[components]]
name = "body"
shape = "box"
size = [2.0, 2.0, 2.5]
centre = [0, 0, 0]
material = "m"
[[components]]
name = "wing"
shape = "plate"
size = [2.0, 6.0]
centre = [0, 4.5, 0]
u = [1, 0, 0]
v = [0, 1, 0]
tracks = { target = "sun", axis = [0, 1, 0] }
material = "m"
[materials.m]
n = N
r_spec = 0.3
r_diff = 0.3
[model]
effects = []
"""
ANY_GLOSS = '{ value = 100.0, low = 1.0, high = 1e6, prior = "loguniform" }'


def by_the_equinox(gloss: str, **given):
    """The night of a geostationary box-wing in eclipse season: both faces are nearest to their glints in the umbra."""
    tle = (
        "1 37834U 11045A   26074.51234567 -.00000155  00000-0  00000+0 0  9999",
        "2 37834   0.0213  85.4012 0002513 210.1123  30.2201  1.00271810 53325",
    )
    roof = torchlc.scene.Station(id="roof", latitude=48.2, longitude=16.37, height=210.0)
    parts = BOX_WING.replace("n = N", f"n = {gloss}")
    return torchlc.predict(scene(tle, parts=parts), stations=[roof], date="2026-03-16", **given)


@pytest.mark.parametrize("gloss", ["150.0", ANY_GLOSS])
def test_nothing_glints_in_the_umbra(gloss):
    """The closest approach lies in the dark, so that what is left ends at the umbra, and is told so: in JSON, table, calendar
    and figure."""
    found = by_the_equinox(gloss)
    (one,) = found.passes
    dark = {word: seconds for seconds, word in one.path.events if word.endswith(" umbra")}
    begin, end = str(found.iso(dark["enters umbra"])), str(found.iso(dark["leaves umbra"]))
    told = found.to_json()["passes"][0]["glints"]
    assert {(glint["component"], glint["face"]) for glint in told} >= {("body", "+Z"), ("wing", "front")}
    for glint in told:
        assert not begin < glint["time"] < end
        edge = "it enters the umbra" if glint["time"] < begin else "it leaves the umbra"
        assert glint["closest_when"] == edge
        # two widths of lobes of at most 5 deg
        assert glint["degrees"] < 10
    calendar = found.to_ics().replace("\r\n ", "").replace("\\,", ",")
    for cells in (str(found.passes_table()["glints"][0]).split("; "), calendar.split("Glint: ")[1:]):
        assert len(cells) == len(told)
        for cell, glint in zip(cells, told, strict=True):
            assert f"{glint['time'][11:19]} ± 5 s, closest when {glint['closest_when']}" in cell
    (panel,) = found.panels()
    first = found.span.seconds[one.path.index[0]]
    marked = first + 60 * np.array(panel.glints)
    assert not ((marked > dark["enters umbra"]) & (marked < dark["leaves umbra"])).any()


def test_only_draws_with_a_sharp_lobe_in_reach_glint():
    """n is log-uniform from 1 to 1e6 and a lobe 1/sqrt(n) wide: at an angle a, those count whose n lies between (1/5 deg)^2
    and (2/a)^2. Their share and their median width are in closed form; 4000 draws, four standard deviations."""
    found = by_the_equinox(ANY_GLOSS, draws=4000)
    glints = found.passes[0].glints
    assert glints
    for glint in glints:
        low, high = (1 / math.radians(5.0)) ** 2, (2 / math.radians(glint.degrees)) ** 2
        share = math.log(high / low) / math.log(1e6)
        assert glint.probability == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / 4000))
        # log n of the median is off by 1.25 of its standard deviation over the root of their number; half of it is the width's
        off = 2.5 * math.log(high / low) / math.sqrt(12 * 4000 * share)
        assert glint.width_deg == pytest.approx(math.degrees((low * high) ** -0.25), rel=off)


@pytest.mark.long
def test_a_spinning_mirror_glints_every_turn():
    """A plate that spins about the axis of the sky: its normal crosses the bisector's meridian twice a turn, once with
    each side; where the bisector is far from the plane of the normal's circle it never comes near. By brute force on
    the same track at 0.25 s: the number of glints and their times."""
    plate = """
[[components]]
name = "mirror"
shape = "plate"
size = [1.0, 1.0]
centre = [0, 0, 0]
u = [0, 1, 0]
v = [-0.3, 0, 1]
rotation = [0, 20, 0]
material = "m"
[materials.m]
n = 300.0
r_spec = 0.5
r_diff = 0.1
[model]
effects = []
"""
    spinning = scene(parts=plate, attitude='mode = "inertial"\nspin_axis = [0, 0, 1]\nspin_rate = 40.0')
    found = torchlc.predict(spinning, **SPAN, sun=90.0, cadence=1.0)
    assert any("the spin has no epoch" in text for text in found.warnings)
    one = next(one for one in found.passes if one.path.lit.all() and len(one.glints) > 1)
    fine = torchlc.visibility(
        spinning.with_spin_epoch(found.iso(0.0)),
        start=found.iso(one.path.begin),
        hours=(one.path.end - one.path.begin) / 3600,
        cadence=0.25,
    )
    bisector = (fine.to_sun + fine.to_observer).numpy()
    bisector /= np.linalg.norm(bisector, axis=1, keepdims=True)
    u, v = np.array([0.0, 1.0, 0.0]), np.array([-0.3, 0.0, 1.0])
    turn = np.radians(20.0)
    about_y = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    normal = about_y @ (np.cross(u, v) / np.linalg.norm(np.cross(u, v)))
    expected = []
    for side in (1.0, -1.0):
        facing = np.minimum(side * (fine.to_sun.numpy() @ normal), side * (fine.to_observer.numpy() @ normal))
        angle = np.degrees(np.arccos(np.clip(side * bisector @ normal, -1, 1)))
        angle[facing <= 0] = 180.0
        lows = np.flatnonzero((angle[1:-1] < angle[:-2]) & (angle[1:-1] <= angle[2:])) + 1
        expected += [
            one.path.begin + 0.25 * k for k in lows if angle[k] < 2 * math.degrees(1 / math.sqrt(300))
        ]
    inner = [glint.seconds for glint in one.glints if one.path.begin + 2 < glint.seconds < one.path.end - 2]
    expected = sorted(when for when in expected if one.path.begin + 2 < when < one.path.end - 2)
    assert len(inner) == len(expected) > 1
    np.testing.assert_allclose(inner, expected, atol=0.5)  # the fine grid's 0.25 s, and half a row
