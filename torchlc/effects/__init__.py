"""The library of effects: every module of this folder is imported, and every class of an effect is listed by name, these
and those that are defined elsewhere."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from torchlc.stages.effect import EFFECTS, GEOMETRY_STAGES, STAGES, Context, Effect, Entry

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")


def registry() -> dict[str, type[Effect]]:
    """Every effect that is defined by now, by name, in the order of the stages."""
    in_order = sorted(EFFECTS.values(), key=lambda cls: (STAGES.index(cls.stage), cls.order, cls.name))
    return {cls.name: cls for cls in in_order}


def effect_class(entry: str) -> type[Effect]:
    """The class of an item of a list of effects."""
    return EFFECTS[Entry.parse(entry).name]


def names() -> tuple[str, ...]:
    """The names that a scene's ``effects`` list may hold."""
    return tuple(registry())


__all__ = ["GEOMETRY_STAGES", "STAGES", "Context", "Effect", "Entry", "effect_class", "names", "registry"]
