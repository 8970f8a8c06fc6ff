"""What a recording says about itself before its rows, and which of its columns a scene needs."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from torchlc.errors import InputError
from torchlc.recording.table import Header
from torchlc.spelling import did_you_mean

if TYPE_CHECKING:
    from torchlc.scene import Scene

VECTORS = {"sun": "sun", "obs": "obs", "position": "r", "velocity": "v"}
"""Field of a Recording and the prefix of its three columns."""
UNITS = {"mag": u.mag, "mag_err": u.mag, "exptime": u.s, "alt": u.deg, "az": u.deg, "height": u.km}
UNITS |= {f"{prefix}_{axis}": u.km for prefix in ("sun", "obs", "r") for axis in "xyz"}
UNITS |= {f"v_{axis}": u.km / u.s for axis in "xyz"}
EQUATORIAL = re.compile(r"(icrs|icrf|gcrs|gcrf|eme ?2000|j2000|fk5|equatorial)\b")
TIME_FORMATS = {"": "", "jd": "jd", "mjd": "mjd", "iso": "iso", "isot": "iso"}


def missing(header: Header, name: str, expected: str) -> InputError:
    """The error of a column that is not there, with the nearest one that is."""
    hint = did_you_mean(name, header.names)
    if hint is None and len(header.names) == 1:
        hint = "The header holds one name only: is the delimiter a comma?"
    elif hint is None and name == "time":
        hint = "Columns are named time, mag and mag_err, or time, flux and flux_err"
    found = f"no column {name} among {', '.join(header.names)}"[:200]
    return InputError(header.source, "header", found, expected, hint)


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


def time_scale(header: Header) -> str:
    """ "utc" or "tdb"; local time is refused wherever it shows."""
    scale = str(header.meta.get("time_scale", "utc")).strip().lower()
    if scale not in ("utc", "tdb"):
        hint = "A local time cannot be converted safely." if "local" in scale else None
        raise InputError(header.source, "metadata time_scale", repr(scale[:40]), "utc or tdb", hint)
    if re.search(r"\blocal\b", header.descriptions.get("time", ""), re.IGNORECASE):
        raise InputError(header.source, "column time", "described as local time", "UTC", "Convert it first.")
    return scale


def time_format(header: Header) -> str:
    """ "iso", "jd", "mjd", or "" where the cells decide."""
    text = str(header.meta.get("time_format", "")).strip().lower()
    if text not in TIME_FORMATS:
        raise InputError(header.source, "metadata time_format", repr(text[:40]), "jd, mjd or iso")
    unit = header.units.get("time", "d")
    if unit.lower() not in ("d", "day", "days", "jd", "mjd", "utc"):
        raise InputError(header.source, "column time", f"unit {unit[:40]}", "d, for Julian dates")
    return TIME_FORMATS[text]


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
    needed, optional = [kind], [[name] for name in (f"{kind}_err", "exptime") if name in header.names]
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
    target = header.units.get("flux") if name == "flux_err" else UNITS.get(name)
    if not text or target is None:
        return values
    try:
        unit = u.Unit(text[:60])
        if getattr(unit, "function_unit", None) == u.mag:
            return values
        factor = unit.to(u.Unit(target))
    except (ValueError, TypeError, OverflowError, u.UnitsError):
        place = f"column {name}"
        raise InputError(header.source, place, f"unit {text[:60]}", f"a unit like {target}") from None
    return values if factor == 1.0 else values * factor
