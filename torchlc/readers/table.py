"""Text tables, ECSV or CSV, read in chunks of bounded memory; every defect is one InputError."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table.meta import get_header_from_yaml

from torchlc.errors import InputError
from torchlc.files.decimals import advice, decimal, decimals
from torchlc.files.reading import readable_file
from torchlc.readers.astropy_tables import described_table, read_table

MAX_ROWS = 5_000_000
MAX_LINE = 65_536
MOST_LABEL = 200
"""Characters of a name of a station, band or curve."""
BLOCK_BYTES = 1 << 20
MAX_HEADER_LINES = 10_000
CHUNK_ROWS = 50_000
BLANK = frozenset({"", "--", "-", "na", "n/a", "null", "none", "nan", "masked"})
TRUE, FALSE = frozenset({"true", "t", "yes", "1", "1.0"}), frozenset({"false", "f", "no", "0", "0.0"})
BEYOND_MAG = 90.0
"""Magnitudes and their errors beyond it, such as 99.0 and -99.9, mark missing values: the Sun has -26.7."""
FORMAT = "CSV with a header line, or ECSV"
AS_A_LIMIT = "Write a limit as a number, and true in a column upper_limit."
METADATA = ("time_scale", "time_format", "light_time_corrected", "frame")
"""What comment lines ``# key: value`` above the header of a CSV may say, as the metadata of an ECSV."""
NOT_TEXT = re.compile(rb"[\x00-\x08\x0b\x0e-\x19\x1b-\x1f\x7f]")
"""Bytes that no line of text holds, whatever its encoding; the end mark of DOS, 1a, is let through."""


@dataclass(frozen=True)
class Header:
    """What a table says before its rows: column names, units, descriptions and metadata.

    ``comments`` are the lines of a CSV above its header that say no metadata; ``notes`` is what has to be
    told of how the file was read. ``rows`` yields the cells of each row where they are not simply the lines
    of ``source``.
    """

    source: Path
    names: tuple[str, ...]
    delimiter: str
    ecsv: bool
    units: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)
    comments: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    rows: Callable[[], Iterator[list[str]]] | None = None


Layout = Callable[[Path, Sequence[str], str], Header | None]
"""Recognises a file by its comment lines and its first other line."""
CellReader = Callable[[Header, str, list[str], int], np.ndarray]
"""Turns cells of one column (header, name, cells, index of the first row) into an array, first axis rows."""


def read_header(path: Path, layouts: Sequence[Layout] = ()) -> Header:
    """Check that ``path`` is a text table of a bearable length, and read what stands before its rows: in the
    first of ``layouts`` that recognises it, else as ECSV or CSV.
    """
    lines = _count_lines(readable_file(path, FORMAT))
    comments, first = _leading_lines(path)
    if lines - len(comments) - 1 > MAX_ROWS:
        raise _too_long(path)
    if first is None:
        raise InputError(path, None, "no rows", FORMAT)
    header = _header(path, layouts, comments, first)
    if encoding_of(path) != "utf-8-sig":
        told = "the file is not UTF-8 text and was read as Windows-1252 (Latin-1): check names with accents"
        header = replace(header, notes=(told, *header.notes))
    return header


def _header(path: Path, layouts: Sequence[Layout], comments: list[str], first: str) -> Header:
    if comments and comments[0].startswith("%ECSV"):
        return _ecsv_header(path, comments, first)
    for layout in layouts:
        if (header := layout(path, comments, first)) is not None:
            return header
    delimiter = max(",;\t", key=first.count)
    names = tuple(name.strip() for name in next(csv.reader([first], delimiter=delimiter)))
    _check_names(path, names)
    meta, others = metadata_of_comments(comments)
    return Header(path, names, delimiter, ecsv=False, meta=meta, comments=tuple(others))


