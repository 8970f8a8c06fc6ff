"""Two-line element sets: line numbers, lengths, columns, checksums, and files that hold many."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError

from torchlc.errors import InputError, option
from torchlc.files.decimals import decimal
from torchlc.files.encodings import wide_encoding
from torchlc.files.numbers import problem
from torchlc.files.reading import readable_file
from torchlc.suggest import did_you_mean

PLACEHOLDER = "xxxxx"
LENGTH = 69
COLUMNS = (
    "1 a####l xxxxxxxx _#___.######## n.######## s_____s# s_____s# _ ____#",
    "2 a#### ___.#### ___.#### _______ ___.#### ___.#### __.########_____#",
)
"""What may stand in each column of the two lines: a key of ``KINDS``, else the character itself."""
KINDS = {
    "#": ("a digit", "[0-9]"),
    "_": ("a digit or a blank", "[0-9 ]"),
    "a": ("a digit, a blank or a letter other than I and O", "[0-9A-HJ-NP-Z ]"),
    "l": ("a letter or a blank", "[A-Za-z ]"),
    "s": ("a sign, a blank or 0", "[+ 0-]"),
    "n": ("a sign, a blank or a digit", "[+ 0-9-]"),
    "x": ("printable ASCII", "[ -~]"),
}
"""Words and pattern. Alpha-5 numbers leave out I and O, which look like 1 and 0. Where a sign may stand some
catalogues write the 0 before the decimal point, which is no sign.
"""
FIELDS = (
    {"day of the year": (20, 32, 1.0, 367.0)},
    {
        "inclination": (8, 16, 0.0, 180.0),
        "right ascension of the node": (17, 25, 0.0, 360.0),
        "argument of perigee": (34, 42, 0.0, 360.0),
        "mean anomaly": (43, 51, 0.0, 360.0),
        "mean motion": (52, 63, 1e-8, 20.0),
    },
)
"""Numbers of each line: first column less one, last column, and what an orbit allows."""


MAX_ELEMENT_BYTES = 50_000_000
JD_OF_2000 = 2451544.5
LIKE_ELEMENTS = re.compile(r"(?<![\w.])[12]\s{1,2}(?:x{5}|[ \dA-Za-z][ \dOIl]{4})[A-Za-z]?\s")
"""A line number and a catalogue number, also with letters typed for 0 and 1; the placeholder of papers included."""
ALPHA_5 = "ABCDEFGHJKLMNPQRSTUVWXYZ"
"""First signs of catalogue numbers from 100000 on, without I and O."""
MOST_LISTED = 200
"""Objects that a message lists."""
LONGEST_NAME = 30
"""Characters of a line that may be a name: NORAD's have 24."""


@dataclass(frozen=True)
class Elements:
    """Two lines with the name above them, if there was one; ``epoch`` a Julian date."""

    name: str | None
    lines: tuple[str, str]

    @property
    def epoch(self) -> float:
        year, day = int(self.lines[0][18:20]), float(self.lines[0][20:32])
        days = np.datetime64(f"{year + (1900 if year >= 57 else 2000)}-01-01") - np.datetime64("2000-01-01")
        return JD_OF_2000 + int(days.astype(int)) + day - 1.0

    @property
    def number(self) -> str:
        """The catalogue number as it stands in the lines, without outer blanks and zeros."""
        return self.lines[0][2:7].strip().lstrip("0") or "0"

    @property
    def whole_number(self) -> str:
        """The catalogue number in digits alone: a first letter of the Alpha-5 scheme stands for 10 to 33."""
        text = self.number
        if len(text) == 5 and text[0] in ALPHA_5 and text[1:].isdigit():
            return f"{10 + ALPHA_5.index(text[0])}{text[1:]}"
        return text

    @property
    def label(self) -> str:
        return f"{self.number} {self.name}" if self.name else self.number


def read_elements(path: str | Path) -> list[Elements]:
    """Every two-line element set of a file, as :func:`read_catalogue` has it, all of one object."""
    return sets_of_object(
        path,
        read_catalogue(path),
        None,
        "Keep the lines of the object alone in the file; torchlc init --object picks them",
    )


