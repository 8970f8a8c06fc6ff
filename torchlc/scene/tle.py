"""Two-line element sets: line numbers, lengths, columns, checksums, and files that hold many."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError

from torchlc.errors import InputError
from torchlc.files import readable_file
from torchlc.scene.numbers import problem

PLACEHOLDER = "xxxxx"
LENGTH = 69
LINE_1 = re.compile(
    r"1 [ \dA-Z]\d{4}[UCS] .{8} [ \d]\d[ \d]{3}\.\d{8} [ +-][ \d]?\.\d{8} "
    r"[ +-][ \d]{5}[+-]\d [ +-][ \d]{5}[+-]\d [ \d] [ \d]{4}\d"
)
LINE_2 = re.compile(
    r"2 [ \dA-Z]\d{4} [ \d]{3}\.\d{4} [ \d]{3}\.\d{4} [ \d]{7} "
    r"[ \d]{3}\.\d{4} [ \d]{3}\.\d{4} [ \d]{2}\.\d{8}[ \d]{5}\d"
)


MAX_ELEMENT_BYTES = 50_000_000
JD_OF_2000 = 2451544.5


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


def read_elements(path: str | Path) -> list[Elements]:
    """Every two-line element set of a file, names above them kept; all checked, all of one object."""
    path = readable_file(path, "two-line element sets")
    if path.stat().st_size > MAX_ELEMENT_BYTES:
        raise InputError(path, None, "more than 50 MB", "two-line element sets")
    lines = [line.rstrip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    found = []
    for number, line in enumerate(lines[:-1]):
        after = lines[number + 1]
        if line.startswith("1 ") and after.startswith("2 ") and len(line) >= LENGTH and len(after) >= LENGTH:
            above = lines[number - 1].removeprefix("0 ").strip() if number else ""
            title = above if above and above[:2] not in ("1 ", "2 ") else None
            try:
                checked = checked_lines((line[:LENGTH], after[:LENGTH]))
            except PydanticCustomError as error:
                said: Any = error.context
                place = f"line {number + 1 + (said['key'] == '[1]')}"
                raise InputError(path, place, said["found"], said["expected"], said["hint"] or None) from None
            found.append(Elements(title, checked))
    if not found:
        raise InputError(path, None, "no two-line elements", "lines that begin with '1 ' and '2 '")
    numbers = sorted({one.lines[0][2:7] for one in found})
    if len(numbers) > 1:
        listed = ", ".join(numbers[:8])
        raise InputError(
            path, None, f"elements of {len(numbers)} objects ({listed})", "elements of one object"
        )
    return found


def nearest(sets: Sequence[Elements], jd: np.ndarray) -> np.ndarray:
    """Index (T,) of the set with its epoch nearest to each Julian date (T,), UTC."""
    order = np.argsort([one.epoch for one in sets], kind="stable")
    epochs = np.array([sets[k].epoch for k in order])
    return order[np.searchsorted((epochs[1:] + epochs[:-1]) / 2, jd)]


def checksum(line: str) -> int:
    """Sum of the digits of the first 68 columns, a minus sign counting 1, modulo 10."""
    return sum(int(c) if c.isdigit() else c == "-" for c in line[: LENGTH - 1]) % 10


def checked_lines(lines: tuple[str, str]) -> tuple[str, str]:
    """The two lines without trailing blanks; raises when they are no valid element set."""
    lines = (lines[0].rstrip(), lines[1].rstrip())
    for number, (line, layout) in enumerate(zip(lines, (LINE_1, LINE_2), strict=True), 1):
        where = f"[{number - 1}]"
        if not line.isascii() or not line.startswith(f"{number} "):
            raise problem(f"{line[:20]!r}", f"a line that begins with '{number} '", where)
        if len(line) != LENGTH:
            raise problem(f"{len(line)} characters", f"{LENGTH}", where, "Copy the line with all its blanks.")
        if line[-1] != str(checksum(line)):
            raise problem(
                f"checksum {line[-1]!r}", f"{checksum(line)}", where, "A digit of the line is wrong."
            )
        plain = line[:2] + line[2:7].replace(PLACEHOLDER, "00000") + line[7:]
        if not layout.fullmatch(plain):
            raise problem(f"{line!r}", "the columns of a two-line element set", where)
    first, second = (line[2:7] for line in lines)
    if first != second:
        raise problem(f"catalogue numbers {first} and {second}", "the same in both lines")
    if not float(lines[1][8:16]) <= 180 or not float(lines[1][52:63]) > 0:
        raise problem("an inclination above 180 deg or a mean motion of 0", "the elements of an orbit", "[1]")
    return lines
