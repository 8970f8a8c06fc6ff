"""A first scene: commented TOML from orbital elements and a preset shape, ready to be edited."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchlc.effects import names as effect_names
from torchlc.errors import InputError
from torchlc.geometry.orbit.elements import FRESH_DAYS
from torchlc.prediction.posterior import POSTERIOR_FILE, read_posterior
from torchlc.scene import Scene, Station, load_scene, station_of
from torchlc.scene.timestamps import UnreadableTime, instant
from torchlc.scene.tle import Elements, nearest, passed_over, read_catalogue, sets_of_object, sound_sets
from torchlc.scene.writer import toml_value
from torchlc.shapes import Shape
from torchlc.suggest import did_you_mean

TEMPLATES = Path(__file__).parent / "templates"
PLACEHOLDER_STATION = ("site", 0.0, 0.0, 0.0)
CATALOGUE = Path(__file__).parent / "presets.toml"
SCATTER_MAG = {"starlink-v1.5": 0.45, "starlink-v2-mini": 0.4}
"""Standard deviation between satellites of one kind, mag, about the preset's model: 1.48 times the median deviation of the
recorded magnitudes that it was fitted to, 0.39 and 0.35, rounded up; see docs/how_to/predict.md."""
ON_STATION = """
# As in the model that the materials were fitted with: nothing shadows anything else.
effects = ["sun_distance", "light_time", "earth_shadow"]"""
TUMBLING = """
# While the attitude is free, shadows and the Sun's disc are worked out anew for every try, which costs some hundred times
# more: add self_shadowing and finite_sun once it is known.
effects = ["sun_distance", "light_time", "earth_shadow"]"""
NOMINAL = """
# Nobody knows an attitude exactly, nor errors: attitude_offset is free by 0.3 deg about each axis, and jitter widens the quoted
# errors where the data ask for it. Add exposure_smearing where the recording has a column exptime, and finite_sun for mirrors.
effects = ["sun_distance", "light_time", "earth_shadow", "self_shadowing", "attitude_offset", "jitter"]"""
NOMINAL_NUMBERS = """
"attitude_offset.x" = { value = 0.0, sigma = 0.3, prior = "normal" }
"attitude_offset.y" = { value = 0.0, sigma = 0.3, prior = "normal" }
"attitude_offset.z" = { value = 0.0, sigma = 0.3, prior = "normal" }"""
SIZE, FIXED = re.compile(r"~(\w+)~"), re.compile(r"=(\w+)=")
"""Marks of a template: a size, which has a prior, and another number of the preset."""
LEAST_SHARE = 0.1
"""Of a size's nominal value, that its prior allows: a size is never 0."""


@dataclass(frozen=True)
class Preset:
    """A class of objects: its template, its numbers (m), the standard deviation of its sizes in percent, and their source."""

    template: str
    percent: float
    source: str
    values: Mapping[str, float]

    def shape(self, *, exact: bool) -> str:
        """The template with its sizes: numbers if ``exact``, else with a normal prior each."""
        text = (TEMPLATES / f"shape_{self.template}.toml").read_text(encoding="utf-8")
        spread = f", within {self.percent:g} %" if not exact and self.percent else ""
        text = text.replace("@SIZES@", f"Sizes{spread}: {self.source}")
        text = SIZE.sub(lambda mark: self._size(self.values[mark[1]], exact), text)
        return FIXED.sub(lambda mark: f"{self.values[mark[1]]:g}", text)

    def _size(self, value: float, exact: bool) -> str:
        if exact or not self.percent:
            return f"{value:g}"
        sigma, low = value * self.percent / 100, value * LEAST_SHARE
        return f'{{ value = {value:g}, sigma = {sigma:.3g}, low = {low:.3g}, prior = "normal" }}'

    @property
    def tumbles(self) -> bool:
        """Whether its attitude is free already, so that an offset of it says nothing more."""
        return self.template in ("rocket_body", "cubesat")


PRESETS = {
    name: Preset(**content) for name, content in tomllib.loads(CATALOGUE.read_text(encoding="utf-8")).items()
}
"""Shape by the name people say."""


def elements_for(
    path: Path, date: str | float | None, wanted: str | None = None
) -> tuple[Elements, list[str]]:
    """The set of a file with its epoch nearest to ``date`` (ISO UTC or JD), or the latest; of a file of many objects
    that of the one ``wanted``, by its number, its name or a part of its name. Beside that one, sets that are not right
    are passed over, which the list says.
    """
    if wanted is None:
        return nearest_set(sets_of_object(path, read_catalogue(path), None), date), []
    sets, wrong = sound_sets(path)
    try:
        chosen = sets_of_object(path, sets, wanted)
    except InputError as error:
        hint = ". ".join(filter(None, [error.hint, *passed_over(wrong)]))
        raise InputError(path, error.place, error.found, error.expected, hint or None) from None
    return nearest_set(chosen, date), passed_over(wrong)


def to_the_minute(when: str | float) -> str:
    """ISO text of an instant (ISO UTC or JD), as --start takes it."""
    moment: Any = instant(when, "utc")
    return str(moment.isot)[:16]


def old_elements(elements: Elements, wanted: str | float) -> list[str]:
    """What to say where elements are of another time than the one that is ``wanted``."""
    when: Any = instant(wanted, "utc")
    days = abs(float(when.jd) - elements.epoch)
    if days <= FRESH_DAYS:
        return []
    return [
        f"the elements are {days:,.0f} days from --date: a position along the orbit drifts by kilometres a day; take elements of that time"
    ]


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
    """Name and place of a station from "id,latitude,longitude,height"."""
    station = station_of(text)
    return station.id, station.latitude, station.longitude, station.height


