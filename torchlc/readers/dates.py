"""Dates and times of day as people and programs write them, as ISO texts."""

from __future__ import annotations

import calendar
import datetime
import re
from collections.abc import Sequence

from torchlc.scene.timestamps import ISO, UnreadableTime

MONTHS = (
    "january", "february", "march", "april", "may", "june", "july", "august", "september", "october", "november", "december",
)  # fmt: skip
"""Read by their first three letters or more."""
_PART = r"\d{1,2}|[A-Za-z]{3,9}\.?"
DATE = rf"(?:\d{{4}}([-/. ])(?:{_PART})\1\d{{1,2}}|(?:{_PART})([-/. ])(?:{_PART})\2\d{{4}})"
CLOCK = r"\d{1,2}:\d\d(?::\d\d(?:\.\d+)?)?(?:\s*[AaPp]\.?[Mm]\.?)?"
YEAR_FIRST = re.compile(
    rf"(?P<year>\d{{4}})(?P<between>[-/. ])(?P<month>{_PART})(?P=between)(?P<day>\d{{1,2}})(?P<share>\.\d+)?",
    re.ASCII,
)
YEAR_LAST = re.compile(
    rf"(?P<first>{_PART})(?P<between>[-/. ])(?P<second>{_PART})(?P=between)(?P<year>\d{{4}})", re.ASCII
)
TWO_DIGITS = re.compile(r"\s*\d{1,2}([-/.])\d{1,2}\1\d\d(?!\d)", re.ASCII)
DAY_OF_YEAR = re.compile(r"(?P<year>\d{4})[-:](?P<day>\d{3})(?!\d)[T :]*", re.ASCII)
WITHOUT_MARKS = re.compile(r"(\d{4})(\d\d)(\d\d)[T ](\d\d)(\d\d)(\d\d(?:\.\d+)?)?(?=\D|$)", re.ASCII)
DATE_IN_DIGITS = re.compile(r"\s*(19|20)\d\d(0[1-9]|1[0-2])[0-3]\d\s*", re.ASCII)
CLOCK_IN_DIGITS = re.compile(r"\s*[0-2]\d[0-5]\d([0-6]\d(\.\d+)?)?\s*", re.ASCII)
HALVES = re.compile(
    r"(?P<hour>\d{1,2})(?P<rest>:\d\d(?::\d\d(?:\.\d+)?)?)\s*(?P<half>[AaPp])\.?[Mm]\.?(?![A-Za-z])", re.ASCII
)
ONE_DIGIT = re.compile(r"\d:\d\d", re.ASCII)
ISO_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d(?:[T ]\d\d:(?!.*[AaPp]\.?[Mm])|\s*$)", re.ASCII)
PARTS = re.compile(
    r"\d{4} \d{1,2} (\d{1,2}(\.\d*)?|\d{1,2} \d{1,2} \d{1,2}|\d{1,2} \d{1,2} \d{1,2} \d{1,2}(\.\d*)?)",
    re.ASCII,
)
"""Year, month and day with or without a share; these, hour and minute; or these, hour, minute and second."""
MICROSECONDS = 86_400_000_000
"""In a day."""
ORDERS = ("day-first", "month-first")
WHICH_ORDER = "the year first, or the order of day and month told: both can be a month"


def are_apart(date: str, clock: str) -> bool:
    """Is this a date, and that a time of day, in two cells?"""
    if DATE_IN_DIGITS.fullmatch(date):
        return CLOCK_IN_DIGITS.fullmatch(clock) is not None
    return bool(
        re.fullmatch(rf"\s*{DATE}\s*", date) and re.fullmatch(rf"\s*{CLOCK}\s*(Z|UTC?)?\s*", clock, re.I)
    )


def moment_of(cells: Sequence[str]) -> str:
    """The text of an instant that stands in one cell, or in several: a date and a time of day, or year, month, day, hour, minute
    and second, of which the last may have a share."""
    parts = [cell.strip() for cell in cells]
    if len(parts) == 1 or PARTS.fullmatch(" ".join(parts)) is None:
        return "T".join(parts)
    year, month, day, *clock = parts
    if not clock:
        return f"{year} {month} {day}"
    whole, _, share = clock[-1].partition(".")
    clock[-1] = f"{whole:0>2}{share and f'.{share}'}"
    return f"{year}-{month:0>2}-{day:0>2}T{':'.join(f'{part:0>2}' for part in clock)}"


def is_moment(cell: str) -> bool:
    """Is this a date with its time of day, or a date with a share of a day?"""
    try:
        return bool(ISO.fullmatch(Calendar(ORDERS[0]).iso([cell])[0]))
    except UnreadableTime:
        return True


