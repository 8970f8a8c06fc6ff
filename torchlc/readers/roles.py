"""Which column of a file is what: by the user's word, by our own names, by the format's, by those that people use."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import astropy.units as u

from torchlc.errors import InputError, option
from torchlc.readers.dates import are_apart, is_moment, moment_of
from torchlc.readers.table import Header, first_row, is_as_wide
from torchlc.scene.problems import with_others
from torchlc.scene.reading import SETTINGS, Reading
from torchlc.suggest import did_you_mean

VECTORS = {"sun": "sun", "obs": "obs", "position": "r", "velocity": "v"}
"""Field of a Recording and the prefix of its three columns."""
GEOMETRY = tuple(f"{prefix}_{axis}" for prefix in VECTORS.values() for axis in "xyz")
HORIZONTAL = ("alt", "az", "height")
SITE = ("site_lat", "site_lon", "site_height")
"""Columns of the place of the observer, by which a row's station is known where no column names it."""
BRIGHTNESS = ("mag", "mag_err", "flux", "flux_err")
LABELS = ("station", "band", "curve", "object", "object_number")
"""Columns of names: which of several a row belongs to."""
ROLES = (
    "time",
    *BRIGHTNESS,
    "exptime",
    *LABELS,
    "upper_limit",
    "bad",
    "limiting_mag",
    *GEOMETRY,
    *HORIZONTAL,
    *SITE,
)
"""Columns of ours."""
DELIVERED = "delivered "
"""What a column is called whose name is one of ours, but which the user replaced by another."""


@dataclass(frozen=True)
class Stamp:
    """What the name of a column of times says: the ``format`` of its numbers, the time ``scale``, the ``mark`` of the
    exposure, and to where the way of light was reduced (``light_path``); empty where the name does not say.
    """

    format: str = ""
    scale: str = ""
    mark: str = ""
    light_path: str = ""


