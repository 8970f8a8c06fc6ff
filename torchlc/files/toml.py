"""TOML text read at the door: every defect is one InputError with its place, and no key takes more than its share."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from torchlc.errors import InputError

MOST_PARTS = 64
"""Parts of a dotted key. A scene needs 3; time and memory of the parser grow with the square, to 47 s and 4.4 GB at 50,000."""
LONG_KEY = re.compile(
    rf"""(?<![\w"'-])(?:(?:[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*+\.[ \t]*+){{{MOST_PARTS}}}""", re.ASCII
)


def parse_toml(text: str, source: str | Path | None) -> dict[str, Any]:
    """The content of TOML text."""
    long_key = LONG_KEY.search(text)
    if long_key is not None:
        line = text.count("\n", 0, long_key.start()) + 1
        raise InputError(
            source, f"line {line}", f"a key of more than {MOST_PARTS} parts", "keys of at most 3 parts"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _with_place(source, error) from None
    except (RecursionError, ValueError) as error:
        raise InputError(source, None, f"unreadable TOML: {error}", "TOML without deep nesting") from None


def _with_place(source: str | Path | None, error: tomllib.TOMLDecodeError) -> InputError:
    """A syntax error with its line and column."""
    place = re.search(r"\(at (line \d+, column \d+|end of document)\)", str(error))
    found = re.sub(r"\s*\(at [^)]*\)", "", str(error))
    return InputError(source, place.group(1) if place else None, found[:1].lower() + found[1:], "TOML")
