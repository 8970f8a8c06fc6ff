"""Tables of text: CSV and its kin, with a header anywhere in the first lines, in a comment, or none."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, takewhile
from typing import ClassVar

from torchlc.errors import InputError, option
from torchlc.readers.comments import TOLD, metadata_of, told_in
from torchlc.readers.dates import are_apart, is_moment, moment_of
from torchlc.readers.format import FORMATS, Format, Head
from torchlc.readers.roles import assigned, known_names
from torchlc.readers.table import BLANK, Header, check_names, repeated_names, without_blank_end
from torchlc.scene.reading import Reading
from torchlc.scene.timestamps import JULIAN_DATE

DELIMITERS = (",", ";", "\t", "|", " ")
"""In the order in which they are preferred where a line of names can be read with several."""
MARKS = "#%"
"""Signs that begin a comment whatever the delimiter; a semicolon does where it is no delimiter."""
NUMBER = re.compile(r"\s*([<>]=?)?\s*[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?\s*", re.ASCII)
WITH_COMMA, WITH_POINT = (
    re.compile(r"\s*([<>]=?)?\s*[+-]?\d*,\d+\s*", re.ASCII),
    re.compile(r"\s*([<>]=?)?\s*[+-]?\d*\.\d+\s*", re.ASCII),
)
JULIAN = (2_400_000.0, 2_500_000.0)
PLAIN_MAGNITUDES = (3.0, 30.0)
"""Of a table without names: numbers beyond may be fluxes. A relative flux is near 1."""
LARGEST_PLAIN_ERROR = 1.0
"""Of a table without names: what follows the magnitude is taken as its error up to here; an airmass is larger."""


class Delimited(Format):
    """A table of cells between commas, semicolons, tabs, bars or blanks.

    Names of columns in wide use are known, those of ADES among them.
    """

    name = "table"
    files = "CSV and its kin"
    order = 100

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return True

    @classmethod
    def read(cls, head: Head) -> Header:
        return table_header(head)


class NamedTable(Format):
    """A table whose format is known by the names of its columns: ``marks_of_it`` are among them."""

    files = "a table of text"
    marks_of_it: ClassVar[frozenset[str]] = frozenset()

    @classmethod
    def recognises(cls, head: Head) -> bool:
        if not any(all(name in text for name in cls.marks_of_it) for _, text in head.lines):
            return False
        return cls.marks_of_it <= set(table_header(head).names)

    @classmethod
    def read(cls, head: Head) -> Header:
        return replace(table_header(head), format=cls.name)


def cells_of(line: str, delimiter: str) -> list[str]:
    """Cells of one line, without blanks around."""
    if delimiter == " ":
        line = line.replace("\t", " ").strip()
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=delimiter == " "), [])
    except csv.Error:
        return []
    return [cell.strip() for cell in cells]


def table_header(head: Head) -> Header:
    """Delimiter, names, decimal sign and comments of a table."""
    given = head.reading
    head = replace(head, reading=told_in(head.path, _above_all(head), given))
    wanted: dict[str, list[str]] = {}
    for form in FORMATS.values():
        for role, names in form.columns.items():
            wanted.setdefault(role, []).extend(names)
    header = (
        _by_names(head, wanted) or _by_comment(head, wanted) or _without_names(head) or _by_first_line(head)
    )
    header = _told_apart(header, head.reading, wanted)
    rows = _sample(head, header)
    above = [text for number, text in head.lines if number <= header.skip]
    if above and cells_of(above[-1], header.delimiter) == list(header.names):
        above.pop()
    ruled = len(rows) > 2 and _is_ruler(rows[1][1])  # VizieR writes names, units and a line of dashes
    below = 1 + ruled
    if len(rows) > below and _is_line_of_units(rows[0][1]) and not _is_line_of_units(rows[below][1]):
        note = f"line {rows[0][0]}, below the names, is taken for their units and left: {', '.join(rows[0][1])[:60]}"
        header = replace(header, skip=rows[below - 1][0], notes=(*header.notes, note))
        rows = rows[below:]
    meta, others = metadata_of([text.lstrip("#%;").removeprefix(" ") for text in above])
    reading = told_in(head.path, meta, given)
    taken = [f"{key}: {meta[key]}" for key in TOLD if key in meta and key not in given.model_fields_set]
    if taken:
        header = replace(
            header, notes=(*header.notes, f"taken from comments of the file: {', '.join(taken)}")
        )
    meta = {key: value for key, value in meta.items() if key not in TOLD}
    return replace(
        header, meta=meta, comments=tuple(others), told=reading, decimal=_decimal(head, header, rows)
    )


def _told_apart(header: Header, reading: Reading, wanted: Mapping[str, Sequence[str]]) -> Header:
    """``header`` with a number behind the names that several of its columns share, but for the one that the user tells by
    its number, which keeps its name. InputError where such a name has a use and the user does not tell which is meant."""
    repeated = repeated_names(header.names)
    if not repeated:
        return header
    parts = {part.strip() for text in reading.columns.values() for part in text.split("+")}
    meant = {int(part) - 1 for part in parts - set(header.names) if re.fullmatch(r"\d{1,6}", part, re.ASCII)}
    names = list(header.names)
    for name, places in repeated.items():
        kept = next((column for column in places if column in meant), places[0])
        for column in places:
            if column != kept:
                names[column] = f"{name} column {column + 1}"
    apart = replace(header, names=tuple(names))
    roles = assigned(apart, reading, wanted).columns
    for name, places in repeated.items():
        role = next((role for role, used in roles.items() if places[0] in used), None)
        if role is not None and not meant & set(places):
            way = option("columns", f"{role}={places[1] + 1}")
            hint = f"Rename one of them, or say which is meant by its number, as in {way}"
            check_names(header.source, [other if other == name else "" for other in header.names], hint)
    return apart


def _above_all(head: Head) -> dict[str, str]:
    """What the comments above all other lines say: where the table begins is not known yet."""
    above = takewhile(lambda text: not text.strip() or text[0] in MARKS, (text for _, text in head.lines))
    return metadata_of([text.lstrip("#%").removeprefix(" ") for text in above])[0]


def _delimiters(head: Head) -> Sequence[str]:
    return DELIMITERS if head.reading.delimiter is None else (head.reading.delimiter,)


def _marks(delimiter: str) -> str:
    return MARKS if delimiter == ";" else f"{MARKS};"


def _header(head: Head, names: Sequence[str], delimiter: str, skip: int) -> Header:
    return Header(head.path, tuple(names), delimiter, ecsv=False, skip=skip, marks=_marks(delimiter))


def _by_names(head: Head, wanted: dict[str, list[str]]) -> Header | None:
    """The first line that is no comment and holds names that a recording's columns have, or that the user told."""
    named = {part.strip() for text in head.reading.columns.values() for part in (text, *text.split("+"))}
    for number, text in head.lines:
        if not text.strip() or text[0] in MARKS:
            continue
        for delimiter in _delimiters(head):
            names = cells_of(text, delimiter)
            if text[0] in _marks(delimiter) or len(names) < 2:
                continue
            if known_names(names, wanted) or len(named & set(names)) > 1:
                return _header(head, names, delimiter, number)
    return None