def sets_of_object(
    path: str | Path, sets: Sequence[Elements], wanted: str | None, advice: str | None = None
) -> list[Elements]:
    """The sets of the object of that number, name or part of a name; InputError where that is not one object, with
    ``advice`` where the reader cannot say which."""
    objects = {elements.lines[0][2:7]: elements for elements in sets}
    if wanted is None:
        if len(objects) == 1:
            return list(sets)
        some = min(objects.values(), key=lambda elements: elements.lines[0][2:7])
        hint = (
            advice
            or f"Say which: {option('object', some.number)}, by its number, its name or a part of its name"
        )
        raise InputError(
            path,
            None,
            f"elements of {len(objects)} objects ({_listed(objects.values())})",
            "elements of one object",
            hint,
        )
    sought = wanted.strip().casefold()
    digits = sought.lstrip("0") or "0"
    chosen = [
        number
        for number, elements in objects.items()
        if digits in (elements.number.casefold(), elements.whole_number)
        or sought == (elements.name or "").casefold()
    ]
    named = {
        elements.lines[0][2:7] for elements in sets if sought and sought in (elements.name or "").casefold()
    }
    chosen = chosen or sorted(named)
    if not chosen:
        names = [elements.name for elements in objects.values() if elements.name]
        known = [*names, *(elements.number for elements in objects.values())]
        raise InputError(
            path,
            option("object"),
            f"no object {wanted[:60]!r}",
            f"one of {_listed(objects.values())}",
            did_you_mean(wanted, known),
        )
    if len(chosen) > 1:
        found = f"{len(chosen)} objects for {wanted[:60]!r} ({_listed(objects[number] for number in chosen)})"
        raise InputError(
            path,
            option("object"),
            found,
            "one",
            f"Say its number, as in {option('object', objects[chosen[0]].number)}",
        )
    return [elements for elements in sets if elements.lines[0][2:7] == chosen[0]]


def _listed(objects: Iterable[Elements]) -> str:
    """Number and name of objects, in order of their numbers."""
    ordered = sorted(objects, key=lambda elements: elements.lines[0][2:7])
    more = (
        f" and {len(ordered) - MOST_LISTED} more: a part of a name finds them"
        if len(ordered) > MOST_LISTED
        else ""
    )
    return ", ".join(elements.label for elements in ordered[:MOST_LISTED]) + more


def read_catalogue(path: str | Path) -> list[Elements]:
    """Every two-line element set of a file, of one object or many, names above them kept.

    InputError where one of them is not right: no set is passed over.
    """
    sets, wrong = sound_sets(path)
    if wrong:
        raise wrong[0]
    return sets


def passed_over(wrong: Sequence[InputError]) -> list[str]:
    """What is said of the sets of a file of many objects that are not right: the first, and how many more."""
    if not wrong:
        return []
    more = f"; and {len(wrong) - 1} more like it" if len(wrong) > 1 else ""
    return [f"element set passed over: {wrong[0]}{more}"]


def sound_sets(path: str | Path) -> tuple[list[Elements], list[InputError]]:
    """The sets of a file that are right, and what is wrong with each of the others; InputError where none is right.

    One wrong character in a list of thousands does not keep a user from the other objects.
    """
    path = readable_file(path, "two-line element sets")
    if path.stat().st_size > MAX_ELEMENT_BYTES:
        raise InputError(path, None, "more than 50 MB", "two-line element sets")
    content = path.read_bytes()
    decoded = content.decode(wide_encoding(content) or "utf-8-sig", errors="replace")
    texts = re.split(r"\r\n|\r|\n", decoded)
    lines = [(number, text.lstrip("\ufeff \t").rstrip()) for number, text in enumerate(texts, 1)]
    lines = [(number, text) for number, text in lines if text and not text.startswith("#")]
    sets: list[Elements] = []
    wrong: list[InputError] = []
    lacking, whole, k = None, False, 0
    while k < len(lines):
        number, line = lines[k]
        following = lines[k + 1] if k + 1 < len(lines) else (number, "")
        if not is_elements(line):
            k += 1
        elif not (line.startswith("1 ") and following[1].startswith("2 ") and is_elements(following[1])):
            lacks = {"1 ": ", without its line 2", "2 ": ", without its line 1"}
            fault = lacks.get(line[:2], ", which does not begin with '1 ' or '2 '")
            place, said = f"line {number}", f"{line[:90]!r}{fault}"
            lacking = lacking or f"{place}: {said}"
            wrong.append(InputError(path, place, said, "both lines of each set, one below the other"))
            k += 1
        else:
            whole = True
            above = lines[k - 1][1] if k else ""
            name = None if is_elements(above) else above.removeprefix("0 ").strip() or None
            try:
                sets.append(Elements(name, _checked(path, (number, line), following)))
            except InputError as error:
                wrong.append(error)
            k += 2
    if not whole:
        raise InputError(path, None, "no two-line elements", "lines that begin with '1 ' and '2 '", lacking)
    if not sets:
        raise wrong[0]
    return sets, wrong