_JD, _MJD = Stamp("jd"), Stamp("mjd")
STAMPS: dict[str, Stamp] = {
    "time": Stamp(),
    **dict.fromkeys(("midtime", "timemid", "midexposure", "utcmid", "midutc", "dateobsmid"), Stamp(mark="mid")),
    **dict.fromkeys(("jdmid", "midjd", "jdutcmid", "jdmobs"), Stamp("jd", mark="mid")),
    **dict.fromkeys(("mjdmid", "midmjd", "mjdutcmid"), Stamp("mjd", mark="mid")),
    **dict.fromkeys(("jdutc", "utcjd"), Stamp("jd", "utc")),
    **dict.fromkeys(("jd", "juliandate", "julianday", "juliandateutc", "obsjd", "jdobs"), _JD),
    **dict.fromkeys(("jourjulien", "giornogiuliano", "fechajuliana", "datajuliana", "julianischesdatum"), _JD),
    "jdtdb": Stamp("jd", "tdb"),
    "jdtt": Stamp("jd", "tt"),
    **dict.fromkeys(("mjdutc",), Stamp("mjd", "utc")),
    "mjdtdb": Stamp("mjd", "tdb"),
    "mjdtt": Stamp("mjd", "tt"),
    **dict.fromkeys(("mjd", "obsmjd", "modifiedjuliandate"), _MJD),
    **dict.fromkeys(("rjd", "reducedjd", "jdreduced", "reducedjuliandate"), Stamp("jd-2400000")),
    "btjd": Stamp("jd-2457000", "tdb", light_path="barycentric"),
    "bkjd": Stamp("jd-2454833", "tdb", light_path="barycentric"),
    **dict.fromkeys(("unix", "unixtime", "unixtimestamp", "unixseconds", "unixepoch", "posixtime", "timeunix"), Stamp("unix", "utc")),
    **dict.fromkeys(("unixms", "unixtimems", "unixmilliseconds"), Stamp("unix-ms", "utc")),
    **dict.fromkeys(("gps", "gpstime", "gpsseconds", "timegps"), Stamp("gps")),
    "midpointmjdtai": Stamp("mjd", "tai", mark="mid"),
    "mjdtai": Stamp("mjd", "tai"),
    **dict.fromkeys(
        ("datetime", "datetimeutc", "utc", "utctime", "timeutc", "dateutc", "utcdatetime", "obstime", "observationtime", "obstimeutc", "observationtimeutc"),
        Stamp(),
    ),
    **dict.fromkeys(("timestamp", "timestamputc", "isotime", "obsdate"), Stamp()),
    **dict.fromkeys(("utdate", "utcdate", "dateut", "utdatetime", "datetimeut", "timeut", "uttime", "utctimestamp"), Stamp()),
    **dict.fromkeys(("datumzeit", "datumuhrzeit", "datumzeitut", "datumzeitutc", "dateheure", "dateheureut", "fechahora", "dataora"), Stamp()),
    **dict.fromkeys(("localtime", "timelocal", "civiltime", "datetimelocal", "localdatetime"), Stamp()),
    **dict.fromkeys(("zeit", "temps", "tiempo", "tempo", "ora", "hora", "heure", "datum", "fecha"), Stamp()),
    "date": Stamp(),
    **dict.fromkeys(("dateobs", "starttime", "timestart", "utcstart", "startutc", "datebeg"), Stamp(mark="start")),
    **dict.fromkeys(("jdstart", "startjd", "jdsobs"), Stamp("jd", mark="start")),
    **dict.fromkeys(("mjdstart", "startmjd", "mjdobs", "mjdbeg"), Stamp("mjd", mark="start")),
    **dict.fromkeys(("endtime", "timeend", "utcend", "dateend"), Stamp(mark="end")),
    **dict.fromkeys(("jdend", "endjd"), Stamp("jd", mark="end")),
    **dict.fromkeys(("mjdend", "endmjd"), Stamp("mjd", mark="end")),
    **dict.fromkeys(("hjd", "hjdutc", "jdhel", "heliocentricjd"), Stamp("jd", "utc", light_path="heliocentric")),
    "hjdtt": Stamp("jd", "tt", light_path="heliocentric"),
    **dict.fromkeys(("bjd", "bjdtdb"), Stamp("jd", "tdb", light_path="barycentric")),
    "bjdutc": Stamp("jd", "utc", light_path="barycentric"),
    **dict.fromkeys(("hmjd", "mhjd"), Stamp("mjd", "utc", light_path="heliocentric")),
    **dict.fromkeys(("bmjd", "mbjd", "bmjdtdb"), Stamp("mjd", "tdb", light_path="barycentric")),
}  # fmt: skip
"""Names of columns of times, letters and digits only, the preferred first."""
NAMES: dict[str, tuple[str, ...]] = {
    "mag": (
        "apparentmagnitude", "magapparent", "apparentmag", "appmag", "calibratedmagnitude", "calmag", "magcal", "magnitude", "magpsf", "unforcedmag", "magauto", "magbest", "magiso", "magaper",
        "sourceamag", "sourceamagt1", "vmag", "gmag", "rmag", "imag", "bmag", "helligkeit", "magnitud", "grandeur", "magnitudine", "mags", "v", "cv", "clear",
    ),
    "flux": ("fluxadu", "relflux", "relativeflux", "netflux", "fluxrel", "counts", "fluss", "aperturesum", "relfluxt1"),
    "exptime": ("exposuretime", "exposure", "exp", "expt", "texp", "exposures", "integrationtime", "belichtung", "exposition"),
    "band": ("filter", "filt", "passband", "bandpass", "filtercode", "magband", "filtername", "observingfilter", "filtre"),
    "station": ("observatory", "site", "observatorycode", "obscode"),
    "limiting_mag": ("diffmaglim", "limitingmagnitude", "limmag", "maglim", "maglimit", "limitmag", "mag5sig"),
    "bad": ("catflags",),
    "object": ("objectname", "satellite", "satellitename", "satelliteid", "satname", "noradcatid", "noradid", "norad", "catalognumber", "cataloguenumber"),
    "object_number": ("noradcatid", "noradid", "norad", "noradnumber", "noradcatnumber", "catalognumber", "cataloguenumber", "satno", "satcat"),
}  # fmt: skip
"""Names of other columns, letters and digits only, the preferred first."""
OF_A_FILTER = ("vmag", "gmag", "rmag", "imag", "bmag")
"""Magnitudes named after their filter: of several, the user has to say which."""
ERRORS = (
    "{}err", "err{}", "{}error", "e{}", "{}uncertainty", "{}uncert", "{}unc", "sigma{}", "{}sigma", "d{}", "u{}", "{}sig", "{}std", "rms{}",
)  # fmt: skip
ANY_ERROR = ("err", "error", "merr", "uncertainty", "uncert", "unc", "sigma", "sig", "fehler", "erreur", "errore", "magerr", "stderr", "sigmapsf", "std", "stddev", "standarddeviation", "magnitudeerror", "magnitudeuncertainty", "magerrmag")  # fmt: skip
"""Names of errors of whatever brightness there is."""
SIGNS = ("\N{PLUS-MINUS SIGN}", "+/-", "+-")
"""What stands for an error in a name, alone or beside that of its quantity."""
ERROR_WORD = re.compile(r"error|err|uncertainty|uncert|unc|sigma|sig|std|rms")
"""What stands anywhere in the name of an error, as in Source_AMag_Err_T2."""
CLOCK = (
    "localtime",
    "timelocal",
    "lt",
    "civiltime",
    "time",
    "ut",
    "utc",
    "timeutc",
    "utctime",
    "uttime",
    "uhrzeit",
    "zeit",
    "temps",
    "tiempo",
    "tempo",
    "heure",
    "hora",
    "ora",
)
CALENDAR = ("date", "dateutc", "utcdate", "utdate", "obsdate", "datum", "fecha", "data")
"""Names of two columns that hold the time of day and the date."""
PARTS_OF_DATE = (
    ("year", "yr", "yyyy", "jahr", "annee"),
    ("month", "mon", "monat", "mois"),
    ("day", "dd", "tag", "jour"),
    ("hour", "hours", "hr", "hh", "h", "stunde"),
    ("minute", "minutes", "min", "mn", "m"),
    ("second", "seconds", "sec", "ss", "s", "sekunde"),
)
"""Names of columns that hold the parts of a date, letters and digits only."""