def _by_comment(head: Head, wanted: dict[str, list[str]]) -> Header | None:
    """Names in the last comment above the first row, if there are as many as cells."""
    comment = None
    for number, text in head.lines:
        if not text.strip():
            continue
        if text[0] in f"{MARKS};":
            comment = text.lstrip("#%; ")
            continue
        if comment is None:
            return None
        for delimiter in _delimiters(head):
            cells = cells_of(text, delimiter)
            if len(cells) < 2 or (not NUMBER.fullmatch(cells[-1]) and not any(map(NUMBER.fullmatch, cells))):
                continue
            for between in dict.fromkeys((delimiter, *DELIMITERS)):
                names = without_blank_end(cells_of(comment, between))
                if len(names) == len(without_blank_end(cells, len(names))) and known_names(names, wanted):
                    return _header(head, names, delimiter, number - 1)
        return None
    return None


def _without_names(head: Head) -> Header | None:
    """A table that begins with its first row: columns are called 1, 2, 3 ..., and the first three are taken."""
    first = next(
        ((number, text) for number, text in head.lines if text.strip() and text[0] not in f"{MARKS};"), None
    )
    if first is None:
        return None
    number, text = first
    for delimiter in ("\t", ";", ",", "|", " "):
        if delimiter not in _delimiters(head):
            continue
        cells = cells_of(text, delimiter)
        if len(cells) < 2 or not _is_row(cells, head.reading.columns.get("time", "")):
            continue
        header = _header(head, (), delimiter, number - 1)
        width = max(len(without_blank_end(row)) for _, row in _sample(head, header))
        header = replace(header, names=tuple(str(column) for column in range(1, width + 1)))
        if "time" in head.reading.columns:
            return header
        return _guessed(head, header)
    return None


def _is_row(cells: Sequence[str], time: str) -> bool:
    """Do cells hold an instant and numbers, as no line of names does? ``time`` is what the user says of its columns."""
    places = [int(part) - 1 for part in time.split("+") if re.fullmatch(r"\s*\d{1,6}\s*", part, re.ASCII)]
    if places and len(places) == time.count("+") + 1 and max(places) < len(cells):
        moment = moment_of([cells[index] for index in places])
    elif are_apart(cells[0], cells[1]):
        places, moment = [0, 1], moment_of(cells[:2])
    else:
        places, moment = [0], cells[0]
        if not NUMBER.fullmatch(cells[1]):
            return False
    others = [cell for index, cell in enumerate(cells) if index not in places]
    return bool(NUMBER.fullmatch(moment) or is_moment(moment)) and any(map(NUMBER.fullmatch, others))


