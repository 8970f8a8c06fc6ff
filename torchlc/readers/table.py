"""Text tables read in chunks of bounded memory, whatever their format; every defect is one InputError."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from torchlc.digits import number_of
from torchlc.errors import InputError, option
from torchlc.files.decimals import advice, decimal, decimals
from torchlc.files.encodings import wide_encoding_of
from torchlc.readers.dates import moment_of
from torchlc.scene.reading import Reading

MAX_ROWS = 5_000_000
MAX_LINE = 65_536
MOST_LABEL = 200
"""Characters of a name of a station, band or curve."""
BLOCK_BYTES = 1 << 20
MAX_HEADER_LINES = 10_000
CHUNK_ROWS = 50_000
BLANK = frozenset({"", "--", "-", "na", "n/a", "null", "none", "nan", "masked", "indef"})
MARKS_ALONE = re.compile(r"[*.?_/~\-]+")
"""Cells without a letter or digit, such as ... and ****, hold nothing either."""
TRUE, FALSE = frozenset({"true", "t", "yes", "1", "1.0"}), frozenset({"false", "f", "no", "0", "0.0"})
BEYOND_MAG = 90.0
"""Magnitudes and their errors beyond it, such as 99.0 and -99.9, mark missing values: the Sun has -26.7."""
FORMAT = "CSV with a header line, or ECSV"
AS_A_LIMIT = "Write a magnitude's limit as in >18.5 and a flux's as in <0.1: fainter than this. Or write a number, and true in a column upper_limit."
NO_ROW = "A line without a measurement, such as a remark or a sum, may go or begin with #"
METADATA = ("time_scale", "time_format", "light_time_corrected", "frame")
"""Keys of ours in the metadata of an ECSV, and in comment lines ``# key: value`` above the header of a CSV."""
OF_SPREADSHEETS = re.compile(r'"?sep=.?"?[\s,;]*', re.IGNORECASE)
"""The first line of a table for Excel: which delimiter follows."""
NOT_TEXT = re.compile(rb"[\x00-\x08\x0b\x0e-\x19\x1b-\x1f\x7f]")
"""Bytes that no line of text holds, whatever its encoding; the end mark of DOS, 1a, is let through."""


Row = tuple[int, list[str]]
"""Where a row stands, counted from 1, and its cells."""


@dataclass(frozen=True)
class Header:
    """What a table says before its rows: column names, units, descriptions and metadata.

    ``format`` is the format's name where it is not our own. ``comments`` are the lines above the header that say
    no metadata; ``notes`` is what has to be told of how the file was read. ``skip`` counts the lines of the file
    down to its header (0: there is none); lines that begin with one of ``marks`` are comments. ``decimal`` is the
    decimal sign. ``columns`` holds the places of what :mod:`torchlc.readers.roles` took under our names, several
    where cells are joined, and ``theirs`` the names that these have in the file, in which a format may tell what it took. ``rows`` yields the cells of each row, with its place, where they are not simply the lines of ``source``; places are
    lines of ``source`` or, where ``placed_by`` is "row", numbers of rows.
    ``told``: what the file says with keys of the table [recording].
    ``skips_non_detections``: the format has a row only where the object was found.
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
    rows: Callable[[], Iterator[Row]] | None = None
    placed_by: str = "line"
    format: str = ""
    skip: int = 0
    marks: str = "#"
    decimal: str = "."
    columns: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    theirs: Mapping[str, str] = field(default_factory=dict)
    told: Reading = field(default_factory=Reading)
    skips_non_detections: bool = False

    def places(self, name: str) -> tuple[int, ...]:
        """Where the cells of a column stand in a row."""
        return self.columns.get(name) or (self.names.index(name),)


CellReader = Callable[[Header, str, list[str], int], np.ndarray]
"""Turns cells of one column (header, name, cells, index of the first row) into an array, first axis rows."""


def read_columns(
    header: Header, readers: Mapping[str, CellReader]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Where the rows stand (T,), and the named columns, each turned from text by its reader a chunk of rows at a time; first
    axis T."""
    where = {name: header.places(name) for name in readers}
    pieces: dict[str, list[np.ndarray]] = {name: [] for name in readers}
    places, count = [], 0
    for chunk in _chunks(header):
        rows = [cells for _, cells in chunk]
        places.append(np.array([place for place, _ in chunk]))
        _check_widths(header, rows, count)
        for name, read in readers.items():
            first, *others = where[name]
            cells = [row[first] for row in rows]
            if others:
                cells = [moment_of([row[column] for column in where[name]]) for row in rows]
            pieces[name].append(read(header, name, cells, count))
        count += len(rows)
        if count > MAX_ROWS:
            raise too_long(header.source)
    if not count:
        raise InputError(header.source, None, "no rows below the header", "at least one row")
    return np.concatenate(places), {name: np.concatenate(pieces.pop(name)) for name in readers}


