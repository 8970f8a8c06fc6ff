"""Rows to simulate where nothing has been recorded: a regular grid of times at the scene's stations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from torchlc.errors import InputError, option
from torchlc.geometry.orbit.earth import after, in_scale, julian_dates
from torchlc.readers import Recording
from torchlc.readers.groups import compact, local_nights
from torchlc.readers.table import MAX_ROWS
from torchlc.scene.timestamps import UnreadableTime, instant

if TYPE_CHECKING:
    from torchlc.scene import Scene


def observation_grid(
    scene: Scene, start: str | float, hours: float, cadence_s: float, station: str | None = None
) -> Recording:
    """A recording of times only, ``observed`` not-a-number, for ``hours`` from ``start`` (ISO UTC or JD).

    Both ends are included. At every station of the scene, or at the one named; each is a curve of its own.
    Rows may be below the horizon.
    """
    if not scene.orbit.known:
        raise InputError(
            scene.source,
            "orbit",
            "no TLE and no ephemeris",
            "tle, tle_file or oem_file, or a recording to take the geometry from",
        )
    if not (np.isfinite(hours) and hours > 0 and np.isfinite(cadence_s) and cadence_s > 0):
        raise InputError(
            None,
            f"{option('hours')}, {option('cadence')}",
            f"{hours:g} h every {cadence_s:g} s",
            "numbers > 0",
        )
    ids = tuple(site.id for site in scene.stations)
    if station is not None and station not in ids:
        raise InputError(
            None, option("station"), repr(station), f"one of {', '.join(ids) or 'none in the scene'}"
        )
    chosen = np.arange(len(ids)) if station is None else np.array([ids.index(station)])
    if not chosen.size:
        raise InputError(scene.source, "stations", "none", "the place of the observer")
    count = int(np.floor(hours * 3600.0 / cadence_s * (1 + 1e-12))) + 1
    if count * chosen.size > MAX_ROWS:
        raise InputError(None, option("cadence"), f"{count * chosen.size:,} rows", f"at most {MAX_ROWS:,}")
    try:
        first = instant(start, "utc")
    except UnreadableTime as error:
        raise InputError(None, option("start"), repr(error.found), error.expected) from None
    elapsed = np.repeat(np.arange(count) * float(cadence_s), chosen.size)
    time = in_scale(after(first, elapsed), "utc")
    places = np.tile(chosen, count)
    longitudes = np.array([site.longitude for site in scene.stations])
    night, night_ids = local_nights(np.add(*julian_dates(time, "utc")), longitudes, places, ids)
    curve, curve_ids = compact(places, ids)
    return Recording(
        time=time,
        seconds=elapsed,
        first_time=first,
        kind="mag",
        observed=np.full(elapsed.size, np.nan),
        error=None,
        station=places,
        station_ids=ids,
        curve=curve,
        curve_ids=curve_ids,
        night=night,
        night_ids=night_ids,
        upper_limit=np.zeros(elapsed.size, dtype=bool),
    )
