"""What a search has finished, kept in a file so that a run that was killed goes on from there."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import torch

T = TypeVar("T")
EVERY_S = 5.0
"""Seconds between writings of what is new: a kill costs no more than these."""


class Steps:
    """Results of the stages of one search, by name. ``path``: the file of an earlier run, read if it is of the same ``key``;
    ``write`` puts a new one in place, given what fills it, at most every ``every_s`` seconds; without them nothing is kept."""

    def __init__(
        self,
        key: str = "",
        path: Path | None = None,
        write: Callable[[Callable[[Path], object]], object] | None = None,
        every_s: float = 0.0,
    ) -> None:
        self._key, self._write, self._every_s, self._written = key, write, every_s, time.monotonic()
        self._known: dict[str, list[dict[str, object]]] = {}
        if path is None or not path.exists():
            return
        try:
            stored = torch.load(path, weights_only=True)
            known = stored["steps"] if stored["key"] == key else {}
        except Exception:  # PyTorch raises whatever the broken bytes make it raise
            return  # cut short, or of another kind: the search begins anew
        self._known = known

    @property
    def resumed(self) -> bool:
        """Whether stages of an earlier run are known."""
        return bool(self._known)

    def of(self, name: str, kind: type[T], make: Callable[[], Sequence[T]]) -> list[T]:
        """The results of a stage, dataclasses of tensors, numbers and tuples: those known, or made now and kept."""
        if name not in self._known:
            made = list(make())
            self._known[name] = [dict(vars(result)) for result in made]
            if self._write is not None and time.monotonic() >= self._written + self._every_s:
                self._written = time.monotonic()
                # PyTorch's own writing to a file turns a full disk into a RuntimeError
                content = io.BytesIO()
                torch.save({"key": self._key, "steps": self._known}, content)
                self._write(lambda path: path.write_bytes(content.getbuffer()))
            return made
        return [kind(**fields) for fields in self._known[name]]
