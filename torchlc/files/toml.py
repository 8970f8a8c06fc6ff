"""TOML text read at the door: every defect is one InputError with its place, and no key takes more than its share."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from torchlc.errors import InputError
from torchlc.files.decimals import advice

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
        raise _with_place(source, text, error) from None
    except (RecursionError, ValueError) as error:
        raise InputError(source, None, f"unreadable TOML: {error}", "TOML without deep nesting") from None


TOKEN = re.compile(r"""[^\s=\[\]{}#"']+""")
"""What may be a number or a word on a line."""
BARE_POINT = re.compile(r"([+-]?)\.(\d+(?:[eE][+-]?\d+)?)", re.ASCII)
OPEN_POINT = re.compile(r"([+-]?\d+)\.((?:[eE][+-]?\d+)?)", re.ASCII)
LEADING_ZEROS = re.compile(r"([+-]?)0+(\d+(?:\.\d+)?)", re.ASCII)
WITH_UNIT = re.compile(r"[+-]?\d[\d.]*(?![eEdD][+-]?\d)[A-Za-z%\N{DEGREE SIGN}]\S*", re.ASCII)
COMMA = re.compile(r"[+-]?\d+,\d[\d,.]*", re.ASCII)
QUOTES = re.compile("[\N{LEFT SINGLE QUOTATION MARK}-\N{DOUBLE LOW-9 QUOTATION MARK}]")
"""Quotation marks of text processors."""


def _with_place(source: str | Path | None, text: str, error: tomllib.TOMLDecodeError) -> InputError:
    """A syntax error with its line and column, and what to do about it where it is a known slip."""
    place = re.search(r"\(at (line (\d+), column (\d+)|end of document)\)", str(error))
    found = re.sub(r"\s*\(at [^)]*\)", "", str(error))
    found = re.sub(r"\('(.*?)',?\)", lambda match: f"[{match[1].replace(QUOTED_DOT, '.')}]", found)
    hint = None
    if place is not None:
        lines = text.splitlines() or [""]
        line = lines[min(int(place[2]), len(lines)) - 1] if place[2] else lines[-1]
        hint = _advice(line, int(place[3]) if place[3] else len(line) + 1, found)
    where = place[1] if place is not None else None
    return InputError(source, where, found[:1].lower() + found[1:], "TOML", hint)


QUOTED_DOT = "', '"
"""Between the parts of a dotted name, as the parser writes it."""


def _advice(line: str, column: int, found: str) -> str | None:
    """What to do about a known slip at a column, counted from 1, of a line."""
    if "\\" in line and re.search(r"hex|escape|\\", found):
        return "Write each backslash twice, or the text between single quotes"
    if QUOTES.search(line):
        return "Write the quotation marks as the keyboard has them"
    if found.startswith("Expected '=' after a key"):
        if ":" in line[column - 1 :].partition("=")[0]:
            return "Write = between a key and its value"
        return "Put a key with blanks or signs between double quotes"
    at = [match for match in TOKEN.finditer(line) if match.start() < column <= match.end() + 1]
    token = at[-1][0].rstrip(",") if at else ""
    if match := BARE_POINT.fullmatch(token):
        return f"Write a 0 before the point: {match[1]}0.{match[2]}"
    if match := OPEN_POINT.fullmatch(token):
        return f"Write a 0 behind the point: {match[1]}.0{match[2]}"
    if match := LEADING_ZEROS.fullmatch(token):
        return f"Leave out the zeros in front: {match[1]}{match[2]}"
    if WITH_UNIT.fullmatch(token):
        return "Write the number alone, without a unit"
    if COMMA.fullmatch(token) and "[" not in line[:column]:
        return "Write decimals with a point, and nothing between thousands"
    if token.lower() in ("true", "false"):
        return f"Write {token.lower()}"
    if (hint := advice(token)) and "[" not in line[:column]:
        return hint
    if found.startswith("Invalid value"):
        if re.fullmatch(r"[^\W\d]\S*", token):
            return "Put text between double quotes"
        if not line[column - 1 :].strip() or line[column - 1 :].startswith("#"):
            return "Write a value behind ="
    return None
