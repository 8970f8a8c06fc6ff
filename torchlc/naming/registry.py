"""The classes that a name may stand for: an effect (noise among them), a law of reflection, a shape, a
format of recordings, a figure of the report.

A class enters by being defined, in the package, a script, a test or a notebook. Whoever lists the classes asks the
registry at that moment, so that no list is older than the last definition. :func:`import_modules` defines those of a
folder of the package.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, Generic, TypeVar

PACKAGE = __name__.partition(".")[0]
Class = TypeVar("Class", bound=type)


class Replaced(UserWarning):
    """A class has taken a name that another class had."""


class Registry(Mapping[str, Class], Generic[Class]):
    """Classes of one ``kind`` by name, in the order in which they were defined, the latest last."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._classes: dict[str, Class] = {}

    def __getitem__(self, name: str) -> Class:
        return self._classes[name]

    def __iter__(self) -> Iterator[str]:
        return iter(tuple(self._classes))

    def __len__(self) -> int:
        return len(self._classes)

    def declared(self, cls: Class, attribute: str, key: str | None = None) -> None:
        """Enter a class that has just been defined, if it names itself: its own body sets ``attribute``. A class
        that only inherits its name, as a common base does, stays out. ``key`` is the name to enter, if not the
        attribute's value."""
        if isinstance(cls.__dict__.get(attribute), str):
            self.enter(key or cls.__dict__[attribute], cls)

    def enter(self, name: str, cls: Class) -> None:
        """Let ``name`` stand for ``cls``; a Replaced warning tells if it stood for another class."""
        before = self._classes.get(name)
        if before is not None and before is not cls:
            warnings.warn(
                f"{self.kind} {name!r} is now {_full_name(cls)}, in place of {_full_name(before)}",
                Replaced,
                stacklevel=_level_of_user(),
            )
        self._classes.pop(name, None)
        self._classes[name] = cls

    @contextmanager
    def restored(self) -> Iterator[None]:
        """What is defined meanwhile is known only meanwhile, as a test wants it."""
        before = dict(self._classes)
        try:
            yield
        finally:
            self._classes = before

    def pop(self, name: str) -> Class:
        """Take a name away; the class that it stood for."""
        return self._classes.pop(name)

    def outside(self) -> dict[str, Class]:
        """The classes that were defined outside this package."""
        return {name: cls for name, cls in self._classes.items() if not _is_ours(cls)}


def _level_of_user() -> int:
    """How many frames above the one that asks is the first of code that is neither this package's nor what makes abstract classes, so that a
    warning stands at the user's line, and comes again where a notebook runs its cell again."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in (
        PACKAGE,
        "abc",
    ):
        level, frame = level + 1, frame.f_back
    return level


def _is_ours(cls: type) -> bool:
    return cls.__module__.partition(".")[0] == PACKAGE


def _full_name(cls: Any) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"


def import_modules(package: str, path: Iterable[str]) -> None:
    """Import every module of a folder of the package, whose classes are known from then on."""
    for module in iter_modules(path):
        import_module(f"{package}.{module.name}")
