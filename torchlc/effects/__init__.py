"""The library of effects: every module of this folder is found and its Effect classes are listed by name."""

from __future__ import annotations

import functools
import importlib
import pkgutil

from torchlc.effects.base import GEOMETRY_STAGES, STAGES, Context, Effect


@functools.cache
def registry() -> dict[str, type[Effect]]:
    """Every effect by name, in the order of the stages."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    found = sorted(Effect.__subclasses__(), key=lambda cls: (STAGES.index(cls.stage), cls.order, cls.name))
    return {cls.name: cls for cls in found}


def names() -> tuple[str, ...]:
    """The names that a scene's ``effects`` list may hold."""
    return tuple(registry())


__all__ = ["GEOMETRY_STAGES", "STAGES", "Context", "Effect", "names", "registry"]
