"""What the time stamps of a file are: by what the user, the names, the descriptions and the metadata say of them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import astropy.units as u

from torchlc.errors import InputError, option
from torchlc.readers.comments import key_and_value
from torchlc.readers.dates import ORDERS, Calendar, is_moment, moment_of
from torchlc.readers.roles import stamp_named, stamp_of, without_brackets
from torchlc.readers.table import METADATA, Header, first_row
from torchlc.scene.reading import SINCE, TIME_FORMATS, Reading, is_time_format, is_zone
from torchlc.scene.timestamps import ISO, MJD_ZERO, REDUCED_ZERO, UnreadableTime, instant

DAY_S = 86400.0
COUNTS = {
    "jd": ((0.0, 0.0), 1.0),
    "mjd": ((MJD_ZERO, 0.0), 1.0),
    "jd-2400000": ((REDUCED_ZERO, 0.0), 1.0),
    "unix": ((2440587.5, 0.0), DAY_S),
    "unix-ms": ((2440587.5, 0.0), 1000.0 * DAY_S),
    "gps": ((2444244.5, 0.0), DAY_S),
}
"""Two-part Julian date from which the numbers of a time format count, and how many there are in a day. The clock of GPS
began on 6 January 1980."""
UNITS_A_DAY = {"seconds": DAY_S, "minutes": 1440.0, "hours": 24.0, "days": 1.0}
OWN_SCALES = {"unix": "utc", "unix-ms": "utc", "gps": "gps"}
"""Time scales of formats that have one of their own."""
SCALES = {
    "utc": "utc",
    "ut": "utc",
    "tai": "tai",
    "tt": "tt",
    "tdt": "tt",
    "tdb": "tdb",
    "gps": "gps",
    "gpst": "gps",
}
"""Time scales that can be used, as people name them."""
ON_A_CLOCK = re.compile(
    r"(?<![A-Za-z])(UTC|UT1?|TAI|TT|TDT|TDB|TCB|TCG|GPST?|LM?ST|GMST)(?![A-Za-z])", re.IGNORECASE
)
KEEPS_A_CLOCK = "gps"
"""By this name people mean a clock of its own, or what sets one that shows UTC, 18 s behind it since 2017."""
NAMES_OF_SCALES = {
    "tt": r"terrestrial([ _-]dynamical)?[ _-]time",
    "tdb": r"barycentric[ _-]dynamical[ _-]time|ephemeris[ _-]time",
    "tai": r"(international[ _-])?atomic[ _-]time",
    "tcb": r"barycentric[ _-]coordinate[ _-]time",
    "tcg": r"geocentric[ _-]coordinate[ _-]time",
    "utc": r"(coordinated[ _-])?universal[ _-]time",
}
"""Time scales whose names are written out. The ephemeris time of planetary ephemerides is TDB (Standish 1998)."""
BARYCENTRE = re.compile(r"b.?jd|bary", re.IGNORECASE)
AT_THE_SUN = re.compile(
    r"(?<![A-Za-z])(HJD|BJD|HMJD|BMJD|heliocent\w*|barycent\w*(?![ _-](dynamical|coordinate)))(?![A-Za-z])",
    re.IGNORECASE,
)
_EXPOSED = r"(expos\w*|integration|frame|shutter|obs|observation)"
_CLOCK = r"(t|times?|dates?|m?jd|utc?)"
_OPENS, _CLOSES = r"(start\w*|begin\w*|open\w*)", r"(end\w*|stop\w*|finish\w*|clos\w*)"
MARKS = {
    mark: re.compile(
        rf"\b{word}\b[^.;]{{0,30}}\b{_EXPOSED}|\b{_EXPOSED}([ _-]?| (is|are|marks|gives) (the )?){word}\b"
        rf"|^({_CLOCK}[ _-]*((of|at)[ _-]*)?)?{word}([ _-]{_CLOCK})?$",
        re.I,
    )
    for mark, word in (("start", _OPENS), ("end", _CLOSES))
}
"""How people say that a time stamp is not the middle of its exposure."""
MIDDLE = re.compile(r"\b(mid\w*|centre|center|central)", re.IGNORECASE)
ABOUT_TIME = re.compile(r"time|date|jd|stamp|expos|trefpos|zeit|heure|\bhora\b", re.IGNORECASE)
"""Keys of metadata that may say what the time stamps are."""
KEEPER = re.compile(r"source|sync|receiver|server", re.IGNORECASE)
"""Keys of metadata that say what keeps the clock, not what it shows: a receiver of GPS mostly gives UTC."""
OF_ANOTHER_CLOCK = re.compile(
    r"\b(?i:local(time)?|civil ?time|ortszeit|sommerzeit|winterzeit|heure (locale|d'(hiver|[eé]t[eé]))|hora local|ora locale)\b"
    r"|^LT$|\+ LT$"
    r"|\b(CES?T|WES?T|EES?T|MES?Z|[ECMPH][SD]T|AK[SD]T|BST|MSK|IST|SAST|SGT|PKT|HKT|BRT|JST|KST|A[ECW][SD]T|NZ[SD]?T)\b"
    r"|\b(Africa|America|Antarctica|Arctic|Asia|Atlantic|Australia|Europe|Indian|Pacific)/[A-Z]\w+"
    r"|\b(UTC?|GMT)\s*[+-]\s*(0?[1-9]|1[0-4])(:?[0-5]\d)?(?![\d.])"
)
"""Local time, by a word, the name of a zone or an offset from UTC."""
IN_BRACKETS = re.compile(
    r"utc?|z|tai|tt|tdt|tdb|gps|unix|posix|m?jd|julian|iso[tc]?|fits|ecsv|date|datum|time|zeit|stamp|clock|decimal|gregorian"
    r"|[ymdhstfz]+|sec(ond)?s?|minutes?|hours?|days?|since|epoch|of|the|at|in|and|or|from|to|am|pm"
    r"|mid\w*|cent\w+|start\w*|begin\w*|open\w*|end\w*|stop\w*|clos\w*|shutter|expos\w*|obs|observation|frame|integration"
    r"|helio\w*|bary\w*|dynamical|coordinated?|universal|terrestrial|atomic|international|observer|telescope|observatory",
    re.IGNORECASE,
)
"""Words behind the name of times that say nothing of a zone: scales, formats as YYYY-MM-DD hh:mm:ss, units, and marks of the exposure."""
SPEAKS_OF_TIME = re.compile(
    r"time|date|jd|expos|stamp|clock|shutter|utc|\bUT\b|\bGMT\b|zeit|uhr|heure|hora\b|\bora\b|tiempo|temps|helioc|baryc",
    re.IGNORECASE,
)
"""What a comment about the times holds."""
PLACE_OF_CLOCK = ("timeref", "trefpos", "treferen")
"""Keywords of FITS whose LOCAL is the place of the observer, not a civil time."""
MARK_WORDS = {"mid": "mid-exposure", "start": "start of exposure", "end": "end of exposure"}
FORMAT_WORDS = {
    "jd": "Julian date",
    "mjd": "modified Julian date, JD - 2400000.5",
    "iso": "ISO",
    "unix": "seconds since 1970",
    "unix-ms": "milliseconds since 1970",
    "gps": "seconds of GPS",
}


@dataclass(frozen=True)
class Timing:
    """What the time stamps of a file are: their ``scale`` (utc, tai, tt, tdb), their ``format`` (one of
    TIME_FORMATS, or "" where the cells decide), the ``mark`` of the exposure (start, mid, end), the ``zone`` of a
    civil time, and to where the way of light was reduced (``light_path``: heliocentric, barycentric or empty); and
    what has to be said of them.
    """

    scale: str
    format: str
    mark: str
    notes: tuple[str, ...]
    zone: str | None = None
    light_path: str = ""


def count_of(time_format: str, scale: str) -> tuple[tuple[float, float], float]:
    """Two-part Julian date from which the numbers of ``time_format`` count, and how many there are in a day."""
    if since := SINCE.fullmatch(time_format):
        start: Any = instant(since[2], scale)
        return (float(start.jd1), float(start.jd2)), UNITS_A_DAY[since[1]]
    return COUNTS.get(time_format) or ((float(time_format.removeprefix("jd-")), 0.0), 1.0)


def ways_to_say(header: Header, key: str, value: str) -> str:
    """Where a user says what a file does not."""
    where = "in the metadata" if header.ecsv else "in a line above the header that begins with #"
    return f"{key}: {value} {where}, or {option('columns', f'{key}={value}')}"


def _example_of_a_zone() -> str:
    return f"{option('columns', 'time_zone=+02:00')} or time_zone=Europe/Vienna"


def timing(header: Header, reading: Reading, *, located: bool = False) -> Timing:
    """What the user, the name and the description of ``time`` and the metadata say of the time stamps; InputError
    where they cannot be brought to the middle of the exposure in UTC or TDB, or contradict each other.

    ``located``: the direction of the object is known, so that a reduction to the Sun can be taken back.
    """
    stamp = stamp_of(header)
    named = (
        "" if is_moment(_first_time(header)) else stamp.format
    )  # a date under the name of a number is a date
    form = reading.time_format or _time_format(header) or named
    scale, known = _scale(header, reading, form, stamp.scale)
    mark = reading.time_mark or stamp.mark or "mid"
    draft = Timing(scale, form, mark, header.notes, reading.time_zone, stamp.light_path)
    draft = _as_stated(header, reading, draft, scale if known else None)
    _check_brackets(header, reading)
    light_path = _light_path(header, reading, draft.light_path, located)
    mark = "mid" if draft.mark == "middle" else draft.mark
    notes = [*draft.notes, *_notes_of_remarks(header, reading, draft.scale, mark)]
    _check_movable(header, reading, mark)
    if mark != "mid" and not any("half of exptime" in note for note in notes):
        notes.append(
            f"times are those of the {mark} of exposures: half of exptime is {_moved(mark)} every time"
        )
    if reading.time_zone and draft.scale != "utc":
        raise InputError(
            header.source, "time_zone", f"beside the time scale {draft.scale}", "UTC with a zone, or a scale"
        )
    if reading.time_zone:
        notes.append(f"the times are civil time of the zone {reading.time_zone}, and converted to UTC")
    return replace(draft, mark=mark, notes=tuple(notes), light_path=light_path)


def _scale(header: Header, reading: Reading, form: str, stamped: str | None) -> tuple[str, bool]:
    """The time scale by the user's word, ``time_scale``, the format or the column's name, else UTC; and whether one of them says it.
    InputError where it is none that can be used, or not that of the format."""
    given = reading.time_scale or header.meta.get("time_scale")
    if form in OWN_SCALES:
        if given and SCALES.get(str(given).strip().lower()) != OWN_SCALES[form]:
            expected = f"{OWN_SCALES[form]}, in which times of that format are"
            raise InputError(
                header.source, "time_scale", f"{str(given)[:40]!r} beside the time format {form}", expected
            )
        given = OWN_SCALES[form]
    scale = str(given or stamped or "utc").strip().lower()
    if scale not in SCALES:
        hint = (
            "A local time needs its zone: time_zone in [recording] of the scene."
            if "local" in scale
            else None
        )
        raise InputError(
            header.source, "metadata time_scale", repr(scale[:40]), "utc, tdb, tai, tt or gps", hint
        )
    return SCALES[scale], bool(given or stamped)


def _as_stated(header: Header, reading: Reading, draft: Timing, given: str | None) -> Timing:
    """The timing after what descriptions and metadata state of scale, mark and way of light; ``given`` is the scale that is told
    elsewhere."""
    scale, mark, light_path, notes = draft.scale, draft.mark, draft.light_path, list(draft.notes)
    settled = reading.time_scale is not None or draft.format in OWN_SCALES
    for place, text in _statements(header, reading):
        said = f"{place} says {text[:60]!r}"
        if AT_THE_SUN.search(text):
            light_path = light_path or ("barycentric" if BARYCENTRE.search(text) else "heliocentric")
        stated = None if settled else _stated_scale(header, reading, place, text, given)
        if stated not in (None, scale):
            scale = stated
            notes.append(f"{said}: the times are taken as {stated.upper()}")
        for name, pattern in MARKS.items():
            if reading.time_mark is not None or not pattern.search(text):
                continue
            if MIDDLE.search(text):
                notes.append(f"{said}: the times are taken as mid-exposure")
            else:
                mark = name
                notes.append(f"{said}: half of exptime is {_moved(name)} every time")
    return replace(draft, scale=scale, mark=mark, light_path=light_path, notes=tuple(notes))


def _notes_of_remarks(header: Header, reading: Reading, scale: str, mark: str) -> list[str]:
    """One for each comment that may say another thing of the times than is taken, with the option that settles it; none
    for what the user says."""
    notes = []
    for text in _remarks(header):
        named = {SCALES.get(name.lower(), "other") for name in ON_A_CLOCK.findall(text)}
        named |= {name for name, words in NAMES_OF_SCALES.items() if re.search(rf"\b({words})\b", text, re.I)}
        settings = {
            "time_zone=+02:00": OF_ANOTHER_CLOCK.search(text) and not _has_offset(header),
            "time_mark=start": any(pattern.search(text) for pattern in MARKS.values()),
            f"light_path={'barycentric' if BARYCENTRE.search(text) else 'heliocentric'}": AT_THE_SUN.search(
                text
            ),
            f"time_scale={next(iter(sorted(named & set(SCALES.values()) - {scale})), 'tai')}": named - {scale}
            and "time_scale" not in header.meta,
        }
        open_ = [
            setting
            for setting, seen in settings.items()
            if seen and getattr(reading, setting.partition("=")[0]) is None
        ]
        if open_:
            notes.append(
                f"a comment says {text[:60]!r}: the times are taken as {MARK_WORDS[mark]} in {scale.upper()}. "
                f"If they are others, say so, as in {option('columns', ','.join(open_))}"
            )
    return notes


def _check_brackets(header: Header, reading: Reading) -> None:
    """InputError where brackets behind the name of the times hold a word that is no scale, format, unit or mark: it may be
    a zone, of which there are more than any list has."""
    if reading.time_zone or reading.time_scale or "time_scale" in header.meta:
        return
    name = header.theirs.get("time", "time")
    for text in (without_brackets(part)[1] for part in name.split(" + ")):
        words = [word for word in re.findall(r"[^\W\d_]+", text) if not IN_BRACKETS.fullmatch(word)]
        if not words or stamp_named(text) or _is_unit_of_time(text) or _has_offset(header):
            continue
        hint = (
            f"Say {option('columns', 'time_scale=utc')} if the times are UTC. If the word is a time zone, say which, "
            f"as in {_example_of_a_zone()}"
        )
        expected = "a time scale, a format or a unit in brackets behind the name of the times"
        raise InputError(header.source, "the column of time", repr(name[:60]), expected, hint)


def _is_unit_of_time(text: str) -> bool:
    try:
        return u.Unit(text[:60]).is_equivalent(u.s)
    except (ValueError, TypeError, OverflowError):
        return False


def _check_movable(header: Header, reading: Reading, mark: str) -> None:
    """InputError where times are not of mid-exposure and no exposure is known by which to move them."""
    if mark == "mid" or "exptime" in header.names or reading.exptime is not None:
        return
    raise InputError(
        header.source,
        "column time",
        f"the {mark} of the exposures",
        "mid-exposure",
        f"Add a column exptime (s), by half of which the times are moved, or say {option('columns', 'exptime=SECONDS')}; or "
        f"{option('columns', 'time_mark=middle')} if they are times of mid-exposure",
    )


def _light_path(header: Header, reading: Reading, stated: str, located: bool) -> str:
    """To where the way of light was reduced; InputError where that cannot be taken back."""
    path = stated if reading.light_path is None else reading.light_path
    path = "" if path == "observer" else path
    if path and not located:
        name = header.theirs.get("time", "time")
        said = next((text for _, text in _statements(header, reading) if AT_THE_SUN.search(text)), name)
        back = (
            "Of an object in orbit about the Earth it cannot be put back: the direction in which it was reckoned is not known"
            if reading.direction is not None
            else "For an asteroid it can be put back: say its direction (ICRS right ascension and declination, deg), as in "
            + option("columns", "direction=120.5 -3.2")
        )
        raise InputError(
            header.source,
            "column time",
            f"{said[:60]!r}",
            "times at the observer",
            f"Give UTC at the telescope: these are {path} times, and the way of light, up to 8.3 minutes, was taken off. {back}",
        )
    return path


def _moved(mark: str) -> str:
    return "added to" if mark == "start" else "taken from"


def _statements(header: Header, reading: Reading) -> list[tuple[str, str]]:
    """Place and text of what the name and description of ``time`` and the metadata say of the time stamps."""
    place = "the description of time" if header.theirs.get("time", "time") == "time" else "the column of time"
    statements = [(place, header.descriptions.get("time", ""))]
    for key, value in header.meta.items():
        if key in METADATA or not isinstance(value, str):
            continue
        if re.sub(r"[ _-]", "", key.lower()) in ("tz", "timezone", "zeitzone"):
            plainly_utc = r"(utc|ut|gmt|z|etc/utc)?([+-]?0?0(:?00)?)?"
            if reading.time_zone is None and not re.fullmatch(plainly_utc, value.strip(), re.IGNORECASE):
                zone = value.strip() if is_zone(value) else "+02:00"
                said, utc = (option("columns", f"time_zone={text}") for text in (zone, "+00:00"))
                hint = f"Say {said} if that is the zone of the times, or {utc} if they are UTC"
                raise InputError(header.source, f"metadata {key}", repr(value[:40]), "UTC", hint)
        elif _is_about_time(key):
            statements.append((f"metadata {key}", value))
    return [(place, text) for place, text in statements if text.strip()]


def _is_about_time(key: str) -> bool:
    """May metadata under this key say what the time stamps are?"""
    return ABOUT_TIME.search(key) is not None and not KEEPER.search(key)


def _remarks(header: Header) -> list[str]:
    """Comment lines, of a CSV or kept by astropy, that may speak of time; of one whose value is judged as metadata the key."""
    kept = header.meta.get("comments", [])
    lines = [*header.comments, *(kept if isinstance(kept, list) else [kept])]
    remarks = []
    for line in map(str, lines):
        pair = key_and_value(line)
        judged = pair is not None and header.meta.get(pair[0]) == pair[1] and _is_about_time(pair[0])
        remarks.append(pair[0] if pair is not None and judged else line)
    return [text for text in remarks if SPEAKS_OF_TIME.search(text)]


def _first_time(header: Header) -> str:
    """The text of the first time; "" where there is none."""
    cells, places = first_row(header), header.places("time")
    return "" if max(places) >= len(cells) else moment_of([cells[column] for column in places])


def _has_offset(header: Header) -> bool:
    """Does the first time say its own offset from UTC, as in 2020-10-17T17:00:00+02:00?"""
    try:
        match = ISO.fullmatch(Calendar(ORDERS[0]).iso([_first_time(header)])[0])
    except UnreadableTime:
        return False
    return match is not None and match["offset"] is not None


def _stated_scale(header: Header, reading: Reading, place: str, text: str, given: str | None) -> str | None:
    """The time scale that a statement names, None where it names none; ``given`` is that of time_scale."""
    if OF_ANOTHER_CLOCK.search(text) and not place.lower().endswith(PLACE_OF_CLOCK):
        if reading.time_zone is not None or _has_offset(header):
            return None
        hint = f"Convert it first, or say its zone, as in {_example_of_a_zone()}"
        raise InputError(header.source, place, f"{text[:60]!r}: local time", "UTC", hint)
    named = {name.lower() for name in ON_A_CLOCK.findall(text)}
    named |= {scale for scale, words in NAMES_OF_SCALES.items() if re.search(rf"\b({words})\b", text, re.I)}
    if (stamp := stamp_named(text)) is not None and stamp.format == KEEPS_A_CLOCK:
        named.add(KEEPS_A_CLOCK)  # as one word: gpstime
    if "utc" in named or (
        given not in (None, KEEPS_A_CLOCK) and not re.search(r"gps[ _-]?time", text, re.IGNORECASE)
    ):
        named -= {KEEPS_A_CLOCK}  # what sets the clock, beside a scale that is told
    known = {SCALES[name] for name in named if name in SCALES}
    if given is not None and (not named or given in known):
        return given
    if len(known) == 1 and len(named) == 1 and given is None and KEEPS_A_CLOCK not in named:
        return known.pop()
    if not named:
        return None
    said = f"{text[:60]!r}" + (f", but time_scale is {given}" if given else "")
    hint = f"Convert the times to UTC, or say {ways_to_say(header, 'time_scale', 'utc')} (utc, tdb, tai, tt or gps)"
    if KEEPS_A_CLOCK in named:
        hint = (
            "Receivers of GPS mostly show UTC; GPS's own clock is 18 s ahead of it. "
            f"Say {option('columns', 'time_scale=utc')}, or time_scale=gps for its own clock"
        )
    raise InputError(header.source, place, said, "one time scale: UTC, TDB, TAI, TT or GPS", hint)


def _time_format(header: Header) -> str:
    text = str(header.meta.get("time_format", "")).strip()
    if not SINCE.fullmatch(text):
        text = text.lower().replace(" ", "").replace("2400000.0", "2400000").replace("isot", "iso")
    if text and not is_time_format(text):
        raise InputError(header.source, "metadata time_format", repr(text[:40]), TIME_FORMATS)
    unit = header.units.get("time", "d").lower()
    if unit not in ("d", "day", "days", "jd", "mjd", "utc"):
        raise InputError(header.source, "column time", f"unit {unit[:40]}", "d, for Julian dates")
    return text or ("mjd" if unit == "mjd" else "")