def first_row(header: Header) -> list[str]:
    """Cells of the first row; none where there is no row."""
    return next(lines_as_cells(header) if header.rows is None else header.rows(), (0, []))[1]


def without_row(header: Header) -> str:
    """What to do about a row that holds no measurement."""
    return NO_ROW if header.rows is None else "Leave out the row"


def row_place(index: int, column: str) -> str:
    """How an error names a cell: rows count from 1 below the header."""
    return f"row {index + 1}, column {column}"


def count_lines(path: Path) -> int:
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
                raise too_long(path)
            last = block[-1:]
    if not start:
        raise InputError(path, None, "the file is empty", FORMAT)
    return lines + (last != b"\n")


def too_long(path: Path) -> InputError:
    return InputError(
        path, None, f"more than {MAX_ROWS:,} rows", f"at most {MAX_ROWS:,}", "Split or average it."
    )


def encoding_of(path: Path) -> str:
    """ "utf-8-sig", the name of a wide encoding, or "cp1252" (which holds Latin-1) for a text that is neither;
    InputError for no text.
    """
    wide = wide_encoding_of(path)
    name = wide or "utf-8-sig"
    decoder = codecs.getincrementaldecoder(name)()
    try:
        with path.open("rb") as stream:
            while block := stream.read(BLOCK_BYTES):
                decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        if wide:
            hint = "Save it again as UTF-8"
            raise InputError(path, None, f"{wide.upper()} text that is damaged", FORMAT, hint) from None
    else:
        return name
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
    """Lines of bounded length; the first is a comment where it only tells a spreadsheet the delimiter."""
    number = 0
    with path.open(encoding=encoding_of(path)) as stream:
        while line := stream.readline(MAX_LINE):
            number += 1
            if len(line) == MAX_LINE:
                raise InputError(path, f"line {number}", f"longer than {MAX_LINE} characters", FORMAT)
            yield f"# {line}" if number == 1 and OF_SPREADSHEETS.fullmatch(line) else line


def repeated_names(names: Sequence[str]) -> dict[str, list[int]]:
    """Places of the columns that share a name, by that name; blank names are none."""
    places: dict[str, list[int]] = {}
    for column, name in enumerate(names):
        if name:
            places.setdefault(name, []).append(column)
    return {name: shared for name, shared in places.items() if len(shared) > 1}


def check_names(path: Path, names: Sequence[str], hint: str = "Rename one of them in the header") -> None:
    """InputError where two columns have one name, which says which two."""
    for name, places in repeated_names(names).items():
        numbers = [str(column + 1) for column in places]
        listed = f"{', '.join(numbers[:-1])} and {numbers[-1]}"[:200]
        twice = "twice" if len(places) == 2 else f"{len(places)} times"
        found = f"column {name[:60]!r} appears {twice}, as columns {listed}"
        raise InputError(path, "header", found, "distinct column names", hint)


def _chunks(header: Header) -> Iterator[list[Row]]:
    cells = lines_as_cells(header) if header.rows is None else header.rows()
    while rows := list(islice(cells, CHUNK_ROWS)):
        yield rows


def lines_as_cells(header: Header) -> Iterator[Row]:
    """The rows below the header. A line of the header that comes again is left out: files were joined."""
    numbered = enumerate(lines_of(header.source), 1)
    above = {line.strip() for _, line in islice(numbered, header.skip)}
    lines = (
        (number, line)
        for number, line in numbered
        if line[0] not in header.marks and not line.isspace() and line.strip() not in above
    )
    if header.delimiter == " ":
        lines = ((number, line.replace("\t", " ").strip()) for number, line in lines)
    yield from cells_of_lines(
        header.source, lines, header.delimiter, blanks=header.ecsv or header.delimiter == " "
    )


def cells_of_lines(
    path: Path, lines: Iterable[tuple[int, str]], delimiter: str = ",", *, blanks: bool = False
) -> Iterator[Row]:
    """Rows of numbered lines, each with the number of its last one; ``blanks`` behind a delimiter are no part of a cell."""
    last = 0

    def texts() -> Iterator[str]:
        nonlocal last
        for last, text in lines:  # noqa: B007 the reader takes a line at a time
            yield text

    try:
        for cells in csv.reader(texts(), delimiter=delimiter, skipinitialspace=blanks):
            yield last, cells
    except csv.Error as error:
        raise InputError(path, f"line {last}", str(error), FORMAT) from None


