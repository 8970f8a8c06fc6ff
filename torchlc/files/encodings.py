"""Texts of two or four bytes a character, as Windows programs write them: found by their mark, or by their zeros."""

from __future__ import annotations

import codecs
from pathlib import Path

BEGINNING = 4096
"""Bytes looked at for zeros: some 2,000 characters."""
MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),  # before that of UTF-16, with which it begins
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def wide_encoding(content: bytes) -> str | None:
    """The encoding of a text of which ``content`` is the beginning, where a character is more than a byte; else None.

    Without a mark it is told by its zeros: of digits, letters and delimiters every other byte is one, and no text of one
    byte a character holds any.
    """
    for mark, name in MARKS:
        if content.startswith(mark):
            return name
    start = content[:BEGINNING]
    first, second = start[0::2].count(0), start[1::2].count(0)
    if first == 0 and 4 * second > len(start):
        return "utf-16-le"
    if second == 0 and 4 * first > len(start):
        return "utf-16-be"
    return None


def wide_encoding_of(path: Path) -> str | None:
    """:func:`wide_encoding` of a file."""
    with path.open("rb") as stream:
        return wide_encoding(stream.read(BEGINNING))
