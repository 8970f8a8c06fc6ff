"""What pydantic finds wrong with a scene, as one sentence with a place in the file."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.files.numbers import FIXED, FREE, SEVERAL, SIDES, SINGLE, WHOLE
from torchlc.suggest import did_you_mean

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

KEY = "[key]"
"""How pydantic says that a problem is that of the key of a table, not of its value."""
MOST_TOLD = 20
"""Keys that one message lists."""
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


def of_validation(source: str | Path | None, error: ValidationError) -> InputError:
    """The first problem, unknown keys before all others: a misspelt key is also a missing one. Keys that are unknown, and
    those that are missing, are told all at once.
    """
    details = sorted(error.errors(include_url=False), key=lambda detail: detail["type"] != "unknown_key")
    sentences = [_sentence(detail) for detail in details]
    place, found, expected, hint = sentences[0]
    unknown = [(where, advice) for where, what, _, advice in sentences[1:] if what == "unknown key"]
    hint = with_others(hint, unknown)
    absent = [where for where, what, _, _ in sentences if what == "missing" and where is not None]
    if found == "missing" and len(absent) > 1:
        rest = [where for where in absent if where != place]
        listed = ", ".join(rest[:MOST_TOLD]) + (
            f" and {len(rest) - MOST_TOLD} more" if len(rest) > MOST_TOLD else ""
        )
        hint = f"{hint or ''} Missing too: {listed}".strip()
    elif absent and found != "missing":
        hint = f"{hint or ''} Missing: {', '.join(absent[:MOST_TOLD])}".strip()
    others = len(details) - 1 - len(unknown) - len(absent) + (found == "missing")
    if others:
        hint = f"{hint or ''} ({others} more to mend)".strip()
    return InputError(source, place, found, expected, hint)


def with_others(hint: str | None, unknown: Sequence[tuple[str | None, str | None]]) -> str | None:
    """The hint on the first of several unknown names, and the places of the others, each with its own advice."""
    if not unknown:
        return hint
    more = ", ".join(
        f"{where} ({advice[0].lower()}{advice[1:]})" if advice else str(where)
        for where, advice in unknown[:MOST_TOLD]
    )
    rest = f" and {len(unknown) - MOST_TOLD} more" if len(unknown) > MOST_TOLD else ""
    return f"{hint or ''} Unknown too: {more}{rest}".strip()


MOST_BITS = 4096
"""Of a whole number that is written out; Python refuses to write 4,300 digits."""


def shown(value: Any) -> str:
    """A short repr; deep nesting is cut. Python refuses to write integers of thousands of digits in decimals."""
    if isinstance(value, int) and value.bit_length() > MOST_BITS:
        return f"an integer of {value.bit_length()} bits"
    short = reprlib.Repr()
    short.maxstring = short.maxother = 60
    return short.repr(value)


def place_of(location: Sequence[str | int], key: str = "") -> str | None:
    """``components[1].size[0]`` from pydantic's location, without the tags of unions."""
    tags = (FIXED, FREE, WHOLE, SIDES, SINGLE, SEVERAL, KEY)
    parts = [part for part in location if part not in tags]
    if parts[:1] == ["materials"] and parts[2:3] == ["parameters"]:
        parts = parts[:2] + parts[3:]
    if parts[:2] == ["model", "band_sun_magnitude"]:
        parts.insert(1, "parameters")
    names = [
        f"[{part}]" if isinstance(part, int) else part if len(part) <= 110 else f"{part[:60]}..."
        for part in (*parts, key)
        if part != ""
    ]
    joined = "".join(name if name.startswith("[") else f".{name}" for name in names)
    return "".join(c if c.isprintable() else "?" for c in joined.removeprefix(".")) or None


def _sentence(detail: ErrorDetails) -> tuple[str | None, str, str | None, str | None]:
    """(place, found, expected, hint) of one problem."""
    location, value, context = detail["loc"], detail["input"], detail.get("ctx") or {}
    place = place_of(location)
    match detail["type"]:
        case "torchlc":
            place = place_of(location, context["key"])
            return place, context["found"], context["expected"], context["hint"] or None
        case "unknown_key":
            place = place_of(location, context["key"])
            return (
                place,
                "unknown key",
                context["expected"],
                did_you_mean(context["typed"], context["allowed"]),
            )
        case "missing":
            return place, "missing", "a value", None
        case "literal_error":
            return _choice(place, value, str(context["expected"]))
        case "too_long" | "too_short":
            most, least = context.get("max_length"), context.get("min_length")
            # a vector or a quaternion is declared as a tuple of so many numbers, what may have fewer as a list
            exactly = most is not None and context["field_type"] == "Tuple"
            word = "" if exactly else "at most " if most is not None else "at least "
            return (
                place,
                number_of(context["actual_length"], "value"),
                f"{word}{least if most is None else most}",
                None,
            )
        case kind:
            return (
                place,
                shown(value),
                EXPECTED.get(kind) or detail["msg"].removeprefix("Input should be "),
                None,
            )


def _choice(place: str | None, value: Any, expected: str) -> tuple[str | None, str, str, str | None]:
    known = re.findall(r"'([^']*)'", expected)
    return place, shown(value), f"one of {', '.join(known)}", did_you_mean(str(value), known)
