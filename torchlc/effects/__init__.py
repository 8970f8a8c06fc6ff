"""The library of effects: every module of this folder is found and its Effect classes are listed by name."""

from __future__ import annotations

import functools
import importlib
import pkgutil

from torchlc.stages.effect import GEOMETRY_STAGES, STAGES, Context, Effect, Entry


@functools.cache
def every() -> dict[str, type[Effect]]:
    """Every effect by name, in the order of the stages, those included that a diagnosis never names."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    found = sorted(Effect.__subclasses__(), key=lambda cls: (STAGES.index(cls.stage), cls.order, cls.name))
    return {cls.name: cls for cls in found}


@functools.cache
def registry() -> dict[str, type[Effect]]:
    """Every effect that a scene may list and a diagnosis may name, in the order of the stages."""
    return {name: cls for name, cls in every().items() if cls.listed}


def effect_class(entry: str) -> type[Effect]:
    """The class of an item of a list of effects."""
    return every()[Entry.parse(entry).name]


def names() -> tuple[str, ...]:
    """The names that a scene's ``effects`` list may hold."""
    return tuple(registry())


__all__ = ["GEOMETRY_STAGES", "STAGES", "Context", "Effect", "effect_class", "every", "names", "registry"]
