"""What a format of recordings is: how it is recognised, and how its columns are read.

A new format is one file in :mod:`torchlc.readers.formats` with one class, or a class anywhere else.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from torchlc.errors import InputError
from torchlc.files.reading import readable_file
from torchlc.naming import Registry
from torchlc.readers.table import FORMAT, MAX_HEADER_LINES, MAX_ROWS, Header, count_lines, lines_of, too_long
from torchlc.scene.reading import Reading

if TYPE_CHECKING:
    from torchlc.scene import Scene

MOST_LINES = 200
"""Lines beside comments that a format may look at to recognise a file."""
KINDS = (
    (rb"PK\x03\x04", "a spreadsheet or another zip archive", "Export the table as CSV from the program that wrote it"),
    (rb"\x1f\x8b|BZh|\xfd7zXZ", "a compressed file", "Unpack it"),
    (rb"SIMPLE  =", "a FITS file", "Read its table with astropy and give it to torchlc.load, or write it as ECSV"),
    (rb"\x89HDF", "an HDF5 file", "Write its table as CSV"),
    (rb"%PDF", "a PDF", "Export the table as CSV from the program that wrote it"),
    (rb"<[A-Za-z!?]", "XML or HTML", "Save the table as CSV. A VOTable is read by astropy: give its Table to torchlc.load"),
    (rb'\{\s*"|\[\s*(\{\s*"|\[|\n)', "JSON", "Write a table with one row for each measurement"),
)  # fmt: skip
"""How files of other kinds begin, what they are called, and what to do."""
FORMATS: Registry[type[Format]] = Registry("format")
"""Every format that is defined, by its name."""


@dataclass(frozen=True)
class Head:
    """How a file begins: ``comments``, the lines with # above all others, without it; the ``first`` other line;
    and ``lines`` (number, text) down to the 200th that is not blank and no such comment. ``reading`` says what the
    user tells of the file, ``scene`` what it is read for.
    """

    path: Path
    comments: Sequence[str]
    first: str
    lines: Sequence[tuple[int, str]]
    reading: Reading
    scene: Scene | None = None


class Format(ABC):
    """A format of recordings. Defining a class makes it known; of two with one name the later counts.

    ``name`` is what people call it, and ``files`` what kind of file it is, for the list in the documentation; formats of lower ``order`` are asked first, and of equal ones the latest.
    ``columns`` are names of columns that the format knows beside those that all tables may have: one of ours, and
    the format's, the preferred first.
    """

    name: ClassVar[str]
    files: ClassVar[str] = "text"
    order: ClassVar[int] = 0
    columns: ClassVar[Mapping[str, Sequence[str]]] = {}

    def __init_subclass__(cls) -> None:
        FORMATS.declared(cls, "name")

    @classmethod
    @abstractmethod
    def recognises(cls, head: Head) -> bool:
        """Is a file that begins so of this format?"""

    @classmethod
    @abstractmethod
    def read(cls, head: Head) -> Header:
        """Names of the columns, units and metadata, and how the rows are read."""


def _refuse_other_files(path: Path) -> None:
    with path.open("rb") as stream:
        start = stream.read(64).removeprefix(b"\xef\xbb\xbf").lstrip()
    for pattern, what, hint in KINDS:
        if re.match(pattern, start):
            raise InputError(path, None, f"looks like {what}", FORMAT, hint)


def read_head(path: Path, reading: Reading, scene: Scene | None) -> Head:
    """Check that ``path`` is a text of a bearable length, and read how it begins."""
    _refuse_other_files(readable_file(path, FORMAT))
    count = count_lines(path)
    comments: list[str] = []
    lines: list[tuple[int, str]] = []
    first, others = None, 0
    for number, line in enumerate(lines_of(path), 1):
        text = line.rstrip("\r\n")
        lines.append((number, text))
        if line.startswith("#"):
            if first is None:
                comments.append(text[1:].removeprefix(" "))
            if len(comments) > MAX_HEADER_LINES or len(lines) > 2 * MAX_HEADER_LINES:
                raise InputError(path, None, f"more than {MAX_HEADER_LINES} comment lines", FORMAT)
        elif text.strip():
            first = text if first is None else first
            others += 1
            if others == MOST_LINES:
                break
    if first is None:
        raise InputError(path, None, "no rows", FORMAT)
    if count - len(comments) - 1 > MAX_ROWS:
        raise too_long(path)
    return Head(path, comments, first, lines, reading, scene)
