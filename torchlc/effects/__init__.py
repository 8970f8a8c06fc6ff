"""The library of effects: every module of this folder, and of the folder of noise models, is found; their classes and
those of a user are listed by name."""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Iterator

from torchlc import noise
from torchlc.noise.kind import NoiseKind
from torchlc.stages.effect import GEOMETRY_STAGES, STAGES, Context, Effect, Entry


@functools.cache
def _library() -> None:
    """Import every file of the library, once."""
    for package, path in ((__name__, __path__), (noise.__name__, noise.__path__)):
        for module in pkgutil.iter_modules(path):
            importlib.import_module(f"{package}.{module.name}")


def _named(cls: type[Effect]) -> Iterator[type[Effect]]:
    """The subclasses of a class, and theirs, that have a name of their own."""
    for subclass in cls.__subclasses__():
        if "name" in vars(subclass):
            yield subclass
        yield from _named(subclass)


def every() -> dict[str, type[Effect]]:
    """Every effect by name, in the order of the stages, those included that a diagnosis never names."""
    _library()
    found = sorted(_named(Effect), key=lambda cls: (STAGES.index(cls.stage), cls.order, cls.name))
    return {cls.name: cls for cls in found}


def registry() -> dict[str, type[Effect]]:
    """Every effect that a scene may list and a diagnosis may name, in the order of the stages."""
    return {name: cls for name, cls in every().items() if cls.listed}


def effect_class(entry: str) -> type[Effect]:
    """The class of an item of a list of effects."""
    return every()[Entry.parse(entry).name]


def names() -> tuple[str, ...]:
    """The names that a scene's ``effects`` list may hold."""
    return tuple(registry())


def mending_kind() -> type[NoiseKind]:
    """The noise that a fit adds where chi-square says that the quoted errors are too small."""
    kinds = (cls for cls in registry().values() if issubclass(cls, NoiseKind))
    return next(kind for kind in kinds if kind.mends_errors)


def with_title(name: str) -> str:
    """The name of an effect and what it is in plain words; the name alone of one that the library does not have."""
    cls = every().get(name)
    return name if cls is None else f"{name} ({cls.title})"


__all__ = [
    "GEOMETRY_STAGES",
    "STAGES",
    "Context",
    "Effect",
    "effect_class",
    "every",
    "mending_kind",
    "names",
    "registry",
    "with_title",
]
