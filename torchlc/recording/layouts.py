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
from torchlc.recording.table import Header, lines_of

MAG_PER_LN = 2.5 / math.log(10)
MMT = {"StdMag", "Mag", "Filter", "Channel"}
SUN, OBSERVER = ("sun_x", "sun_y", "sun_z"), ("obs_x", "obs_y", "obs_z")
NOT_APPLIED = ("", "NONE", "FALSE")


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
    """One session of an ALCDEF file: what stands above its data, and how its magnitudes are to be taken."""

    line: int
    said: dict[str, str] = field(default_factory=dict)

    @property
    def relative(self) -> bool:
        """Differential magnitudes, or reduced to unit distances by amounts that the file does not tell."""
        reduced = self.said.get("REDUCEDMAGS", "").upper()
        untold = reduced not in NOT_APPLIED and not (reduced == "AVERAGE" and "UCORMAG" in self.said)
        return self.said.get("DIFFERMAGS", "").upper() == "TRUE" or untold

    @property
    def light_time_corrected(self) -> bool:
        return any(self.said.get(key, "").upper() not in NOT_APPLIED for key in ("LTCAPP", "LTCTYPE"))


def alcdef(path: Path, comments: Sequence[str], first: str) -> Header | None:
    """The Asteroid Lightcurve Data Exchange Format, version 2 and simple (Warner, Stephens & Harris; alcdef.org).

    Times are UTC. Each session is a curve, its MAGBAND (else FILTER) the band. Magnitudes reduced to unit
    distances by one UCORMAG are made apparent again. If those of any session are differential, or reduced
    row by row, all are read as relative flux, each session with a gain of its own.
    """
    if first.strip() not in ("STARTMETADATA", "STARTBLOCK"):
        return None
    blocks = [block for block, _, cells in _alcdef_lines(path) if not cells]
    names = sorted({block.said["OBJECTNAME"] for block in blocks if "OBJECTNAME" in block.said})
    if len(names) > 1:
        raise InputError(path, None, f"{len(names)} objects ({', '.join(names)[:100]})", "one object a file")
    corrected = {block.light_time_corrected for block in blocks}
    if len(corrected) > 1:
        raise InputError(
            path, "LTCAPP, LTCTYPE", "sessions with and without light-time correction", "the same in all"
        )
    relative = any(block.relative for block in blocks)

    def rows() -> Iterator[list[str]]:
        curves: dict[int, tuple[str, float]] = {}
        for block, number, cells in _alcdef_lines(path):
            if not cells:
                continue
            mag = _number(path, number, cells[1])
            error = _number(path, number, cells[2]) if len(cells) > 2 and cells[2].strip() else None
            if block.line not in curves:
                curves[block.line] = (f"{len(curves) + 1} {block.said.get('SESSIONDATE', '')}".strip(), mag)
            curve, zero = curves[block.line]
            band = block.said.get("MAGBAND") or block.said.get("FILTER") or "unknown"
            if relative:
                flux = math.exp(min((zero - mag) / MAG_PER_LN, 700.0))
                value, sigma = flux, None if error is None else flux * error / MAG_PER_LN
            else:
                value, sigma = mag - _number(path, block.line, block.said.get("UCORMAG", "0")), error
            yield [cells[0], repr(value), "" if sigma is None else repr(sigma), curve, band]

    kind = "flux" if relative else "mag"
    meta = {"time_format": "jd", "light_time_corrected": corrected == {True}}
    meta |= {"object": names[0]} if names else {}
    columns = ("time", kind, f"{kind}_err", "curve", "band")
    return Header(path, columns, "|", ecsv=False, meta=meta, rows=rows)


def _alcdef_lines(path: Path) -> Iterator[tuple[_Block, int, list[str]]]:
    """Every session once with no cells as its data begin, then with the cells of each of its rows."""
    block, inside = None, False
    for number, line in enumerate(lines_of(path), 1):
        text = line.partition("#")[0].strip()
        if text in ("STARTMETADATA", "STARTBLOCK"):
            block, inside = _Block(number), False
        elif not text or text in ("ENDBLOCK",):
            continue
        elif block is None:
            raise InputError(path, f"line {number}", repr(text[:40]), "STARTMETADATA or STARTBLOCK before it")
        elif text in ("ENDMETADATA", "STARTDATA"):
            inside = True
            yield block, number, []
        elif text == "ENDDATA":
            inside = False
        elif not inside:
            key, equals, value = text.partition("=")
            if not equals:
                raise InputError(path, f"line {number}", repr(text[:40]), "KEYWORD=value")
            block.said[key.strip().upper()] = value.strip()
        else:
            tab = block.said.get("DELIMITER", "PIPE").upper() == "TAB"
            cells = line.strip().removeprefix("DATA=").partition("#")[0].split("\t" if tab else "|")
            if len(cells) < 2:
                raise InputError(
                    path, f"line {number}", repr(text[:40]), "a Julian date, a magnitude and its error"
                )
            yield block, number, [cell.strip() for cell in cells]


def damit(path: Path, comments: Sequence[str], first: str) -> Header | None:
    """A light-curve file of DAMIT (Durech, Sidorin & Kaasalainen 2010): number of curves; for each its number
    of points and 1 if calibrated, else 0; rows of JD, brightness, then object to Sun and to Earth in au.

    Vectors are ecliptic, times corrected for light time. Each relative curve has a gain of its own; the
    calibrated ones, reduced to unit distances in the file, are put back to their distances and share one.
    Lines ``# time_scale: tdb`` above the first say what the layout itself does not: without, it is UTC.
    """
    if not re.fullmatch(r"\s*\d+\s*", first):
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
            if not re.fullmatch(r"\s*\d{1,9}\s+[01]\b.*", line.rstrip()):
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
                    vectors = [_number(path, number, cell) for cell in cells[2:]]
                    far = math.hypot(*vectors[:3]) * math.hypot(*vectors[3:])
                    cells[1] = repr(_number(path, number, cells[1]) / far**2 if far else math.nan)
                    name = "calibrated"
                yield [*cells[:2], name, *cells[2:]]

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


def _number(path: Path, line: int, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise InputError(path, f"line {line}", repr(cell[:40]), "a number") from None
