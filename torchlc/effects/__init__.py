"""The library of effects: every module of this folder, and of the folder of noise models, is imported, and every class of
an effect is listed by name, these and those that are defined elsewhere."""

from __future__ import annotations

from functools import lru_cache

from torchlc import noise
from torchlc.naming import import_modules
from torchlc.noise.kind import NoiseKind
from torchlc.stages.effect import EFFECTS, Context, Effect
from torchlc.stages.entry import Entry
from torchlc.stages.order import GEOMETRY_STAGES, STAGES
from torchlc.stages.swing import swinging

import_modules(noise.__name__, noise.__path__)
import_modules(__name__, __path__)


def registry() -> dict[str, type[Effect]]:
    """Every effect that is defined by now, by name, in the order of the stages."""
    return {cls.name: cls for cls in _in_order(tuple(EFFECTS.values()))}


@lru_cache(maxsize=4)
def _in_order(classes: tuple[type[Effect], ...]) -> list[type[Effect]]:
    return sorted(classes, key=lambda cls: (STAGES.index(cls.stage), cls.order, cls.name))


def effect_class(entry: str) -> type[Effect]:
    """The class of an item of a list of effects, or of one that is :func:`unlisted`."""
    name = Entry.parse(entry).name
    return EFFECTS[name] if name in EFFECTS else unlisted()[name]


def unlisted() -> dict[str, type[Effect]]:
    """What the library does not hold but a diagnosis looks for, by name: the effects whose constant angle swings instead."""
    return {cls.name: cls for cls in _swinging(tuple(EFFECTS.values())) if cls.name not in EFFECTS}


@lru_cache(maxsize=4)
def _swinging(classes: tuple[type[Effect], ...]) -> list[type[Effect]]:
    return [swinging(cls) for cls in _in_order(classes) if cls.swings]


def nameable() -> dict[str, type[Effect]]:
    """What a scene's ``effects`` list may name: the library's effects, and then those that are :func:`unlisted`."""
    return registry() | unlisted()


def names() -> tuple[str, ...]:
    """The names of :func:`nameable`."""
    return tuple(nameable())


def mending_kind() -> type[NoiseKind]:
    """The noise that a fit adds where chi-square says that the quoted errors are too small."""
    kinds = (cls for cls in registry().values() if issubclass(cls, NoiseKind))
    return next(kind for kind in kinds if kind.mends_errors)


def object_kind() -> type[NoiseKind]:
    """The noise by which objects of one design differ."""
    kinds = (cls for cls in registry().values() if issubclass(cls, NoiseKind))
    return next(kind for kind in kinds if kind.between_objects)


def with_title(entry: str) -> str:
    """The name of an effect, or an item of a list of them, and what it is in plain words; the item alone where the library does
    not have the effect."""
    cls = nameable().get(Entry.parse(entry).name)
    return entry if cls is None else f"{entry} ({cls.title})"


__all__ = [
    "GEOMETRY_STAGES",
    "STAGES",
    "Context",
    "Effect",
    "Entry",
    "effect_class",
    "mending_kind",
    "nameable",
    "names",
    "registry",
    "unlisted",
    "with_title",
]
