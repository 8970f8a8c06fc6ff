"""The Asteroid Lightcurve Data Exchange Format (Warner, Stephens & Harris; alcdef.org)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from torchlc.errors import InputError
from torchlc.files.decimals import checked_decimal
from torchlc.readers.format import Format, Head
from torchlc.readers.table import BEYOND_MAG, Header, Row, lines_of

MAG_PER_LN = 2.5 / math.log(10)
NOT_APPLIED = ("", "NONE", "FALSE", "NO", "N")
BEGINS = ("STARTMETADATA", "STARTBLOCK")
COUNTED = frozenset(
    {
        "DELIMITER",
        "DIFFERMAGS",
        "EXPJD",
        "EXPOSURE",
        "FILTER",
        "LTCAPP",
        "LTCTYPE",
        "MAGADJUST",
        "MAGBAND",
        "OBJECTNAME",
    }
    | {"OBJECTNUMBER", "REDUCEDMAGS", "SESSIONDATE", "UCORMAG"}
)
"""Keywords on which the rows depend."""
DELIMITERS = {"PIPE": "|", "TAB": "\t", "SPACE": " ", "COMMA": ",", "SEMICOLON": ";"}
MOST_NOTES = 5
DAY_S = 86400.0


class Alcdef(Format):
    """Light curves of one asteroid, in version 2 or simple: each session a curve, its ``MAGBAND`` (else ``FILTER``) the band.

    Times are JD in UTC. They are moved to mid-exposure where ``EXPJD`` says ``START`` or ``END`` and ``EXPOSURE`` how long.
    ``LTCAPP`` (else ``LTCTYPE``) says whether light time is corrected. ``MAGADJUST`` is added to the magnitudes. Those that
    ``REDUCEDMAGS`` says are reduced to unit distances by one ``UCORMAG`` are made apparent again. If those of any session are
    differential, all are read as relative flux, each session with a gain of its own. So they are where magnitudes were reduced row by
    row, or by an amount that is not told. A keyword without a value is absent. The warnings say what was done.
    """

    name = "ALCDEF"
    files = "text in blocks `STARTMETADATA` ... `ENDDATA`"

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return head.first.strip().upper() in BEGINS

    @classmethod
    def read(cls, head: Head) -> Header:
        path = head.path
        blocks = [block for block, _, cells in _alcdef_lines(path) if not cells]
        if not blocks:
            raise InputError(
                path, None, "no session with data", "STARTMETADATA, ENDMETADATA, DATA=... and ENDDATA"
            )
        for key in ("OBJECTNAME", "OBJECTNUMBER"):
            names = sorted(
                {block.said[key] for block in blocks if key in block.said and block.said[key] != "0"}
            )
            if len(names) > 1:
                raise InputError(
                    path, None, f"{len(names)} objects ({', '.join(names)[:100]})", "one object a file"
                )
        corrected = {block.light_time_corrected for block in blocks}
        if len(corrected) > 1:
            raise InputError(
                path, "LTCAPP, LTCTYPE", "sessions with and without light-time correction", "the same in all"
            )
        relative = any(block.relative for block in blocks)
        notes = [note for block in blocks for note in block.notes(path, relative)]

        def rows() -> Iterator[Row]:
            curves: dict[int, str] = {}
            zeros: dict[int, float] = {}
            for block, number, cells in _alcdef_lines(path):
                if not cells:
                    continue
                place = f"line {number}"
                date, later = cells[0], block.half_exposure_days(path)
                if later:
                    date = repr(checked_decimal(date, path, place) + later)
                mag = checked_decimal(cells[1], path, place)
                error = (
                    checked_decimal(cells[2], path, place) if len(cells) > 2 and cells[2].strip() else None
                )
                beyond = not abs(mag) <= BEYOND_MAG or (error is not None and abs(error) > BEYOND_MAG)
                if block.line not in curves:
                    curves[block.line] = f"{len(curves) + 1} {block.said.get('SESSIONDATE', '')}".strip()
                band = block.said.get("MAGBAND") or block.said.get("FILTER") or "unknown"
                value, sigma = mag, error
                if relative:
                    zero = mag if beyond else zeros.setdefault(block.line, mag)
                    value = math.nan if beyond else math.exp((zero - mag) / MAG_PER_LN)
                    sigma = None if error is None else value * error / MAG_PER_LN
                elif not beyond:
                    value = mag + block.correction(path)
                spread = "" if sigma is None else repr(sigma)
                yield number, [date, repr(value), spread, curves[block.line], band]

        kind = "flux" if relative else "mag"
        meta = {"time_format": "jd", "light_time_corrected": corrected == {True}}
        objects = {block.said["OBJECTNAME"] for block in blocks if "OBJECTNAME" in block.said}
        meta |= {"object": objects.pop()} if objects else {}
        columns = ("time", kind, f"{kind}_err", "curve", "band")
        theirs = {
            "time": "1st of DATA",
            kind: "2nd",
            f"{kind}_err": "3rd",
            "curve": "session",
            "band": "MAGBAND or FILTER",
        }
        return Header(
            path,
            columns,
            "|",
            ecsv=False,
            meta=meta,
            notes=_few(notes),
            rows=rows,
            format=cls.name,
            theirs=theirs,
        )


@dataclass
class _Block:
    """One session of an ALCDEF file: what stands above its data, and how its magnitudes are to be taken.

    A keyword without a value is one that is not there.
    """

    line: int
    said: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)

    def word(self, key: str) -> str:
        return self.said.get(key, "").upper()

    @property
    def differential(self) -> bool:
        return self.word("DIFFERMAGS") not in NOT_APPLIED

    @property
    def reduced(self) -> bool:
        """Magnitudes brought to unit distances. UCORMAG alone only tells what would do so."""
        return self.word("REDUCEDMAGS") not in NOT_APPLIED

    @property
    def relative(self) -> bool:
        """Differential magnitudes, or reduced to unit distances by amounts that the file does not tell."""
        return self.differential or (self.reduced and not self._told)

    @property
    def _told(self) -> bool:
        """One amount for all rows; 0, the default of the format, is none: r and Delta of 1 au do not last."""
        return self.word("REDUCEDMAGS") in ("AVERAGE", "TRUE") and bool(
            re.search("[1-9]", self.word("UCORMAG"))
        )

    @property
    def light_time_corrected(self) -> bool:
        """LTCAPP says what was applied; without it LTCTYPE does."""
        return self.word("LTCAPP" if self.word("LTCAPP") else "LTCTYPE") not in NOT_APPLIED

    def number(self, path: Path, key: str) -> float:
        if key not in self.said:
            return 0.0
        return checked_decimal(self.said[key], path, f"line {self.lines[key]}, {key}")

    def correction(self, path: Path) -> float:
        """What is added to a magnitude of the file to make it apparent, mag."""
        return self.number(path, "MAGADJUST") - (self.number(path, "UCORMAG") if self.reduced else 0.0)

    def half_exposure_days(self, path: Path) -> float:
        """What is added to a date of the file for the middle of its exposure."""
        mark = self.word("EXPJD")
        if mark in ("", "NONE", "MID", "MIDDLE"):
            return 0.0
        if mark not in ("START", "BEGIN", "END"):
            raise InputError(path, f"line {self.lines['EXPJD']}, EXPJD", repr(mark[:40]), "START, MID or END")
        exposure = self.number(path, "EXPOSURE") if "EXPOSURE" in self.said else math.nan
        if not 0 <= exposure <= DAY_S:
            raise InputError(
                path,
                f"line {self.lines['EXPJD']}, EXPJD",
                f"{mark}, and no EXPOSURE in seconds",
                "an EXPOSURE, by half of which the dates are moved, or EXPJD=MID",
            )
        return (-0.5 if mark == "END" else 0.5) * exposure / DAY_S

    def notes(self, path: Path, relative: bool) -> list[str]:
        """What has to be told of how its rows were read."""
        notes, place = [], f"the session of line {self.line}"
        if relative and not self.differential and not self.reduced:
            notes.append(f"{place} is calibrated, but others are not: all are read as relative flux")
        if self.differential:
            notes.append(f"{place} holds differential magnitudes, read as relative flux")
        elif self.relative:
            notes.append(
                f"{place} is reduced to unit distances by amounts that it does not tell, and is read as relative flux"
            )
        elif not relative and self.correction(path):
            names = " and ".join(
                key
                for key in ("MAGADJUST", "UCORMAG")
                if key in self.said and (key != "UCORMAG" or self.reduced)
            )
            notes.append(f"{place}: {self.correction(path):+g} mag are added ({names})")
        if self.half_exposure_days(path):
            notes.append(
                f"{place}: dates of the {self.word('EXPJD').lower()} of exposures are moved to their middle"
            )
        if self.word("LTCAPP") in ("NONE", "FALSE") and self.word("LTCTYPE") not in NOT_APPLIED:
            notes.append(f"{place}: LTCAPP says that light time is not corrected, whatever LTCTYPE says")
        return notes


def _few(notes: list[str]) -> tuple[str, ...]:
    """The first notes and how many more there are: a file may hold hundreds of sessions."""
    more = len(notes) - MOST_NOTES
    return (*notes[:MOST_NOTES], *([f"and {more} more remarks on sessions of this kind"] if more > 0 else []))


def _alcdef_lines(path: Path) -> Iterator[tuple[_Block, int, list[str]]]:
    """Every session once with no cells as its data begin, then with the cells of each of its rows."""
    block, inside = None, False
    for number, line in enumerate(lines_of(path), 1):
        text = line.partition("#")[0].strip()
        word = text.upper()
        if word in BEGINS:
            if inside:
                raise InputError(
                    path, f"line {number}", f"{word} inside the data of a session", "ENDDATA before it"
                )
            block, inside = _Block(number), False
        elif not text or word == "ENDBLOCK":
            continue
        elif block is None:
            raise InputError(path, f"line {number}", repr(text[:40]), "STARTMETADATA or STARTBLOCK before it")
        elif word in ("ENDMETADATA", "STARTDATA"):
            inside = True
            yield block, number, []
        elif word == "ENDDATA":
            inside = False
        elif not inside:
            key, equals, value = (part.strip() for part in text.partition("="))
            if not equals:
                raise InputError(path, f"line {number}", repr(text[:40]), "KEYWORD=value")
            if key.upper() == "DATA":
                raise InputError(
                    path, f"line {number}", "DATA outside a session's data", "ENDMETADATA before it"
                )
            if value and key.upper() in COUNTED and block.said.get(key.upper(), value) != value:
                found = (
                    f"{key.upper()} again, {block.said[key.upper()][:40]} in line {block.lines[key.upper()]}"
                )
                raise InputError(path, f"line {number}", found, "each keyword once in a session")
            if value:
                block.said[key.upper()], block.lines[key.upper()] = value, number
        else:
            cells = _alcdef_cells(path, number, block, line)
            if len(cells) < 2:
                raise InputError(
                    path, f"line {number}", repr(text[:40]), "a Julian date, a magnitude and its error"
                )
            yield block, number, cells
    if inside:
        raise InputError(path, None, "ends inside the data of a session", "ENDDATA", "It may be cut off.")


def _alcdef_cells(path: Path, number: int, block: _Block, line: str) -> list[str]:
    text = re.sub(r"^DATA\s*=", "", line.partition("#")[0].strip(" \r\n"), flags=re.IGNORECASE)
    name = block.word("DELIMITER") or "PIPE"
    if name not in DELIMITERS:
        place = f"line {block.lines['DELIMITER']}, DELIMITER"
        raise InputError(path, place, repr(name[:40]), ", ".join(DELIMITERS))
    return [cell.strip() for cell in (text.split() if name == "SPACE" else text.split(DELIMITERS[name]))]
