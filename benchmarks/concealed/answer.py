"""What a method says of a case, and what a method is: a module of ``methods`` with TITLE, NEEDS and ``examine``.

``TITLE`` is its name in the table, ``NEEDS`` the modules that it imports beyond torchlc's own, ``NAMES`` whether it can name
a cause, ``SHARES`` what it takes from the case that others take too and whose seconds are added to its own ("nominal",
"menu"), and ``examine(case, without, seed)`` returns an :class:`Answer`, the causes ``without`` taken out of the menu.
"""

from __future__ import annotations

import importlib.util
import pkgutil
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

import numpy as np

from benchmarks.concealed.case import Case
from benchmarks.concealed.methods import __path__ as folders

SURE = 0.01
"""p-value below which a method without probabilities of its own calls something missing."""


@dataclass(frozen=True)
class Answer:
    """``p``: of the recording if nothing is missing. ``verdict``: "none", "named", "unlisted", or "missing" of a method that
    cannot name. ``sets``: sets of names, the most probable first, with ``families``, for each member of the first what may
    stand in its place. ``confidence``: probability that the verdict is right, None where the method gives none. ``rows``
    (T,): where it sees something. ``gain``: log density of unseen rows over the nominal model's, None where it does not
    predict."""

    p: float
    verdict: str
    sets: Sequence[tuple[str, ...]] = ()
    families: Sequence[tuple[str, ...]] = ()
    confidence: float | None = None
    rows: np.ndarray | None = None
    gain: float | None = None


class Method(Protocol):
    TITLE: str
    NEEDS: Sequence[str]
    NAMES: bool
    SHARES: Sequence[str]

    def examine(self, case: Case, without: Collection[str], seed: int) -> Answer: ...


def method_names() -> list[str]:
    """Every file in ``methods``."""
    return sorted(one.name for one in pkgutil.iter_modules(folders))


def method(name: str) -> Method:
    return import_module(f"benchmarks.concealed.methods.{name}")  # pyright: ignore[reportReturnType]


def absent(name: str) -> list[str]:
    """Modules that a method needs and this environment lacks."""
    return [one for one in method(name).NEEDS if importlib.util.find_spec(one) is None]
