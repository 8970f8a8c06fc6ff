"""What can be concealed, at any size, and the kinds of object that it is concealed on."""

from __future__ import annotations

import sys
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))

import sky
from circumstances import (
    Setup,
    draw,
    draw_log,
    found,
    from_priors,
    geo,
    leo,
    meo,
    parked,
    rocket,
    tumbler,
)
from gain import Make
from scene_files import tight_material

Rng = np.random.Generator
Concealed = dict[str, dict[str, Any]]


def sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def by(effect: str, key: str, scale: float = 1.0, **fixed: Any) -> Make:
    """The effect with its parameter ``key`` equal to scale times the size."""
    return lambda size, setup: (setup, {effect: {key: round(scale * size, 6), **fixed}})


def attitude_offset(rng: Rng) -> Make:
    x, y, z = sky.unit(rng.standard_normal(3))
    return lambda size, setup: (
        setup,
        {"attitude_offset": {k: round(float(size * w), 5) for k, w in zip("xyz", (x, y, z), strict=True)}},
    )


def appendage(rng: Rng) -> Make:
    x, y, z = sky.unit(rng.standard_normal(3))
    return by(
        "appendage",
        "area",
        lon=round(float(np.rad2deg(np.arctan2(y, x))), 3),
        lat=round(float(np.rad2deg(np.arcsin(z))), 3),
        n=draw_log(rng, 15.0, 80.0),
        r_spec=draw(rng, 0.1, 0.4),
        r_diff=draw(rng, 0.2, 0.5),
    )


def smaller_wings(size: float, setup: Setup) -> tuple[Setup, Concealed]:
    """Self-shadowing weakens with the wings: their sides are ``size`` times what they were."""
    tree = deepcopy(setup.tree)
    wall = tree["components"][0]["size"][1] / 2
    for wing in tree["components"][1:]:
        wing["size"] = [round(size * side, 4) for side in wing["size"]]
        reach = round(wall + wing["size"][1] / 2 + 0.05, 4)
        wing["centre"] = [0.0, float(np.copysign(reach, wing["centre"][1])), 0.0]
    return replace(setup, tree=tree), {"self_shadowing": {}}


def longer_exposures(size: float, setup: Setup) -> tuple[Setup, Concealed]:
    return replace(setup, exptime=round(float(size), 2)), {"exposure_smearing": {}}


def polish(size: float, setup: Setup) -> tuple[Setup, Concealed]:
    """The solar disc matters more the larger n is."""
    materials = deepcopy(setup.materials)
    materials["body"]["n"] = round(float(size), 1)
    return replace(setup, materials=materials), {"finite_sun": {}}


def tail(size: float, setup: Setup) -> tuple[Setup, Concealed]:
    material = "panel" if "panel" in setup.materials else next(iter(setup.materials))
    return setup, {"lobe_tail": {"material": material, "g": round(1.0 / size, 4)}}


def instant(setup: Setup, share: float) -> float:
    """When that share of the recording has passed."""
    return float(setup.t[0] + share * (setup.t[-1] - setup.t[0]))


def step(rng: Rng) -> Make:
    share, s = rng.uniform(0.3, 0.7), sign(rng)
    return lambda size, setup: (
        setup,
        {"zero_point_step": {"mag": round(s * size, 5), "time": round(instant(setup, share), 3)}},
    )


def attitude_jump(rng: Rng) -> Make:
    """A turn, mostly about Y, a little after the middle."""
    return lambda size, setup: (
        setup,
        {"attitude_jump": {"y": size, "x": round(0.47 * size, 5), "time": round(instant(setup, 0.55), 3)}},
    )


def fixed_lobe(setup: Setup) -> Setup:
    """The panel's n known from the laboratory, so that a spread of normals can be told from it."""
    tree = deepcopy(setup.tree)
    tree["materials"]["panel"]["n"] = setup.materials["panel"]["n"]
    return replace(setup, tree=tree)


def known(setup: Setup, rng: Rng) -> Setup:
    """Every material known to 3 %."""
    tree = deepcopy(setup.tree)
    tree["materials"] = {name: tight_material(values, 0.03, rng) for name, values in setup.materials.items()}
    return replace(setup, tree=tree)


def fixed_materials(setup: Setup) -> Setup:
    tree = deepcopy(setup.tree)
    for name, values in setup.materials.items():
        tree["materials"][name] = {"model": "ashikhmin-shirley", **values}
    return replace(setup, tree=tree)


# ---------------------------------------------------------------------------------------- the table of cases

Kind = Callable[[Rng], Setup]
Recipe = tuple[
    str, Callable[[Rng], Make], float, tuple[float, float]
]  # kind of object, effect, first size, limits


SHARPER = {"sharp_box": (80.0, 300.0), "fast": (100.0, 1000.0)}
"""n of surfaces drawn from their priors, where what is concealed needs a narrow lobe."""


