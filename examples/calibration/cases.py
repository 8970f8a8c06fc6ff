"""The concealed-effect cases by name: on what object, what is concealed, and what the answer says of it.

An effect comes at sizes that its gain sets (SIZES), or once where something else makes it matter.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))

from body import DEFAULT_EFFECTS
from circumstances import Setup, draw
from concealed import RECIPES, Concealed, Kind, Rng, appendage, instant, kinds, smaller_wings
from gain import gain, sized, with_effects
from nominal import as_brought

NOISE = ("jitter", "red_noise", "outliers")
OUTSIDE = "outside the library"
LAWS = {"ggx": "GGX", "beckmann": "Beckmann"}
SIZES = {"small": 3.0, "medium": 6.0, "large": 20.0}
THREE_SIZES = ("panel_offset", "attitude_offset", "self_shadowing", "exposure_smearing", "appendage",
               "second_material", "lobe_tail", "time_offset", "spin_rate_offset", "zero_point_drift",
               "background")  # fmt: skip
ONE_SIZE = (
    "attitude_jump",
    "wing_split",
    "earth_shadow",
    "interreflection",
    "earthshine",
    "light_time",
    "sun_distance",
)
ELSEWHERE = (  # the same effects on other objects, medium or large
    ("time_offset", "leo"), ("time_offset", "box"), ("panel_offset", "meo"), ("panel_offset", "leo"),
    ("exposure_smearing", "rocket"), ("spin_rate_offset", "rocket"), ("background", "rocket"),
    ("zero_point_drift", "geo"), ("lobe_tail", "known"), ("wobble", "rocket"),
)  # fmt: skip
PAIRS = (
    ("wing", "self_shadowing", "zero_point_step"), ("geo", "panel_offset", "background"),
    ("box", "spin_rate_offset", "appendage"), ("leo", "time_offset", "background"),
    ("fast", "exposure_smearing", "saturation"),
)  # fmt: skip
THREES = (
    ("wing", "self_shadowing", "zero_point_step", "background"), ("box", "appendage", "zero_point_drift", "saturation"),
    ("geo", "panel_offset", "background", "zero_point_step"), ("leo", "time_offset", "extinction_residual", "background"),
)  # fmt: skip
UNLISTED = ("flash", "cloud", "star", "cirrus", "detachment", "flexing")
"""Truths that no effect of the library describes."""
BROUGHT = (
    ("panel_offset", "geo"), ("attitude_offset", "wing"), ("self_shadowing", "wing"), ("appendage", "box"),
    ("lobe_tail", "sharp_box"), ("time_offset", "rocket"), ("time_offset", "leo"), ("zero_point_drift", "meo"),
    ("zero_point_step", "box"), ("extinction_residual", "leo"), ("background", "wing"), ("saturation", "box"),
    ("wobble", "box"), ("exposure_smearing", "fast"), ("panel_offset", "meo"), ("attitude_jump", "geo"),
)  # fmt: skip
"""Effects concealed in scenes that are only nominal, and on what object."""
BROUGHT_CLEAN = ("geo_free", "meo", "box", "wing", "rocket", "leo")
CONDUCTORS = (
    ("ggx", "wing", "self_shadowing"), ("ggx", "geo_free", "panel_offset"), ("ggx", "box", "time_offset"),
    ("ggx", "leo", "appendage"), ("beckmann", "wing", "self_shadowing"), ("beckmann", "geo_free", "panel_offset"),
    ("beckmann", "meo", "zero_point_drift"), ("beckmann", "box", "spin_rate_offset"),
)  # fmt: skip
"""Rough conductors without a base: the distribution of their microfacets, on what object, and what is concealed."""


def names() -> Iterator[str]:
    """Every case, in order."""
    for kind in ("geo", "geo_free", "eclipse_none", "meo", "box", "wing", "rocket", "leo"):
        yield f"control_{kind}"
    for effect in RECIPES:
        sizes = ("as_is",) if effect in ONE_SIZE else ("medium", "large")
        for size in ("small", *sizes) if effect in THREE_SIZES else sizes:
            yield f"{effect}-{size}"
    for effect, kind in ELSEWHERE:
        yield f"{effect}-large-{kind}"
    for effect in NOISE:
        for size in ("medium", "large"):
            yield f"{effect}-{size}"
    for _, one, two in PAIRS:
        yield f"two-{one}-{two}"
    yield from ("wrong-box-wing", "wrong-box-box", "wrong-orbit-leo", "wrong-orbit-meo", "wrong-clock-leo",
                "wrong-clock-rocket", "ggx-wing-self_shadowing", "ggx-geo-panel_offset",
                "outside-flash", "outside-cloud")  # fmt: skip
    for law, kind, effect in CONDUCTORS:
        yield f"{law}-{kind}-{effect}-bare"
    for _, *three in THREES:
        yield "three-" + "-".join(three)
    for kind in UNLISTED[2:]:
        yield f"outside-{kind}"
    for kind in BROUGHT_CLEAN:
        yield f"nominal-control_{kind}"
    for effect, kind in BROUGHT:
        yield f"nominal-{effect}-{'as_is' if effect in ONE_SIZE else 'large'}-{kind}"
    for kind in UNLISTED:
        yield f"nominal-outside-{kind}"


KINDS = {
    "nominal-control": "nominal, nothing missing",
    "nominal-outside": "nominal, outside the library",
    "nominal": "nominal, one effect",
    "control": "nothing missing",
    "two": "two effects",
    "three": "three effects",
    "outside": "outside the library",
    "wrong": "scene slightly wrong",
    **dict.fromkeys(LAWS, "other reflection law"),
    **dict.fromkeys(NOISE, "other noise"),
}
"""What a case is by how its name begins, the longer beginnings first; every other is one effect."""


def kind(name: str) -> str:
    """What a case conceals, in a few words."""
    return next((words for head, words in KINDS.items() if name.startswith(head)), "one effect")


SUBSET = (
    "control_geo", "control_leo", "panel_offset-large", "earth_shadow-as_is", "appendage-large",
    "attitude_offset-large", "two-self_shadowing-zero_point_step", "outliers-large", "outside-flash",
)  # fmt: skip
"""One of nearly every kind of answer, for a run of minutes."""


Composed = tuple[Setup, Concealed, dict[str, Any]]  # and what the answer says of it


def compose(name: str, number: int, rng: Rng, from_their_priors: bool = False) -> Composed:
    """A case by its name, of surfaces as spacecraft have them or drawn from their priors."""
    at = kinds(number, from_their_priors)
    if name.startswith("nominal-"):
        setup, concealed, said = compose(name.removeprefix("nominal-"), number, rng, from_their_priors)
        accepted = [said["verdict"], *(["noise_model"] if said["verdict"] == "adequate" else [])]
        return as_brought(setup, rng), concealed, {"accepted": accepted, **said, "nominal": True}
    if name.startswith("control_"):
        kind = name.removeprefix("control_")
        return at["geo_free" if kind == "eclipse_none" else kind](rng), {}, {"verdict": "adequate"}
    first, *rest = name.split("-")
    if first in NOISE:
        return noisy(first, rest[0] == "large", at, rng)
    special = {"two": several_effects, "three": several_effects, "wrong": wrong_scene, "outside": outside}
    if first in LAWS:
        return other_law(first, rest, at, rng)
    if first in special:
        return special[first](rest, at, rng)
    return one_effect(first, rest, at, rng)


def one_effect(effect: str, words: list[str], at: Mapping[str, Kind], rng: Rng) -> Composed:
    """words: size, and another kind of object than the effect's own."""
    kind, maker, first, limits = RECIPES[effect]
    setup, make = at[words[1] if len(words) > 1 else kind](rng), maker(rng)
    if effect == "interreflection":
        setup = with_effects(smaller_wings(1.0, setup)[0], ["self_shadowing"])
    size = first
    if words[0] != "as_is":
        size = sized(setup, make, first, limits, SIZES[words[0]])
    elif effect == "earthshine":  # only where the Sun leaves it room
        for _ in range(30):
            if gain(*make(size, setup), linear=True) > 10.0:
                break
            setup = at[kind](rng)
    setup, concealed = make(size, setup)
    concealed = {k: {a: b for a, b in v.items() if a != "unused"} for k, v in concealed.items()}
    return setup, concealed, {"verdict": "missing_physics"}