_OF_A_SITE = r"(?:station|site|observers?|obs|observatory|telescope|tel|sensor)"
_OF_ANY = r"(?:geodetic|geographic|geo|gps|location|wgs84)"
_DEGREES_NORTH, _DEGREES_EAST = (
    r"(?:n|north|deg|degrees|degn|decdeg)?",
    r"(?:e|east|deg|degrees|dege|decdeg)?",
)
_HEIGHT, _METRES = r"(?:altitude|alt|elevation|elev|height|hgt)", r"(?:m|meters?|metres?|masl)"
NAMES_OF_SITE = {
    "site_lat": rf"(?:{_OF_A_SITE}|{_OF_ANY})?(?:lat|latitude){_DEGREES_NORTH}|(?:lat|latitude){_OF_A_SITE}",
    "site_lon": rf"(?:{_OF_A_SITE}|{_OF_ANY})?(?:lon|long|lng|longitude){_DEGREES_EAST}|(?:lon|long|longitude){_OF_A_SITE}",
    "site_height": rf"{_OF_A_SITE}?{_OF_ANY}?{_HEIGHT}{_METRES}",
}
"""How the columns of the observer's place are called, letters and digits only. A height without metres may be an elevation."""
_IN_BRACKETS = {
    "site_lat": f"rad|{_DEGREES_NORTH}",
    "site_lon": f"rad|{_DEGREES_EAST}",
    "site_height": _METRES,
}
SAYS_WHOSE = re.compile(_OF_A_SITE)
LIKE_A_SITE = re.compile(r"(?<![a-z])(lat|latitude|lon|long|lng|longitude)(?![a-z])")
OF_ANOTHER_PLACE = re.compile(
    r"(?<![a-z])(body|sun|sub|subsat|ssp|sat|satellite|target|object|ecl\w*|gal\w*|helio\w*|pab|phase)(?![a-z])"
)
"""Words beside a latitude or longitude that is not the observer's."""


def named_as_site(name: str) -> str | None:
    """Which of SITE a column of this name holds; None where it is none, or counts west or south."""
    before, within = without_brackets(name)
    folded, inside = plain(before), plain(within)
    for role, pattern in NAMES_OF_SITE.items():
        metres = role == "site_height" and bool(re.fullmatch("k?m|meters|metres", inside))
        if inside and not metres and not re.fullmatch(_IN_BRACKETS[role], inside):
            continue
        if re.fullmatch(pattern, f"{folded}m" if metres else folded):
            return role
    return None


def looks_like_site(name: str) -> bool:
    """May a column of this name hold where the observer is?"""
    words = re.sub(r"[\W_\d]+|(?<=[a-z])(?=[A-Z])", " ", name).lower()
    return bool(named_as_site(name) or LIKE_A_SITE.search(words)) and not OF_ANOTHER_PLACE.search(words)


