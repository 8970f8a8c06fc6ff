"""A first scene: commented TOML from orbital elements and a preset shape, ready to be edited."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchlc.effects import names as effect_names
from torchlc.errors import InputError
from torchlc.files.decimals import decimal
from torchlc.scene import Scene
from torchlc.scene.timestamps import UnreadableTime, instant
from torchlc.scene.tle import Elements, nearest, read_catalogue, sets_of_object
from torchlc.scene.writer import toml_value
from torchlc.suggest import did_you_mean

TEMPLATES = Path(__file__).parent / "templates"
PLACEHOLDER_STATION = ("site", 0.0, 0.0, 0.0)
PRESETS = {
    "box-wing": "box_wing",
    "cubesat": "cubesat",
    "rocket body": "rocket_body",
    "cylinder": "cylinder",
    "mesh": "mesh",
}
"""Shape by the name people say, and its template."""
TUMBLING = """
# While the attitude is free, shadows and the Sun's disc are worked out anew for every try, which costs some hundred times
# more: add self_shadowing and finite_sun once it is known.
effects = ["sun_distance", "light_time", "earth_shadow"]"""


def elements_for(path: Path, date: str | float | None, wanted: str | None = None) -> Elements:
    """The set of a file with its epoch nearest to ``date`` (ISO UTC or JD), or the latest; of a file of many objects
    that of the one ``wanted``, by its number, its name or a part of its name.
    """
    return nearest_set(sets_of_object(path, read_catalogue(path), wanted), date)


def nearest_set(sets: Sequence[Elements], date: str | float | None) -> Elements:
    """The set with its epoch nearest to ``date`` (ISO UTC or JD), or the latest."""
    if date is None:
        return max(sets, key=lambda one: one.epoch)
    try:
        when: Any = instant(date, "utc")
    except UnreadableTime as error:
        raise InputError(None, "--date", repr(error.found), error.expected) from None
    return sets[int(nearest(sets, np.array([float(when.jd)]))[0])]


def read_station(text: str) -> tuple[str, float, float, float]:
    """A station from "id,latitude,longitude,height"."""
    parts = [part.strip() for part in text.split(",")]
    try:
        name, latitude, longitude, height = parts[0], *map(decimal, parts[1:])
    except (ValueError, TypeError):
        raise InputError(
            None, "--station", repr(text), "id,latitude,longitude,height as in weihai,37.536,122.05,110"
        ) from None
    return name, latitude, longitude, height


def new_scene(
    elements: Elements,
    preset: str,
    *,
    name: str | None = None,
    station: tuple[str, float, float, float] | None = None,
    mesh: str | None = None,
) -> str:
    """TOML of a scene that can be simulated and fitted as it stands."""
    folded = {key.replace(" ", "-").replace("_", "-"): value for key, value in PRESETS.items()}
    key = preset.strip().lower().replace(" ", "-").replace("_", "-")
    if key not in folded:
        raise InputError(
            None, "--shape", repr(preset), f"one of {', '.join(PRESETS)}", did_you_mean(preset, PRESETS)
        )
    if (key == "mesh") != (mesh is not None):
        raise InputError(
            None,
            "--mesh",
            "missing" if mesh is None else f"given with shape {preset}",
            "a file for the shape mesh",
        )
    place = PLACEHOLDER_STATION if station is None else station
    shape = (TEMPLATES / f"shape_{folded[key]}.toml").read_text(encoding="utf-8")
    text = (TEMPLATES / "scene.toml").read_text(encoding="utf-8")
    values = {
        "NAME": toml_value(name or elements.name or f"object {elements.lines[0][2:7].strip()}"),
        "LINE1": toml_value(elements.lines[0]),
        "LINE2": toml_value(elements.lines[1]),
        "STATION": toml_value(place[0]),
        "LATITUDE": toml_value(place[1]),
        "LONGITUDE": toml_value(place[2]),
        "HEIGHT": toml_value(place[3]),
        "EDIT": "" if station is not None else "   # EDIT: where it is observed from",
        "MESH": toml_value(mesh or ""),
        "SHAPE": shape.rstrip(),
        "EFFECTS": TUMBLING if key == "rocket-body" else "",
    }
    for key, value in values.items():
        if key != "MESH":
            text = text.replace(f"@{key}@", value)
    return text.replace("@MESH@", values["MESH"])


def check_scene(text: str, directory: Path, source: Path) -> Scene:
    """Read what is about to be written, so that a bad element set or station is said before a file exists."""
    return Scene.from_toml(text, directory, source, known_effects=effect_names())
