"""What pydantic and tomllib find wrong with a scene, as one sentence with a place in the file."""

from __future__ import annotations

import difflib
import re
import reprlib
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from torchlc.errors import InputError

EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "finite_number": "a finite number",
}
SHAPES = ("box", "plate", "cylinder", "cone", "dish", "sphere", "mesh")


def of_toml(source: str | Path | None, error: tomllib.TOMLDecodeError) -> InputError:
    text = str(error)
    line = re.search(r"\(at (line \d+, column \d+|end of document)\)", text)
    found = re.sub(r"\s*\(at [^)]*\)", "", text)
    return InputError(source, line.group(1) if line else None, found[:1].lower() + found[1:], "TOML")


def of_validation(source: str | Path | None, error: ValidationError) -> InputError:
    """The first problem, unknown keys before all others: a misspelt key is also a missing one."""
    problems = sorted(error.errors(include_url=False), key=lambda problem: problem["type"] != "unknown_key")
    first = problems[0]
    place, found, expected, hint = _sentence(
        first["type"], first["loc"], first.get("input"), first.get("ctx") or {}, first["msg"]
    )
    if len(problems) > 1:
        hint = f"{hint or ''} ({len(problems) - 1} more like this)".strip()
    return InputError(source, place, found, expected, hint)


def did_you_mean(word: str, known: Sequence[str]) -> str | None:
    near = difflib.get_close_matches(word.lower(), {name.lower(): name for name in known}, n=1)
    return f"Did you mean {next(name for name in known if name.lower() == near[0])!r}?" if near else None


def shown(value: Any) -> str:
    """A short repr; deep nesting is cut."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = 60
    return short.repr(value)


def place_of(location: Sequence[str | int], key: str = "") -> str | None:
    """``components[1].size[0]`` from pydantic's location; tags of unions and tables of our own making are left out."""
    text = ""
    parts = [part for part in location if not (isinstance(part, str) and part.startswith("#"))]
    if parts[:1] == ["components"] and len(parts) > 2 and parts[2] in SHAPES:
        del parts[2]
    if parts[:1] == ["materials"] and parts[2:3] == ["parameters"]:
        del parts[2]
    if parts[:2] == ["model", "band_sun_magnitude"]:
        parts.insert(1, "parameters")
    for part in (*parts, *([key] if key else [])):
        joined = isinstance(part, int) or part.startswith("[")
        text += (
            (f"[{part}]" if isinstance(part, int) else part) if joined else f".{part}" if text else str(part)
        )
    return text or None


def _sentence(
    kind: str, location: Sequence[str | int], value: Any, context: dict[str, Any], message: str
) -> tuple[str | None, str, str | None, str | None]:
    """(place, found, expected, hint) of one problem."""
    if kind == "torchlc":
        return (
            place_of(location, context["key"]),
            context["found"],
            context["expected"],
            context["hint"] or None,
        )
    if kind == "unknown_key":
        allowed = [name for name in context["allowed"] if name != "parameters" or "materials" not in location]
        hint = did_you_mean(context["key"], allowed)
        return place_of(location, context["key"]), "unknown key", f"one of {', '.join(allowed)}", hint
    place = place_of(location)
    if kind == "missing":
        return place, "missing", "a value", None
    if kind == "union_tag_not_found":
        return place_of(location, "shape"), "missing", f"one of {', '.join(SHAPES)}", None
    if kind == "union_tag_invalid":
        tag = str(context.get("tag", ""))
        return (
            place_of(location, "shape"),
            shown(tag),
            f"one of {', '.join(SHAPES)}",
            did_you_mean(tag, SHAPES),
        )
    if kind == "literal_error":
        known = re.findall(r"'([^']*)'", str(context.get("expected", "")))
        return place, shown(value), f"one of {', '.join(known)}", did_you_mean(str(value)[:60], known)
    if kind in ("too_long", "too_short"):
        count = context.get("max_length", context.get("min_length"))
        return place, f"{context.get('actual_length')} values", f"{count}", None
    if kind == "missing" or kind not in EXPECTED:
        return place, shown(value), re.sub(r"^Input should be ", "", message), None
    return place, shown(value), EXPECTED[kind], None
