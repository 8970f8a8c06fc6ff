"""Several recordings of one object, or of several of one design, as one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from astropy.time import Time

from torchlc.errors import InputError
from torchlc.readers.measurements import seconds_since
from torchlc.readers.recording import Recording

OPTIONAL = ("exptime", "band", "sun", "obs", "position", "velocity", "alt", "az", "height")
"""Columns that a recording may lack."""


def joined(recordings: Sequence[Recording]) -> Recording:
    """The rows of all in order of time. Curves stay apart, numbered where two have one name; stations and nights of one
    name are one. A column that some lack is left out, and a warning says so; kind, errors, scale and frame must agree."""
    first = recordings[0]
    if len(recordings) == 1:
        return first
    _check_alike(recordings)
    jd1, jd2 = (
        np.concatenate([np.atleast_1d(getattr(recording.time, part)) for recording in recordings])
        for part in ("jd1", "jd2")
    )
    order = np.lexsort((jd2, jd1))
    time: Any = Time(jd1, jd2, format="jd", scale=first.time.scale)[order]

    def together(name: str) -> np.ndarray:
        return np.concatenate([np.asarray(getattr(recording, name)) for recording in recordings])[order]

    curve, curve_ids = _curves(recordings)
    station, station_ids = _by_name([(recording.station, recording.station_ids) for recording in recordings])
    night, night_ids = _by_name([(recording.night, recording.night_ids) for recording in recordings])
    named = [
        (recording.object, recording.object_ids) for recording in recordings if recording.object is not None
    ]
    objects, object_ids = _by_name(named) if len(named) == len(recordings) else (None, ())
    having = {
        name: sum(getattr(recording, name) is not None for recording in recordings)
        for name in ("object", *OPTIONAL)
    }
    lacking = [name for name, count in having.items() if 0 < count < len(recordings)]
    warnings = [text for recording in recordings for text in recording.warnings]
    if lacking:
        warnings.append(f"left out, because not every recording has it: {', '.join(lacking)}")
    columns = {name: together(name) if having[name] == len(recordings) else None for name in OPTIONAL}
    return replace(
        first,
        time=time,
        seconds=seconds_since(time, time[:1]),
        first_time=min((recording.first_time for recording in recordings), key=_day),
        observed=together("observed"),
        error=None if first.error is None else together("error"),
        station=station[order],
        station_ids=station_ids,
        curve=curve[order],
        curve_ids=curve_ids,
        night=night[order],
        night_ids=night_ids,
        object=None if objects is None else objects[order],
        object_ids=object_ids,
        upper_limit=together("upper_limit"),
        dropped=dict(sum((Counter(recording.dropped) for recording in recordings), Counter())),
        place=None,
        dropped_at={},
        warnings=tuple(dict.fromkeys(warnings)),
        **columns,
    )


def _check_alike(recordings: Sequence[Recording]) -> None:
    """InputError where what all rows have in common is not the same in all recordings."""
    first = recordings[0]
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


def _curves(recordings: Sequence[Recording]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Codes of the curves, one after another, over names of which no two are the same."""
    names: list[str] = []
    codes: list[np.ndarray] = []
    for recording in recordings:
        codes.append(recording.curve + len(names))
        names += [_free(name, names) for name in recording.curve_ids]
    return np.concatenate(codes), tuple(names)


def _day(moment: Any) -> float:
    return float(moment.jd)


def _free(name: str, taken: Sequence[str]) -> str:
    """``name``, numbered if it is taken."""
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name} ({number})"
    return free


def _by_name(parts: Sequence[tuple[np.ndarray, Sequence[str]]]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Codes over the names of all."""
    names = list(dict.fromkeys(name for _, ids in parts for name in ids))
    return np.concatenate(
        [np.array([names.index(name) for name in ids])[codes] for codes, ids in parts]
    ), tuple(names)
