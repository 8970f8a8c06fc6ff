"""Instants written by people: ISO 8601 or Julian date in, two-part Julian dates of a known time scale out."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from astropy.time import Time, conf
from erfa import ErfaWarning

ISO = re.compile(
    r"\s*(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d(?:\.\d+)?)?)\s*"
    r"(?P<zone>Z|UTC|UT|GMT|(?P<offset>[+-])(\d\d)(?::?(\d\d))?)?\s*",
    re.IGNORECASE | re.ASCII,
)
JULIAN_DATE = re.compile(r"\s*[+-]?[\d.]+([eE][+-]?\d+)?\s*", re.ASCII)
"""A text that is meant as a number of days, not as ISO."""
EARLIEST_YEAR = {"utc": 1960, "tai": 1960, "tt": 1960, "tdb": 1900, "gps": 1980}
"""UTC is not defined before 1960, and the clock of GPS began in 1980."""
EARLIEST_AS_UT = 1900
"""From here on Julian dates may be read as UT where UTC is not defined yet."""
JULIAN_1900, UTC_BEGINS = 2415020.5, 2436934.5
"""Julian dates of 1900-01-01 and 1960-01-01."""
BEFORE_UTC = ", for UTC begins in 1960"
"""How an error of such a time ends."""
AS_TAI = {"gps": 19.0 / 86400.0}
"""Clocks that run as TAI does, and by how many days they are behind it."""
LATEST_YEAR = 2200
MJD_ZERO = 2400000.5
REDUCED_ZERO = 2400000.0
REDUCED = (30000.0, 90000.0)
"""Numbers that are Julian dates of this age less one of the two zeros: 1941 to 2105."""


class UnreadableTime(ValueError):
    """One instant that cannot be used: its index in the sequence, the text found, what was expected."""

    def __init__(self, index: int, found: str, expected: str) -> None:
        super().__init__(f"{found!r}: expected {expected}")
        self.index, self.found, self.expected = index, found, expected


def julian_dates_of_iso(texts: Sequence[str], scale: str) -> tuple[np.ndarray, np.ndarray]:
    """Two-part Julian dates (T,), (T,) of ISO texts; an offset such as +08:00 is converted."""
    joined = "".join(texts)
    if (
        set(joined) - set("0123456789-:.T ")
        or joined.count("-") != 2 * len(texts)
        or min(map(len, texts)) < 16
    ):
        plain = _plain_utc(texts, scale)
    else:
        plain = [text.strip().replace(" ", "T") for text in texts]
    times = _parse_iso(plain, "tai" if scale in AS_TAI else scale)
    jd1, jd2 = np.asarray(times.jd1), np.asarray(times.jd2)
    _check_range(jd1 + jd2, scale, texts)
    return jd1, jd2


def julian_dates_of_numbers(
    numbers: np.ndarray,
    scale: str,
    *,
    zero: tuple[float, float] = (0.0, 0.0),
    per_day: float = 1.0,
    first_year: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Two-part Julian dates of numbers (T,), of which a day has ``per_day``, since the two-part Julian date ``zero``;
    not-a-number stays not-a-number. Earlier ones than ``first_year`` (else that of the scale) are refused.
    """
    days = np.floor(numbers / per_day)
    jd1, jd2 = days + zero[0], (numbers - days * per_day) / per_day + zero[1]
    finite = np.isfinite(numbers)
    _check_range(np.where(finite, jd1 + jd2, MJD_ZERO + 51544), scale, numbers, first_year)
    return jd1, jd2


BESIDE_UTC = ("tdb", "tt")
"""Scales of a recording beside which an instant of the scene may be UTC, if it says so."""


def utc_text(moment: Time) -> str:
    """ISO text in UTC of an instant, which :func:`instant` reads as the same beside the moment's own scale."""
    return f"{cast(Any, moment).utc.isot}{'Z' if moment.scale in BESIDE_UTC else ''}"


def instant(value: str | float, scale: str) -> Time:
    """One instant from ISO text or a Julian date, e.g. the ``epoch`` of a scene; raises UnreadableTime. On a clock of AS_TAI
    it is that clock's reading, as if it were TAI's. Text that ends in Z is UTC beside TDB and TT too."""
    if isinstance(value, str) and value.endswith("Z") and scale in BESIDE_UTC:
        return cast(Time, getattr(instant(value, "utc"), scale))
    if isinstance(value, str):
        jd1, jd2 = julian_dates_of_iso([value], scale)
    else:
        if not np.isfinite(value):
            raise UnreadableTime(0, str(value), "a finite Julian date")
        jd1, jd2 = julian_dates_of_numbers(np.array([float(value)]), scale)
    return cast(Time, Time(jd1[0], jd2[0], format="jd", scale="tai" if scale in AS_TAI else scale))