def _folded(name: str) -> str:
    return name.strip().lower().replace(" ", "-").replace("_", "-")


def _preset_key(preset: str, option: str = "--shape, --preset") -> str:
    """The preset's name as PRESETS has it, folded; InputError, which names the option, if there is none."""
    key = _folded(preset)
    if key not in PRESETS:
        raise InputError(
            None, option, repr(preset), f"one of {', '.join(PRESETS)}", did_you_mean(key, PRESETS)
        )
    return key


def beside(folder: Path, mesh: str) -> str:
    """The path of a mesh as a scene in ``folder`` names it: from there. What is typed may also be the path from where the
    command runs, as a shell completes it, or a whole one, if that file lies in ``folder``.
    """
    try:
        if (folder / mesh).is_file() and not Path(mesh).is_absolute():
            return mesh
        if Path(mesh).is_file():
            return Path(mesh).absolute().relative_to(folder.absolute()).as_posix()
    except (OSError, ValueError):
        pass  # said by the reader of the scene, in its words
    return mesh


def new_scene(
    elements: Elements,
    preset: str,
    *,
    name: str | None = None,
    station: tuple[str, float, float, float] | None = None,
    mesh: str | None = None,
    exact: bool = False,
) -> str:
    """TOML of a scene that can be simulated and fitted as it stands: with priors on what nobody knows exactly (sizes, attitude,
    errors), or ``exact``."""
    key = _preset_key(preset)
    if (key == "mesh") != (mesh is not None):
        raise InputError(
            None,
            "--mesh",
            "missing" if mesh is None else f"given with shape {preset}",
            "a file for the shape mesh",
        )
    place = PLACEHOLDER_STATION if station is None else station
    chosen = PRESETS[key]
    nominal = not exact and not chosen.tumbles and key not in SCATTER_MAG
    effects = TUMBLING if key.startswith("rocket-body") else ON_STATION if key in SCATTER_MAG else ""
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
        "SHAPE": chosen.shape(exact=exact).rstrip(),
        "EFFECTS": NOMINAL if nominal else effects,
        "NUMBERS": NOMINAL_NUMBERS if nominal else "",
    }
    for key, value in values.items():
        if key != "MESH":
            text = text.replace(f"@{key}@", value)
    return text.replace("@MESH@", values["MESH"])


@dataclass(frozen=True)
class AskedPrediction:
    """What the arguments of ``predict`` name: a scene or the directory of a fit, the file of elements that takes the place
    of its orbit, stations that take the place of its own, and the preset's scatter between objects, mag."""

    scene: Scene | Path
    elements: Path | None
    stations: list[Station] | None
    scatter: float


def prediction_of(
    given: Path, preset: str | None, like: Path | None, stations: list[str], trust: bool
) -> AskedPrediction:
    """Sort out what was given: TOML is a scene, a directory a fit, anything else elements."""
    whole = given.is_dir() or given.suffix.lower() == ".toml"
    if whole and (preset is not None or like is not None):
        option = "--preset" if preset is not None else "--like"
        raise InputError(None, option, f"given with {given}", "elements of many objects with it")
    if not whole and (preset is None) == (like is None):
        found = f"{given} without --preset and --like" if preset is None else "both of them"
        hint = f"--preset takes {', '.join(PRESETS)}"
        raise InputError(None, "--preset, --like", found, "one of them, to say what the objects are", hint)
    typed = [text for text in stations if "," in text]
    names = [text for text in stations if "," not in text]
    own = [station_of(text) for text in typed]
    if preset is not None:
        if names or not own:
            raise InputError(None, "--station", repr(names[0]) if names else "missing", "ID,LAT,LON,HEIGHT")
        first = sound_sets(given)[0][0]
        key = _preset_key(preset, "--preset")
        if key == "mesh":
            raise InputError(None, "--preset", "mesh", "a shape with sizes; --like takes a scene with a mesh")
        text = new_scene(
            first,
            preset,
            name=preset.strip().lower(),
            station=read_station(typed[0]),
            exact=True,
        )
        scatter = SCATTER_MAG.get(key, 0.0)
        return AskedPrediction(check_scene(text, given.parent, given), given, own, scatter)
    source = given if like is None else like
    if like is not None and not (like.is_dir() or like.suffix.lower() == ".toml"):
        raise InputError(like, None, "neither TOML nor a directory", "a scene, or the directory of a fit")
    scene: Scene | Path = source
    if not source.is_dir():
        scene = load_scene(source, trust=trust, known_effects=effect_names())
    chosen = own
    if names:
        known = {one.id: one for one in _scene_of(scene).stations}
        for name in names:
            if name not in known:
                expected = f"ID,LAT,LON,HEIGHT, or one of {', '.join(known) or 'none in the scene'}"
                raise InputError(None, "--station", repr(name), expected, did_you_mean(name, known))
        chosen = [known[name] for name in names] + own
    return AskedPrediction(scene, None if like is None else given, chosen or None, 0.0)


def _scene_of(scene: Scene | Path) -> Scene:
    return scene if isinstance(scene, Scene) else read_posterior(scene / POSTERIOR_FILE)[0]


def check_scene(text: str, directory: Path, source: Path) -> Scene:
    """Read what is about to be written, so that a bad element set, station or mesh is said before a file exists."""
    scene = Scene.from_toml(text, directory, source, known_effects=effect_names())
    if scene.files():
        Shape(scene, {})
    return scene
