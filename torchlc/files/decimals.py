"""Numbers as people write them in files: digits 0 to 9, one point, an exponent with e."""

from __future__ import annotations

import re

from torchlc.errors import InputError

FAULTS = (
    (
        r"[+-]?[\d.,]+\s*(\N{PLUS-MINUS SIGN}|\+/-|\+-)\s*[\d.,]+",
        "Write the error in a column of its own, such as mag_err.",
    ),
    (r"[+-]?\d+,\d+", "Write decimals with a point."),
    (r"'[+-]?[\d.,]+", "Leave out the apostrophe, which a spreadsheet puts before what it takes for text."),
    (r"[+-]?\d{1,3}([\s,.']\d{3})+([.,]\d*)?", "Leave out what parts the thousands."),
    (r"[+-]?[\d.]+[dD][+-]?\d+", "Write the exponent with e, as in 1.5e3."),
    (r"[+-]?[\d_.]*\d_\d[\d_.]*([eE][+-]?[\d_]+)?", "Leave out the underscores."),
    (r"\N{MINUS SIGN}[\d.]+([eE][+-]?\d+)?", "Write the minus sign as the hyphen of the keyboard."),
    (r"[+-]?0[xX][0-9a-fA-F.]+([pP][+-]?\d+)?", "Write it in decimal digits."),
    (r"[+-]?[\d.,]*[^\x00-\x7f][\d.,eE+-]*", "Write the digits 0 to 9 of the keyboard."),
    (
        r"[+-]?[\d.]+([eE][+-]?\d+)?\s*[A-Za-z%][\w%/^-]*",
        "Write the number alone; its unit or filter goes into the name of the column or a column of its own.",
    ),
)
"""What people and other programs write for a number, and what to do about it."""


def decimal(text: str) -> float:
    """The number that ``text`` holds, not-a-number and infinity included; ValueError where it is none.

    Stricter than ``float``: no underscores between digits, no digits of other scripts. Both are slips, and
    a program that reads the file next would stop at them or read another number.
    """
    text = text.strip()
    if not text.isascii() or "_" in text:
        raise ValueError(f"{text!r} is not a number")
    return float(text)


def decimals(texts: list[str]) -> list[float]:
    """As :func:`decimal`, of many texts; ValueError where one of them is no number."""
    joined = "".join(texts)
    return list(map(float if joined.isascii() and "_" not in joined else decimal, texts))


def advice(text: str) -> str | None:
    """What to do about a text that should have been a number, where it is a known slip."""
    text = text.strip()
    return next((hint for pattern, hint in FAULTS if re.fullmatch(pattern, text)), None)


def checked_decimal(text: str, source: object, place: str | None, expected: str = "a number") -> float:
    """The number that ``text`` holds; InputError, with advice, where it is none."""
    try:
        return decimal(text)
    except ValueError:
        raise InputError(str(source), place, repr(text[:40]), expected, advice(text)) from None
