"""What one table of a scene cannot know of another: names, materials and their models, files, effects."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TypeVar

from pydantic_core import PydanticCustomError

from torchlc import brdf
from torchlc.errors import InputError, option
from torchlc.files.numbers import Free, problem, value_of, within
from torchlc.materials.known import preset as preset_values
from torchlc.naming import ENTRY
from torchlc.scene.parts import PARAMETER_KEY, Material
from torchlc.scene.problems import shown, with_others
from torchlc.scene.tables import SceneTables
from torchlc.scene.tle import PLACEHOLDER
from torchlc.suggest import did_you_mean

Tables = TypeVar("Tables", bound=SceneTables)
MAX_FILE_BYTES = 100_000_000
"""Of a file that a scene names: a mesh or an ephemeris is smaller."""
MOST_NAMED = 10
"""New names that a warning lists."""


def checked(scene: Tables, *, trust: bool, known_effects: Collection[str] | None) -> Tables:
    """``scene`` with its materials completed; InputError where its tables contradict each other."""
    scene = numbered_components(scene)
    check = _Checks(scene, trust)
    check.unique("stations", "id", [station.id for station in scene.stations])
    if scene.orbit.vectors is None and not scene.stations:
        check.missing["stations"] = "no station", "at least one [[stations]], which the object is seen from"
    check.materials_in_use()
    check.files()
    check.effects(known_effects)
    if scene.orbit.tle and PLACEHOLDER in scene.orbit.tle[0]:
        scene.warnings.append(f"orbit.tle: the catalogue number is the placeholder {PLACEHOLDER}")
    completed = {name: check.material(name, material) for name, material in scene.materials.items()}
    check.tell_missing()
    check.axes_of_facets(completed)
    return scene.model_copy(update={"materials": completed})


def numbered_components(scene: Tables) -> Tables:
    """``scene`` with components of one name told apart by a number behind it, and a warning that says so.

    Copies of a table are often left with its name, and nothing but a report needs another. An effect's parameter
    that names one of them is refused: which of them it means cannot be told.
    """
    names = [component.name for component in scene.components]
    repeated = [name for name, count in Counter(names).items() if count > 1]
    taken, renamed = set(names), list(names)
    for name in repeated:
        places = [index for index, other in enumerate(names) if other == name]
        for key in scene.model.parameters:
            match = PARAMETER_KEY.fullmatch(key)
            if match and match["target"] == name and name not in scene.materials:
                hint = f"It is not clear which of the {len(places)} model.parameters.{key_text(key)!r} means."
                place = f"components[{places[1]}].name"
                raise InputError(scene.source, place, f"{name!r} again", "a name used once", hint)
        numbers = (f"{name} {number}" for number in itertools.count(1))
        unused = [new for new in itertools.islice(numbers, len(names) + len(places)) if new not in taken]
        for index, new in zip(places, unused, strict=False):
            renamed[index] = new
        taken.update(renamed)
        listed = ", ".join(repr(renamed[index]) for index in places[:MOST_NAMED])
        scene.warnings.append(
            f"components: {len(places)} have the name {name!r}. They are called "
            f"{listed}{', ...' if len(places) > MOST_NAMED else ''} here, in the order of the file. "
            "Give each a name of its own"
        )
    if not repeated:
        return scene
    pairs = zip(scene.components, renamed, strict=True)
    return scene.model_copy(
        update={"components": [component.model_copy(update={"name": new}) for component, new in pairs]}
    )


def key_text(key: str) -> str:
    """A key of the file as an error names it: as it is if that is plain and short."""
    return key if key.isprintable() and len(key) <= 60 else shown(key)


def _how_to_trust() -> str:
    return f"Put the file there; or, of a scene that you trust, {option('trust', True)} lets it name files anywhere"


def file_inside(directory: Path, name: str, *, trust: bool = False) -> Path:
    """The file ``name`` of a scene in ``directory``, links resolved; raises the problem where it may not be read. Nothing
    is opened."""
    if not trust:
        outside = PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor
        if outside or ".." in re.split(r"[/\\]", name):
            raise problem(shown(name), "a relative path inside the scene's folder", hint=_how_to_trust())
    try:
        path = (directory / name).resolve()
        size = path.stat().st_size if path.is_file() else None
    except (OSError, ValueError, RuntimeError):
        size, path = None, directory
    if not trust and not path.is_relative_to(directory.resolve()):
        raise problem(
            f"{shown(name)} leads out of the scene's folder", "a file inside it", hint=_how_to_trust()
        )
    if size is None:
        raise problem(f"no file {shown(name)}", f"a file in {directory}")
    if size > MAX_FILE_BYTES:
        raise problem(f"{size / 1e6:.0f} MB", f"at most {MAX_FILE_BYTES / 1e6:.0f} MB")
    return path


class _Checks:
    def __init__(self, scene: SceneTables, trust: bool) -> None:
        self.scene, self.trust = scene, trust
        self.missing: dict[str, tuple[str, str]] = {}
        """What was found and what was expected, by place, of all that is missing, to be told at once."""

    def tell_missing(self) -> None:
        if self.missing:
            (place, (found, expected)), *others = self.missing.items()
            hint = f"Missing too: {', '.join(other for other, _ in others)}" if others else None
            raise self.error(place, found, expected, hint)

    def error(self, place: str, found: str, expected: str | None, hint: str | None = None) -> InputError:
        return InputError(self.scene.source, place, found, expected, hint)

    def unique(self, table: str, key: str, names: Sequence[str]) -> None:
        for name, count in Counter(names).items():
            if count > 1:
                second = [index for index, other in enumerate(names) if other == name][1]
                raise self.error(f"{table}[{second}].{key}", f"{name!r} again", "a name used once")

    def materials_in_use(self) -> None:
        known, used = list(self.scene.materials), set()
        for index, component in enumerate(self.scene.components):
            for key, name in component.materials():
                if name not in known:
                    place, expected = f"components[{index}].{key}", f"a table [materials.{name}]"
                    raise self.error(place, f"unknown material {name!r}", expected, did_you_mean(name, known))
                used.add(name)
        for name in known:
            if name not in used:
                place = f"materials.{name}"
                raise self.error(
                    place, "used by no component", "a component made of it", "Remove it otherwise."
                )

    def material(self, name: str, material: Material) -> Material:
        """``material`` completed from its preset and its model's defaults, all in bounds."""
        place = f"materials.{name}"
        model, preset = self._preset(place, material)
        if model not in brdf.MODELS:
            known = sorted(brdf.MODELS)
            expected = f"one of {', '.join(known)}"
            raise self.error(f"{place}.model", shown(model), expected, did_you_mean(model, known))
        reflection = self._form(place, brdf.MODELS[model], material.parameters)
        preset = {key: number for key, number in preset.items() if key in reflection.keys_known()}
        parameters = self._complete(place, reflection, material.parameters, preset)
        if any(absent.startswith(f"{place}.") for absent in self.missing):
            return material
        bounded: dict[str, float | Free] = {}
        for key, number in parameters.items():
            quantity = reflection.quantity(key)
            bounded[key] = self._bounded(f"{place}.{key}", number, quantity.low, quantity.high)
        total = sum(value_of(bounded[key]) for key in reflection.simplex)
        if reflection.simplex and total > 1 + 1e-12:
            raise self.error(place, f"{' + '.join(reflection.simplex)} = {total:g}", "at most 1")
        return material.model_copy(update={"model": reflection.model, "parameters": bounded})

    def axes_of_facets(self, materials: Mapping[str, Material]) -> None:
        """A mesh, say, has no axes of its own for a material that needs them."""
        for index, component in enumerate(self.scene.components):
            if component.axes_wanted is None:
                continue
            for key, name in component.materials():
                reflection = brdf.MODELS[materials[name].model]
                if reflection.anisotropic(materials[name].parameters):
                    apart = " and ".join(reflection.along_axes)
                    raise self.error(
                        f"components[{index}].{key}",
                        f"{name!r} has {apart} apart, and the {component.shape} says nothing of the direction of u",
                        component.axes_wanted,
                    )

    def _preset(self, place: str, material: Material) -> tuple[str, Mapping[str, float | Free]]:
        if material.preset is None:
            return material.model, {}
        try:
            model, values = preset_values(material.preset)
        except InputError as error:
            raise self.error(f"{place}.preset", error.found, error.expected, error.hint) from None
        if "model" in material.model_fields_set and material.model != model:
            raise self.error(
                f"{place}.model", repr(material.model), f"{model}, as of preset {material.preset!r}"
            )
        return model, values

    def _form(self, place: str, law: type[brdf.Brdf], given: Mapping[str, float | Free]) -> type[brdf.Brdf]:
        """The law, or the form of it, whose keys the scene gives."""
        forms = law.forms()
        only: dict[type[brdf.Brdf], list[str]] = {
            form: [
                key
                for key in form.keys_known()
                if all(key not in other.keys_known() for other in forms if other is not form)
            ]
            for form in forms
        }
        wanted = [form for form in forms if any(key in given for key in only[form])]
        if len(wanted) > 1:
            first, second = (next(key for key in only[form] if key in given) for form in wanted[:2])
            choice = ", or ".join(" and ".join(keys) for keys in only.values())
            raise self.error(f"{place}.{second}", f"given beside {first}", choice)
        return wanted[0] if wanted else law

    def _complete(
        self,
        place: str,
        reflection: type[brdf.Brdf],
        given: Mapping[str, float | Free],
        preset: Mapping[str, float | Free],
    ) -> dict[str, float | Free]:
        """What the scene gives, else the preset, else the model's default; every quantity once."""
        quantities = {quantity.name: quantity for quantity in reflection.quantities}
        names = [*reflection.shared, *quantities]

        def covered(keys: Collection[str]) -> set[str]:
            return {name for key in keys for name in reflection.shared.get(key, (key,))}

        for key in given:
            if key not in names:
                expected = f"one of {', '.join(names)} ({reflection.model})"
                raise self.error(
                    f"{place}.{key_text(key)}", "unknown key", expected, did_you_mean(key, names)
                )
        for short, long in reflection.shared.items():
            twice = [key for key in long if short in given and key in given]
            if twice:
                raise self.error(
                    f"{place}.{twice[0]}", f"given beside {short}", f"{short}, or {' and '.join(long)}"
                )
        complete = dict(given)
        for source in (preset, reflection.defaults):
            complete |= {k: v for k, v in source.items() if not covered([k]) & covered(complete)}
        aliases = {long: short for short, keys in reflection.shared.items() for long in keys}
        for name, quantity in quantities.items():
            if name not in covered(complete):
                short = aliases.get(name, name)
                key = name if covered([short]) & covered(complete) else short
                self.missing.setdefault(f"{place}.{key}", ("missing", f"a value: {quantity.meaning}"))
        return complete

    def _bounded(self, place: str, number: float | Free, low: float, high: float) -> float | Free:
        try:
            return within(number, low, high)
        except PydanticCustomError as error:
            context = error.context or {}
            key = f".{context['key']}" if context["key"] else ""
            raise self.error(place + key, context["found"], context["expected"]) from None

    def files(self) -> None:
        for place, name in self.scene.files().items():
            self._file(place, name)

    def _file(self, place: str, name: str) -> None:
        """Unless the scene is trusted, the file must lie in its folder, links resolved."""
        if self.scene.directory is None:
            raise self.error(place, shown(name), "a scene read from a file, or its directory")
        try:
            file_inside(self.scene.directory, name, trust=self.trust)
        except PydanticCustomError as error:
            context = error.context or {}
            raise self.error(place, context["found"], context["expected"], context["hint"]) from None

    def effects(self, known: Collection[str] | None) -> None:
        listed = self.scene.model.effects or []
        self.unique("model.effects", "name", listed)
        targets = [*self.scene.materials, *(component.name for component in self.scene.components)]
        unknown: list[tuple[str, str]] = []
        for index, entry in enumerate(listed):
            match, place = ENTRY.fullmatch(entry), f"model.effects[{index}]"
            name = entry if match is None else match["name"]
            if known is not None and name not in known:
                unknown.append((place, name))
                continue
            if match is None or (known is not None and match["per"]):
                hint = 'A value for each curve is per = "curve" of a number in [model.parameters].'
                raise self.error(place, shown(entry), "effect or effect[material or component]", hint)
            if match["target"] is not None and match["target"] not in targets:
                raise self._unknown_target(place, match["target"], targets)
        for key in self.scene.model.parameters:
            match = PARAMETER_KEY.fullmatch(key)
            place = f'model.parameters."{key_text(key)}"'
            if match and known is not None and match["effect"] not in known:
                unknown.append((place, match["effect"]))
            elif match and match["target"] is not None and match["target"] not in targets:
                raise self._unknown_target(place, match["target"], targets)
        if unknown:
            raise self._unknown_effects(unknown, sorted(known or ()))

    def _unknown_target(self, place: str, target: str, targets: Sequence[str]) -> InputError:
        expected = f"one of {', '.join(targets[:12])}"
        return self.error(
            place, f"no material or component {shown(target)}", expected, did_you_mean(target, targets)
        )

    def _unknown_effects(self, unknown: Sequence[tuple[str, str]], known: Sequence[str]) -> InputError:
        """All effects that are not known, with their places."""
        (place, name), *others = unknown
        expected = f"one of the {len(known)} that torchlc effects lists"
        more = [(f"{where}, {shown(other)}", did_you_mean(other, known)) for where, other in others]
        hint = with_others(did_you_mean(name, known), more)
        return self.error(place, f"unknown effect {shown(name)}", expected, hint)