def noisy(effect: str, large: bool, at: Mapping[str, Kind], rng: Rng) -> Composed:
    setup = at[str(rng.choice(["box", "wing", "meo", "geo"]))](rng)
    extra = round(setup.floor * (2.0 if large else 0.8), 4)
    parameters = {
        "jitter": {"mag": extra},
        "red_noise": {"mag": extra, "tau_min": draw(rng, 6.0, 20.0)},
        "outliers": {"fraction": 0.06 if large else 0.03, "width": 0.3 if large else 0.15},
    }[effect]
    answer: dict[str, Any] = {"verdict": "noise_model"}
    if not large:
        answer["accepted"] = ["noise_model", "adequate"]
    return setup, {effect: parameters}, answer


def several_effects(words: list[str], at: Mapping[str, Kind], rng: Rng) -> Composed:
    kind = next(k for k, *members in (*PAIRS, *THREES) if members == words)
    setup, concealed = at[kind](rng), {}
    for effect in words:
        _, maker, first, limits = RECIPES[effect]
        make = maker(rng)
        setup, one = make(sized(setup, make, first, limits, 15.0), setup)
        concealed |= one
    return setup, concealed, {"verdict": "missing_physics"}


def wrong_scene(words: list[str], at: Mapping[str, Kind], rng: Rng) -> Composed:
    """The scene is slightly wrong: the orbit by 0.1 deg, the clock by 2 s, or the box by 10 %."""
    setup = at[words[1]](rng)
    if words[0] == "orbit":
        return setup, {"along_track_offset": {"deg": 0.1}}, {"verdict": "missing_physics"}
    if words[0] == "clock":
        return setup, {"time_offset": {"s": 2.0}}, {"verdict": "missing_physics"}
    tree = deepcopy(setup.tree)
    size = tree["components"][0]["size"]
    tree["components"][0]["size"] = [round(size[0] / 1.1, 4), *size[1:]]
    answer = {"verdict": "unexplained", "note": "the scene's box is 10 % too long"}
    return replace(setup, true_tree=tree), {}, answer


