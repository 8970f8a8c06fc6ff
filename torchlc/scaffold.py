"""A first scene: commented TOML from orbital elements and a preset shape, ready to be edited."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchlc.effects import names as effect_names
from torchlc.errors import InputError
from torchlc.files import readable_file
from torchlc.scene import Scene
from torchlc.scene.tle import LENGTH
from torchlc.scene.writer import toml_value
from torchlc.spelling import did_you_mean
from torchlc.timestamps import UnreadableTime, instant

TEMPLATES = Path(__file__).parent / "templates"
PLACEHOLDER_STATION = ("site", 0.0, 0.0, 0.0)
MAX_ELEMENT_BYTES = 50_000_000
JD_OF_2000 = 2451544.5
PRESETS = {
    "box-wing": "box_wing",
    "cubesat": "cubesat",
    "rocket body": "rocket_body",
    "cylinder": "cylinder",
    "mesh": "mesh",
}
"""Shape by the name people say, and its template."""


@dataclass(frozen=True)
class ElementSet:
    """Two lines with the name above them, if there was one; ``epoch`` a Julian date."""

    name: str | None
    lines: tuple[str, str]

    @property
    def epoch(self) -> float:
        year, day = int(self.lines[0][18:20]), float(self.lines[0][20:32])
        days = np.datetime64(f"{year + (1900 if year >= 57 else 2000)}-01-01") - np.datetime64("2000-01-01")
        return JD_OF_2000 + int(days.astype(int)) + day - 1.0


def read_elements(path: str | Path) -> list[ElementSet]:
    """Every two-line element set of a file, names above them kept."""
    path = readable_file(path, "two-line element sets")
    if path.stat().st_size > MAX_ELEMENT_BYTES:
        raise InputError(path, None, "more than 50 MB", "two-line element sets")
    lines = [line.rstrip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    found = []
    for number, line in enumerate(lines[:-1]):
        after = lines[number + 1]
        if line.startswith("1 ") and after.startswith("2 ") and len(line) >= LENGTH and len(after) >= LENGTH:
            above = lines[number - 1].removeprefix("0 ").strip() if number else ""
            title = above if above and above[:2] not in ("1 ", "2 ") else None
            found.append(ElementSet(title, (line[:LENGTH], after[:LENGTH])))
    if not found:
        raise InputError(path, None, "no two-line elements", "lines that begin with '1 ' and '2 '")
    return found


def nearest_elements(sets: list[ElementSet], date: str | float | None, source: Path) -> ElementSet:
    """The set with its epoch nearest to ``date`` (ISO UTC or JD), or the latest; all of one object."""
    numbers = sorted({one.lines[0][2:7] for one in sets})
    if len(numbers) > 1:
        listed = ", ".join(numbers[:8])
        raise InputError(
            source, None, f"elements of {len(numbers)} objects ({listed})", "elements of one object"
        )
    epochs = []
    for one in sets:
        try:
            epochs.append(one.epoch)
        except ValueError:
            raise InputError(
                source, one.lines[0][:32], "an epoch that cannot be read", "a two-line element set"
            ) from None
    if date is None:
        return sets[int(np.argmax(epochs))]
    try:
        when: Any = instant(date, "utc")
    except UnreadableTime as error:
        raise InputError(None, "--date", repr(error.found), error.expected) from None
    return sets[int(np.argmin(np.abs(np.array(epochs) - float(when.jd))))]


def read_station(text: str) -> tuple[str, float, float, float]:
    """A station from "id,latitude,longitude,height"."""
    parts = [part.strip() for part in text.split(",")]
    try:
        name, latitude, longitude, height = parts[0], *map(float, parts[1:])
    except (ValueError, TypeError):
        raise InputError(
            None, "--station", repr(text), "id,latitude,longitude,height as in weihai,37.536,122.05,110"
        ) from None
    return name, latitude, longitude, height


def new_scene(
    elements: ElementSet,
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
    }
    for key, value in values.items():
        if key != "MESH":
            text = text.replace(f"@{key}@", value)
    return text.replace("@MESH@", values["MESH"])


def check_scene(text: str, directory: Path, source: Path) -> Scene:
    """Read what is about to be written, so that a bad element set or station is said before a file exists."""
    return Scene.from_toml(text, directory, source, known_effects=effect_names())
