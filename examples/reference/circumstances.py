"""Scenes to observe, drawn at random: kinds of object and orbit, on nights when they can be seen.

Every kind returns a ``Setup``: the scene as it would be handed out (free materials under their priors), the
true materials, the stamps of the rows and the station.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sky
from body import Scene
from bruteforce import simulate
from detector import photometry
from observe import stamps, usable
from scene_files import Tree, box, free_material, tight_material, tle, toml, wings

SITES = {
    "weihai": (37.536, 122.05, 110.0),
    "karoo": (-32.38, 20.81, 1798.0),
    "canarias": (28.3, -16.51, 2390.0),
    "maui": (20.71, -156.26, 3050.0),
    "siding": (-31.27, 149.06, 1130.0),
    "zimmerwald": (46.877, 7.465, 951.0),
}
QUICK = {"samples": 256, "instants": 3, "rays": 512, "cylinder_facets": 120}  # for refits


@dataclass
class Setup:
    """A case before anything is concealed: the scene as it will be handed out, and the circumstances."""

    kind: str
    tree: Tree
    materials: dict[str, dict[str, float]]
    t: sky.Array
    exptime: float
    station: str
    floor: float = 0.02
    true_tree: Tree | None = None  # where the real object differs from the tree
    true_materials: dict[str, dict[str, Any]] | None = None  # where its surfaces obey another law

    def scene(self) -> Scene:
        """As handed out, with the true values of its materials."""
        return Scene.parse(toml(self.tree)).with_materials(self.materials)

    def true_scene(self) -> Scene:
        return Scene.parse(toml(self.true_tree or self.tree)).with_materials(
            self.true_materials or self.materials
        )


def draw(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.round(rng.uniform(low, high), 4))


def draw_log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.round(np.exp(rng.uniform(np.log(low), np.log(high))), 2))


def _tree(name: str, orbit: list[str], station: str, attitude: Tree, components: list[Tree]) -> Tree:
    latitude, longitude, height = SITES[station]
    return {
        "format": "torchlc-scene/1",
        "name": name,
        "orbit": {"tle": orbit},
        "stations": [{"id": station, "latitude": latitude, "longitude": longitude, "height": height}],
        "attitude": attitude,
        "components": components,
        "materials": {},
        "model": {"effects": [], "parameters": {"zero_point": 0.0, "band_sun_magnitude": -26.7}},
    }


def _local_midnight(date: str, longitude: float) -> float:
    return sky.seconds(date) + 86400.0 - longitude * 240.0


def _geo_orbit(
    rng: np.random.Generator, date: str, longitude: float, inclination: float, number: int
) -> list[str]:
    node, perigee = draw(rng, 60.0, 100.0), 120.0
    theta = float(np.rad2deg(sky.sidereal_angle(np.array(sky.seconds(date)))))
    anomaly = longitude + theta - node - perigee
    return tle(date, inclination, node, 3e-4, perigee, anomaly, 1.00273683, number)


def _date(rng: np.random.Generator, low_day: int, high_day: int) -> str:
    year = int(rng.integers(2019, 2025))
    return str(np.datetime64(f"{year}-01-01") + int(rng.integers(low_day, high_day)))


def _materials(
    rng: np.random.Generator, wing: bool, sharp: tuple[float, float] = (30.0, 300.0)
) -> dict[str, Any]:
    out = {
        "body": {"n": draw_log(rng, *sharp), "r_spec": draw(rng, 0.1, 0.4), "r_diff": draw(rng, 0.2, 0.45)}
    }
    if wing:
        out["panel"] = {
            "n": draw_log(rng, 40.0, 300.0),
            "r_spec": draw(rng, 0.04, 0.1),
            "r_diff": draw(rng, 0.03, 0.1),
        }
    return out


def from_priors(setup: Setup, rng: np.random.Generator, n: tuple[float, float] = (3.0, 3000.0)) -> Setup:
    """The setup with surfaces of which the scene knows nothing drawn from its own priors, in which n lies between ``n``: only
    then must 90 % intervals hold 90 % of them. Surfaces known to a few per cent are as they were."""
    tree, materials = deepcopy(setup.tree), deepcopy(setup.materials)
    for name, entry in tree["materials"].items():
        if "low" in entry["n"] and "sigma" not in entry["n"]:
            entry["n"] |= {"value": round(float(np.sqrt(n[0] * n[1])), 2), "low": n[0], "high": n[1]}
            r_spec, r_diff = (draw(rng, 0.0, 1.0) for _ in "sd")
            if r_spec + r_diff > 1.0:  # even over what a surface can send back
                r_spec, r_diff = round(1.0 - r_spec, 4), round(1.0 - r_diff, 4)
            materials[name] = {"n": draw_log(rng, *n), "r_spec": r_spec, "r_diff": r_diff}
    return replace(setup, tree=tree, materials=materials)


def geo(
    rng: np.random.Generator, number: int, near_shadow: bool = False, known: bool = True, rows: int = 320
) -> Setup:
    """Nadir-pointing box-wing in GEO over one night; the glint falls in it."""
    station = str(rng.choice(["weihai", "canarias", "maui", "zimmerwald"]))
    longitude = SITES[station][1] + draw(rng, -20.0, 20.0)
    if near_shadow:
        date = _date(rng, 275, 288)
    else:
        date = _date(rng, 296, 325) if rng.random() < 0.5 else _date(rng, 30, 48)
    size = [draw(rng, 1.8, 2.6), draw(rng, 1.6, 2.2), draw(rng, 1.8, 2.8)]
    wing = (draw(rng, 1.6, 2.4), draw(rng, 5.0, 7.0))
    reach = size[1] / 2 + wing[1] / 2 + draw(rng, 0.8, 1.6)
    tree = _tree("GEO box-wing", _geo_orbit(rng, date, longitude, draw(rng, 0.03, 0.1), number), station,
                 {"mode": "nadir"}, [box(size), *wings(wing, reach, True)])  # fmt: skip
    materials = _materials(rng, True)
    tree["materials"]["body"] = tight_material(materials["body"], 0.03, rng) if known else free_material()
    tree["materials"]["panel"] = free_material()
    hours = 4.0 if near_shadow else draw(rng, 6.5, 8.5)
    middle = _local_midnight(date, longitude if near_shadow else SITES[station][1])
    t = stamps(
        sky.iso(middle - hours * 1800.0 + draw(rng, -1.0, 1.0) * (600.0 if near_shadow else 3600.0)),
        hours,
        rows,
        rng,
    )
    kind = "GEO near equinox" if near_shadow else "GEO box-wing nadir, body " + ("known" if known else "free")
    return Setup(kind, tree, materials, t, 1.0, station, draw(rng, 0.015, 0.025))


def meo(rng: np.random.Generator, number: int) -> Setup:
    """Yaw-steering box-wing in MEO."""
    station = str(rng.choice(list(SITES)))
    date = _date(rng, 0, 365)
    orbit = tle(date, 55.5, draw(rng, 0, 360), 0.002, draw(rng, 0, 360), draw(rng, 0, 360), 2.0056, number)
    size = [draw(rng, 1.5, 2.2), draw(rng, 1.5, 2.2), draw(rng, 1.5, 2.2)]
    wing = (draw(rng, 1.6, 2.2), draw(rng, 4.5, 6.5))
    tree = _tree("MEO box-wing", orbit, station, {"mode": "yaw-steering"},
                 [box(size), *wings(wing, size[1] / 2 + wing[1] / 2 + 0.8, True)])  # fmt: skip
    materials = _materials(rng, True, (10.0, 60.0))
    materials["panel"]["n"] = draw_log(rng, 10.0, 60.0)
    tree["materials"]["body"] = tight_material(materials["body"], 0.05, rng)
    tree["materials"]["panel"] = free_material(50.0, 0.1)
    t = stamps(
        sky.iso(_local_midnight(date, SITES[station][1]) + draw(rng, -4.0, 0.0) * 3600.0), 4.0, 300, rng
    )
    return Setup("MEO box-wing yaw-steering", tree, materials, t, 1.0, station, draw(rng, 0.015, 0.02))


def tumbler(
    rng: np.random.Generator,
    number: int,
    wing: bool = False,
    rate: float | None = None,
    sharp: tuple[float, float] = (15.0, 120.0),
) -> Setup:
    """A box, with fixed wings or without, turning about an oblique axis in GEO."""
    station = str(rng.choice(list(SITES)))
    longitude = SITES[station][1] + draw(rng, -20.0, 20.0)
    date = _date(rng, 100, 240)
    start = sky.iso(_local_midnight(date, SITES[station][1]) - 2.0 * 3600.0)
    attitude = {
        "mode": "inertial",
        "spin_axis": [draw(rng, 0.2, 0.9), draw(rng, 0.2, 0.9), draw(rng, 0.2, 0.9)],
        "spin_rate": rate or draw(rng, 0.9, 1.6),
        "spin_phase": draw(rng, 0.0, 360.0),
        "spin_epoch": start,
        "x_angle": draw(rng, 0.0, 360.0),
    }
    size = [draw(rng, 1.8, 2.4), draw(rng, 1.7, 2.4), draw(rng, 1.9, 2.6)]
    sides = (draw(rng, 1.8, 2.2), draw(rng, 3.5, 5.0))
    plates = wings(sides, size[1] / 2 + sides[1] / 2 + 0.1, False) if wing else []
    orbit = _geo_orbit(rng, date, longitude, draw(rng, 2.0, 7.0), number)
    tree = _tree(
        "tumbling " + ("box-wing" if wing else "box"), orbit, station, attitude, [box(size), *plates]
    )
    materials = _materials(rng, wing, sharp)
    if wing:
        materials["panel"] = {
            "n": draw_log(rng, 12.0, 60.0),
            "r_spec": draw(rng, 0.05, 0.2),
            "r_diff": draw(rng, 0.2, 0.4),
        }
    tree["materials"] = {name: free_material() for name in materials}
    t = stamps(start, 4.0, 340, rng)
    return Setup(tree["name"] + " in GEO", tree, materials, t, 1.0, station, draw(rng, 0.015, 0.025))


def parked(rng: np.random.Generator, number: int) -> Setup:
    """A polished box at rest in inertial space, one face of which sweeps the Sun's image over the station."""
    setup = tumbler(rng, number)
    attitude = setup.tree["attitude"] = {"mode": "inertial", "x_angle": 0.0}
    middle = float(np.median(setup.t))
    setup.t = stamps(sky.iso(middle - 1500.0), 5.0 / 6.0, 300, rng)
    orbit = sky.Orbit(tuple(setup.tree["orbit"]["tle"]))
    at = np.array([middle])
    place = orbit.state(at)[0]
    half = sky.unit(
        sky.unit(sky.sun(at) - place) + sky.unit(sky.station(at, *SITES[setup.station])[0] - place)
    )[0]
    attitude["x_angle"] = float(np.rad2deg(np.arctan2(half[1], half[0])))
    setup.tree["components"][0]["rotation"] = [0.0, float(-np.rad2deg(np.arcsin(half[2]))) + 0.03, 0.0]
    setup.kind = setup.tree["name"] = "polished box at rest in GEO"
    setup.materials["body"].update(n=draw_log(rng, 1.5e5, 4e5), r_spec=0.01, r_diff=0.3)
    setup.exptime = 2.0
    return setup