def metadata_of_comments(comments: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """What comment lines say as ``key: value`` with a key of ``METADATA``, and the other lines."""
    meta, others = {}, []
    for line in comments:
        key, _, value = (part.strip() for part in line.replace("=", ":", 1).partition(":"))
        if key.lower() in METADATA and value:
            meta[key.lower()] = value
        elif line.strip():
            others.append(line.strip())
    return meta, others


def read_columns(header: Header, readers: Mapping[str, CellReader]) -> dict[str, np.ndarray]:
    """The named columns, each turned from text by its reader a chunk of rows at a time; first axis T."""
    where = {name: header.names.index(name) for name in readers}
    pieces: dict[str, list[np.ndarray]] = {name: [] for name in readers}
    count = 0
    for rows in _chunks(header):
        _check_widths(header, rows, count)
        for name, read in readers.items():
            column = where[name]
            pieces[name].append(read(header, name, [row[column] for row in rows], count))
        count += len(rows)
        if count > MAX_ROWS:
            raise _too_long(header.source)
    if not count:
        raise InputError(header.source, None, "no rows below the header", "at least one row")
    return {name: np.concatenate(pieces.pop(name)) for name in readers}


def row_place(index: int, column: str) -> str:
    """How an error names a cell: rows count from 1 below the header."""
    return f"row {index + 1}, column {column}"


def _count_lines(path: Path) -> int:
    """Lines that are not blank, without decoding them; stops where there are too many."""
    lines, start, last = 0, b"", b""
    with path.open("rb") as stream:
        while block := stream.read(BLOCK_BYTES):
            start = start or block[:4]
            newlines = block.count(b"\n")
            if newlines == 0 and len(block) == BLOCK_BYTES:
                raise InputError(path, f"line {lines + 1}", f"longer than {MAX_LINE} characters", FORMAT)
            lines += newlines - block.count(b"\n\n") - block.count(b"\n\r\n")
            if lines > MAX_ROWS + MAX_HEADER_LINES:
                raise _too_long(path)
            last = block[-1:]
    if not start:
        raise InputError(path, None, "the file is empty", FORMAT)
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(path, None, "UTF-16 text", "UTF-8 text", "Save it again as UTF-8.")
    return lines + (last != b"\n")


def _too_long(path: Path) -> InputError:
    return InputError(
        path, None, f"more than {MAX_ROWS:,} rows", f"at most {MAX_ROWS:,}", "Split or average it."
    )


def encoding_of(path: Path) -> str:
    """ "utf-8-sig", or "cp1252" (which holds Latin-1) for a text that is no UTF-8; InputError for no text."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        with path.open("rb") as stream:
            while block := stream.read(BLOCK_BYTES):
                decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        pass
    else:
        return "utf-8-sig"
    with path.open("rb") as stream:
        for number, line in enumerate(stream, 1):
            try:
                line.decode("cp1252")
            except UnicodeDecodeError:
                pass
            else:
                if not NOT_TEXT.search(line):
                    continue
            raise InputError(path, f"line {number}", "not UTF-8 text", "UTF-8 text")
    return "cp1252"


def lines_of(path: Path) -> Iterator[str]:
    """Lines of bounded length."""
    number = 0
    with path.open(encoding=encoding_of(path)) as stream:
        while line := stream.readline(MAX_LINE):
            number += 1
            if len(line) == MAX_LINE:
                raise InputError(path, f"line {number}", f"longer than {MAX_LINE} characters", FORMAT)
            yield line


def _leading_lines(path: Path) -> tuple[list[str], str | None]:
    comments: list[str] = []
    for line in lines_of(path):
        if line.startswith("#"):
            comments.append(line[1:].rstrip("\r\n").removeprefix(" "))
            if len(comments) > MAX_HEADER_LINES:
                raise InputError(path, None, f"more than {MAX_HEADER_LINES} comment lines", FORMAT)
        elif line.strip():
            return comments, line.strip("\r\n")
    return comments, None


def _ecsv_header(path: Path, comments: Sequence[str], first: str) -> Header:
    try:
        header = get_header_from_yaml([line for line in comments[1:] if line.strip()])
        declared = {str(column["name"]): column for column in header["datatype"]}
        meta = dict(header.get("meta") or {})
        delimiter = header.get("delimiter", " ")
    except Exception as error:  # the YAML loader builds astropy objects on request and can raise anything
        raise InputError(
            path, "header", f"unreadable ECSV header: {error}"[:300], "ECSV as astropy writes it"
        ) from None
    if delimiter not in (" ", ","):
        raise InputError(path, "header", f"delimiter {delimiter!r}", "a space or a comma")
    names = tuple(next(csv.reader([first.strip()], delimiter=delimiter, skipinitialspace=True)))
    _check_names(path, names)
    if list(names) != list(declared):
        raise InputError(
            path, "header", f"columns {', '.join(names)}"[:200], f"as declared: {', '.join(declared)}"[:200]
        )
    if meta.get("__serialized_columns__"):
        return Header(**described_table(path, read_table(path, list(lines_of(path)))))
    return Header(
        source=path,
        names=names,
        delimiter=delimiter,
        ecsv=True,
        units={name: str(column["unit"]) for name, column in declared.items() if column.get("unit")},
        descriptions={name: str(column.get("description") or "") for name, column in declared.items()},
        meta=meta,
    )


def _check_names(path: Path, names: Sequence[str]) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1}) if len(names) < 1000 else ["..."]
    if repeated:
        raise InputError(path, "header", f"column {repeated[0]!r} appears twice", "distinct column names")


def _chunks(header: Header) -> Iterator[list[list[str]]]:
    cells = _csv_rows(header) if header.rows is None else header.rows()
    while rows := list(islice(cells, CHUNK_ROWS)):
        yield rows


def _csv_rows(header: Header) -> Iterator[list[str]]:
    lines = lines_of(header.source)
    if header.ecsv and header.delimiter == " ":
        kept = (line.strip() for line in lines if line[0] != "#" and not line.isspace())
    else:
        kept = (line for line in lines if line[0] != "#" and not line.isspace())
    reader = csv.reader(kept, delimiter=header.delimiter, skipinitialspace=header.ecsv)
    try:
        next(reader)
        yield from reader
    except csv.Error as error:
        raise InputError(header.source, f"line {reader.line_num}", str(error), FORMAT) from None


def _check_widths(header: Header, rows: list[list[str]], start: int) -> None:
    width = len(header.names)
    if set(map(len, rows)) != {width}:
        index = next(i for i, row in enumerate(rows) if len(row) != width)
        found = f"{len(rows[index])} values"
        raise InputError(header.source, f"row {start + index + 1}", found, f"{width}, as in the header")


def read_numbers(header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
    """(T,) float64; a blank cell is not-a-number."""
    try:
        return np.array(decimals(cells), dtype=np.float64)
    except ValueError:
        pass
    numbers = np.empty(len(cells))
    for index, cell in enumerate(cells):
        try:
            numbers[index] = decimal(cell)
        except ValueError:
            if cell.strip().lower() not in BLANK:
                hint = AS_A_LIMIT if re.match(r"\s*[<>]", cell) else advice(cell)
                place = row_place(start + index, name)
                raise InputError(header.source, place, repr(cell[:40]), "a number", hint) from None
            numbers[index] = np.nan
    return numbers


def read_flags(header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
    """(T,) bool; a blank cell is false."""
    flags = np.empty(len(cells), dtype=bool)
    for index, cell in enumerate(cells):
        word = cell.strip().lower()
        if word not in TRUE and word not in FALSE and word not in BLANK:
            raise InputError(header.source, row_place(start + index, name), repr(cell[:40]), "true or false")
        flags[index] = word in TRUE
    return flags


class LabelReader:
    """Reads names as (T,) int64 indices into ``ids``, the distinct names in order of appearance."""

    def __init__(self) -> None:
        self._codes: dict[str, int] = {}

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(self._codes)

    def __call__(self, header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
        codes, known = self._codes, len(self._codes)
        read = np.array(
            [codes.setdefault(cell, len(codes)) for cell in map(str.strip, cells)], dtype=np.int64
        )
        for cell in list(codes)[known:]:
            if len(cell) > MOST_LABEL or not cell.isprintable():
                row = start + int(np.flatnonzero(read == codes[cell])[0])
                expected = f"a name of at most {MOST_LABEL} printable characters"
                raise InputError(header.source, row_place(row, name), repr(cell[:40]), expected)
        return read
