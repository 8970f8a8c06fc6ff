"""Recordings in the layouts of others: tracks of Mini-MegaTORTORA, ALCDEF, light-curve files of DAMIT.

Each reader recognises its layout by how a file begins and gives a Header whose rows are those of our own
tables; what they hold is then checked as that of any recording.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from torchlc.errors import InputError
from torchlc.files.decimals import checked_decimal
from torchlc.readers.table import BEYOND_MAG, Header, lines_of

MAG_PER_LN = 2.5 / math.log(10)
MMT = {"StdMag", "Mag", "Filter", "Channel"}
SUN, OBSERVER = ("sun_x", "sun_y", "sun_z"), ("obs_x", "obs_y", "obs_z")
NOT_APPLIED = ("", "NONE", "FALSE", "NO", "N")
BEGINS = ("STARTMETADATA", "STARTBLOCK")
DELIMITERS = {"PIPE": "|", "TAB": "\t", "SPACE": " ", "COMMA": ",", "SEMICOLON": ";"}
MOST_NOTES = 5
DAY_S = 86400.0


def mini_megatortora(path: Path, comments: Sequence[str], first: str) -> Header | None:
    """A track, or all tracks of a satellite, of mmt.favor2.info (Karpov et al. 2016), or the same as CSV.

    ``Mag`` is taken, which is apparent; ``StdMag`` is not. Each track and camera channel is a curve, for
    steps of some hundredths of a magnitude may lie between channels.
    """
    names = first.split(",")
    if not set(names) >= MMT | {"Date"}:
        titles = (line.split() for line in comments if line.startswith("Date Time"))
        names = next((title for title in titles if set(title) >= MMT), [])
    if not names:
        return None
    split = "Time" in names
    place = {name: names.index(name) for name in (*MMT, "Date", "Track") if name in names}

    def rows() -> Iterator[list[str]]:
        for number, line in enumerate(lines_of(path), 1):
            if line.startswith(("#", "Date,")) or not line.strip():
                continue
            cells = line.split() if split else next(csv.reader([line.strip()]))
            if len(cells) != len(names):
                raise InputError(
                    path, f"line {number}", f"{len(cells)} values", f"{len(names)}: {', '.join(names)}"
                )
            date = "T".join(cells[:2]) if split else cells[place["Date"]]
            track = f"track {cells[place['Track']]} " if "Track" in place else ""
            band = cells[place["Filter"]]
            curve = f"{track}channel {cells[place['Channel']]}"
            yield [date, cells[place["Mag"]], "clear" if band == "Clear" else band, curve]

    about = dict(line.split(": ", 1) for line in comments if ": " in line)
    meta = {"object": about["satellite"]} if "satellite" in about else {}
    return Header(path, ("time", "mag", "band", "curve"), ",", ecsv=False, meta=meta, rows=rows)


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
        told, place = [], f"the session of line {self.line}"
        if relative and not self.differential and not self.reduced:
            told.append(f"{place} is calibrated, but others are not: all are read as relative flux")
        if self.differential:
            told.append(f"{place} holds differential magnitudes, read as relative flux")
        elif self.relative:
            told.append(
                f"{place} is reduced to unit distances by amounts that it does not tell, and is read as relative flux"
            )
        elif not relative and self.correction(path):
            names = " and ".join(
                key
                for key in ("MAGADJUST", "UCORMAG")
                if key in self.said and (key != "UCORMAG" or self.reduced)
            )
            told.append(f"{place}: {self.correction(path):+g} mag are added ({names})")
        if self.half_exposure_days(path):
            told.append(
                f"{place}: dates of the {self.word('EXPJD').lower()} of exposures are moved to their middle"
            )
        if self.word("LTCAPP") in ("NONE", "FALSE") and self.word("LTCTYPE") not in NOT_APPLIED:
            told.append(f"{place}: LTCAPP says that light time is not corrected, whatever LTCTYPE says")
        return told


def alcdef(path: Path, comments: Sequence[str], first: str) -> Header | None:
    """The Asteroid Lightcurve Data Exchange Format, version 2 and simple (Warner, Stephens & Harris; alcdef.org).

    Times are UTC. Each session is a curve, its MAGBAND (else FILTER) the band. MAGADJUST is added to the
    magnitudes; those that REDUCEDMAGS says are reduced to unit distances by one UCORMAG are made apparent
    again. If those of any session are differential, or reduced row by row, all are read as relative flux,
    each session with a gain of its own.
    """
    if first.strip().upper() not in BEGINS:
        return None
    blocks = [block for block, _, cells in _alcdef_lines(path) if not cells]
    if not blocks:
        raise InputError(
            path, None, "no session with data", "STARTMETADATA, ENDMETADATA, DATA=... and ENDDATA"
        )
    for key in ("OBJECTNAME", "OBJECTNUMBER"):
        names = sorted({block.said[key] for block in blocks if key in block.said and block.said[key] != "0"})
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

    def rows() -> Iterator[list[str]]:
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
            error = checked_decimal(cells[2], path, place) if len(cells) > 2 and cells[2].strip() else None
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
            yield [date, repr(value), "" if sigma is None else repr(sigma), curves[block.line], band]

    kind = "flux" if relative else "mag"
    meta = {"time_format": "jd", "light_time_corrected": corrected == {True}}
    objects = {block.said["OBJECTNAME"] for block in blocks if "OBJECTNAME" in block.said}
    meta |= {"object": objects.pop()} if objects else {}
    columns = ("time", kind, f"{kind}_err", "curve", "band")
    return Header(path, columns, "|", ecsv=False, meta=meta, notes=_few(notes), rows=rows)


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


def damit(path: Path, comments: Sequence[str], first: str) -> Header | None:
    """A light-curve file of DAMIT (Durech, Sidorin & Kaasalainen 2010): number of curves; for each its number
    of points and 1 if calibrated, else 0; rows of JD, brightness, then object to Sun and to Earth in au.

    Vectors are ecliptic, times corrected for light time. Each relative curve has a gain of its own; the
    calibrated ones, reduced to unit distances in the file, are put back to their distances and share one.
    Lines ``# time_scale: tdb`` above the first say what the layout itself does not: without, it is UTC.
    """
    if not re.fullmatch(r"\s*\d+\s*", first, re.ASCII):
        return None

    def rows() -> Iterator[list[str]]:
        lines = (
            (number, line)
            for number, line in enumerate(lines_of(path), 1)
            if line.strip() and not line.startswith("#")
        )
        next(lines)
        for curve in range(int(first[:9])):
            number, line = next(lines, (0, ""))
            if not re.fullmatch(r"\s*\d{1,9}\s+[01]\b.*", line.rstrip(), re.ASCII):
                place = f"line {number}" if number else None
                raise InputError(
                    path, place, repr(line.strip()[:40]), f"points and 0 or 1 of curve {curve + 1}"
                )
            points, calibrated = line.split()[:2]
            for _ in range(int(points)):
                number, line = next(lines, (0, ""))
                cells = line.split()
                if len(cells) != 8:
                    place = f"line {number}" if number else f"curve {curve + 1}"
                    expected = "JD, brightness, 3 numbers to the Sun, 3 to the Earth"
                    raise InputError(path, place, f"{len(cells)} values", expected)
                name = f"{curve + 1:03d}"
                if calibrated == "1":
                    place = f"line {number}"
                    vectors = [checked_decimal(cell, path, place) for cell in cells[2:]]
                    far = math.hypot(*vectors[:3]) * math.hypot(*vectors[3:])
                    cells[1] = repr(checked_decimal(cells[1], path, place) / far**2 if far else math.nan)
                    name = "calibrated"
                yield [*cells[:2], name, *cells[2:]]
        number, line = next(lines, (0, ""))
        if number:
            found = f"{line.strip()[:40]!r} after the last point that the file announces"
            expected = "as many curves and points as it says"
            raise InputError(
                path, f"line {number}", found, expected, "Correct the counts, or take the lines out."
            )

    said = dict(line.split(": ", 1) for line in comments if ": " in line)
    meta: Mapping[str, object] = {
        "time_format": "jd",
        "light_time_corrected": True,
        "frame": "ecliptic",
        **said,
    }
    names = ("time", "flux", "curve", *SUN, *OBSERVER)
    units = dict.fromkeys((*SUN, *OBSERVER), "AU")
    return Header(path, names, " ", ecsv=False, units=units, meta=meta, rows=rows)


LAYOUTS = (mini_megatortora, alcdef, damit)