def _guessed(head: Head, header: Header) -> Header:
    """Time, magnitude and error of a table without names, where its numbers leave no doubt."""
    width = len(header.names)
    rows = [cells for _, row in _sample(head, header) if len(cells := without_blank_end(row, width)) == width]
    comma = header.delimiter != "," and not any(
        WITH_POINT.fullmatch(cell) for cells in rows for cell in cells
    )

    def numbers(column: int) -> list[float]:
        values = []
        for cells in rows:
            text = cells[column].lstrip("<>= ")
            text = text.replace(",", ".", 1) if comma else text
            if NUMBER.fullmatch(text) and "," not in text:
                values.append(float(text))
        return values

    first, second = rows[0][0], numbers(1)
    dated = is_moment(first)
    if not dated:
        days = numbers(0)
        dated = bool(days) and all(JULIAN[0] < day < JULIAN[1] for day in days)
    sure = [mag for mag in second if abs(mag) < 90]
    apart = are_apart(*rows[0][:2])
    if (
        apart
        or not dated
        or not sure
        or not all(PLAIN_MAGNITUDES[0] <= mag <= PLAIN_MAGNITUDES[1] for mag in sure)
    ):
        choice = "time=1+2,mag=3,mag_err=4" if apart else "time=1,mag=2,mag_err=3"
        ways = [choice]
        if not dated and JULIAN_DATE.fullmatch(first):
            ways = [f"{choice},time_format={form}" for form in ("jd-2400000", "mjd", "jd")]
        raise InputError(
            head.path,
            "header",
            f"no names of columns; the first row is {', '.join(rows[0])[:100]}",
            "a header such as time,mag,mag_err",
            f"Or say which column is what: {', or '.join(option('columns', way) for way in ways)}; flux={2 + apart} if it is a flux",
        )
    names = ["time", "mag", *header.names[2:]]
    if len(names) > 2:
        errors = numbers(2)
        marked = [error for error in errors if 0 < error < 90]
        if (
            marked
            and len(marked) + sum(abs(error) > 90 for error in errors) == len(errors)
            and max(marked) < LARGEST_PLAIN_ERROR
        ):
            names[2] = "mag_err"
    note = f"the file has no names of columns: taken as {', '.join(f'{k + 1} {name}' for k, name in enumerate(names) if not name.isdigit())}"
    left = [name for name in names if name.isdigit()]
    note += f"; left: {', '.join(left)}" if left else ""
    return replace(header, names=tuple(names), notes=(note,))


def _by_first_line(head: Head) -> Header:
    """The first line of names above a row of as many cells, else the first line that is no comment, as the header."""
    lines = [(number, text) for number, text in head.lines if text.strip() and text[0] not in MARKS]
    for (number, text), (_, below) in pairwise(lines):
        for delimiter in _delimiters(head):
            names = without_blank_end(cells_of(text, delimiter))
            cells = without_blank_end(cells_of(below, delimiter), len(names))
            fits = len(names) == len(cells) > 1 and all(names) and text[0] not in _marks(delimiter)
            if fits and not any(map(NUMBER.fullmatch, names)) and any(map(NUMBER.fullmatch, cells)):
                return _header(head, names, delimiter, number)
    number, text = next((number, text) for number, text in head.lines if text.strip() and text[0] != "#")
    delimiter = max(",;\t", key=text.count) if head.reading.delimiter is None else head.reading.delimiter
    if head.reading.delimiter is None and text.count(delimiter) == 0:
        delimiter = " "
    return _header(head, cells_of(text, delimiter), delimiter, number)


def _sample(head: Head, header: Header) -> list[tuple[int, list[str]]]:
    """Line numbers and cells of the first rows."""
    return [
        (number, cells_of(text, header.delimiter))
        for number, text in head.lines
        if number > header.skip and text.strip() and text[0] not in header.marks
    ]


def _is_line_of_units(cells: Sequence[str]) -> bool:
    """A line below the names that holds units, or rules them off: no digit in any cell, and no missing value."""
    return any(cells) and not any(
        re.search(r"\d", cell) or cell.lower() in BLANK - {"", "-", "--"} for cell in cells
    )


def _is_ruler(cells: Sequence[str]) -> bool:
    """A line of dashes below names and units."""
    return any(cells) and all(re.fullmatch(r"-*", cell) for cell in cells)


def _decimal(head: Head, header: Header, rows: Sequence[tuple[int, list[str]]]) -> str:
    """The decimal sign; a table with both signs, which may hold thousands, is refused."""
    if head.reading.decimal is not None:
        return head.reading.decimal
    if header.delimiter == ",":
        return "."
    commas = [(number, cell) for number, cells in rows for cell in cells if WITH_COMMA.fullmatch(cell)]
    points = [(number, cell) for number, cells in rows for cell in cells if WITH_POINT.fullmatch(cell)]
    if commas and points:
        raise InputError(
            head.path,
            f"line {commas[0][0]}",
            f"{commas[0][1]!r}, and {points[0][1]!r} in line {points[0][0]}",
            "one decimal sign, comma or point",
            f"Or say which it is: {option('columns', 'decimal=comma')}, where a point is then one too",
        )
    return "," if commas else "."
