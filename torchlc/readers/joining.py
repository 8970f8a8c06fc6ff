"""Several recordings of one object, or of several of one design, as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from astropy.time import Time

from torchlc.errors import InputError
from torchlc.readers.measurements import seconds_since
from torchlc.readers.recording import Recording


def joined(recordings: Sequence[Recording]) -> Recording:
    """The rows of all in order of time. Curves stay apart, numbered where two have one name; stations and nights of one
    name are one. A column that some lack is left out, and a warning says so; kind, errors, scale and frame must agree."""
    first = recordings[0]
    if len(recordings) == 1:
        return first
    for other in recordings[1:]:
        for what, ours, theirs in (
            ("kind", first.kind, other.kind),
            ("errors", first.error_source, other.error_source),
            ("time scale", first.time.scale, other.time.scale),
            ("frame", first.frame, other.frame),
            ("light_time_corrected", first.light_time_corrected, other.light_time_corrected),
        ):
            if ours != theirs:
                raise InputError(other.source, what, str(theirs), f"{ours}, as in {first.source}")
    jd1, jd2 = (
        np.concatenate([np.atleast_1d(getattr(one.time, part)) for one in recordings])
        for part in ("jd1", "jd2")
    )
    times = Time(jd1, jd2, format="jd", scale=first.time.scale)
    order = np.lexsort((jd2, jd1))
    taken: list[str] = []
    curves: list[np.ndarray] = []
    for one in recordings:
        names = [_free(name, taken) for name in one.curve_ids]
        curves.append(one.curve + len(taken))
        taken += names
    station, station_ids = _by_name([(one.station, one.station_ids) for one in recordings])
    night, night_ids = _by_name([(one.night, one.night_ids) for one in recordings])
    told = [(one.object, one.object_ids) for one in recordings if one.object is not None]
    objects, object_ids = _by_name(told) if len(told) == len(recordings) else (None, ())
    columns: dict[str, np.ndarray | None] = {}
    lacking = ["object"] if told and objects is None else []
    for name in ("exptime", "band", "sun", "obs", "position", "velocity", "alt", "az", "height"):
        parts = [getattr(one, name) for one in recordings]
        given = [part for part in parts if part is not None]
        columns[name] = np.concatenate(given)[order] if len(given) == len(parts) else None
        if given and columns[name] is None:
            lacking.append(name)
    warnings = [text for one in recordings for text in one.warnings]
    if lacking:
        warnings.append(f"left out, because not every recording has it: {', '.join(lacking)}")
    time: Any = times[order]
    dropped: dict[str, int] = {}
    for one in recordings:
        for reason, count in one.dropped.items():
            dropped[reason] = dropped.get(reason, 0) + count
    error = (
        None if first.error is None else np.concatenate([np.asarray(one.error) for one in recordings])[order]
    )
    return replace(
        first,
        time=time,
        seconds=seconds_since(time, time[:1]),
        first_time=min((one.first_time for one in recordings), key=_day),
        observed=np.concatenate([one.observed for one in recordings])[order],
        error=error,
        station=station[order],
        station_ids=station_ids,
        curve=np.concatenate(curves)[order],
        curve_ids=tuple(taken),
        night=night[order],
        night_ids=night_ids,
        object=None if objects is None else objects[order],
        object_ids=object_ids,
        upper_limit=np.concatenate([one.upper_limit for one in recordings])[order],
        dropped=dropped,
        warnings=tuple(dict.fromkeys(warnings)),
        **columns,
    )


def _day(moment: Any) -> float:
    return float(moment.jd)


def _free(name: str, taken: Sequence[str]) -> str:
    """``name``, numbered if it is taken."""
    number, found = 1, name
    while found in taken:
        number += 1
        found = f"{name} ({number})"
    return found


def _by_name(parts: Sequence[tuple[np.ndarray, Sequence[str]]]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Codes over the names of all."""
    names = list(dict.fromkeys(name for _, ids in parts for name in ids))
    return np.concatenate(
        [np.array([names.index(name) for name in ids])[codes] for codes, ids in parts]
    ), tuple(names)
