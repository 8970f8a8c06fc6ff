"""How rows belong together: order of time, repeated rows, curves, nights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

NIGHT_GAP_DAYS = 6 / 24
NOON_OF_2000_JAN_1 = 2451545


def time_order(days: np.ndarray) -> np.ndarray | None:
    """Stable order (T,) of two-part Julian dates (T, 2), or None if they are in order."""
    whole = np.floor(days.sum(-1))
    rest = (days[:, 0] - whole) + days[:, 1]
    step = np.diff(whole)
    if not ((step < 0) | ((step == 0) & (np.diff(rest) < 0))).any():
        return None
    return np.lexsort((rest, whole))


def repeats(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """(T,) true for rows, in order of time, that equal an earlier row in every column."""
    time = columns["time"].sum(-1)
    tied, equal = np.zeros(len(time), dtype=bool), time[1:] == time[:-1]
    tied[1:] |= equal
    tied[:-1] |= equal
    index = np.flatnonzero(tied)
    repeated = np.zeros(len(time), dtype=bool)
    if index.size:
        rows = [column[index].reshape(len(index), -1).astype(np.float64) for column in columns.values()]
        _, first = np.unique(np.concatenate(rows, axis=-1), axis=0, return_index=True)
        repeated[index] = True
        repeated[index[first]] = False
    return repeated


def medians(values: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """The median (T,) of the finite values (T,) of each row's ``curve`` (T,); that of all rows in a curve without any."""
    finite = np.isfinite(values)
    result = np.full(len(values), np.median(values[finite]) if finite.any() else np.nan)
    for code in np.unique(curve[finite]):
        rows = curve == code
        result[rows] = np.median(values[rows & finite])
    return result


def compact(codes: np.ndarray, ids: Sequence[str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Indices (T,) into ``ids`` renumbered so that every id left is in use; equal ids of different codes are
    numbered, "a" and "a (2)"."""
    used, renumbered = np.unique(codes, return_inverse=True)
    distinct: dict[str, None] = {}
    for code in used:
        name, copy = str(ids[code]), 2
        while name in distinct:
            name, copy = f"{ids[code]} ({copy})", copy + 1
        distinct[name] = None
    return renumbered.astype(np.int64), tuple(distinct)


def local_nights(
    jd: np.ndarray, longitude: np.ndarray, station: np.ndarray, station_ids: Sequence[str]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Local noon to noon of each row's station (east ``longitude`` in deg), named after the evening's date.

    With rows of several stations a night belongs to one: "weihai 2020-10-17".
    """
    noon = np.floor(jd + longitude[station] / 360).astype(np.int64)
    keys, night = np.unique(np.stack([noon, station], axis=-1), axis=0, return_inverse=True)
    several = len(np.unique(station)) > 1
    ids = []
    for day, index in keys:
        date = np.datetime64("2000-01-01") + np.timedelta64(int(day) - NOON_OF_2000_JAN_1, "D")
        ids.append(f"{station_ids[index]} {date}" if several else str(date))
    return night.reshape(-1).astype(np.int64), tuple(ids)


def nights_between_gaps(jd: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Runs of rows, in order of time, without a gap of over 6 h; named after the minute they start in."""
    night = np.concatenate([[0], np.cumsum(np.diff(jd) > NIGHT_GAP_DAYS)]).astype(np.int64)
    starts = np.flatnonzero(np.diff(night, prepend=-1))
    minutes = np.floor((jd[starts] - (NOON_OF_2000_JAN_1 - 0.5)) * 1440 + 1e-3).astype(np.int64)
    dates = np.datetime64("2000-01-01T00:00") + minutes.astype("timedelta64[m]")
    return night, tuple(map(str, dates))


def between_directions(
    columns: Mapping[str, np.ndarray], before: np.ndarray, after: np.ndarray, share: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Altitude and azimuth (N,), deg, of the directions a ``share`` (N,) of the chord from those of the rows ``before``
    (N,) to those of ``after`` (N,)."""
    alt, az = np.radians(columns["alt"]), np.radians(columns["az"])
    towards = np.stack([np.cos(alt) * np.cos(az), np.cos(alt) * np.sin(az), np.sin(alt)], -1)
    x, y, z = ((1 - share)[:, None] * towards[before] + share[:, None] * towards[after]).T
    return np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x)) % 360.0
