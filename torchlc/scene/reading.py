"""What a user tells of a recording's file: the table [recording] of a scene, or the option --columns."""

from __future__ import annotations

import re
import zoneinfo
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError

from torchlc.errors import InputError, option
from torchlc.files.decimals import decimal
from torchlc.files.numbers import Real, Table, between, problem
from torchlc.scene.problems import of_validation
from torchlc.scene.timestamps import UnreadableTime, instant

DECIMALS = {"point": ".", "comma": ",", ".": ".", ",": ","}
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " ", "space": " ", "bar": "|"}
OFFSET = re.compile(r"(?:UTC|GMT)?([+-])(\d{1,2})(?::?([0-5]\d))?", re.ASCII | re.IGNORECASE)
LESS_A_DATE = re.compile(r"jd-(24[0-7]\d{4}(\.5)?)", re.ASCII)
"""A time format of days since a Julian date, as in jd-2450000; from 1858 to 2050."""
SINCE = re.compile(r"(seconds|minutes|hours|days) since (\S.*\S)", re.ASCII)
"""A time format of a count from an instant, as the conventions for climate and forecast data write it."""
KNOWN_TIME_FORMATS = ("jd", "mjd", "iso", "unix", "unix-ms", "gps")
TIME_FORMATS = (
    "jd, mjd, jd- and a Julian date (as in jd-2400000), unix or unix-ms (since 1970), gps (s since 1980), "
    "seconds since 2020-10-17T16:31:00, or iso"
)
OBJECTS = {"objects": "object"}
"""How the column that names each row's object is told, for "object" is the one wanted."""
ITEM = re.compile(r'(?:[^,"]|"[^"]*"?)+')
"""What stands between commas; a comma between double quotes belongs to a name."""


def _delimiter(text: str) -> str:
    mark = DELIMITERS.get(text.strip().lower(), text)
    if mark not in DELIMITERS.values():
        raise problem(repr(text[:40]), f"one of {', '.join(DELIMITERS)}")
    return mark


def _decimal(text: str) -> str:
    if text.strip().lower() not in DECIMALS:
        raise problem(repr(text[:40]), "point or comma")
    return DECIMALS[text.strip().lower()]


def _zone(text: str) -> str:
    """A zone that can be converted: an offset from UTC, or a name of the IANA's data base."""
    if is_zone(text):
        return text.strip()
    if OFFSET.fullmatch(text.strip()):
        raise problem(repr(text[:40]), "an offset of at most 14 h")
    raise problem(repr(text[:40]), 'an offset such as "+02:00", or a name such as "Europe/Vienna"')


def is_zone(text: str) -> bool:
    """Is it an offset from UTC of at most 14 h, or the name of a zone?"""
    if match := OFFSET.fullmatch(text.strip()):
        return int(match[2]) * 60 + int(match[3] or 0) <= 14 * 60
    try:
        zoneinfo.ZoneInfo(text.strip())
    except (ValueError, OSError, zoneinfo.ZoneInfoNotFoundError):
        return False
    return True


def _time_format(text: str) -> str:
    if not is_time_format(text):
        raise problem(repr(text[:40]), TIME_FORMATS)
    return text


def is_time_format(text: str) -> bool:
    """Is it one of TIME_FORMATS?"""
    if since := SINCE.fullmatch(text):
        try:
            instant(since[2], "utc")
        except UnreadableTime:
            return False
        return True
    return text in KNOWN_TIME_FORMATS or bool(LESS_A_DATE.fullmatch(text))


class Reading(Table):
    """How a recording's file is to be read, where it does not say so itself.

    ``columns``: our name of a column and the file's, of which several are joined by "+"; ``units`` of our columns;
    ``time_format``, ``time_scale``, ``time_zone`` and ``time_mark`` say what the times are, ``date_order`` how dates such
    as 10/11/2020 are meant; ``light_path``: the Sun
    or the barycentre, to which the way of light was reduced, for an object in the ``direction`` (ICRS right ascension
    and declination, deg); ``exptime`` of all rows, s; ``object``: name or number of the one wanted, "*" for all.
    ``non_detections``: empty slots of a steady cadence are upper limits (None: where the format leaves such rows out), in
    gaps of at most ``longest_gap`` s.
    """

    columns: dict[str, str] = Field(default_factory=dict)
    units: dict[str, str] = Field(default_factory=dict)
    time_format: Annotated[str, AfterValidator(_time_format)] | None = None
    date_order: Literal["day-first", "month-first"] | None = None
    time_scale: Literal["utc", "tai", "tt", "tdb", "gps"] | None = None
    time_zone: Annotated[str, AfterValidator(_zone)] | None = None
    time_mark: Literal["start", "middle", "end"] | None = None
    light_path: Literal["observer", "heliocentric", "barycentric"] | None = None
    direction: tuple[Annotated[Real, between(-180, 360)], Annotated[Real, between(-90, 90)]] | None = None
    exptime: Annotated[Real, between(0.0, 86400.0)] | None = None
    object: str | None = None
    delimiter: Annotated[str, AfterValidator(_delimiter)] | None = None
    decimal: Annotated[str, AfterValidator(_decimal)] | None = None
    non_detections: bool | None = None
    longest_gap: Annotated[Real, between(0.0, 86400.0)] | None = None

    def with_given(self, given: Reading) -> Reading:
        """These entries, with those that are ``given`` in their place; columns and units each by name."""
        update = {name: getattr(given, name) for name in given.model_fields_set}
        for name in ("columns", "units"):
            if name in update:
                update[name] = {**getattr(self, name), **update[name]}
        return self.model_copy(update=update)


SETTINGS = tuple(name for name in Reading.model_fields if name not in ("columns", "units"))
"""What --columns may say beside columns."""


def reading_of(given: str | Mapping[str, Any] | Reading | None) -> Reading:
    """What is typed after --columns, "time=JD_UTC,mag=V,time_scale=tdb", or the same as a mapping."""
    if given is None:
        return Reading()
    if isinstance(given, Reading):
        return given
    if not isinstance(given, (str, Mapping)):
        raise InputError(None, option("columns"), type(given).__name__, "a text or a mapping of names")
    pairs = _pairs(given) if isinstance(given, str) else dict(given)
    table: dict[str, Any] = {key: value for key, value in pairs.items() if key in Reading.model_fields}
    columns = {
        OBJECTS.get(key, key): str(value) for key, value in pairs.items() if key not in Reading.model_fields
    }
    if "exptime" in table and not _is_number(table["exptime"]):
        columns["exptime"] = str(table.pop("exptime"))
    for name in ("exptime", "longest_gap"):
        if _is_number(table.get(name)):
            table[name] = decimal(str(table[name]))
    if isinstance(table.get("direction"), str):
        parts = table["direction"].replace(",", " ").split()
        table["direction"] = [decimal(part) if _is_number(part) else part for part in parts]
    if columns:
        table["columns"] = {**table.get("columns", {}), **columns}
    try:
        return Reading.model_validate(table)
    except ValidationError as error:
        raise of_validation(option("columns"), error) from None


def _pairs(text: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for item in ITEM.findall(text):
        name, equals, value = (part.strip().strip('"').strip() for part in item.partition("="))
        if not (name and equals and value):
            raise InputError(None, option("columns"), repr(item[:60]), "name=column, as in time=JD_UTC,mag=V")
        if name in pairs:
            raise InputError(None, option("columns"), f"{name} twice", "each name once")
        pairs[name] = value
    return pairs


def _is_number(value: Any) -> bool:
    try:
        decimal(str(value))
    except (TypeError, ValueError):
        return False
    return True
