"""Libraries that read a person's environment when they are imported, imported although it is not to their liking."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from importlib import import_module
from types import ModuleType


def arviz_library() -> ModuleType:
    """The module ``arviz``. At import it writes a file into the user's cache once a day, which a home that cannot be written
    refuses. Neither that nor what it warns of may cost a result.
    """
    if "arviz" in sys.modules:
        return sys.modules["arviz"]
    matplotlib_library()
    with _unheard(), tempfile.TemporaryDirectory(prefix="torchlc-") as folder:
        return _imported("arviz", {"XDG_CACHE_HOME": folder})


def matplotlib_library() -> ModuleType:
    """The module ``matplotlib``. It refuses to be imported where ``MPLBACKEND``, of a notebook say, names a backend that is not
    installed, or where a matplotlibrc is no text.
    """
    with _unheard():
        return _imported("matplotlib", {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull})


def _imported(name: str, instead: Mapping[str, str]) -> ModuleType:
    """The module; where the environment stops its import, imported with these variables in place of the person's."""
    try:
        return import_module(name)
    except (OSError, ValueError):
        with environment(instead):
            return import_module(name)


@contextlib.contextmanager
def environment(instead: Mapping[str, str]) -> Iterator[None]:
    """Variables of the environment, for a while, with these values."""
    before = {key: os.environ.get(key) for key in instead}
    os.environ.update(instead)
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                del os.environ[key]
            else:
                os.environ[key] = value


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Warnings of libraries, which ``PYTHONWARNINGS=error`` makes errors, are not heard."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