def other_law(law: str, words: list[str], at: Mapping[str, Kind], rng: Rng) -> Composed:
    """An effect on an object whose every surface is a rough conductor, microfacets distributed by ``law``."""
    kind, effect, *bare = words
    setup = at[kind](rng)
    _, maker, first, limits = RECIPES[effect]
    make = maker(rng)
    rough = {
        material: {
            "model": law,
            "alpha": round(float(np.sqrt(2.0 / (values["n"] + 2.0))), 4),
            "f0": 0.6 if bare else values["r_spec"],
            "r_diff": 0.0 if bare else values["r_diff"],
        }
        for material, values in setup.materials.items()
    }
    answer = {
        "verdict": "missing_physics",
        "note": f"every surface is a rough conductor ({LAWS[law]})"
        + (", bare" if bare else " over a Lambert base"),
        "family": [[effect, "lobe_tail"]],
    }
    setup = replace(setup, true_materials=rough)
    return *make(sized(setup, make, first, limits, 20.0), setup), answer


def outside(words: list[str], at: Mapping[str, Kind], rng: Rng) -> Composed:
    """Truths that no effect of the library describes."""
    answer = {"verdict": "unexplained", "accepted": ["unexplained", "noise_model"], "note": OUTSIDE}
    if words[0] == "flash":
        flash = {"period_min": draw(rng, 17.0, 40.0), "fraction": 0.8, "width": 0.04}
        return at["wing"](rng), {"flash": flash}, answer
    if words[0] == "cloud":
        setup = at["meo"](rng)
        cloud = {"mag": 0.25, "minutes": 12.0, "time": round(instant(setup, 0.4), 3)}
        return setup, {"cloud": cloud}, answer
    if words[0] == "star":
        setup = at["box"](rng)
        star = {"fraction": draw(rng, 0.2, 0.5), "minutes": draw(rng, 8.0, 15.0)}
        return setup, {"star": {**star, "time": round(instant(setup, draw(rng, 0.3, 0.7)), 3)}}, answer
    if words[0] == "cirrus":
        setup = at["geo"](rng)
        cirrus = {
            "mag": draw(rng, 0.06, 0.12),
            "tau_min": draw(rng, 15.0, 30.0),
            "seed": int(rng.integers(1000)),
        }
        return setup, {"cirrus": cirrus}, answer
    if words[0] == "detachment":
        setup = at["box"](rng)
        plate = appendage(rng)(draw(rng, 0.8, 1.5), setup)[1]["appendage"]
        return (
            setup,
            {"detachment": {**plate, "time": round(instant(setup, draw(rng, 0.35, 0.65)), 3)}},
            answer,
        )
    setup = at["geo"](rng)
    flexing = {"deg": draw(rng, 1.0, 2.0), "period_min": draw(rng, 30.0, 90.0)}
    return setup, {"flexing": flexing}, answer


def listed(setup: Setup, concealed: Concealed, rng: Rng) -> Setup:
    """The scene's ``effects`` list: empty, some known physics, or no key at all, never what is concealed."""
    if setup.tree["model"].get("effects"):
        return setup
    chance = rng.random()
    if chance < 0.55:
        return setup
    some = [e for e in ("sun_distance", "light_time") if e not in concealed]
    if chance < 0.85 or set(concealed) & set(DEFAULT_EFFECTS):
        return with_effects(setup, some)
    return with_effects(setup, None)
