"""What a recording says about itself before its rows, what the user adds, and which of its columns a scene needs."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np

from torchlc.errors import InputError
from torchlc.readers.dates import ORDERS, Calendar, is_moment, moment_of
from torchlc.readers.roles import ROLES, VECTORS, stamp_of
from torchlc.readers.table import METADATA, Header, first_row
from torchlc.scene.reading import LESS_A_DATE, SINCE, TIME_FORMATS, Reading, is_time_format
from torchlc.scene.timestamps import (
    ISO,
    JULIAN_DATE,
    MJD_ZERO,
    REDUCED,
    REDUCED_ZERO,
    UnreadableTime,
    instant,
)
from torchlc.suggest import did_you_mean

if TYPE_CHECKING:
    from torchlc.scene import Scene

UNITS = {
    "mag": u.mag,
    "mag_err": u.mag,
    "limiting_mag": u.mag,
    "exptime": u.s,
    "alt": u.deg,
    "az": u.deg,
    "height": u.km,
}
UNITS |= {f"{prefix}_{axis}": u.km for prefix in ("sun", "obs", "r") for axis in "xyz"}
UNITS |= {f"v_{axis}": u.km / u.s for axis in "xyz"}
EQUATORIAL = re.compile(r"(icrs|icrf|gcrs|gcrf|eme ?2000|j2000|fk5|equatorial)\b")
DAY_S = 86400.0
COUNTS = {
    "jd": ((0.0, 0.0), 1.0),
    "mjd": ((MJD_ZERO, 0.0), 1.0),
    "jd-2400000": ((REDUCED_ZERO, 0.0), 1.0),
    "unix": ((2440587.5, 0.0), DAY_S),
    "unix-ms": ((2440587.5, 0.0), 1000.0 * DAY_S),
    "gps": ((2444244.5, 19.0 / DAY_S), DAY_S),
}
"""Two-part Julian date from which the numbers of a time format count, and how many there are in a day. The clock of GPS
began on 6 January 1980 and stays 19 s behind TAI."""
UNITS_A_DAY = {"seconds": DAY_S, "minutes": 1440.0, "hours": 24.0, "days": 1.0}
OWN_SCALES = {"unix": "utc", "unix-ms": "utc", "gps": "tai"}
"""Time scales of formats that have one of their own."""
SCALES = {"utc": "utc", "ut": "utc", "tai": "tai", "tt": "tt", "tdt": "tt", "tdb": "tdb"}
"""Time scales that can be used, as people name them."""
ON_A_CLOCK = re.compile(
    r"(?<![A-Za-z])(UTC|UT1?|TAI|TT|TDT|TDB|TCB|TCG|GPST?|LM?ST|GMST|utc|tai|tdb|gps)(?![A-Za-z])"
)
NAMES_OF_SCALES = {
    "tt": r"terrestrial([ _-]dynamical)?[ _-]time",
    "tdb": r"barycentric[ _-]dynamical[ _-]time|ephemeris[ _-]time",
    "tai": r"(international[ _-])?atomic[ _-]time",
    "tcb": r"barycentric[ _-]coordinate[ _-]time",
    "tcg": r"geocentric[ _-]coordinate[ _-]time",
    "utc": r"(coordinated[ _-])?universal[ _-]time",
}
"""Time scales whose names are written out. The ephemeris time of planetary ephemerides is TDB (Standish 1998)."""
AT_THE_SUN = re.compile(
    r"(?<![A-Za-z])(HJD|BJD|HMJD|BMJD|heliocent\w*|barycent\w*(?![ _-](dynamical|coordinate)))(?![A-Za-z])",
    re.IGNORECASE,
)
_EXPOSED = r"(expos\w*|integration|frame|shutter|obs|observation)"
_CLOCK = r"(t|times?|dates?|m?jd|utc?)"
_OPENS, _CLOSES = r"(start\w*|begin\w*|open\w*)", r"(end\w*|stop\w*|finish\w*|clos\w*)"
MARKS = {
    mark: re.compile(
        rf"\b{word}\b[^.;]{{0,30}}\b{_EXPOSED}|\b{_EXPOSED}[ _-]?{word}\b"
        rf"|^({_CLOCK}[ _-]*((of|at)[ _-]*)?)?{word}([ _-]{_CLOCK})?$",
        re.I,
    )
    for mark, word in (("start", _OPENS), ("end", _CLOSES))
}
"""How people say that a time stamp is not the middle of its exposure."""
MIDDLE = re.compile(r"\b(mid\w*|centre|center|central)", re.IGNORECASE)
ABOUT_TIME = re.compile(r"time|date|jd|stamp|expos|trefpos", re.IGNORECASE)
"""Keys of metadata that may say what the time stamps are."""
OF_ANOTHER_CLOCK = re.compile(
    r"\b(?i:local(time)?|civil ?time)\b|^LT$|\+ LT$"
    r"|\b(CES?T|WES?T|EES?T|[ECMP][SD]T|BST|MSK|JST|KST|AE[SD]T)\b"
    r"|\b(UTC?|GMT)\s*[+-]\s*(0?[1-9]|1[0-4])(:?[0-5]\d)?(?![\d.])"
)
"""Local time, by a word, the name of a zone or an offset from UTC."""
PLACE_OF_CLOCK = ("timeref", "trefpos", "treferen")
"""Keywords of FITS whose LOCAL is the place of the observer, not a civil time."""
LIKE_TIME = re.compile(r"time|date|jd|utc?\b|stamp|epoch|zeit|^t([ _(\[]|$)|second", re.IGNORECASE)
LIKE_MAG = re.compile(r"(?<![a-z])mag|mag(?![a-z])|^[A-Z0-9]{1,3}-[A-Z0-9]{1,3}$|bright|hell", re.IGNORECASE)
LIKE_FLUX = re.compile(r"flu[xs]|counts?|adu|intensity|sum", re.IGNORECASE)
NO_BRIGHTNESS = re.compile(
    r"err|unc|sig|rms|std|snr|s/n|lim|air ?mass|zero|zp|\bid\b|name|(^|[ _-])(x|y|ra|dec)(cent\w+)?$",
    re.IGNORECASE,
)
"""What the names of columns have in common that may hold times or brightness, or do not; for offers only."""
JULIAN_DATES = (2_400_000.0, 2_500_000.0)
FALSE_FRIENDS = (
    "exptime",
    *(f"{p}_{axis}" for p in VECTORS.values() for axis in "xyz"),
    *UNITS,
    "flux",
    "flux_err",
)
"""Columns of ours, never offered for another one that is missing."""


def count_of(time_format: str, scale: str) -> tuple[tuple[float, float], float]:
    """Two-part Julian date from which the numbers of ``time_format`` count, and how many there are in a day."""
    if since := SINCE.fullmatch(time_format):
        start: Any = instant(since[2], scale)
        return (float(start.jd1), float(start.jd2)), UNITS_A_DAY[since[1]]
    return COUNTS.get(time_format) or ((float(time_format.removeprefix("jd-")), 0.0), 1.0)


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


def missing(header: Header, name: str, expected: str) -> InputError:
    """The error of a column that is not there, with the nearest one that is."""
    others = [other for other in header.names if other and other not in FALSE_FRIENDS]
    hint = did_you_mean(name, others)
    if len(header.names) == 1 and header.rows is None:
        hint = "The header holds one name only: is the delimiter a comma?"
    elif name in ("time", "mag", "flux"):
        offered = _offered(name, header)
        if name == "time" and "time" not in offered:
            hint = "None of them looks like times: add a column time, or say which it is: --columns time=NAME"
        elif offered:
            said = shlex.quote(",".join(f"{role}={_quoted(other)}" for role, other in offered.items()))
            hint = f"{hint or ''} Say which column is what, as in --columns {said}".strip()
    listed = ", ".join(other for other in header.names if other)
    return InputError(header.source, "header", f"no column {name} among {listed}"[:200], expected, hint)


def _offered(name: str, header: Header) -> dict[str, str]:
    """Our columns beside those of the file that look like them; empty for a role that none can have."""
    cells = first_row(header)
    left = {
        other: cells[place] if place < len(cells) else ""
        for place, other in enumerate(header.names)
        if other and other not in FALSE_FRIENDS and other not in ROLES
    }
    offered: dict[str, str] = {}
    if "time" not in header.names:
        called = [other for other in left if LIKE_TIME.search(other)]
        dated = [other for other, cell in left.items() if _is_instant(cell)]
        for chosen in [*(one for one in dated if one in called), *dated, *called][:1]:
            offered["time"] = chosen
            del left[chosen]
    if "mag" in header.names or "flux" in header.names:
        return offered
    measured = [other for other in left if not NO_BRIGHTNESS.search(other)]
    for role, like in (("mag", LIKE_MAG), ("flux", LIKE_FLUX)):
        for chosen in [other for other in measured if like.search(other) and name in ("time", "mag", role)][
            :1
        ]:
            return offered | {role: chosen}
    fractions = [
        other for other in measured if re.fullmatch(r"\s*[<>]?[+-]?\d*[.,]\d+([eE][+-]?\d+)?\s*", left[other])
    ]
    return offered | ({"flux" if name == "flux" else "mag": fractions[0]} if fractions else {})


def _is_instant(cell: str) -> bool:
    """Does a cell hold an instant, or a Julian date in one of its forms?"""
    if is_moment(cell):
        return True
    if not JULIAN_DATE.fullmatch(cell):
        return False
    try:
        number = float(cell)
    except ValueError:
        return False
    return "." in cell and (REDUCED[0] < number < REDUCED[1] or JULIAN_DATES[0] < number < JULIAN_DATES[1])


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name


def ways_to_say(header: Header, key: str, value: str) -> str:
    """Where a user says what a file does not."""
    place = "in the metadata" if header.ecsv else "in a line above the header that begins with #"
    return f"{key}: {value} {place}, or --columns {key}={value}"


def brightness(header: Header, use: str | None) -> str:
    """ "mag" or "flux": ``use``, else what is there, mag first."""
    if use not in (None, "mag", "flux"):
        raise InputError(None, "--use", repr(use), "mag or flux")
    for name in ("time", use or "time"):
        if name not in header.names:
            raise missing(header, name, f"a column {name}")
    if use is not None:
        return use
    if "mag" not in header.names and "flux" not in header.names:
        raise missing(header, "mag", "a column mag or flux")
    return "mag" if "mag" in header.names else "flux"


def timing(header: Header, reading: Reading, *, located: bool = False) -> Timing:
    """What the user, the name and the description of ``time`` and the metadata say of the time stamps; InputError
    where they cannot be brought to the middle of the exposure in UTC or TDB, or contradict each other.

    ``located``: the direction of the object is known, so that a reduction to the Sun can be taken back.
    """
    stamp = stamp_of(header)
    form = reading.time_format or _time_format(header) or stamp.format
    given = reading.time_scale or header.meta.get("time_scale")
    if form in OWN_SCALES:
        if given and SCALES.get(str(given).strip().lower()) != OWN_SCALES[form]:
            expected = f"{OWN_SCALES[form]}, in which times of that format are"
            raise InputError(
                header.source, "time_scale", f"{str(given)[:40]!r} beside the time format {form}", expected
            )
        given = OWN_SCALES[form]
    scale = str(given or stamp.scale or "utc").strip().lower()
    if scale not in SCALES:
        hint = (
            "A local time needs its zone: time_zone in [recording] of the scene."
            if "local" in scale
            else None
        )
        raise InputError(header.source, "metadata time_scale", repr(scale[:40]), "utc, tdb, tai or tt", hint)
    scale, mark, notes = SCALES[scale], reading.time_mark or stamp.mark or "mid", list(header.notes)
    known_scale = scale if given or stamp.scale else None
    light_path = stamp.light_path
    for place, text in _statements(header, reading):
        if AT_THE_SUN.search(text):
            light_path = light_path or (
                "barycentric" if re.search(r"b.?jd|bary", text, re.I) else "heliocentric"
            )
        stated = (
            scale
            if reading.time_scale or form in OWN_SCALES
            else _stated_scale(header, reading, place, text, known_scale)
        )
        if stated not in (None, scale):
            scale = stated
            notes.append(f"{place} says {text[:60]!r}: the times are taken as {stated.upper()}")
        for name, pattern in MARKS.items():
            if reading.time_mark is not None or not pattern.search(text):
                continue
            if MIDDLE.search(text):
                notes.append(f"{place} says {text[:60]!r}: the times are taken as mid-exposure")
            else:
                mark = name
                notes.append(f"{place} says {text[:60]!r}: half of exptime is {_moved(name)} every time")
    light_path = _light_path(header, reading, light_path, located)
    notes += [
        f"a comment says {text[:60]!r}: the times are taken as mid-exposure in {scale.upper()}"
        for text in _remarks(header)
        if any(one.search(text) for one in (AT_THE_SUN, *MARKS.values(), OF_ANOTHER_CLOCK))
        and not (reading.time_zone or reading.time_mark or reading.light_path)
    ]
    mark = "mid" if mark == "middle" else mark
    if mark != "mid" and "exptime" not in header.names and reading.exptime is None:
        raise InputError(
            header.source,
            "column time",
            f"the {mark} of the exposures",
            "mid-exposure",
            "Add a column exptime (s), by half of which the times are moved, or say --columns exptime=SECONDS; or "
            "--columns time_mark=middle if they are times of mid-exposure",
        )
    if mark != "mid" and not any("half of exptime" in note for note in notes):
        notes.append(
            f"times are those of the {mark} of exposures: half of exptime is {_moved(mark)} every time"
        )
    if reading.time_zone and scale != "utc":
        raise InputError(
            header.source, "time_zone", f"beside the time scale {scale}", "UTC with a zone, or a scale"
        )
    if reading.time_zone:
        notes.append(f"the times are civil time of the zone {reading.time_zone}, and converted to UTC")
    return Timing(scale, form, mark, tuple(notes), reading.time_zone, light_path)


def _light_path(header: Header, reading: Reading, stated: str, located: bool) -> str:
    """To where the way of light was reduced; InputError where that cannot be taken back."""
    path = stated if reading.light_path is None else reading.light_path
    path = "" if path == "observer" else path
    if path and not located:
        name = header.theirs.get("time", "time")
        said = next((text for _, text in _statements(header, reading) if AT_THE_SUN.search(text)), name)
        raise InputError(
            header.source,
            "column time",
            f"{said[:60]!r}",
            "times at the observer",
            f"Give UTC at the telescope: these are {path} times, and the way of light, up to 8.3 minutes, was taken off. "
            "For an asteroid it can be put back: say its direction (ICRS right ascension and declination, deg), as in "
            '--columns direction="120.5 -3.2"',
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
        if key.lower() in ("tz", "timezone", "time_zone"):
            plainly_utc = r"(utc|ut|gmt|z|etc/utc)?([+-]?0?0(:?00)?)?"
            if reading.time_zone is None and not re.fullmatch(plainly_utc, value.strip(), re.IGNORECASE):
                hint = (
                    f"Convert it first, or say --columns time_zone={value.strip()[:40]} if that is what it is"
                )
                raise InputError(header.source, f"metadata {key}", repr(value[:40]), "UTC", hint)
        elif ABOUT_TIME.search(key):
            statements.append((f"metadata {key}", value))
    return [(place, text) for place, text in statements if text.strip()]


def _remarks(header: Header) -> list[str]:
    """Comment lines, of a CSV or kept by astropy, that speak of time."""
    kept = header.meta.get("comments", [])
    lines = [*header.comments, *(kept if isinstance(kept, list) else [kept])]
    return [
        str(line) for line in lines if re.search(r"time|date|jd|utc|expos|stamp", str(line), re.IGNORECASE)
    ]


def _has_offset(header: Header) -> bool:
    """Does the first time say its own offset from UTC, as in 2020-10-17T17:00:00+02:00?"""
    cells, places = first_row(header), header.places("time")
    if max(places) >= len(cells):
        return False
    text = moment_of([cells[place] for place in places])
    try:
        match = ISO.fullmatch(Calendar(ORDERS[0]).iso([text])[0])
    except UnreadableTime:
        return False
    return match is not None and match["offset"] is not None


def _stated_scale(header: Header, reading: Reading, place: str, text: str, given: str | None) -> str | None:
    """The time scale that a statement names, None where it names none; ``given`` is that of time_scale."""
    if OF_ANOTHER_CLOCK.search(text) and not place.lower().endswith(PLACE_OF_CLOCK):
        if reading.time_zone is not None or _has_offset(header):
            return None
        hint = (
            "Convert it first, or say its zone, as in --columns time_zone=+02:00 or time_zone=Europe/Vienna"
        )
        raise InputError(header.source, place, f"{text[:60]!r}: local time", "UTC", hint)
    named = {name.lower() for name in ON_A_CLOCK.findall(text)}
    named |= {scale for scale, words in NAMES_OF_SCALES.items() if re.search(rf"\b({words})\b", text, re.I)}
    if "utc" in named or (given is not None and not re.search(r"gps[ _-]?time", text, re.IGNORECASE)):
        named -= {"gps"}  # what keeps the clock, beside a scale that is told
    known = {SCALES[name] for name in named if name in SCALES}
    if given is not None and (not named or given in known):
        return given
    if len(known) == 1 and len(named) == 1 and given is None:
        return known.pop()
    if not named:
        return None
    said = f"{text[:60]!r}" + (f", but time_scale is {given}" if given else "")
    hint = (
        f"Convert the times to UTC, or say {ways_to_say(header, 'time_scale', 'utc')} (utc, tdb, tai or tt)"
    )
    raise InputError(header.source, place, said, "one time scale: UTC, TDB, TAI or TT", hint)


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


def frame(header: Header, scene: Scene | None) -> str | None:
    """Frame of the vectors, "icrs" or "ecliptic"; None where none are read."""
    expected = None if scene is None else scene.orbit.vectors
    if scene is not None and expected is None:
        return None
    said = str(header.meta.get("frame", "")).strip().lower()
    if not said or not any(f"{prefix}_x" in header.names for prefix in VECTORS.values()):
        return expected or "icrs"
    found = "ecliptic" if said.startswith("ecliptic") else "icrs" if EQUATORIAL.match(said) else None
    if found is None:
        raise InputError(header.source, "metadata frame", repr(said[:40]), "icrs or ecliptic")
    if expected and found != expected:
        contradiction = f"{found}, but the scene says vectors = {expected!r}"
        raise InputError(header.source, "metadata frame", contradiction, "the same frame in both")
    return found


def light_time_corrected(header: Header) -> bool:
    """True if the times are those at the object."""
    said = str(header.meta.get("light_time_corrected", False)).strip().lower()
    if said not in ("true", "false"):
        raise InputError(header.source, "metadata light_time_corrected", repr(said[:40]), "true or false")
    return said == "true"


def numeric_columns(header: Header, scene: Scene | None, kind: str) -> tuple[list[str], list[list[str]]]:
    """Columns of numbers to read: those that are needed, and groups that may be blank altogether."""
    groups: dict[str, list[str]] = {name: [f"{p}_{axis}" for axis in "xyz"] for name, p in VECTORS.items()}
    groups["alt-az"] = ["alt", "az", "height"]
    reasons = _reasons(scene)
    beside = (f"{kind}_err", "exptime", *(("limiting_mag",) if kind == "mag" else ()))
    needed, optional = [kind], [[name] for name in beside if name in header.names]
    for group, names in groups.items():
        present = [name for name in names if name in header.names]
        if group in reasons:
            if len(present) < len(names):
                name = next(name for name in names if name not in present)
                raise missing(header, name, f"columns {', '.join(names)}: the scene has {reasons[group]}")
            needed += names
        elif len(present) == len(names) and _may_use(scene, group):
            optional.append(names)
    return needed, optional


def _reasons(scene: Scene | None) -> dict[str, str]:
    """Groups of columns that the scene cannot do without, each with the key that wants it."""
    if scene is None:
        return {}
    mode = scene.attitude.mode
    if scene.orbit.altaz:
        if mode == "nadir":
            found, expected = (
                "nadir needs a velocity, which alt-az rows lack",
                'a mode such as "yaw-steering"',
            )
            raise InputError(scene.source, "attitude.mode", found, expected)
        return {"alt-az": "altaz = true"}
    if scene.orbit.vectors is None:
        return {}
    vectors = f'vectors = "{scene.orbit.vectors}"'
    reasons = {"sun": vectors, "obs": vectors}
    if mode in ("nadir", "yaw-steering"):
        reasons["position"] = f'attitude mode = "{mode}"'
    if mode == "nadir":
        reasons["velocity"] = f'attitude mode = "{mode}"'
    return reasons


def _may_use(scene: Scene | None, group: str) -> bool:
    return scene is None or (scene.orbit.vectors is not None and group in VECTORS)


def converted(header: Header, name: str, values: np.ndarray) -> np.ndarray:
    """``values`` in our unit; a ``flux_err`` comes to the unit of ``flux``."""
    text = header.units.get(name)
    if name == "flux":
        _refuse_logarithms(header, text)
        return values
    target = header.units.get("flux", "") if name == "flux_err" else UNITS.get(name)
    if not text or text == target or target is None:
        return values
    try:
        unit = u.Unit(text[:60])
        if getattr(unit, "function_unit", None) == u.mag and target == u.mag:
            return values
        if name == "flux_err" and not target and unit != u.dimensionless_unscaled:
            raise u.UnitsError("a share, or a unit that flux does not have")
        factor = unit.to(u.Unit(target))
    except (ValueError, TypeError, OverflowError, u.UnitsError):
        place = f"column {name}"
        expected = f"a unit like {target}" if target else "that of flux, which has none"
        hint = "Give flux and flux_err in one unit, and a relative error times its flux"
        raise InputError(
            header.source, place, f"unit {text[:60]}", expected, hint if name == "flux_err" else None
        ) from None
    return values if factor == 1.0 else values * factor


def _refuse_logarithms(header: Header, text: str | None) -> None:
    """A column flux in magnitudes or dex is none; units that astropy does not know are the file's own."""
    try:
        unit = u.Unit((text or "")[:60])
    except (ValueError, TypeError, OverflowError):
        return
    if hasattr(unit, "function_unit") or any(unit == one for one in (u.mag, u.dex, u.dB)):
        hint = "Name the columns mag and mag_err if they are magnitudes"
        raise InputError(header.source, "column flux", f"unit {text}", "a linear unit", hint)


