"""What the paper fixes once for all its figures: elements, station, objects, times.

"The paper" is Aerospace 2023, 10(1), 41. Where it is silent: the printed elements have their zeros and
points put back (``table_1.py`` shows how); the station is that of the authors' institute; the box of Object 1
has the edges that give its three areas, and its wings stand 1.59 m off the wall, from the published span of
18.10 m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torchlc

Material = Mapping[str, Any]

ORBITS = {
    1: (
        "1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993",
        "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966",
    ),
    2: (
        "1 00002U 19097A   20284.25674796 -.00000355  00000-0  00000-0 0  9994",
        "2 00002   0.4814  94.5914 0028139 151.0334 350.7694  1.00271793  2885",
    ),
    3: (
        "1 00003U 14026A   20284.37504348 -.00000027  00000-0  00000-0 0  9996",
        "2 00003  56.2287  52.2835 0020597 291.4800  68.3069  2.00569053 46908",
    ),
    4: (
        "1 00004U 18109A   20284.07190081  .00000009  00000-0  00000-0 0  9994",
        "2 00004  55.0110 174.1807 0009159 205.9132 258.7572  2.00569258 13470",
    ),
}
LATITUDE, LONGITUDE, HEIGHT = 37.536, 122.05, 110.0
SUN_MAGNITUDE = -26.7

NIGHT = {1: ("2020-10-17T14:00:00", 7.0), 2: ("2019-02-25T14:00:00", 5.0)}
"""By object, the beginning of the paper's recording and its hours."""

ATTITUDES = {
    1: 'mode = "nadir"\nspin_axis = [0, 1, 0]\nspin_rate = 1.0',
    2: 'mode = "inertial"\nx_angle = 30.0',
    3: 'mode = "sun"\nspin_axis = [0, 0, 1]\nspin_rate = 1.0',
    4: 'mode = "nadir"',
}

AREAS_OBJECT_1 = {"X": 3.748, "Y": 4.4, "Z": 3.44}
AREA_WING_1, AREA_WING_2 = 11.352, 11.0
WIDTH_WING_1, SPAN_OBJECT_1 = 1.72, 18.10
EDGE_X = math.sqrt(AREAS_OBJECT_1["Y"] * AREAS_OBJECT_1["Z"] / AREAS_OBJECT_1["X"])
BOX_OBJECT_1 = (EDGE_X, AREAS_OBJECT_1["Z"] / EDGE_X, AREAS_OBJECT_1["Y"] / EDGE_X)
GAP_OBJECT_1 = SPAN_OBJECT_1 / 2 - AREA_WING_1 / WIDTH_WING_1 - BOX_OBJECT_1[1] / 2
"""Between wall and wing, m."""

TABLE_3 = {
    1: {
        "body": {"n": 12030.1146, "r_spec": 0.4908, "r_diff": 0.1566},
        "panel": {"n": 154.2440, "r_spec": 0.0325, "r_diff": 0.0172},
    },
    2: {
        "body": {"n": 12547.791, "r_spec": 0.2807, "r_diff": 0.4336},
        "panel": {"n": 295.1551, "r_spec": 0.7544, "r_diff": 0.0134},
    },
}
FREE = {
    "n": "{ value = 200.0, low = 1.0, high = 1e6, prior = 'loguniform' }",
    "r_spec": "{ value = 0.1, low = 0.0, high = 1.0 }",
    "r_diff": "{ value = 0.1, low = 0.0, high = 1.0 }",
}
"""The paper's priors (eq. 13), with n log-uniform."""


