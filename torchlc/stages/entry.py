"""One item of a list of effects, as a person writes it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from torchlc.naming import ENTRY


@dataclass(frozen=True)
class Entry:
    """One item of a list of effects: ``name``, ``name[target]``, and, where the diagnosis divides an offset,
    ``name@curve`` (or ``@night``, ``@station``): a value for each, drawn from a normal of standard deviation
    ``width`` (``name@curve~width``)."""

    name: str
    target: str | None = None
    per: str | None = None
    width: float | None = None

    @classmethod
    def parse(cls, text: str) -> Entry:
        """The parts of an item; the whole of one that has another form counts as a name, which no effect has."""
        return _parsed(text)

    @classmethod
    def split(cls, text: str) -> list[str]:
        """Items of a list as it is typed: commas divide it, those in brackets belong to a target."""
        return [item.strip() for item in re.split(r",(?![^\[]*\])", text) if item.strip()]

    @property
    def plain(self) -> str:
        """The entry without the width."""
        return self.name + (f"[{self.target}]" if self.target else "") + (f"@{self.per}" if self.per else "")

    def __str__(self) -> str:
        return self.plain + (f"~{self.width:.3g}" if self.width is not None else "")


@lru_cache(maxsize=4096)
def _parsed(text: str) -> Entry:
    match = ENTRY.fullmatch(text)
    if match is None:
        return Entry(text)
    width = match["width"]
    return Entry(match["name"], match["target"], match["per"], float(width) if width else None)
