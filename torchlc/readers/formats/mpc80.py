"""Observations in the 80 columns of the Minor Planet Center (minorplanetcenter.net/iau/info/OpticalObs.html)."""

from __future__ import annotations

import re
from collections.abc import Iterator

from torchlc.errors import InputError
from torchlc.readers.format import Format, Head
from torchlc.readers.objects import chosen_object
from torchlc.readers.table import Header, Row, lines_of

DATE = re.compile(r"\d{4} \d\d \d\d\.\d{1,6} {0,6}", re.ASCII)
CODE = re.compile(r"[A-Z0-9]\d\d", re.ASCII)
SECOND_LINES = "svr"
"""In column 15: places of spacecraft and roving observers, and the second line of a radar's."""
RADAR = "R"


class Mpc80(Format):
    """Magnitudes beside astrometry, at mid-exposure in UTC, without errors.

    The observatory's code is the station. Observations without a magnitude are rows without one. The magnitudes have one or two decimals.
    """

    name = "MPC 80 columns"
    files = "text in lines of 80 columns"

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return _is_observation(head.first)

    @classmethod
    def read(cls, head: Head) -> Header:
        path = head.path

        def all_rows() -> Iterator[tuple[str, Row]]:
            for number, line in enumerate(lines_of(path), 1):
                text = line.rstrip("\r\n")
                if text.startswith("#") or not text.strip() or (len(text) == 80 and text[14] in SECOND_LINES):
                    continue
                if not _is_observation(text):
                    expected = "80 columns: the date in 16 to 32, the magnitude in 66 to 70, the observatory in 78 to 80"
                    raise InputError(path, f"line {number}", repr(text[:40]), expected)
                name = text[:5].strip() or text[5:12].strip()
                cells = [text[15:32].strip(), text[65:70].strip(), text[70].strip(), text[77:80], name]
                yield name, (number, cells)

        wanted = chosen_object(path, [{name} for name, _ in all_rows()], head.reading.object)

        def rows() -> Iterator[Row]:
            return (row for name, row in all_rows() if wanted is None or name == wanted)

        return Header(
            path,
            ("time", "mag", "band", "station", "object"),
            ",",
            ecsv=False,
            meta={"time_format": "iso"},
            notes=("the file holds no errors of magnitudes, and one or two decimals of them",),
            rows=rows,
            format=cls.name,
            theirs={
                "time": "columns 16-32",
                "mag": "66-70",
                "band": "71",
                "station": "78-80",
                "object": "1-12",
            },
        )


def _is_observation(line: str) -> bool:
    return (
        len(line) == 80
        and line[14] != RADAR
        and bool(DATE.fullmatch(line[15:32]))
        and bool(CODE.fullmatch(line[77:80]))
    )