def cube(
    orbit: int = 1,
    attitude: int = 4,
    *,
    n: float = 12_000.0,
    r_spec: float = 0.8,
    r_diff: float = 0.2,
    latitude: float = LATITUDE,
    longitude: float = LONGITUDE,
    effects: str = "[]",
) -> torchlc.Scene:
    """Space debris X: a cube with faces of 16 m2, Section 2.2."""
    body = _component("cube", "box", "size = [4.0, 4.0, 4.0]", "surface")
    materials = {"surface": {"n": n, "r_spec": r_spec, "r_diff": r_diff}}
    return _scene(
        f"cube, orbit {orbit}, attitude {attitude}",
        ORBITS[orbit],
        ATTITUDES[attitude],
        body,
        materials,
        effects,
        {"weihai": (latitude, longitude, HEIGHT)},
    )


def object_1(
    materials: Mapping[str, Material] = TABLE_3[1],
    *,
    effects: str = "[]",
    stations: Mapping[str, tuple[float, float, float]] | None = None,
    gap: float = GAP_OBJECT_1,
) -> torchlc.Scene:
    """Object 1: a geostationary box-wing, nadir pointing, its wings turning about Y."""
    x, y, z = BOX_OBJECT_1
    parts = _component("body", "box", f"size = [{x}, {y}, {z}]", "body")
    parts += _wings(WIDTH_WING_1, AREA_WING_1 / WIDTH_WING_1, y / 2 + gap)
    return _scene("Object 1", ORBITS[1], ATTITUDES[4], parts, materials, effects, stations)


def object_2(materials: Mapping[str, Material] = TABLE_3[2], *, effects: str = "[]") -> torchlc.Scene:
    """Object 2: a navigation satellite in medium orbit, steering in yaw, its shape the paper's assumption."""
    parts = _component("body", "box", "size = [2.0, 2.0, 2.0]", "body")
    parts += _wings(2.0, AREA_WING_2 / 2.0, 1.0 + 1.0)
    return _scene("Object 2", ORBITS[3], 'mode = "yaw-steering"', parts, materials, effects, None)


def free_materials() -> dict[str, Material]:
    """Body and panel with all six numbers free: the paper's parameter space."""
    return {"body": FREE, "panel": FREE}


def _wings(width: float, length: float, root: float) -> str:
    """Two wings of that width and length along Y, from ``root`` m outwards."""
    text = ""
    for sign in (1, -1):
        numbers = f"size = [{width}, {length}]\ncentre = [0, {sign * (root + length / 2)}, 0]"
        axes = "u = [1, 0, 0]\nv = [0, 1, 0]\ntracks = { target = 'sun', axis = [0, 1, 0] }"
        text += _component(f"panel {'+' if sign > 0 else '-'}Y", "plate", f"{numbers}\n{axes}", "panel")
    return text


def _component(name: str, shape: str, lines: str, material: str) -> str:
    centre = "" if "centre" in lines else "centre = [0, 0, 0]\n"
    return f'[[components]]\nname = "{name}"\nshape = "{shape}"\n{centre}{lines}\nmaterial = "{material}"\n\n'


def _scene(
    name: str,
    tle: tuple[str, str],
    attitude: str,
    components: str,
    materials: Mapping[str, Material],
    effects: str,
    stations: Mapping[str, tuple[float, float, float]] | None,
) -> torchlc.Scene:
    places = stations or {"weihai": (LATITUDE, LONGITUDE, HEIGHT)}
    text = (
        f'format = "torchlc-scene/1"\nname = "{name}"\n\n[orbit]\ntle = ["{tle[0]}",\n       "{tle[1]}"]\n\n'
    )
    for station, (latitude, longitude, height) in places.items():
        text += f'[[stations]]\nid = "{station}"\nlatitude = {latitude}\nlongitude = {longitude}\n'
        text += f"height = {height}\n\n"
    text += f"[attitude]\n{attitude}\n\n{components}"
    for material, values in materials.items():
        text += f"[materials.{material}]\n" + "".join(f"{key} = {value}\n" for key, value in values.items())
    text += f"\n[model]\neffects = {effects}\n[model.parameters]\nband_sun_magnitude = {SUN_MAGNITUDE}\n"
    return torchlc.Scene.from_toml(text)