def _check_widths(header: Header, rows: list[list[str]], start: int) -> None:
    width = len(header.names) - sum(
        len(places) > 1 for places in header.columns.values()
    )  # joined ones come last
    if set(map(len, rows)) == {width}:
        return
    for index, row in enumerate(rows):
        check_width(header.source, f"row {start + index + 1}", row, header.names[:width])


def is_as_wide(cells: Sequence[str], names: Sequence[str]) -> bool:
    """Has a row as many cells as there are names, beside blank cells and blank names at the end? A delimiter may end
    the line of names, or each row."""
    if len(cells) == len(names):
        return True
    least = len(without_blank_end(names))
    return least <= len(without_blank_end(cells, least)) <= len(names)


def check_width(path: Path, place: str, cells: Sequence[str], names: Sequence[str]) -> None:
    """InputError where a row is not as wide as the names."""
    if not is_as_wide(cells, names):
        long = len(cells) > len(names)
        hint = f"A cell that holds the delimiter stands between double quotes. {NO_ROW}" if long else NO_ROW
        raise InputError(path, place, number_of(len(cells), "value"), f"{len(names)}, as in the header", hint)


def without_blank_end(cells: Sequence[str], width: int = 0) -> Sequence[str]:
    """Cells without the blank ones at their end, but ``width`` of them at least."""
    end = len(cells)
    while end > width and not cells[end - 1].strip():
        end -= 1
    return cells[:end]


def read_numbers(header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
    """(T,) float64; a blank cell is not-a-number."""
    if header.decimal != ".":
        cells = [with_point(cell, header.decimal) for cell in cells]
    try:
        return np.array(decimals(cells), dtype=np.float64)
    except ValueError:
        pass
    numbers = np.empty(len(cells))
    for index, cell in enumerate(cells):
        try:
            numbers[index] = decimal(cell)
        except ValueError:
            text = cell.strip()
            if text.lower() not in BLANK and not MARKS_ALONE.fullmatch(text):
                hint = AS_A_LIMIT if re.match(r"[<>\[]", text) else advice(cell)
                hint = hint or (None if re.search(r"\d", text) else without_row(header))
                if hint and OF_DECIMAL_COMMAS.fullmatch(text) and not header.ecsv and header.rows is None:
                    hint = f"{hint.rstrip('.')}, or say {option('columns', 'decimal=comma')}"
                place = row_place(start + index, name)
                raise InputError(header.source, place, repr(cell[:40]), "a number", hint) from None
            numbers[index] = np.nan
    return numbers


def with_point(cell: str, sign: str) -> str:
    """A number written with another decimal ``sign``, with a point; a cell that holds both is left as it is."""
    return cell if "." in cell else cell.replace(sign, ".", 1)


OF_DECIMAL_COMMAS = re.compile(r"[+-]?\d+,\d+", re.ASCII)


class BrightnessReader:
    """Reads magnitudes or fluxes (T,); those behind a mark of a limit are noted in ``limits`` (T,).

    A magnitude's limit is written ">18.5" or ">=18.5": fainter than this. A flux's is written "<0.1".
    """

    def __init__(self, kind: str) -> None:
        self._mark = ">" if kind == "mag" else "<"
        self._pieces: list[np.ndarray] = []

    @property
    def limits(self) -> np.ndarray:
        return np.concatenate(self._pieces)

    def __call__(self, header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
        if self._mark not in "".join(cells):
            self._pieces.append(np.zeros(len(cells), dtype=bool))
            return read_numbers(header, name, cells, start)
        marked = [cell.lstrip().startswith(self._mark) for cell in cells]
        plain = [
            cell.lstrip()[1:].removeprefix("=") if limit else cell
            for cell, limit in zip(cells, marked, strict=True)
        ]
        self._pieces.append(np.array(marked))
        return read_numbers(header, name, plain, start)


def read_flags(header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
    """(T,) bool; a blank cell is false."""
    flags = np.empty(len(cells), dtype=bool)
    for index, cell in enumerate(cells):
        word = cell.strip().lower()
        if word not in TRUE and word not in FALSE and word not in BLANK:
            raise InputError(header.source, row_place(start + index, name), repr(cell[:40]), "true or false")
        flags[index] = word in TRUE
    return flags


def read_bad(header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
    """(T,) bool: rows that are flagged, by true or by any number but 0; a blank cell is false."""
    words = [
        "1" if cell.strip().lower() in TRUE else "0" if cell.strip().lower() in FALSE else cell
        for cell in cells
    ]
    try:
        return np.nan_to_num(read_numbers(header, name, words, start)) != 0
    except InputError as error:
        raise InputError(
            error.source, error.place, error.found, "true, false, or a number: 0 for a good row"
        ) from None


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
