"""Cells of a column of times: what they hold, as Julian dates, and what to do about those that hold something else."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from torchlc.errors import InputError, option
from torchlc.files.decimals import advice, decimal
from torchlc.readers.civil_time import to_utc
from torchlc.readers.dates import WHICH_ORDER, Calendar
from torchlc.readers.table import BLANK, Header, read_numbers, row_place, with_point, without_row
from torchlc.readers.timing import FORMAT_WORDS, Timing, count_of, ways_to_say
from torchlc.scene.timestamps import (
    BEFORE_UTC,
    EARLIEST_AS_UT,
    ISO,
    JULIAN_DATE,
    REDUCED,
    UnreadableTime,
    in_utc,
    julian_dates_of_iso,
    julian_dates_of_numbers,
)

OFFSET = re.compile(r":\d\d(\.\d+)?\s*[+-]\d\d", re.ASCII)
"""An offset from UTC behind a time of day."""
SECONDS_WITH_COMMA = re.compile(r"(:\d\d),(?=\d)", re.ASCII)
"""ISO 8601 writes the share of a second behind a comma or a point."""
FIRST_GPS_S = 1e8
"""March 1983: before it the system had no receivers in use; seconds of a week and Julian dates are smaller."""
SPREADSHEET_TO = 51000.0
"""2039 in days of a spreadsheet, 1998 in modified Julian dates: recordings of objects of known elements are rarely older."""
YEARS = (1950.0, 2100.0)
"""Years with decimals of recordings of satellites."""
JULIAN_DATES_FROM = 2_400_000.0
SECONDS_SINCE_1970 = (1e8, 1e10)
"""1973 to 2286; in milliseconds a thousand times these."""


class TimeReader:
    """Reads the cells of a file in pieces; what one piece tells of the ``format``, the order of dates (``calendar``) and offsets holds for
    the next. ``scale`` is that of the dates: tdb or utc. ``before_utc``: Julian dates of before 1960 are read, as UT."""

    def __init__(
        self, header: Header, timing: Timing, date_order: str | None, *, before_utc: bool = False
    ) -> None:
        self.header, self.timing, self.format = header, timing, timing.format
        # a date of a satellite from before 1960 is a slip, and a number that nobody calls a Julian date may be anything
        self.first_year = (
            EARLIEST_AS_UT if before_utc and timing.format == "jd" and timing.scale == "utc" else None
        )
        self._before_utc = before_utc
        self.scale = "tdb" if timing.scale == "tdb" else "utc"
        self.calendar = Calendar(date_order or "")
        self._offsets = False

    def __call__(self, header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
        """Two-part Julian dates (T, 2); the first of the file that is not blank decides between ISO and JD."""
        if header.decimal != ".":
            cells = [with_point(cell, header.decimal) for cell in cells]
        cells = [SECONDS_WITH_COMMA.sub(r"\1.", cell) if "," in cell else cell for cell in cells]
        if not self.format:
            first = next((cell for cell in cells if cell.strip().lower() not in BLANK), cells[0])
            self.format = "jd" if JULIAN_DATE.fullmatch(first) else "iso"
        try:
            days = self._days(header, name, cells, start)
            if self.timing.scale != self.scale:
                days = in_utc(*days, self.timing.scale)
        except UnreadableTime as error:
            found = cells[error.index].strip() if self.format == "iso" else error.found
            hint = self._hint(found, error.expected)
            raise self._refused(start + error.index, name, found, error.expected, hint) from None
        if self.timing.zone is not None:
            try:
                days = to_utc(*days, self.timing.zone)
            except UnreadableTime as error:
                raise self._refused(start + error.index, name, error.found, error.expected) from None
        return np.stack(days, axis=-1)

    def _refused(self, row: int, name: str, found: str, expected: str, hint: str | None = None) -> InputError:
        return InputError(self.header.source, row_place(row, name), repr(found[:40]), expected, hint)

    def _days(self, header: Header, name: str, cells: list[str], start: int) -> tuple[np.ndarray, np.ndarray]:
        """Two-part Julian dates in the scale of the cells."""
        if self.format == "iso":
            texts = self._iso(cells)
            days = julian_dates_of_iso(texts, self.timing.scale)
            self._check_offsets(texts)
            return days
        if not all(map(str.strip, cells)):
            blank = next(index for index, cell in enumerate(cells) if not cell.strip())
            raise UnreadableTime(blank, "", "a time")
        numbers = read_numbers(header, name, cells, start)
        if self.format == "gps" and (short := np.flatnonzero(numbers < FIRST_GPS_S)).size:
            expected = (
                "seconds since 1980-01-06, to which those of a week come if its number times 604800 is added"
            )
            raise UnreadableTime(int(short[0]), cells[short[0]].strip(), expected)
        zero, per_day = count_of(self.format, self.timing.scale)
        return julian_dates_of_numbers(
            numbers, self.timing.scale, zero=zero, per_day=per_day, first_year=self.first_year
        )

    def _iso(self, cells: list[str]) -> list[str]:
        """Cells as ISO texts; none may hold an offset of its own where the user tells the zone."""
        cells = self.calendar.iso(cells)
        if self.timing.zone is not None:
            for index, cell in enumerate(cells):
                match = ISO.fullmatch(cell)
                if match and match["zone"]:
                    raise UnreadableTime(index, cell, f"no offset beside time_zone = {self.timing.zone}")
        return cells

    def _check_offsets(self, texts: Sequence[str]) -> None:
        """All times hold an offset from UTC, or "Z", where one of the file holds an offset."""
        self._offsets |= OFFSET.search("\n".join(texts)) is not None
        for index, cell in enumerate(texts if self._offsets else ()):
            match = ISO.fullmatch(cell)
            if match and match["zone"] is None:
                raise UnreadableTime(index, cell, "an offset from UTC, as other times of the file have")

    def _hint(self, found: str, expected: str) -> str | None:
        """What to do about a time that is no Julian date but may be one of a known kind."""
        if self._before_utc and expected.endswith(BEFORE_UTC):
            said = ways_to_say(self.header, "time_scale", "tdb")
            return f"For times from 1900 on give Julian dates in a column JD, which are read as UT. If they are TDB, say {said}"
        try:
            number = decimal(found)
        except ValueError:
            if expected == WHICH_ORDER:
                orders = (option("columns", f"date_order={order}") for order in ("day-first", "month-first"))
                return f"Say {', or '.join(orders)}"
            return advice(found) or (None if re.search(r"\d", found) else without_row(self.header))
        if not math.isfinite(number):
            return without_row(self.header)
        if self.header.decimal == "." and "," in found:
            return f"Write decimals with a point, or say {option('columns', 'decimal=comma')}"
        if self.format == "jd" and REDUCED[0] < number < REDUCED[1]:
            reduced = ways_to_say(self.header, "time_format", "jd-2400000")
            mjd = ways_to_say(self.header, "time_format", "mjd")
            spreadsheet = option("columns", "time_format=jd-2415018.5")
            days = f". For the days of a spreadsheet, since 1899-12-30, say {spreadsheet}"
            return (
                f"If it is JD - 2400000, say {reduced}. If it is JD - 2400000.5, say {mjd}"
                f"{days if number < SPREADSHEET_TO else ''}"
            )
        for form, scale in (("unix", 1.0), ("unix-ms", 1000.0)):
            if SECONDS_SINCE_1970[0] < number / scale < SECONDS_SINCE_1970[1] and self.format != form:
                said = ways_to_say(self.header, "time_format", form)
                other = "; or time_format=gps for seconds of GPS, since 1980" if form == "unix" else ""
                return f"Say, for {FORMAT_WORDS[form]}, {said}{other}"
        if self.format == "jd" and YEARS[0] < number < YEARS[1]:
            return f"If it is a year with decimals, write dates. {self._hint_of_days()}"
        if self.format == "jd" and 0 <= number < REDUCED[0]:
            return self._hint_of_days()
        if self.format not in ("jd", "iso") and number > JULIAN_DATES_FROM:
            return f"A whole Julian date: {ways_to_say(self.header, 'time_format', 'jd')}"
        return None

    def _hint_of_days(self) -> str:
        return (
            f"Days since another date: {ways_to_say(self.header, 'time_format', 'jd-2450000')}; jd-2457000 "
            "for BTJD of TESS, jd-2454833 for BKJD of Kepler. Seconds since a start: "
            f"{option('columns', 'time_format=seconds since 2020-10-17T16:31:00')}, with minutes, hours and days likewise"
        )