def without_brackets(name: str) -> tuple[str, str]:
    """A name, and what stands in brackets at its end: "JD (UTC)" as "JD" and "UTC"; "" where nothing does."""
    text = name.rstrip()
    opens = max(text.rfind("("), text.rfind("["))
    if not text.endswith((")", "]")) or opens < 0 or re.search(r"[)\]]", text[opens:-1]):
        return name, ""
    return text[:opens].rstrip(), text[opens + 1 : -1].strip()


def plain(name: str) -> str:
    """A name's letters and digits, lower case, without what stands in brackets at its end; "± mag" and "mag +/-" as magerr."""
    text = without_brackets(name)[0].lower()
    return re.sub(r"[\W_]+", "", text) + ("err" if any(sign in text for sign in SIGNS) else "")


LESS_A_NUMBER = re.compile(r"([a-z]+)(24[0-7]\d{4})(\.50*|\.0+)?", re.ASCII)
"""JD - 2400000.5, HJD-2450000 and their like, without signs."""


LEFT_OFF = re.compile(r"[+-]?\s*(24[0-7]\d{4}(?:\.\d+)?)\s*\+?", re.ASCII)
"""What stands in brackets behind JD where that number was taken off, as in JD (2400000+)."""


def stamp_named(name: str) -> Stamp | None:
    """What the name of a column says of times, "Time (BJD_TDB-2457000)" included; None where it names none."""
    before, within = without_brackets(name)
    if zero := LEFT_OFF.fullmatch(within):
        return _one_stamp(f"{before}-{zero[1]}")
    outside, inside = _one_stamp(before), _one_stamp(within)
    if inside is not None and inside.format and (outside or Stamp()).format == "":
        return replace(inside, mark=outside.mark) if outside is not None else None
    return outside


def _one_stamp(text: str) -> Stamp | None:
    letters = re.sub(r"[^a-z0-9.]+", "", text.lower())
    letters = re.sub(r"(?<!\d)\.|\.(?!\d)", "", letters)
    if less := LESS_A_NUMBER.fullmatch(letters):
        whole = Stamp("jd") if less[1] == "time" else STAMPS.get(less[1])
        if whole is None or whole.format != "jd":
            return None
        half = (less[3] or "").startswith(".5")
        zero = f"{less[2]}.5" if half else less[2]
        return replace(whole, format="mjd" if zero == "2400000.5" else f"jd-{zero}")
    name = plain(text)
    return STAMPS.get(name) or _beside_time(name)


def _beside_time(name: str) -> Stamp | None:
    """What a name says that puts the word time beside a scale or a format: time_tdb, TDB time, time MJD."""
    rest = name.removeprefix("time") if name.startswith("time") else name.removesuffix("time")
    if rest in ("tdb", "tt", "tai"):
        return Stamp(scale=rest)
    stamp = STAMPS.get(rest, Stamp())
    return stamp if rest != name and stamp.format else None


def known_names(names: Sequence[str], columns: Mapping[str, Sequence[str]]) -> bool:
    """Do these look like the names of a recording's columns: one of times, and one of brightness?"""
    folded = {plain(name) for name in names}
    special = {role: {plain(name) for name in columns.get(role, ())} for role in ("time", "mag", "flux")}
    times = {"time", *STAMPS, *special["time"]}
    lights = {"mag", "flux", *NAMES["mag"], *NAMES["flux"], *special["mag"], *special["flux"]}
    return bool(folded & times or any(map(stamp_named, names))) and bool(folded & lights)


