"""When objects pass over stations in the dark: rise, highest point, set, and the Earth's shadow on the way.

Numpy on one grid of times for all objects: the Earth's orientation and the Sun are worked out once. Letters: K instants of
the grid, S stations, R rows of one pass.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

import numpy as np
import torch
from astropy.time import Time
from astropy.utils import iers
from astropy.utils.exceptions import AstropyWarning
from erfa import ErfaWarning

from torchlc.errors import InputError, option
from torchlc.geometry.orbit import shadow_coordinate
from torchlc.geometry.orbit.earth import (
    Orientation,
    after,
    horizontal_itrs,
    in_scale,
    orientation,
    station_itrs,
    sun_of_earth,
)
from torchlc.geometry.orbit.elements import along_track_error_deg
from torchlc.scene import Station

COARSE_S = 30.0
"""Steps at which passes are looked for. They are found by samples above ``FLOOR_DEG`` or 5 deg below the least elevation:
the lowest orbits take 45 s from 5 to 10 deg, and what culminates between has slowed down."""
FLOOR_DEG, BELOW_DEG = 5.0, 5.0
MOST_ROWS = 240
"""Rows of one pass; objects that stay up all night are sampled more coarsely than the grid."""
AIR_KM = 20.0
"""Opaque air over the Earth at the edges of the shadow, as in the effect earth_shadow."""
BEGINS = {"rise": "rises", "dark": "the night begins", "span": "the span begins"}
ENDS = {"rise": "sets", "dark": "the night ends", "span": "the span ends"}


class Places(Protocol):
    """Where an object is at any time."""

    @property
    def mean_motion(self) -> float:
        """Radians per second."""
        ...

    def positions(self, time: Time) -> tuple[np.ndarray, np.ndarray]:
        """Positions, km, (T, 3), and codes (T,), 0 where there is one."""
        ...

    def check(self, time: Time) -> None:
        """Raise InputError at the first of the times for which there is no orbit."""
        ...


@dataclass(frozen=True)
class Orbiter:
    """An object with its orbit; positions are in GCRS where ``celestial``, else in TEME. ``age_days``: the time from the
    epoch of its elements to the span, None where it has none."""

    name: str
    number: str | None
    places: Places
    celestial: bool = False
    age_days: float | None = None


@dataclass(frozen=True)
class Span:
    """A grid of times, ``seconds`` (K,) after the first, with the Earth's orientation, the Sun (K, 3) km from the Earth's
    centre in GCRS, and by station its place (S, 3), up, north, east (S, 3) in ITRS and the Sun's elevation (S, K), deg."""

    time: Time
    seconds: np.ndarray
    cadence_s: float
    frame: Orientation
    sun: np.ndarray
    stations: tuple[Station, ...]
    place: np.ndarray
    up: np.ndarray
    north: np.ndarray
    east: np.ndarray
    sun_elevation: np.ndarray

    def into_itrs(self, vector: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Vectors (N, 3) of GCRS at instants ``index`` (N,) of the grid, in ITRS."""
        return np.einsum("tji,tj->ti", self.frame.gcrs_from_itrs[index], vector)

    def into_gcrs(self, vector: np.ndarray, index: np.ndarray) -> np.ndarray:
        return np.einsum("tij,tj->ti", self.frame.gcrs_from_itrs[index], vector)


@dataclass(frozen=True)
class Pass:
    """One object over one station, above the least elevation and in the dark.

    ``begin`` and ``end``, s after the start of the span, with what happens there; ``top``, s, and its elevation and azimuth,
    deg. Rows (R,): ``index`` into the grid, ``position`` and ``velocity`` (R, 3), km and km/s in GCRS, ``elevation``,
    ``azimuth``, ``phase_angle``, deg, ``range_km``, and ``shadow``, the coordinate that is -1 at the edge of the umbra and 1
    at that of the penumbra. ``events``: seconds and words of entry and exit.
    """

    orbiter: int
    station: int
    begin: float
    begins: str
    end: float
    ends: str
    top: float
    top_elevation: float
    top_azimuth: float
    index: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    elevation: np.ndarray
    azimuth: np.ndarray
    range_km: np.ndarray
    phase_angle: np.ndarray
    shadow: np.ndarray
    events: tuple[tuple[float, str], ...] = field(default=())

    @property
    def lit(self) -> np.ndarray:
        """Rows (R,) that at least a part of the Sun reaches."""
        return self.shadow > -1.0


def make_span(first: Time, hours: float, cadence_s: float, stations: Sequence[Station]) -> Span:
    """The grid of ``hours`` from ``first`` every ``cadence_s`` seconds over these stations."""
    count = int(np.floor(hours * 3600.0 / cadence_s * (1 + 1e-12))) + 1
    seconds = np.arange(count) * cadence_s
    with warnings.catch_warnings(), iers.conf.set_temp("auto_download", False):
        warnings.simplefilter("ignore", AstropyWarning)
        warnings.simplefilter("ignore", ErfaWarning)
        time = in_scale(after(first, seconds), "utc")
        frame, (sun, _) = orientation(time), sun_of_earth(time)
    place = station_itrs(*np.array([[s.latitude, s.longitude, s.height] for s in stations], dtype=float).T)
    up, north, east = (
        horizontal_itrs(place, np.full(len(place), altitude), np.full(len(place), azimuth))
        for altitude, azimuth in ((90.0, 0.0), (0.0, 0.0), (0.0, 90.0))
    )
    sun_itrs = np.einsum("tji,tj->ti", frame.gcrs_from_itrs, sun)
    to_sun = sun_itrs[None] - place[:, None]
    sine = np.einsum("ski,si->sk", to_sun, up) / np.linalg.norm(to_sun, axis=-1)
    return Span(
        time,
        seconds,
        cadence_s,
        frame,
        sun,
        tuple(stations),
        place,
        up,
        north,
        east,
        np.degrees(np.arcsin(sine)),
    )


def find_passes(
    span: Span, orbiter: Orbiter, number: int, *, elevation_deg: float, sun_deg: float
) -> list[Pass]:
    """Passes of one object, numbered ``number``, above ``elevation_deg`` while the Sun is below ``sun_deg``.

    Raises InputError where the elements give no position. What is up for less than the grid's cadence is not found. Edges
    are interpolated by parabolas through three instants of the grid: within 0.1 s at 10 s for low orbits.
    """
    dark = span.sun_elevation < sun_deg
    stride = max(1, int(COARSE_S // span.cadence_s))
    coarse = np.arange(0, len(span.seconds), stride)
    near_dark = np.zeros(len(coarse), dtype=bool)
    for k in range(stride):
        near_dark |= dark[:, np.minimum(coarse + k, len(span.seconds) - 1)].any(axis=0)
    coarse = coarse[near_dark]
    if not len(coarse):
        return []
    ends = cast(Time, span.time[[coarse[0], coarse[-1]]])
    orbiter.places.check(ends)
    floor = min(FLOOR_DEG, elevation_deg - BELOW_DEG)
    position = _positions(span, orbiter, coarse)
    found = []
    for station in range(len(span.stations)):
        height, _, _ = _horizontal(span, station, position, coarse)
        for low, high in _runs(height > floor, coarse, stride):
            fine = np.arange(max(low - stride, 0), min(high + stride, len(span.seconds) - 1) + 1)
            found += _fine_passes(span, orbiter, number, station, fine, elevation_deg, sun_deg)
    return found


def _positions(span: Span, orbiter: Orbiter, index: np.ndarray) -> np.ndarray:
    """Places (N, 3), km in GCRS, at instants of the grid."""
    position, _ = orbiter.places.positions(cast(Time, span.time[index]))
    if orbiter.celestial:
        return position
    return np.einsum("tij,tj->ti", span.frame.gcrs_from_teme[index], position)


def _velocity(position: np.ndarray, step_s: float) -> np.ndarray:
    """Time derivative (N, 3) of places at even steps by central differences of fourth order, of second order near the
    ends: within 1e-7 and 2e-4 km/s at 10 s in a low orbit, where SGP4's own velocity is up to 3e-3 off its places.
    """
    if len(position) < 3:
        return np.gradient(position, step_s, axis=0) if len(position) > 1 else np.zeros_like(position)
    found = np.gradient(position, step_s, axis=0, edge_order=2)
    inner = 8 * (position[3:-1] - position[1:-3]) - (position[4:] - position[:-4])
    found[2:-2] = inner / (12 * step_s)
    return found


def _horizontal(
    span: Span, station: int, position: np.ndarray, index: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Elevation and azimuth, deg, and range, km, (N,), of places (N, 3) of GCRS."""
    sight = span.into_itrs(position, index) - span.place[station]
    distance = np.linalg.norm(sight, axis=-1)
    elevation = np.degrees(np.arcsin(sight @ span.up[station] / distance))
    azimuth = np.degrees(np.arctan2(sight @ span.east[station], sight @ span.north[station])) % 360.0
    return elevation, azimuth, distance


def _runs(mask: np.ndarray, index: np.ndarray, stride: int) -> Iterator[tuple[int, int]]:
    """First and last of each run of ``index`` (N,) for which ``mask`` holds; a gap in the index ends a run."""
    chosen = index[mask]
    if len(chosen):
        breaks = np.flatnonzero(np.diff(chosen) > stride)
        starts, stops = chosen[np.append(0, breaks + 1)], chosen[np.append(breaks, len(chosen) - 1)]
        yield from zip(starts.tolist(), stops.tolist(), strict=True)


def _fine_passes(
    span: Span,
    orbiter: Orbiter,
    number: int,
    station: int,
    fine: np.ndarray,
    elevation_deg: float,
    sun_deg: float,
) -> Iterator[Pass]:
    position = _positions(span, orbiter, fine)
    elevation, azimuth, distance = _horizontal(span, station, position, fine)
    above, night = elevation - elevation_deg, sun_deg - span.sun_elevation[station, fine]
    seconds = span.seconds[fine]
    velocity = _velocity(position, span.cadence_s)
    for low, high in _runs((above > 0) & (night > 0), np.arange(len(fine)), 1):
        begin, begins = _edge(seconds, above, night, low, -1)
        end, ends = _edge(seconds, above, night, high, 1)
        top, sine = _summit(seconds, np.sin(np.radians(elevation)), low, high)
        top = float(np.clip(top, begin, end))
        summit = low + int(np.argmax(elevation[low : high + 1]))
        rows = np.arange(low, high + 1)
        shadow = _shadow(span, position[rows], fine[rows])
        events = tuple(_events(seconds[rows], shadow))
        rows = rows[:: -(-len(rows) // MOST_ROWS)]
        sun = span.sun[fine[rows]] - position[rows]
        observer = (
            span.into_gcrs(np.broadcast_to(span.place[station], (len(rows), 3)), fine[rows]) - position[rows]
        )
        yield Pass(
            orbiter=number,
            station=station,
            begin=begin,
            begins=BEGINS[begins],
            end=end,
            ends=ENDS[ends],
            top=top,
            top_elevation=float(np.degrees(np.arcsin(min(sine, 1.0)))),
            top_azimuth=float(np.interp(top, seconds, np.degrees(np.unwrap(np.radians(azimuth)))) % 360.0)
            if high > low
            else float(azimuth[summit]),
            index=fine[rows],
            position=position[rows],
            velocity=velocity[rows],
            elevation=elevation[rows],
            azimuth=azimuth[rows],
            range_km=distance[rows],
            phase_angle=_angle_deg(sun, observer),
            shadow=_shadow(span, position[rows], fine[rows]),
            events=events,
        )


def _edge(
    seconds: np.ndarray, above: np.ndarray, night: np.ndarray, place: int, side: int
) -> tuple[float, str]:
    """When a run that ends at ``place`` on this ``side`` begins or ends, s, and why."""
    beyond = place + side
    if not 0 <= beyond < len(seconds):
        return float(seconds[place]), "span"
    reached = {"rise": above, "dark": night}
    times = {
        why: _crossing(seconds, values, place, beyond)
        for why, values in reached.items()
        if values[beyond] <= 0
    }
    why = (max if side < 0 else min)(times, key=lambda one: times[one])
    return times[why], why


def _crossing(seconds: np.ndarray, values: np.ndarray, inside: int, beyond: int) -> float:
    """Where values pass 0 between two neighbouring instants: by the parabola through these and the next inside."""
    further = 2 * inside - beyond
    step = seconds[inside] - seconds[beyond]
    a, b = values[beyond], values[inside]
    bend = 0.0
    if 0 <= further < len(values):
        bend = 0.5 * (values[further] - 2 * b + a)
    share = -a / (b - a) if b > a else 1.0
    for _ in range(4):  # a + (b - a) x + bend x (x - 1): Newton's method from the chord
        value = a + (b - a) * share + bend * share * (share - 1)
        slope = (b - a) + bend * (2 * share - 1)
        share = float(np.clip(share - value / slope, 0.0, 1.0)) if slope > 0 else share
    return float(seconds[beyond] + share * step)


def _summit(seconds: np.ndarray, values: np.ndarray, low: int, high: int) -> tuple[float, float]:
    """Where values between two places are largest, and how large, by the parabola about the largest."""
    k = low + int(np.argmax(values[low : high + 1]))
    if not 0 < k < len(values) - 1:
        return float(seconds[k]), float(values[k])
    before, here, later = values[k - 1], values[k], values[k + 1]
    bend = before - 2 * here + later
    if bend >= 0:
        return float(seconds[k]), float(here)
    share = float(np.clip(0.5 * (before - later) / bend, -1.0, 1.0))
    return float(seconds[k] + share * (seconds[k + 1] - seconds[k])), float(
        here - 0.25 * (before - later) * share
    )


def _shadow(span: Span, position: np.ndarray, index: np.ndarray) -> np.ndarray:
    """The shadow coordinate (N,): -1 at the edge of the umbra, 1 at that of the penumbra."""
    sun = torch.from_numpy(span.sun[index] - position)
    return shadow_coordinate(torch.from_numpy(position), sun, AIR_KM).t.numpy()


def _events(seconds: np.ndarray, shadow: np.ndarray) -> Iterator[tuple[float, str]]:
    """Entries and exits in order of time, by straight lines between instants: at 10 s within 0.05 s in low orbits."""
    found = []
    for level, part in ((1.0, "penumbra"), (-1.0, "umbra")):
        side = shadow - level
        for k in np.flatnonzero((side[1:] > 0) != (side[:-1] > 0)):
            share = side[k] / (side[k] - side[k + 1])
            word = "enters" if side[k] > 0 else "leaves"
            found.append((float(seconds[k] + share * (seconds[k + 1] - seconds[k])), f"{word} {part}"))
    return iter(sorted(found))


def _angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))


def no_station(source: Any) -> InputError:
    return InputError(
        source,
        "stations",
        "none",
        "the place of the observer",
        f"Give {option('station', 'ID,LAT,LON,HEIGHT', argument='stations')}.",
    )


def along_track_sd_s(orbiter: Orbiter) -> float:
    """How far ahead or behind on its way an object may be, s: the geometric mean of the likely least and largest error
    of elements of this age; 0 for an ephemeris."""
    if orbiter.age_days is None:
        return 0.0
    low, high = along_track_error_deg(orbiter.age_days)
    return math.radians(math.sqrt(low * high)) / orbiter.places.mean_motion