def _checked(path: Path, first: tuple[int, str], second: tuple[int, str]) -> tuple[str, str]:
    """The two lines, given with their numbers in the file, as :func:`checked_lines` has them."""
    try:
        return checked_lines((_cut(first[1]), _cut(second[1])))
    except PydanticCustomError as error:
        said: Any = error.context
        place = f"line {second[0] if said['key'] == '[1]' else first[0]}"
        raise InputError(path, place, said["found"], said["expected"], said["hint"] or None) from None


def is_elements(line: str) -> bool:
    """Does it hold a line of elements, whole or not, and in whatever wrapping? Names are shorter."""
    return len(line) > LONGEST_NAME and LIKE_ELEMENTS.search(line) is not None


def _cut(line: str) -> str:
    """The line without what some catalogues write beyond its last column, after a blank."""
    return line[:LENGTH] if len(line) > LENGTH and line[LENGTH].isspace() else line


def nearest(sets: Sequence[Elements], jd: np.ndarray) -> np.ndarray:
    """Index (T,) of the set with its epoch nearest to each Julian date (T,), UTC; of equally near ones the
    earlier, of sets of one epoch the last on file, which corrects those before.
    """
    last = {elements.epoch: k for k, elements in enumerate(sets)}
    epochs = np.array(sorted(last))
    order = np.array([last[epoch] for epoch in epochs])
    return order[np.searchsorted((epochs[1:] + epochs[:-1]) / 2, jd)]


def checksum(line: str) -> int:
    """Sum of the digits of the first 68 columns, a minus sign counting 1, modulo 10."""
    return sum(int(c) if c.isdigit() else c == "-" for c in line[: LENGTH - 1]) % 10


def checked_lines(lines: tuple[str, str]) -> tuple[str, str]:
    """The two lines without trailing blanks; raises when they are no valid element set."""
    lines = (lines[0].rstrip(), lines[1].rstrip())
    for number, (line, columns, fields) in enumerate(zip(lines, COLUMNS, FIELDS, strict=True), 1):
        where = f"[{number - 1}]"
        if not line.startswith(f"{number} "):
            raise problem(f"{line[:20]!r}", f"a line that begins with '{number} '", where)
        if len(line) != LENGTH:
            raise problem(
                f"{len(line)} characters in {line[:90]!r}",
                f"{LENGTH}",
                where,
                "Copy the line with all its blanks.",
            )
        plain = line[:2] + line[2:7].replace(PLACEHOLDER, "00000") + line[7:]
        for column, (character, kind) in enumerate(zip(plain, columns, strict=True), 1):
            words, pattern = KINDS.get(kind, ("a blank" if kind == " " else repr(kind), re.escape(kind)))
            if not re.fullmatch(pattern, character):
                expected = f"{words}, by the columns of a two-line element set"
                hint = (
                    "Write the catalogue number with its zeros."
                    if 3 < column < 8 and character == " "
                    else ""
                )
                raise problem(f"column {column}: {character!r} in {line!r}", expected, where, hint)
        if line[-1] != str(checksum(line)):
            hint = f"A character of the line is wrong: {line!r}"
            raise problem(f"checksum {line[-1]!r}", f"{checksum(line)}", where, hint)
        for name, (first, last, low, high) in fields.items():
            _check_field(line, name, (first, last), (low, high), where)
    first, second = (line[2:7] for line in lines)
    if first != second:
        raise problem(f"catalogue numbers {first} and {second}", "the same in both lines")
    return lines


def _check_field(
    line: str, name: str, place: tuple[int, int], limits: tuple[float, float], where: str
) -> None:
    text = line[slice(*place)]
    columns = f"columns {place[0] + 1}-{place[1]}, {name}: {text!r} in {line!r}"
    try:
        value = decimal(text)
    except ValueError:
        raise problem(columns, "a number without blanks inside", where) from None
    if not limits[0] <= value <= limits[1]:
        raise problem(columns, f"{limits[0]:g} to {limits[1]:g}", where)