def assigned(header: Header, reading: Reading, columns: Mapping[str, Sequence[str]]) -> Header:
    """``header`` with its columns under our names, and what was taken for what among its notes.

    ``columns`` are the names that the file's format knows. What the user says counts first, then our own names, the
    format's, and those that are in use elsewhere.
    """
    taken: dict[str, tuple[int, ...]] = {}
    _check_roles([role for role in reading.columns if role not in ROLES])
    for role, text in reading.columns.items():
        taken[role] = _told(header, role, text)
    _check_apart(header, taken)
    used = {column for places in taken.values() for column in places}
    for role in ROLES:
        if role not in taken and role in header.names and header.names.index(role) not in used:
            taken[role] = (header.names.index(role),)
    for role in (
        "time",
        "mag",
        "flux",
        "exptime",
        "band",
        "station",
        "object",
        "object_number",
        "bad",
        "limiting_mag",
    ):
        if role not in taken:
            others = [*STAMPS, *filter(stamp_named, header.names)] if role == "time" else NAMES.get(role, ())
            if role == "mag" and not _one_filter(header, columns.get("mag", ())):
                continue
            taken |= _found(header, role, [*columns.get(role, ()), role, *others], taken)
    taken |= _site(header, taken)
    for kind in ("mag", "flux"):
        role = f"{kind}_err"
        if kind in taken and role not in taken:
            base = plain(header.names[taken[kind][0]])
            other = "flux" if kind == "mag" else "mag"
            loose = () if other in taken else ANY_ERROR
            named = [pattern.format(word) for word in dict.fromkeys((base, kind)) for pattern in ERRORS]
            stems = {base, base.replace(kind, "") or base}  # cal_mag_err, or cal_err, of cal_mag
            named += [name for name in header.names if ERROR_WORD.sub("", plain(name), count=1) in stems]
            taken |= _found(header, role, [*columns.get(role, ()), *named, *loose], taken)
            signs = [index for index, name in enumerate(header.names) if name.strip() in SIGNS]
            if role not in taken and len(signs) == 1 and loose:
                taken[role] = (signs[0],)
    taken |= _parts_of_date(header, taken) or _date_and_time(header, reading, taken)
    return _renamed(header, reading, taken)


def _check_roles(unknown: Sequence[str]) -> None:
    """InputError for all that the user tells and that is none of ours."""
    if not unknown:
        return
    plain_roles = [role for role in ROLES if role not in (*GEOMETRY, *HORIZONTAL)]
    known = list(dict.fromkeys((*plain_roles, *SETTINGS)))
    more = [(repr(role[:40]), did_you_mean(role, known)) for role in unknown[1:]]
    hint = with_others(did_you_mean(unknown[0], known), more)
    raise InputError(option("columns"), None, repr(unknown[0][:40]), f"one of {', '.join(known)}", hint)


def _told(header: Header, role: str, text: str) -> tuple[int, ...]:
    """Places of the columns that the user names, joined by "+"; a number counts the columns of a table."""
    names = [text] if text in header.names else [part.strip() for part in text.split("+")]
    places = []
    for name in names:
        folded = [index for index, other in enumerate(header.names) if other.lower() == name.lower()]
        if name in header.names:
            places.append(header.names.index(name))
        elif len(folded) == 1:
            places.append(folded[0])
        elif name.isascii() and name.isdigit() and 1 <= int(name[:6]) <= len(header.names):
            places.append(int(name) - 1)
        else:
            listed = ", ".join(filter(None, header.names))[:200]
            hint = did_you_mean(name, [other for other in header.names if other])
            raise InputError(
                header.source, f"column of {role}", f"no column {name[:60]!r}", f"one of {listed}", hint
            )
    if len(places) > 1 and role != "time":
        found = f"{len(places)} columns: {text[:60]!r}"
        raise InputError(
            header.source, f"column of {role}", found, "one column", "Only parts of a date are joined by +"
        )
    return tuple(places)


def _check_apart(header: Header, named: Mapping[str, tuple[int, ...]]) -> None:
    """InputError where the user tells one column to be two things."""
    roles: dict[int, list[str]] = {}
    for role, places in named.items():
        for column in dict.fromkeys(places):
            roles.setdefault(column, []).append(role)
    for column, both in roles.items():
        if len(both) > 1:
            found = f"{header.names[column][:60]!r} told as {' and as '.join(both)}"
            raise InputError(header.source, "columns", found, "one meaning for each column")


def _found(
    header: Header, role: str, names: Iterable[str], taken: Mapping[str, tuple[int, ...]]
) -> dict[str, tuple[int, ...]]:
    """The first of ``names`` that the header has and that is not taken yet; of two columns of one name the first."""
    used = {column for places in taken.values() for column in places}
    free = {}
    for index, name in reversed(list(enumerate(header.names))):
        if index not in used and name:
            free[plain(name)] = index
    return next(({role: (free[plain(name)],)} for name in names if plain(name) in free), {})


def _site(header: Header, taken: Mapping[str, tuple[int, ...]]) -> dict[str, tuple[int, ...]]:
    """Latitude, longitude and height of the observer, where both of the former are known; names that say whose they are come first."""
    used = {column for places in taken.values() for column in places}
    free = [index for index, name in enumerate(header.names) if name and index not in used]
    free.sort(key=lambda index: not SAYS_WHOSE.search(plain(header.names[index])))
    sites: dict[str, tuple[int, ...]] = {}
    for index in free:
        role = named_as_site(header.names[index])
        if role is not None and role not in taken:
            sites.setdefault(role, (index,))
    return sites if {"site_lat", "site_lon"} <= {*sites, *taken} else {}


