"""Light-curve files of DAMIT (Durech, Sidorin & Kaasalainen 2010)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.files.decimals import checked_decimal
from torchlc.readers.format import Format, Head
from torchlc.readers.table import Header, Row, lines_of

SUN, OBSERVER = ("sun_x", "sun_y", "sun_z"), ("obs_x", "obs_y", "obs_z")


class Damit(Format):
    """Light curves of one asteroid as relative flux, with the vectors to Sun and Earth.

    The file gives the number of curves, for each its number of points and 1 if calibrated, else 0. Then come rows of JD, brightness,
    object to Sun and object to Earth in au. Vectors are ecliptic, times corrected for light time. Each relative curve has a gain of its own; the
    calibrated ones, reduced to unit distances in the file, are put back to their distances and share one. Lines
    ``# time_scale: tdb`` above the first say what the format itself does not: without, it is UTC. Lines beyond the counts are refused.
    """

    name = "DAMIT"
    files = "text that begins with the number of curves"

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return bool(re.fullmatch(r"\s*\d+\s*", head.first, re.ASCII))

    @classmethod
    def read(cls, head: Head) -> Header:
        path = head.path

        def rows() -> Iterator[Row]:
            lines = (
                (number, line)
                for number, line in enumerate(lines_of(path), 1)
                if line.strip() and not line.startswith("#")
            )
            next(lines)
            for curve in range(int(head.first[:9])):
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
                        raise InputError(path, place, number_of(len(cells), "value"), expected)
                    name = f"{curve + 1:03d}"
                    if calibrated == "1":
                        place = f"line {number}"
                        vectors = [checked_decimal(cell, path, place) for cell in cells[2:]]
                        far = math.hypot(*vectors[:3]) * math.hypot(*vectors[3:])
                        cells[1] = repr(checked_decimal(cells[1], path, place) / far**2 if far else math.nan)
                        name = "calibrated"
                    yield number, [*cells[:2], name, *cells[2:]]
            number, line = next(lines, (0, ""))
            if number:
                found = f"{line.strip()[:40]!r} after the last point that the file announces"
                expected = "as many curves and points as it says"
                raise InputError(
                    path, f"line {number}", found, expected, "Correct the counts, or take the lines out."
                )

        said = dict(line.split(": ", 1) for line in head.comments if ": " in line)
        meta: Mapping[str, object] = {
            "time_format": "jd",
            "light_time_corrected": True,
            "frame": "ecliptic",
            **said,
        }
        names = ("time", "flux", "curve", *SUN, *OBSERVER)
        units = dict.fromkeys((*SUN, *OBSERVER), "AU")
        theirs = {"time": "JD", "flux": "brightness", "curve": "number of the curve"}
        theirs |= dict(zip(SUN, ("to the Sun x", "y", "z"), strict=True))
        theirs |= dict(zip(OBSERVER, ("to the Earth x", "y", "z"), strict=True))
        return Header(
            path,
            names,
            " ",
            ecsv=False,
            units=units,
            meta=meta,
            rows=rows,
            format=cls.name,
            theirs=theirs,
        )
