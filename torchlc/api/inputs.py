"""What every verb is given, read and checked: a scene, and the rows of a recording or of a grid of times."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, date, datetime
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, overload

import numpy as np
from astropy.time import Time, TimeBase

from torchlc.effects import names as effect_names
from torchlc.errors import InputError, option
from torchlc.geometry.orbit import above_horizon, make_track, observation_grid, sun_elevation_deg
from torchlc.readers import Recording, recording_of, too_few_rows
from torchlc.scene import Scene, load_scene
from torchlc.tensors.moving import on_cpu

Progress = Callable[[str, float], None]
Rows = Any
"""What holds a recording: a path, a Recording, astropy's Table or TimeSeries, a LightCurve of lightkurve, a DataFrame of
pandas, or a mapping of columns (arrays, quantities, instants)."""
Columns = str | Mapping[str, Any] | None
"""Which column is what: "time=JD_UTC,mag=V", or a mapping; over the table [recording] of the scene."""
Moment = str | float | datetime | Time
"""ISO UTC or a Julian date, or an instant of Python's or astropy's."""
DATE = re.compile(r"\d{4}-\d\d-\d\d", re.ASCII)
MIN_ROWS = 2
"""Of a fit: one row only fixes the zero point."""
IN_DAYLIGHT_MAG = -3.0
"""Fainter than this hardly anybody records objects beside the Sun: Venus and the ISS at its brightest are brighter."""
BY_DAY = "the Sun is above the horizon"


@overload
def load(
    scene: str | Path | Scene,
    recording: None = None,
    *,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
) -> Scene: ...
@overload
def load(
    scene: str | Path | Scene,
    recording: Rows,
    *,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
) -> tuple[Scene, Recording]: ...
@on_cpu
def load(
    scene: str | Path | Scene,
    recording: Rows = None,
    *,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
) -> Scene | tuple[Scene, Recording]:
    """Read a scene, or a scene and a recording, and check them.

    A recording is a path, or what holds its rows in memory: astropy's Table or TimeSeries, a LightCurve of lightkurve, a
    DataFrame of pandas, or a mapping of arrays, quantities and instants. ``use`` picks "mag" or "flux" of one that has
    both. ``columns`` says which column is what ("time=JD_UTC,mag=V", or a mapping). ``trust`` lets the scene name files
    outside its own folder.
    """
    read = read_scene(scene, trust)
    return read if recording is None else (read, recording_of(recording, read, use=use, columns=columns))


def read_scene(scene: str | Path | Scene, trust: bool) -> Scene:
    """A scene as it is, or read from its file with every effect known by name."""
    if not isinstance(scene, (str, PathLike, Scene)):
        raise InputError(None, "scene", type(scene).__name__, "a path or a Scene")
    return scene if isinstance(scene, Scene) else load_scene(scene, trust=trust, known_effects=effect_names())


def moment(value: Any, argument: str = "start") -> str | float | None:
    """An instant as ISO UTC or a Julian date: a date alone is its 0 h, a naive datetime is in UTC."""
    if isinstance(value, TimeBase):
        if not value.isscalar:
            raise InputError(None, argument, f"{len(value)} times", "one time")
        return str(Time(value.utc, format="isot", precision=9).value)
    if isinstance(value, datetime):
        value = value if value.tzinfo is None else value.astimezone(UTC)
        return value.replace(tzinfo=None).isoformat(timespec="microseconds")
    if isinstance(value, date):
        value = value.isoformat()
    if isinstance(value, np.datetime64):
        value = str(value.astype("datetime64[us]"))
    if isinstance(value, str):
        return f"{value}T00:00:00" if DATE.fullmatch(value) else value
    if value is None:
        return None
    if isinstance(value, Real):
        return float(value)
    raise InputError(None, argument, type(value).__name__, "ISO UTC, a Julian date, a Time or a datetime")


def amount(value: Any, unit: str, argument: str) -> Any:
    """A number in ``unit``, of which a Quantity may hold another."""
    if not hasattr(value, "to_value"):
        return value
    try:
        return float(value.to_value(unit))
    except (TypeError, ValueError):  # also of another kind of unit
        raise InputError(None, argument, f"{value!s}"[:60], f"one quantity in {unit}") from None


def grid_or(
    scene: Scene,
    recording: Rows,
    start: Moment | None,
    hours: float | None,
    cadence: float | None,
    columns: Columns = None,
) -> Recording:
    """The rows of a recording, or of a grid of times."""
    start = moment(start)
    if recording is None:
        if start is None or hours is None or cadence is None:
            found = (
                f"no recording, and not all of {option('start')}, {option('hours')} and {option('cadence')}"
            )
            raise InputError(None, None, found, "one or the other")
        return observation_grid(scene, start, amount(hours, "h", "hours"), amount(cadence, "s", "cadence"))
    if start is not None or hours is not None or cadence is not None:
        found = f"a recording and {option('start')}, {option('hours')} or {option('cadence')}"
        raise InputError(None, None, found, "one or the other")
    return recording_of(recording, scene, columns=columns)


def usable(scene: Scene, recording: Rows, *, use: str | None = None, columns: Columns = None) -> Recording:
    """The rows of a recording that a fit may use: at least two, and those below the horizon dropped and
    counted.
    """
    recording = recording_of(recording, scene, use=use, columns=columns, min_rows=MIN_ROWS)
    with scene.reading():
        track = make_track(scene, recording)
    kept = recording.keep(above_horizon(track), "below the horizon")
    if len(kept) < MIN_ROWS:
        raise too_few_rows(kept.source, len(kept), kept.dropped, MIN_ROWS)
    warning = _told_of_day(recording, sun_elevation_deg(track))
    return replace(kept, warnings=(*kept.warnings, warning)) if warning else kept


def _told_of_day(recording: Recording, sun_deg: np.ndarray | None) -> str:
    """A warning where most rows were recorded by day, which is told once; else nothing."""
    if sun_deg is None or any(BY_DAY in text for text in recording.warnings):
        return ""
    by_day = int(np.count_nonzero(sun_deg > 0))
    bright = recording.kind == "mag" and np.median(recording.observed) < IN_DAYLIGHT_MAG
    if 2 * by_day <= len(recording) or bright:
        return ""
    return (
        f"{BY_DAY} of the station in {by_day} of {len(recording)} rows, {np.median(sun_deg):.0f} deg high in the middle row: "
        "are the times local or 12 h off, or has the longitude the wrong sign? East is positive"
    )
