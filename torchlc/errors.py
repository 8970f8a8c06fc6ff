"""What can go wrong, in words for the person at the keyboard; the command line maps each class to an exit
code.
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path

_AT_A_SHELL = ContextVar("at_a_shell", default=False)


@contextlib.contextmanager
def at_a_shell() -> Iterator[None]:
    """Within it messages speak to a person who types commands; elsewhere to one who calls functions."""
    before = _AT_A_SHELL.set(True)
    try:
        yield
    finally:
        _AT_A_SHELL.reset(before)


def option(name: str, value: str | float | None = None, *, argument: str | None = None) -> str:
    """What the reader may give, as it is typed: ``--columns time=JD`` at a shell, ``columns="time=JD"`` in a call.

    ``value`` True is a switch. ``argument`` is the name in a call, where that is another one.
    """
    if _AT_A_SHELL.get():
        return f"--{name}" if value is None or value is True else f"--{name} {shlex.quote(str(value))}"
    argument = argument or name
    if not isinstance(value, str):
        return argument if value is None else f"{argument}={value}"
    return f"{argument}={value!r}" if '"' in value or "\\" in value else f'{argument}="{value}"'


class TorchlcError(Exception):
    """Base of every error torchlc raises on purpose; ``exit_code`` is what the command line returns."""

    exit_code = 1


class InputError(TorchlcError):
    """Input that cannot be used: says the file, the place in it, what was found, what was expected and what
    to do.
    """

    exit_code = 2

    def __init__(
        self,
        source: str | Path | None,
        place: str | None,
        found: str,
        expected: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.source, self.place, self.found, self.expected, self.hint = source, place, found, expected, hint
        where = ": ".join(str(part) for part in (source, place) if part)
        text = f"{where}: {found}" if where else found
        if expected:
            text += f"; expected {expected}"
        if hint:
            text += f". {hint}"
        super().__init__(" ".join(line.strip() for line in text.splitlines() if line.strip()))

    def __reduce__(self) -> tuple[type[InputError], tuple[object, ...]]:
        """What makes it again in another process: Python would call the class with the message alone."""
        return type(self), (self.source, self.place, self.found, self.expected, self.hint)


class BusyError(TorchlcError):
    """The output directory is in use by a run that is alive."""

    exit_code = 2


class ResourceError(TorchlcError):
    """Out of disk or memory."""

    exit_code = 3


class MissingExtraError(TorchlcError):
    """An optional dependency is not installed; the message carries the pip line."""

    exit_code = 2