class Calendar:
    """Turns dates of one file into ISO texts; ``order`` of day and month where the year is last, "" until it is known.

    A date with dots has the day first, which every country that writes dots does. With strokes or dashes the user tells,
    or a number beyond 12 does, which no month has: ``because`` is then the date that showed it.
    """

    def __init__(self, order: str) -> None:
        self.order, self.because = order, ""

    def iso(self, cells: Sequence[str]) -> list[str]:
        """ISO texts (T,) of ``cells`` (T,); what is no date of a known kind stays as it is. Raises UnreadableTime."""
        if all(map(ISO_DATE.match, cells)):
            return list(cells)
        self._learn_order(cells)
        return [self._one(index, cell) for index, cell in enumerate(cells)]

    def _learn_order(self, cells: Sequence[str]) -> None:
        for cell in cells:
            if self.order:
                return
            date = YEAR_LAST.match(cell.strip())
            if date and date["between"] != "." and date["first"].isdigit() and date["second"].isdigit():
                beyond = int(date["first"]) > 12, int(date["second"]) > 12
                if beyond[0] != beyond[1]:
                    self.order, self.because = ORDERS[beyond[1]], date[0]

    def _one(self, index: int, cell: str) -> str:
        text = cell.strip()
        if ISO_DATE.match(text):
            return text
        if marked := WITHOUT_MARKS.match(text):
            year, month, day, hour, minute, second = marked.groups()
            return f"{year}-{month}-{day}T{hour}:{minute}:{second or '00'}{text[marked.end() :]}"
        if counted := DAY_OF_YEAR.match(text):
            return self._of_day(index, text, counted)
        if date := YEAR_FIRST.match(text):
            day, rest = f"{date['year']}-{_month(date['month'])}-{date['day']:0>2}", text[date.end() :]
            if date["share"] and not rest.strip():
                return f"{day}T{_clock_of(date['share'])}"
            return day + _clock(date["share"] or rest)
        if date := YEAR_LAST.match(text):
            return self._year_last(index, text, date) + _clock(text[date.end() :])
        if TWO_DIGITS.match(text):
            raise UnreadableTime(index, text, "a year of four digits, as in 2020-10-17T16:31:00.5")
        return text

    def _of_day(self, index: int, text: str, counted: re.Match[str]) -> str:
        day, year = int(counted["day"]), counted["year"]
        days = 366 if calendar.isleap(int(year)) else 365
        if not 1 <= day <= days or year == "0000":
            raise UnreadableTime(index, text, f"a day of the year from 1 to {days}")
        date = datetime.date(int(year), 1, 1) + datetime.timedelta(days=day - 1)
        return date.isoformat() + _clock("T" + text[counted.end() :])

    def _year_last(self, index: int, text: str, date: re.Match[str]) -> str:
        first, second = date["first"], date["second"]
        if not second.isdigit() and first.isdigit():
            day, month = first, second
        elif not first.isdigit():
            day, month = second, first
        elif date["between"] == "." or first.zfill(2) == second.zfill(2):
            day, month = first, second
        elif not self.order:
            raise UnreadableTime(index, text, WHICH_ORDER)
        else:
            day, month = (first, second) if self.order == ORDERS[0] else (second, first)
        if month.isdigit() and int(month) > 12:
            raise UnreadableTime(index, text, f"a month from 1 to 12: the dates are read {self.order}")
        return f"{date['year']}-{_month(month)}-{day:0>2}"


def _month(text: str) -> str:
    """Two digits of a month's number or English name; what is none as it is."""
    name = text.rstrip(".").lower()
    numbers = [number for number, month in enumerate(MONTHS, 1) if len(name) >= 3 and month.startswith(name)]
    return f"{numbers[0]:02}" if numbers else f"{text:0>2}"


def _clock(rest: str) -> str:
    """What follows a date, with "T" before it, hours of two digits and of 24 to the day."""
    text = rest.strip().lstrip("T, ").strip()
    if not text:
        return ""
    if half := HALVES.match(text):
        hour = int(half["hour"])
        if 1 <= hour <= 12:
            hour = hour % 12 + 12 * (half["half"] in "Pp")
            text = f"{hour:02}{half['rest']}{text[half.end() :]}"
    elif ONE_DIGIT.match(text):
        text = f"0{text}"
    return f"T{text}"


def _clock_of(share: str) -> str:
    """Time of day to the microsecond of a ``share`` of the day, ".75" as 18:00:00."""
    moment = min(round(float(share) * MICROSECONDS), MICROSECONDS - 1)
    minutes, rest = divmod(moment, 60_000_000)
    return f"{minutes // 60:02}:{minutes % 60:02}:{rest // 1_000_000:02}.{rest % 1_000_000:06}"
