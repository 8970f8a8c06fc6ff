"""Scenes in which an effect shows, by the names of torchlc.stages.showing, and a recording of each."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import torchlc
from torchlc.geometry.orbit import above_horizon, make_track, observation_grid
from torchlc.readers import Recording
from torchlc.stages.showing import (
    ECLIPSE,
    LABORATORY,
    MIRROR,
    NIGHT,
    PASS,
    SLOW,
    SPIN,
    STAGE_TURNS,
    STAGE_WEEK,
    YEAR,
)

ERROR_MAG = 0.02
GEO = (Path(torchlc.__file__).parent / "demo" / "scene.toml").read_text(encoding="utf-8")
LEO = """
format = "torchlc-scene/1"
name = "box-wing in a low orbit"
[orbit]
tle = ["1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927",
       "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537"]
[[stations]]
id = "field"
latitude = 31.5
longitude = 92.0
height = 4500.0
[attitude]
mode = "nadir"
[[components]]
name = "body"
shape = "box"
size = [2.0, 1.5, 0.6]
centre = [0, 0, 0]
material = "body"
[[components]]
name = "panel"
shape = "plate"
size = [2.5, 6.0]
centre = [0, 4.0, 0]
u = [1, 0, 0]
v = [0, 1, 0]
material = "panel"
tracks = { target = "sun", axis = [0, 1, 0] }
[materials.body]
n = { value = 100.0, low = 1.0, high = 1e6, prior = "loguniform" }
r_spec = { value = 0.2, low = 0.0, high = 1.0 }
r_diff = { value = 0.4, low = 0.0, high = 1.0 }
[materials.panel]
n = { value = 300.0, low = 1.0, high = 1e6, prior = "loguniform" }
r_spec = { value = 0.1, low = 0.0, high = 1.0 }
r_diff = { value = 0.05, low = 0.0, high = 1.0 }
[model]
effects = []
[model.parameters]
band_sun_magnitude = -26.7
"""
SPINNER = (
    LEO[: LEO.index("[attitude]")].replace("a low orbit", "a spin of one turn a minute")
    + """[attitude]
mode = "inertial"
spin_axis = [0.3, 0.0, 1.0]
spin_rate = 60.0
"""
    + LEO[LEO.index("[[components]]") :].replace('tracks = { target = "sun", axis = [0, 1, 0] }', "")
)
STAGE = """
format = "torchlc-scene/1"
name = "a rocket body that turns in 20 s"
[orbit]
vectors = "icrs"
[attitude]
mode = "spin-pole"
pole = [60.0, 35.0]
period = 0.005555555555555556
phase = 10.0
epoch = "2021-03-20T12:00:00"
[[components]]
name = "stage"
shape = "cylinder"
radius = 1.5
length = 9.0
axis = [1, 0, 0]
centre = [0, 0, 0]
material = "skin"
[materials.skin]
n = { value = 20.0, low = 1.0, high = 1e6, prior = "loguniform" }
r_spec = { value = 0.3, low = 0.0, high = 1.0 }
r_diff = { value = 0.3, low = 0.0, high = 1.0 }
[model]
effects = []
[model.parameters]
band_sun_magnitude = -26.7
"""
HOLLOW = """
v 0 0 0\nv 3 0 0\nv 3 1 0\nv 1 1 0\nv 1 2 0\nv 3 2 0\nv 3 3 0\nv 0 3 0
v 0 0 2\nv 3 0 2\nv 3 1 2\nv 1 1 2\nv 1 2 2\nv 3 2 2\nv 3 3 2\nv 0 3 2
f 8 7 6 5 4 3 2 1\nf 9 10 11 12 13 14 15 16
f 1 2 10 9\nf 2 3 11 10\nf 3 4 12 11\nf 4 5 13 12\nf 5 6 14 13\nf 6 7 15 14\nf 7 8 16 15\nf 8 1 9 16
"""
"""A block with a slot."""
TURNTABLE = (
    STAGE[: STAGE.index("[[components]]")]
    .replace("a rocket body that turns in 20 s", "a white block with a slot on a turntable")
    .replace("pole = [60.0, 35.0]", "pole = [0.0, 90.0]")
    .replace("period = 0.005555555555555556", "period = 1.0")
    + """[[components]]