NOT_APPARENT = re.compile(
    r"\b(instrumental|differential|relative|reduced|normali[sz]ed|detrended|absolute|unit distances?|delta[ _-]?mag\w*)\b",
    re.IGNORECASE,
)
"""How people say that a magnitude is not apparent, or not calibrated."""


DIFFERENCE = re.compile(
    r"^[A-Z]\w{0,2}[ _]?-[ _]?[A-Z]\w{0,2}$|(^|[ _])(d|diff|delta|inst|instr|instrumental|differential)[ _]?mag",
    re.I,
)
"""Names of columns of such magnitudes: V-C, O-C, T1-C1, diff_mag, instr_mag."""


def magnitudes_told(header: Header, kind: str) -> list[str]:
    """What has to be said where the description of magnitudes speaks of others than apparent ones."""
    described, name = header.descriptions.get("mag", ""), header.theirs.get("mag", "")
    if kind != "mag" or not (NOT_APPARENT.search(described) or DIFFERENCE.search(name)):
        return []
    said = (
        f"the description of mag says {described[:60]!r}"
        if NOT_APPARENT.search(described)
        else f"the column of mag is called {name[:60]!r}"
    )
    return [
        f"{said}: torchlc takes apparent magnitudes, corrected for extinction. "
        "Give relative fluxes in a column flux, or a free zero_point, if they are others"
    ]