def rocket(rng: np.random.Generator, number: int, rate: float | None = None) -> Setup:
    """A spent stage, spinning end over end, in a Molniya-like orbit near apogee or in LEO."""
    high = bool(rng.random() < 0.6)
    station = str(rng.choice(["weihai", "canarias", "zimmerwald"]))
    date = _date(rng, 0, 365)
    if high:
        orbit = tle(date, 63.4, draw(rng, 0, 360), 0.68, 270.0, draw(rng, 0, 360), 2.006, number)
        hours, spin, exptime = 3.0, draw(rng, 1.5, 4.0), 5.0
    else:
        orbit = tle(
            date,
            draw(rng, 60, 98),
            draw(rng, 0, 360),
            0.002,
            draw(rng, 0, 360),
            draw(rng, 0, 360),
            12.8,
            number,
        )
        hours, spin, exptime = 0.16, draw(rng, 25.0, 60.0), 0.5
    start = sky.iso(_local_midnight(date, SITES[station][1]) + draw(rng, -6.0, 6.0) * 3600.0)
    attitude = {
        "mode": "inertial",
        "spin_axis": [draw(rng, 0.3, 0.9), draw(rng, 0.3, 0.9), draw(rng, -0.2, 0.2)],
        "spin_rate": rate or spin,
        "spin_phase": draw(rng, 0.0, 360.0),
        "spin_epoch": start,
        "x_angle": draw(rng, 0.0, 360.0),
    }
    tank = {
        "name": "stage",
        "shape": "cylinder",
        "radius": draw(rng, 1.0, 1.9),
        "length": draw(rng, 6.0, 11.0),
        "axis": [0, 0, 1],
        "centre": [0.0, 0.0, 0.0],
        "material": "paint",
    }
    tree = _tree("rocket body, " + ("HEO" if high else "LEO"), orbit, station, attitude, [tank])
    materials = {
        "paint": {
            "n": draw_log(rng, 8.0, 60.0),
            "r_spec": draw(rng, 0.05, 0.3),
            "r_diff": draw(rng, 0.2, 0.6),
        }
    }
    tree["materials"] = {"paint": free_material()}
    return Setup(tree["name"], tree, materials, stamps(start, hours, 300, rng), exptime, station, 0.02)