def _plain_utc(texts: Sequence[str], scale: str) -> list[str]:
    """The texts without zone; those with an offset moved to UTC."""
    plain = []
    for index, text in enumerate(texts):
        match = ISO.fullmatch(text)
        if match is None:
            raise UnreadableTime(index, text.strip(), _advice(text))
        date, clock, zone, sign, hours, minutes = match.groups()
        if zone and scale != "utc":
            raise UnreadableTime(index, text.strip(), f"no UTC offset: the time scale is {scale}")
        moved = f"{date}T{clock}"
        if sign:
            ahead = np.timedelta64(int(sign + "1") * (60 * int(hours) + int(minutes or 0)), "m")
            try:
                moved = str(np.datetime64(moved) - ahead)
            except ValueError:
                raise UnreadableTime(index, text.strip(), "an existing date and time of day") from None
            if abs(ahead) > np.timedelta64(14, "h"):
                raise UnreadableTime(index, text.strip(), "an offset of at most 14 h")
        plain.append(moved)
    return plain


def _advice(text: str) -> str:
    if not text.strip():
        return "a time, found a blank cell"
    if re.fullmatch(r"\s*\d{4}-\d\d-\d\d\s*", text, re.ASCII):
        return "a time of day beside the date"
    if re.search(r"\d\s*[A-Za-z]{2,}\s*$", text) and re.match(r"\s*\d{4}-\d\d-\d\d[T ]\d\d:", text):
        return "UTC: a local time cannot be converted safely; write UTC or give the offset, as in +08:00"
    return "ISO UTC such as 2020-10-17T16:31:00.5, or a Julian date"


def _parse_iso(texts: list[str], scale: str) -> Time:
    """Astropy's parser on all texts; when one is bad, halve the sequence until it is found."""
    try:
        with conf.set_temp("use_fast_parser", "force"), warnings.catch_warnings():
            warnings.simplefilter("error", ErfaWarning)
            warnings.filterwarnings("ignore", message=".*dubious year")
            return cast(Time, Time(np.array(texts, dtype="S"), format="isot", scale=scale))
    except (ValueError, ErfaWarning):
        middle = len(texts) // 2
    if middle == 0:
        raise UnreadableTime(0, texts[0], "an existing date and time of day")
    _parse_iso(texts[:middle], scale)
    try:
        return _parse_iso(texts[middle:], scale)
    except UnreadableTime as error:
        raise UnreadableTime(error.index + middle, error.found, error.expected) from None


def _check_range(
    jd: np.ndarray, scale: str, found: Sequence[str] | np.ndarray, first_year: int | None = None
) -> None:
    first_year = EARLIEST_YEAR[scale] if first_year is None else first_year
    low, high = ((year - 2000) * 365.25 + 2451544.5 for year in (first_year, LATEST_YEAR))
    outside = np.flatnonzero(~((jd >= low) & (jd <= high)))
    if outside.size:
        index = int(outside[0])
        expected = f"a time in {first_year}-{LATEST_YEAR} ({scale.upper()})"
        if scale == "utc" and JULIAN_1900 <= jd[index] < low:
            expected += BEFORE_UTC
        if REDUCED[0] < jd[index] < REDUCED[1]:
            expected += (
                " as a whole Julian date: add 2400000.5 to a modified Julian date (MJD), 2400000 to one "
                "written as JD - 2400000"
            )
        raise UnreadableTime(index, str(found[index]), expected)


def ut_in_tdb(jd1: np.ndarray, jd2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two-part Julian dates (T,) of UTC, and of UT before 1960, as those of TDB; not-a-number stays not-a-number.

    Before 1960 TT is UT and 32.184 s, as astropy has it: 3 s late in 1950 and 35 s in 1900. A light curve of hours does not
    show either.
    """
    known = np.isfinite(jd1 + jd2)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*dubious year", category=ErfaWarning)
        moved: Any = Time(np.where(known, jd1, MJD_ZERO), np.where(known, jd2, 0.0), format="jd", scale="utc")
        tdb = moved.tdb
    return np.where(known, tdb.jd1, np.nan), np.where(known, tdb.jd2, np.nan)


def in_utc(jd1: np.ndarray, jd2: np.ndarray, scale: str) -> tuple[np.ndarray, np.ndarray]:
    """Two-part Julian dates (T,) of TAI, TT or GPS as those of UTC; not-a-number stays not-a-number."""
    if scale in AS_TAI:
        jd2, scale = jd2 + AS_TAI[scale], "tai"
    known = np.isfinite(jd1 + jd2)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*dubious year", category=ErfaWarning)
        moved: Any = Time(np.where(known, jd1, MJD_ZERO), np.where(known, jd2, 0.0), format="jd", scale=scale)
        utc = moved.utc
    return np.where(known, utc.jd1, np.nan), np.where(known, utc.jd2, np.nan)