def _one_filter(header: Header, known: Sequence[str]) -> bool:
    """False where only the user can say which of several filters' magnitudes is meant."""
    folded = {plain(name) for name in header.names}
    if folded & {plain(name) for name in (*known, "mag", *NAMES["mag"]) if plain(name) not in OF_A_FILTER}:
        return True
    return len(folded & set(OF_A_FILTER)) < 2


def _parts_of_date(header: Header, taken: Mapping[str, tuple[int, ...]]) -> dict[str, tuple[int, ...]]:
    """Where year, month, day and the parts of the day stand in columns of their own, and nothing else is a time."""
    if "time" in taken:
        return {}
    used = {column for places in taken.values() for column in places}
    folded = [plain(name) if index not in used else "" for index, name in enumerate(header.names)]
    places: list[int] = []
    for names in PARTS_OF_DATE:
        here = [index for index, name in enumerate(folded) if name in names]
        if len(here) != 1:
            break
        places += here
    cells = first_row(header)
    if len(places) < 3 or not is_as_wide(cells, header.names):
        return {}
    parts = [cells[column] for column in places]
    if len(parts) == 3 and "." not in parts[2]:  # a date alone is no instant
        return {}
    return {"time": tuple(places)} if is_moment(moment_of(parts)) else {}


def _date_and_time(
    header: Header, reading: Reading, taken: Mapping[str, tuple[int, ...]]
) -> dict[str, tuple[int, ...]]:
    """Where date and time of day stand in two columns, both."""
    if "time" in reading.columns or "time" not in taken:
        return {}
    folded = [plain(name) for name in header.names]
    days = [folded.index(name) for name in CALENDAR if name in folded]
    hours = [folded.index(name) for name in CLOCK if name in folded and folded.index(name) not in days]
    stamp = stamp_named(header.names[taken["time"][0]]) or Stamp()
    if not days or not hours or (stamp.format and not stamp.light_path):
        return {}
    cells = first_row(header)
    if not is_as_wide(cells, header.names):
        return {}
    for day in days:
        for hour in hours:
            if are_apart(cells[day], cells[hour]):
                return {"time": (day, hour)}
    return {}


def _renamed(header: Header, reading: Reading, taken: Mapping[str, tuple[int, ...]]) -> Header:
    names = list(header.names)
    theirs = {
        role: " + ".join(header.theirs.get(names[column], names[column]) for column in places)
        for role, places in taken.items()
    }
    for index, name in enumerate(names):
        if name in ROLES and taken.get(name) != (index,):
            names[index] = DELIVERED + name
    units = dict(header.units)
    descriptions = dict(header.descriptions)
    for role, places in taken.items():
        source = header.names[places[0]]
        if len(places) == 1:
            names[places[0]] = role
        else:
            names.append(role)
        units[role] = header.units.get(source, "")
        descriptions[role] = header.descriptions.get(source, "")
        unit = without_brackets(source)[1]
        # brackets behind a magnitude hold its band, which V and G are, and not volts and gauss
        in_mag = role not in ("mag", "mag_err", "limiting_mag") or "mag" in unit.lower()
        of_a_place = role in SITE and not re.match("deg|rad|arc|m|k", unit.lower())  # N and E are no units
        if source != role and not units[role] and in_mag and not of_a_place and _is_unit(role, unit):
            units[role] = unit
        if role == "time" and source != role:
            # the sign of an offset, as in UTC-7, stays
            said = re.sub(r"_|(?<=[^\W\d_])-(?=[^\W\d_])|(?<=[a-z])(?=[A-Z])", " ", theirs[role])
            descriptions[role] = f"{descriptions[role]} {said}".strip()
    units |= reading.units
    return replace(
        header,
        names=tuple(names),
        units={name: text for name, text in units.items() if text},
        descriptions=descriptions,
        columns=dict(taken),
        theirs=theirs,
    )


def _is_unit(role: str, text: str) -> bool:
    if role == "time":
        return False
    try:
        u.Unit(text[:60])
    except (ValueError, TypeError, OverflowError):
        return False
    return bool(text)


def stamp_of(header: Header) -> Stamp:
    """What the name of the column of times says."""
    name = header.theirs.get("time", "time")
    return Stamp() if name == "time" else stamp_named(name) or Stamp()