def kinds(number: int, from_their_priors: bool = False) -> dict[str, Kind]:
    """Observable circumstances by name; ``number`` is the catalogue number to print in the elements. Surfaces are such as
    spacecraft have, or all that their priors in the scene allow."""

    def there(kind: str, make: Kind, shadow: bool = False) -> Kind:
        def one(rng: Rng) -> Setup:
            setup = make(rng)
            if not from_their_priors or kind == "parked":  # whose polish is what it is drawn for
                return setup
            return from_priors(setup, rng, SHARPER.get(kind, (3.0, 3000.0)))

        return lambda rng: found(lambda: one(rng), shadow)

    def near_shadow(rng: Rng) -> Setup:
        return geo(rng, number, True, False, 360)

    plain = there("geo", lambda rng: geo(rng, number))
    eclipse = there("eclipse", near_shadow, shadow=True)
    return {
        "geo": plain,
        "geo_free": there("geo_free", lambda rng: geo(rng, number, known=False)),
        "eclipse": eclipse,
        "fixed_lobe": lambda rng: fixed_lobe(plain(rng)),
        "fixed": lambda rng: fixed_materials(plain(rng)),
        "known": lambda rng: known(plain(rng), rng),
        "eclipse_known": lambda rng: known(eclipse(rng), rng),
        "meo": there("meo", lambda rng: meo(rng, number)),
        "box": there("box", lambda rng: tumbler(rng, number)),
        "sharp_box": there("sharp_box", lambda rng: tumbler(rng, number, sharp=(80.0, 250.0))),
        "fast": there(
            "fast", lambda rng: tumbler(rng, number, rate=draw(rng, 4.0, 8.0), sharp=(150.0, 500.0))
        ),
        "whirling": there("whirling", lambda rng: tumbler(rng, number, rate=draw(rng, 20.0, 40.0))),
        "wing": there("wing", lambda rng: tumbler(rng, number, wing=True)),
        "parked": there("parked", lambda rng: parked(rng, number)),
        "rocket": there("rocket", lambda rng: rocket(rng, number)),
        "leo": there("leo", lambda rng: leo(rng, number)),
    }


def either_way(effect: str, key: str, **fixed: Any) -> Callable[[Rng], Make]:
    """An effect of either sign."""
    return lambda rng: by(effect, key, sign(rng), **fixed)


def one_way(effect: str, key: str, **fixed: Any) -> Callable[[Rng], Make]:
    return lambda rng: by(effect, key, **fixed)


def wobble(rng: Rng) -> Make:
    axis = str(rng.choice(list("xy")))  # z may be an axis of symmetry
    return by("wobble", "deg", period_min=draw(rng, 20, 70), phase_deg=draw(rng, 0, 360), axis=axis)


def second_material(rng: Rng) -> Make:
    n = draw_log(rng, 1500.0, 4000.0)
    return by("second_material", "weight", material="panel", n=n, r_spec=0.1, r_diff=0.05)


def opposition_surge(rng: Rng) -> Make:
    return by("opposition_surge", "b0", material="panel", h=draw(rng, 0.05, 0.12))


RECIPES: dict[str, Recipe] = {
    "panel_offset": ("geo", either_way("panel_offset", "deg"), 0.5, (0.01, 7.5)),
    "panel_cant": ("known", either_way("panel_cant", "deg"), 0.5, (0.01, 5.0)),
    "attitude_offset": ("wing", attitude_offset, 0.3, (0.01, 2.5)),
    "attitude_jump": ("geo", attitude_jump, 1.5, (1.5, 1.5)),
    "wing_split": ("geo", one_way("wing_split", "deg"), 3.0, (3.0, 3.0)),
    "wobble": ("box", wobble, 0.3, (0.01, 5.0)),
    "spin_rate_offset": ("box", either_way("spin_rate_offset", "rev_per_hour"), 1e-3, (1e-6, 0.2)),
    "self_shadowing": ("wing", lambda rng: smaller_wings, 0.5, (0.05, 1.0)),
    "exposure_smearing": ("fast", lambda rng: longer_exposures, 10.0, (0.5, 40.0)),
    "earth_shadow": ("eclipse", one_way("earth_shadow", "h0"), 15.0, (15.0, 15.0)),
    "finite_sun": ("parked", lambda rng: polish, 2e4, (2e3, 6e5)),
    "appendage": ("box", appendage, 0.05, (1e-4, 8.0)),
    "second_material": ("geo", second_material, 0.05, (1e-4, 0.5)),
    "lobe_tail": ("sharp_box", lambda rng: tail, 0.2, (0.1, 0.8)),
    "normal_dispersion": (
        "fixed_lobe",
        one_way("normal_dispersion", "deg", material="panel"),
        1.5,
        (0.05, 15.0),
    ),
    "opposition_surge": ("eclipse_known", opposition_surge, 0.3, (0.01, 1.0)),
    "time_offset": ("rocket", either_way("time_offset", "s"), 1.0, (1e-3, 25.0)),
    "along_track_offset": ("leo", either_way("along_track_offset", "deg"), 0.1, (1e-3, 0.25)),
    "zero_point_drift": ("meo", either_way("zero_point_drift", "mag_per_hour"), 0.02, (1e-4, 0.05)),
    "zero_point_step": ("box", step, 0.02, (1e-4, 0.5)),
    "extinction_residual": ("leo", either_way("extinction_residual", "mag_per_airmass"), 0.05, (1e-4, 0.125)),
    "background": ("wing", either_way("background", "fraction"), 0.03, (1e-4, 0.25)),
    "saturation": ("box", one_way("saturation", "q"), 0.05, (1e-3, 0.125)),
    "color_term": ("wing", either_way("color_term", "mag", component="body"), 0.05, (1e-3, 0.5)),
    "back_transmission": (
        "wing",
        one_way("back_transmission", "t_d", component="panel +Y"),
        0.02,
        (1e-4, 0.05),
    ),
    "interreflection": ("wing", one_way("interreflection", "gain"), 1.0, (1.0, 1.0)),
    "earthshine": ("leo", one_way("earthshine", "albedo"), 0.3, (0.3, 0.3)),
    "light_time": ("whirling", one_way("light_time", "unused"), 1.0, (1.0, 1.0)),
    "sun_distance": ("fixed", one_way("sun_distance", "unused"), 1.0, (1.0, 1.0)),
}
