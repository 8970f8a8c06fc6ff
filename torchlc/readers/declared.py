"""What a recording says about itself before its rows, what the user adds, and which of its columns a scene needs."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from torchlc.errors import InputError, option
from torchlc.readers.dates import is_moment
from torchlc.readers.roles import DELIVERED, ROLES, VECTORS
from torchlc.readers.table import Header, first_row
from torchlc.readers.timing import FORMAT_WORDS, MARK_WORDS, Timing
from torchlc.scene.reading import LESS_A_DATE, Reading
from torchlc.scene.timestamps import (
    JULIAN_DATE,
    REDUCED,
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
    "site_lat": u.deg,
    "site_lon": u.deg,
    "site_height": u.m,
}
UNITS |= {f"{prefix}_{axis}": u.km for prefix in ("sun", "obs", "r") for axis in "xyz"}
UNITS |= {f"v_{axis}": u.km / u.s for axis in "xyz"}
EQUATORIAL = re.compile(r"(icrs|icrf|gcrs|gcrf|eme ?2000|j2000|fk5|equatorial)\b")
LIKE_TIME = re.compile(r"time|date|jd|utc?\b|stamp|epoch|zeit|^t([ _(\[]|$)|second", re.IGNORECASE)
LIKE_MAG = re.compile(r"(?<![a-z])mag|mag(?![a-z])|^[A-Z0-9]{1,3}-[A-Z0-9]{1,3}$|bright|hell", re.IGNORECASE)
LIKE_FLUX = re.compile(r"flu[xs]|counts?|adu|intensity|sum", re.IGNORECASE)
NO_BRIGHTNESS = re.compile(
    r"err|unc|sig|rms|std(?![ _]?mag)|snr|s/n|lim|air ?mass|zero|zp|\bid\b|name|(^|[ _-])(x|y|ra|dec)(cent\w+)?$",
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


def missing(header: Header, name: str, expected: str) -> InputError:
    """The error of a column that is not there, with the nearest one that is."""
    others = [other.removeprefix(DELIVERED) for other in header.names if other and other not in FALSE_FRIENDS]
    hint = did_you_mean(name, others)
    if len(header.names) == 1 and header.rows is None:
        hint = "The header holds one name only: is the delimiter a comma?"
    elif name in ("time", "mag", "flux"):
        offered = _offered(name, header)
        if name == "time" and "time" not in offered:
            hint = "None of them looks like times: add a column time, or say which it is: " + option(
                "columns", "time=NAME"
            )
        elif offered:
            said = ",".join(f"{role}={_quoted(other)}" for role, other in offered.items())
            hint = f"Say which column is what, as in {option('columns', said)}".strip()
    listed = ", ".join(_of_file(header, other) for other in header.names if other)
    return InputError(header.source, "header", f"no column {name} among {listed}"[:200], expected, hint)


def _of_file(header: Header, name: str) -> str:
    """The name that one of our columns, or one that the user replaced, has in the file."""
    return header.theirs.get(name, name.removeprefix(DELIVERED))


def _offered(name: str, header: Header) -> dict[str, str]:
    """Our columns beside those of the file that look like them; empty for a role that none can have."""
    cells = first_row(header)
    left = {
        other.removeprefix(DELIVERED): cells[index] if index < len(cells) else ""
        for index, other in enumerate(header.names)
        if other and other not in FALSE_FRIENDS and other not in ROLES
    }
    offered: dict[str, str] = {}
    if "time" not in header.names:
        called = [other for other in left if LIKE_TIME.search(other)]
        dated = [other for other, cell in left.items() if _is_instant(cell)]
        for chosen in [*(column for column in dated if column in called), *dated, *called][:1]:
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


def brightness(header: Header, use: str | None) -> str:
    """ "mag" or "flux": ``use``, else what is there, mag first."""
    if use not in (None, "mag", "flux"):
        raise InputError(None, option("use"), repr(use), "mag or flux")
    for name in ("time", use or "time"):
        if name not in header.names:
            raise missing(header, name, f"a column {name}")
    if use is not None:
        return use
    if "mag" not in header.names and "flux" not in header.names:
        raise missing(header, "mag", "a column mag or flux")
    return "mag" if "mag" in header.names else "flux"


def frame(header: Header, scene: Scene | None) -> str | None:
    """Frame of the vectors, "icrs" or "ecliptic"; None where none are read."""
    expected = None if scene is None else scene.orbit.vectors
    if scene is not None and expected is None:
        return None
    said = str(header.meta.get("frame", "")).strip().lower()
    if not said or not any(f"{prefix}_x" in header.names for prefix in VECTORS.values()):
        return expected or "icrs"
    stated = "ecliptic" if said.startswith("ecliptic") else "icrs" if EQUATORIAL.match(said) else None
    if stated is None:
        raise InputError(header.source, "metadata frame", repr(said[:40]), "icrs or ecliptic")
    if expected and stated != expected:
        contradiction = f"{stated}, but the scene says vectors = {expected!r}"
        raise InputError(header.source, "metadata frame", contradiction, "the same frame in both")
    return stated


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
    if hasattr(unit, "function_unit") or any(unit == logarithm for logarithm in (u.mag, u.dex, u.dB)):
        hint = "Name the columns mag and mag_err if they are magnitudes"
        raise InputError(header.source, "column flux", f"unit {text}", "a linear unit", hint)


NOT_APPARENT = re.compile(
    r"\b(instrumental|differential|relative|reduced|normali[sz]ed|detrended|absolute|unit distances?|delta[ _-]?mag\w*)\b",
    re.IGNORECASE,
)
"""How people say that a magnitude is not apparent, or not calibrated."""


DIFFERENCE = re.compile(
    r"^[A-Z]\w{0,2}[ _]?-[ _]?[A-Z]\w{0,2}$|(^|[ _])(d|diff|delta|inst|instr|instrumental|differential)[ _]?mag"
    r"|mag[ _]?(diff|inst|instr)([ _]|$)",
    re.I,
)
"""Names of columns of such magnitudes: V-C, O-C, T1-C1, diff_mag, instr_mag."""


AT_A_RANGE = re.compile(r"(?<![a-z])(std|abs)[ _]?mag|\d ?km\b", re.IGNORECASE)
"""Names of magnitudes that are not at the distance of the observer, such as the standard magnitude at 1000 km."""
NOT_AS_SEEN = re.compile(
    r"^(?=.*(mag|bright|photom|hell)).*(?!\breduced (by|with|in)\b)"
    + NOT_APPARENT.pattern
    + r"|\b(reduced|normali[sz]ed|scaled|corrected|referred|standardi[sz]ed)\b.*(\d ?km|\b(unit|standard|common) (range|distance)s?)\b",
    re.IGNORECASE,
)
"""Comments on such magnitudes; what was reduced by a program or a person is not meant."""


def magnitudes_told(header: Header, kind: str) -> list[str]:
    """What has to be said where the name or description of magnitudes, or a comment, speaks of others than apparent ones."""
    if kind != "mag":
        return []
    described, name = header.descriptions.get("mag", ""), header.theirs.get("mag", "")
    parted = re.sub(r"[_-]|(?<=[a-z])(?=[A-Z])", " ", name)
    said = []
    if NOT_APPARENT.search(described):
        said.append(f"the description of mag says {described[:60]!r}")
    elif DIFFERENCE.search(name) or NOT_APPARENT.search(parted) or AT_A_RANGE.search(parted):
        said.append(f"the column of mag is called {name[:60]!r}")
    said += [f"a comment says {text[:60]!r}" for text in header.comments if NOT_AS_SEEN.search(text)]
    return [
        f"{text}: torchlc takes apparent magnitudes, corrected for extinction. "
        "Give relative fluxes in a column flux, or a free zero_point, if they are others"
        for text in said
    ]


def units_told(header: Header, kind: str) -> list[str]:
    """What has to be said of units that the file leaves open."""
    unit = header.units.get("flux")
    if kind == "flux" and unit and "flux_err" in header.names and not header.units.get("flux_err"):
        return [f"flux_err has no unit and is taken in that of flux, {unit[:40]}"]
    return []


MOST_OTHERS = 8
"""Columns without a use that are listed."""


def errors_told(header: Header, kind: str) -> list[str]:
    """What has to be said where no column of errors was found among several that have no use here."""
    used = {place for places in header.columns.values() for place in places}
    others = [
        name for place, name in enumerate(header.names) if name and place not in used and name not in ROLES
    ]
    if f"{kind}_err" in header.names or not others or header.format:
        return []
    example = option("columns", f"{kind}_err={_quoted(others[0][:60]) if len(others) == 1 else 'NAME'}")
    listed = ", ".join(name[:30] for name in others[:MOST_OTHERS]) + (
        ", ..." if len(others) > MOST_OTHERS else ""
    )
    return [f"no column is taken for the errors. Not used: {listed}. If one holds them: {example}"]


def taken(
    header: Header,
    reading: Reading,
    columns: Iterable[str],
    timing: Timing,
    time_format: str,
    not_used: str = "",
) -> list[str]:
    """One line on what was taken for what, and what was not (``not_used``); none where a file has our own names and nothing
    else is to be said."""
    roles = dict.fromkeys(
        "time" if name == "time" else name
        for name in columns
        if name in header.theirs and name in header.columns
    )
    renamed = any(header.theirs[name] != name for name in roles)
    plainly_ours = not renamed and not header.format and header.decimal == "."
    if plainly_ours and not reading.model_fields_set and not not_used:
        return []
    texts = []
    triples = {f"{p}_x": [f"{p}_{axis}" for axis in "xyz"] for p in VECTORS.values()}
    beside = {name for names in triples.values() for name in names[1:]}
    for name in roles:
        if name in beside:
            continue
        names = [part for part in triples.get(name, [name]) if part in roles]
        text = f"{', '.join(header.theirs[part] for part in names)} as {', '.join(names)}"
        if name == "time":
            scale = "civil time" if timing.zone else timing.scale.upper()
            form = FORMAT_WORDS.get(time_format) or LESS_A_DATE.sub(r"JD - \1", time_format)
            moment = timing.light_path or MARK_WORDS[timing.mark]
            if light_time_corrected(header):
                moment += ", corrected for light time"
            text += f" ({form}, {scale}, {moment})"
        texts.append(text)
    form = f"read as {header.format}: " if header.format else "columns: "
    comma = "; decimal commas" if header.decimal == "," else ""
    return [form + ", ".join(texts) + comma + (f"; not used: {not_used}" if not_used else "")]
