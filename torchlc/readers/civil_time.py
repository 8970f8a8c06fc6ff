"""Civil times of a zone, as two-part Julian dates of UTC."""

from __future__ import annotations

import datetime
import zoneinfo

import numpy as np

from torchlc.scene.reading import OFFSET
from torchlc.scene.timestamps import UnreadableTime

JD_OF_1970 = 2440587.5
QUARTER_HOURS = 96
"""In a day: no zone has changed its offset within a quarter of an hour's minutes since 1972."""


def to_utc(jd1: np.ndarray, jd2: np.ndarray, zone: str) -> tuple[np.ndarray, np.ndarray]:
    """Two-part Julian dates (T,) read as if they were UTC, less the zone's offset.

    Raises UnreadableTime at a time that a change of the clocks skips or repeats: nothing tells which is meant.
    """
    match = OFFSET.fullmatch(zone)
    if match:
        minutes = int(match[1] + "1") * (int(match[2]) * 60 + int(match[3] or 0))
        return jd1, jd2 - minutes / 1440.0
    rules = zoneinfo.ZoneInfo(zone)
    finite = np.isfinite(jd1 + jd2)
    days = np.where(finite, (jd1 - JD_OF_1970) + jd2, 0.0)
    quarters, where = np.unique(np.floor(days * QUARTER_HOURS + 1e-6), return_inverse=True)
    offsets = np.empty(len(quarters))
    for index, quarter in enumerate(quarters):
        clock = datetime.datetime(1970, 1, 1) + datetime.timedelta(days=quarter / QUARTER_HOURS)
        early, late = (clock.replace(tzinfo=rules, fold=fold).utcoffset() for fold in (0, 1))
        if early is None or early != late:
            row = int(np.flatnonzero(where == index)[0])
            expected = f"a time that the clocks of {zone} show once; give an offset such as time_zone=+02:00"
            raise UnreadableTime(row, clock.isoformat(" "), expected)
        offsets[index] = early.total_seconds() / 86400.0
    return jd1, jd2 - offsets[where]
