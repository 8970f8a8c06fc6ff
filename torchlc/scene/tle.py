"""Two-line element sets: line numbers, lengths, columns, checksums."""

from __future__ import annotations

import re

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