def units_told(header: Header, kind: str) -> list[str]:
    """What has to be said of units that the file leaves open."""
    unit = header.units.get("flux")
    if kind == "flux" and unit and "flux_err" in header.names and not header.units.get("flux_err"):
        return [f"flux_err has no unit and is taken in that of flux, {unit[:40]}"]
    return []


FORMAT_WORDS = {
    "jd": "Julian date",
    "mjd": "modified Julian date, JD - 2400000.5",
    "iso": "ISO",
    "unix": "seconds since 1970",
    "unix-ms": "milliseconds since 1970",
    "gps": "seconds of GPS",
}
MARK_WORDS = {"mid": "mid-exposure", "start": "start of exposure", "end": "end of exposure"}


def taken(
    header: Header, reading: Reading, columns: Iterable[str], timing: Timing, time_format: str
) -> list[str]:
    """One line on what was taken for what; none where a file has our own names and nothing else is to be said."""
    roles = dict.fromkeys(
        "time" if name == "time" else name
        for name in columns
        if name in header.theirs and name in header.columns
    )
    renamed = any(header.theirs[name] != name for name in roles)
    if not renamed and not header.format and header.decimal == "." and not reading.model_fields_set:
        return []
    told = []
    triples = {f"{p}_x": [f"{p}_{axis}" for axis in "xyz"] for p in VECTORS.values()}
    beside = {name for names in triples.values() for name in names[1:]}
    for name in roles:
        if name in beside:
            continue
        names = [one for one in triples.get(name, [name]) if one in roles]
        text = f"{', '.join(header.theirs[one] for one in names)} as {', '.join(names)}"
        if name == "time":
            scale = "civil time" if timing.zone else timing.scale.upper()
            form = FORMAT_WORDS.get(time_format) or LESS_A_DATE.sub(r"JD - \1", time_format)
            moment = timing.light_path or MARK_WORDS[timing.mark]
            if light_time_corrected(header):
                moment += ", corrected for light time"
            text += f" ({form}, {scale}, {moment})"
        told.append(text)
    form = f"read as {header.format}: " if header.format else "columns: "
    comma = "; decimal commas" if header.decimal == "," else ""
    return [form + ", ".join(told) + comma]