name = "block"
shape = "mesh"
file = "block.obj"
scale = 0.5
centre = [-0.75, -0.75, -0.5]
material = "paint"
[materials.paint]
model = "lambert"
albedo = { value = 0.7, low = 0.0, high = 1.0 }
[model]
effects = []
[model.parameters]
band_sun_magnitude = -26.7
"""
)
MESHES = Path(tempfile.mkdtemp())
(MESHES / "block.obj").write_text(HOLLOW, encoding="utf-8")
OBJECTS = 12


@dataclass(frozen=True)
class Setting:
    """A scene and its grid of times: start, hours, cadence (s), exposure (s); of one whose recording holds vectors
    also the directions to Sun and observer and the distance of the latter, km, and the days at which it is repeated."""

    text: str
    start: str
    hours: float
    cadence: float
    exptime: float | None = None
    to_sun: tuple[float, float, float] | None = None
    to_observer: tuple[float, float, float] = (0.0, 1.0, 0.0)
    range_km: float = 1000.0
    days: tuple[int, ...] = (0,)


SETTINGS = {
    NIGHT: Setting(GEO, "2020-10-17T13:00", 8.0, 120.0),
    MIRROR: Setting(GEO, "2020-10-07T15:30", 2.0, 20.0),
    ECLIPSE: Setting(GEO, "2020-10-05T15:30", 2.0, 15.0),
    YEAR: Setting(GEO, "2020-03-01T16:00", 8760.0, 259_200.0),
    PASS: Setting(LEO, "2008-09-20T12:08", 7.4 / 60, 3.0),
    SPIN: Setting(SPINNER, "2008-09-20T12:09", 5 / 60, 1.5, 5.0),
    SLOW: Setting(SPINNER.replace("spin_rate = 60.0", "spin_rate = 7.5"), "2008-09-20T12:08", 7.4 / 60, 3.0),
    STAGE_TURNS: Setting(
        STAGE, "2021-03-20T12:00:00", 1 / 60, 0.9, to_sun=(1.0, 0.0, 0.2), to_observer=(0.3, 1.0, 0.5)
    ),
    STAGE_WEEK: Setting(
        STAGE,
        "2021-03-20T12:00:00",
        0.4 / 60,
        0.25,
        to_sun=(1.0, 0.0, 0.2),
        to_observer=(0.3, 1.0, 0.5),
        days=(0, 3, 7),
    ),
    LABORATORY: Setting(
        TURNTABLE,
        "2021-03-20T12:00:00",
        1.0,
        20.0,
        to_sun=(-1.0, 0.0, 0.0),
        to_observer=(-0.3, 0.8, 0.35),
        range_km=0.01,
    ),
}


def with_effects(text: str, effects: list[str], values: Mapping[str, float]) -> torchlc.Scene:
    """The scene with this list of effects and nothing else, their values in place."""
    scene = torchlc.Scene.from_toml(text, MESHES)
    parameters = {
        key: value for key, value in scene.model.parameters.items() if not key.startswith("earth_shadow")
    }
    update = {"effects": effects, "parameters": {**parameters, **values}}
    return scene.model_copy(update={"model": scene.model.model_copy(update=update)})


def rows(setting: Setting) -> Recording:
    scene = torchlc.Scene.from_toml(setting.text, MESHES)
    if setting.to_sun is not None:
        return with_vectors(setting, scene)
    grid = observation_grid(scene, setting.start, setting.hours, setting.cadence)
    if setting.exptime is not None:
        grid = replace(grid, exptime=np.full(len(grid), setting.exptime))
    seen = grid.keep(above_horizon(make_track(scene, grid)), "below the horizon")
    objects = np.arange(len(seen)) % OBJECTS  # in turn: nothing but object_scatter asks for them
    return replace(
        seen,
        observed=np.zeros(len(seen)),
        error=np.full(len(seen), ERROR_MAG),
        object=objects,
        object_ids=tuple(f"object {k + 1}" for k in range(OBJECTS)),
    )


def with_vectors(setting: Setting, scene: torchlc.Scene) -> Recording:
    """A recording that holds the directions."""
    assert setting.to_sun is not None  # asked before
    within = np.arange(round(setting.hours * 3600 / setting.cadence)) * setting.cadence
    seconds = np.concatenate([86400.0 * day + within for day in setting.days])
    first = np.datetime64(setting.start, "ns")
    table: dict[str, Any] = {
        "time": [str(first + np.timedelta64(round(1e9 * one), "ns"))[:26] for one in seconds],
        "mag": np.zeros(len(seconds)),
        "mag_err": np.full(len(seconds), ERROR_MAG),
    }
    for prefix, towards, distance in (
        ("sun", setting.to_sun, 149_597_870.7),
        ("obs", setting.to_observer, setting.range_km),
    ):
        place = distance * np.array(towards) / np.linalg.norm(towards)
        table |= {f"{prefix}_{axis}": np.full(len(seconds), x) for axis, x in zip("xyz", place, strict=True)}
    return Recording.from_table(table, scene)