def leo(rng: np.random.Generator, number: int) -> Setup:
    """Nadir box with a tracking wing in LEO, one or two passes at 2 s."""
    station = str(rng.choice(list(SITES)))
    date = _date(rng, 0, 365)
    revs = draw(rng, 13.2, 14.6)
    orbit = tle(
        date, draw(rng, 55, 98), draw(rng, 0, 360), 0.001, draw(rng, 0, 360), draw(rng, 0, 360), revs, number
    )
    size = [draw(rng, 1.2, 2.0), draw(rng, 1.2, 2.0), draw(rng, 1.5, 3.0)]
    wing = (draw(rng, 1.5, 2.0), draw(rng, 3.0, 5.0))
    tree = _tree("LEO pass, box-wing", orbit, station, {"mode": "nadir"},
                 [box(size), *wings(wing, size[1] / 2 + wing[1] / 2 + 0.3, True)])  # fmt: skip
    materials = _materials(rng, True, (15.0, 100.0))
    tree["materials"]["body"] = free_material()
    tree["materials"]["panel"] = free_material(50.0, 0.1)
    start = _local_midnight(date, SITES[station][1]) + draw(rng, -7.0, 7.0) * 3600.0
    one = stamps(sky.iso(start), 0.09, 160, rng)
    # the second pass a revolution later, for as many rows again; rows that cannot be used are dropped later
    two = stamps(sky.iso(start + 86400.0 / revs + draw(rng, 0, 120)), 0.09, 160, rng)
    return Setup("LEO pass, box-wing", tree, materials, np.concatenate([one, two]), 0.5, station, 0.02)


def seen(setup: Setup, shadow: bool = False, least_range: float = 0.8) -> Setup | None:
    """The setup with only its usable rows; None when few are left, it hardly varies, or is low."""
    scene = setup.scene()
    curve = simulate(scene, setup.t, setup.exptime, setup.station, {}, **QUICK)
    keep = usable(curve)
    if keep.sum() < 150:
        return None
    lit = simulate(scene, setup.t[keep], setup.exptime, setup.station, {"earth_shadow": {}}, **QUICK).sunlit
    if shadow:
        if not 6 <= (lit < 0.99).sum() < 0.4 * len(lit):
            return None
    else:
        keep[keep] = lit >= 1.0
    mag = photometry(curve, scene, {})
    keep &= mag < 16.0
    if keep.sum() < 150 or np.ptp(mag[keep]) < least_range or np.median(curve.airmass[keep]) > 3.0:
        return None
    return replace(setup, t=setup.t[keep])


def found(make: Callable[[], Setup], shadow: bool = False, least_range: float = 0.8) -> Setup:
    """Draw circumstances until they can be observed."""
    for _ in range(4000):
        setup = seen(make(), shadow, least_range)
        if setup is not None:
            return setup
    raise RuntimeError("no observable circumstances in 4000 draws")
