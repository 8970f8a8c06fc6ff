"""Ephemerides as CCSDS Orbit Ephemeris Messages (502.0-B-3, keyword form): states in GCRS, interpolated."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from astropy import units as u
from astropy.time import Time, TimeDelta
from erfa import ErfaWarning

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.files.decimals import decimals
from torchlc.files.encodings import wide_encoding_of
from torchlc.files.reading import readable_file
from torchlc.geometry.orbit import earth
from torchlc.geometry.orbit.ephemeris_polynomials import CELLS_PER_REVOLUTION, REACH_S, STENCIL
from torchlc.geometry.orbit.motion import GM_EARTH, inverse_semi_major_axis

NODES = 4
"""States that fix a polynomial with their velocities: degree 7. At 10 min between states of a low orbit it
is some ten metres off, at 2 min less than SGP4 and its own velocities differ."""
LONGEST_TURN = np.pi / 2
"""Between states, rad. A circle of radius r through states h rad apart is left by r h^8 / 128000 (degree 7, middle of
four states): 0.02 degrees seen from the Earth's centre at a quarter of a revolution, 0.2 at a third.
"""
LOWEST_KM = 6350.0
"""From the Earth's centre; the poles are at 6357 km."""
CELESTIAL = ("EME2000", "J2000", "GCRF", "ICRF")
"""Taken as GCRS: the bias of EME2000, 0.02 arcsec, is neglected."""
SCALES = {"UTC": "utc", "TAI": "tai", "TT": "tt", "TDB": "tdb", "GPS": "tai"}
GPS_BEHIND_TAI_S = 19.0
EPOCH = re.compile(r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))T(\d\d:\d\d:\d\d(?:\.\d*)?)Z?", re.ASCII)
MOST_STATES = 500_000
"""Nearly a year, one a minute."""
AROUND_DAYS = 0.5
"""Of the rows: states further away are left."""
EXPECTED = "an Orbit Ephemeris Message in keywords (CCSDS_OEM_VERS = ...)"


@dataclass(frozen=True)
class Segment:
    """States (N,) that one motion joins: ``seconds`` since the origin, km and km/s in GCRS; usable from
    ``start`` to ``stop``, s.
    """

    seconds: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    start: float
    stop: float

    def turn_between(self, seconds: np.ndarray) -> tuple[float, float]:
        """Largest angle, rad, and time, s, from state to state around instants (T,) of this segment."""
        inside = seconds[(seconds >= self.start) & (seconds <= self.stop)]
        if not inside.size:
            return 0.0, 0.0
        left = np.clip(np.searchsorted(self.seconds, inside, side="right") - 1, 0, len(self.seconds) - 2)
        gap = np.diff(self.seconds)[left]
        area = np.linalg.norm(np.cross(self.position, self.velocity), axis=-1)
        rate = area / np.sum(self.position**2, axis=-1)
        turn = gap * np.maximum(rate[left], rate[left + 1])
        return float(turn.max()), float(gap[turn.argmax()])

    def at(self, seconds: np.ndarray) -> np.ndarray:
        """Positions (T, 3) by Hermite's polynomial through the nearest states; carried on beyond the ends."""
        from scipy.interpolate import KroghInterpolator  # loads for 0.1 s: only where there is a table

        nodes = min(NODES, len(self.seconds))
        first = np.searchsorted(self.seconds, seconds) - nodes // 2
        first = np.clip(first, 0, len(self.seconds) - nodes)
        positions = np.empty((len(seconds), 3))
        for start in np.unique(first):
            rows, window = first == start, slice(start, start + nodes)
            middle = self.seconds[window].mean()
            values = np.empty((2 * nodes, 3))
            values[::2], values[1::2] = self.position[window], self.velocity[window]
            polynomial = KroghInterpolator(np.repeat(self.seconds[window] - middle, 2), values)
            positions[rows] = polynomial(seconds[rows] - middle)
        return positions


class Ephemeris:
    """The states of a file near the rows at ``time``, as a source of positions in GCRS.

    Within a segment Hermite interpolation, whatever the file recommends; of overlapping segments the later.
    """

    def __init__(self, path: Path, time: Time) -> None:
        self.path = path
        self._origin: Any = time[0]
        self._segments = _segments(path, time)
        position = np.concatenate([segment.position for segment in self._segments])
        velocity = np.concatenate([segment.velocity for segment in self._segments])
        inverse = inverse_semi_major_axis(torch.from_numpy(position), torch.from_numpy(velocity)).numpy()
        if not (inverse > 0).all():
            raise InputError(path, None, "states that are not of an orbit about the Earth", "km and km/s")
        if (np.linalg.norm(position, axis=-1) < LOWEST_KM).any():
            raise InputError(path, None, "a state inside the Earth", "km and km/s from its centre")
        self.mean_motion = float(np.median(np.sqrt(GM_EARTH * inverse**3)))
        turning = np.linalg.norm(np.cross(position, velocity), axis=-1) / np.sum(position**2, axis=-1)
        self.step_s = float(2 * np.pi / turning.max() / CELLS_PER_REVOLUTION)

    def positions(self, time: Time) -> tuple[np.ndarray, np.ndarray]:
        """Positions in GCRS, km, (T, 3), and 0, or 1 where the file says nothing, (T,). A few cells beyond
        its ends the outermost polynomials go on.
        """
        seconds = _elapsed(time, self._origin)
        position, codes = np.full((len(seconds), 3), np.nan), np.ones(len(seconds), dtype=int)
        edge = (STENCIL[-1] + 1) * self.step_s
        for margin in (edge, 0.0):
            for segment in self._segments:
                rows = (seconds >= segment.start - margin) & (seconds <= segment.stop + margin)
                position[rows], codes[rows] = segment.at(seconds[rows]), 0
        return position, codes

    def refuse(self, time: Time, codes: np.ndarray) -> None:
        """Nothing: rows are checked, and offsets that lead beyond the file have no position."""

    def check(self, time: Time) -> None:
        """Raise InputError at the first of the rows' times that lies in no segment, or between states too far
        apart to tell the way between them.
        """
        seconds = _elapsed(time, self._origin)
        covered = np.zeros(len(seconds), dtype=bool)
        for segment in self._segments:
            covered |= (seconds >= segment.start) & (seconds <= segment.stop)
        if not covered.all():
            moments = cast(Any, time.utc).isot
            found = f"no state at {moments[np.flatnonzero(~covered)[0]]} UTC"
            raise InputError(self.path, None, found, "an ephemeris of the time of the recording")
        for segment in self._segments:
            turn, gap = segment.turn_between(seconds)
            if turn > LONGEST_TURN:
                found = f"states {gap / 60:.0f} minutes apart, {turn / (2 * np.pi):.2f} revolutions"
                expected = f"at most {LONGEST_TURN / (2 * np.pi):.2f} of a revolution from state to state"
                raise InputError(self.path, None, found, expected)


def _segments(path: Path, time: Time) -> list[Segment]:
    segments = []
    for meta, lines in _blocks(path):
        scale = SCALES.get(meta.get("TIME_SYSTEM", "").upper())
        if scale is None:
            raise InputError(
                path, "TIME_SYSTEM", repr(meta.get("TIME_SYSTEM", ""))[:40], f"one of {', '.join(SCALES)}"
            )
        if meta.get("CENTER_NAME", "").upper() != "EARTH":
            raise InputError(path, "CENTER_NAME", repr(meta.get("CENTER_NAME", ""))[:40], "EARTH")
        late = GPS_BEHIND_TAI_S if meta["TIME_SYSTEM"].upper() == "GPS" else 0.0
        times = _times(path, [(number, cells[0]) for number, cells in lines], scale, late)
        origin: Any = time[0]
        seconds, rows = _elapsed(times, origin), _elapsed(time, origin)
        states = _states(path, lines)
        if (np.diff(seconds) <= 0).any():
            place = f"line {lines[int(np.flatnonzero(np.diff(seconds) <= 0)[0]) + 1][0]}"
            raise InputError(path, place, "a time not after the one before", "states in order of time")
        span = [seconds[0], seconds[-1]]
        for i, key in enumerate(("USEABLE_START_TIME", "USEABLE_STOP_TIME")):
            if key in meta:
                span[i] = float(_elapsed(_times(path, [(0, meta[key])], scale, late), origin)[0])
        margin = AROUND_DAYS * 86400 + REACH_S
        near = np.flatnonzero((seconds >= rows.min() - margin) & (seconds <= rows.max() + margin))
        if len(near) >= 2:
            position, velocity = _in_gcrs(path, meta, cast(Time, times[near]), states[near])
            kept = seconds[near]
            segments.append(Segment(kept, position, velocity, max(span[0], kept[0]), min(span[1], kept[-1])))
    if not segments:
        raise InputError(path, None, "no states near the recording", "an ephemeris of its time")
    return segments


def _blocks(path: Path) -> Iterator[tuple[Mapping[str, str], list[tuple[int, list[str]]]]]:
    """Metadata and data lines (number, cells) of every segment; covariances are left."""
    readable_file(path, EXPECTED)
    meta: dict[str, str] = {}
    lines: list[tuple[int, list[str]]] = []
    total, section = 0, "header"
    with path.open(encoding=wide_encoding_of(path) or "utf-8", errors="replace") as stream:
        for number, line in enumerate(stream, 1):
            text = line.strip()
            if number == 1 and not text.lstrip("\ufeff").startswith("CCSDS_OEM_VERS"):
                raise InputError(path, "line 1", repr(text[:40]), EXPECTED)
            if (
                not text
                or text.startswith("COMMENT")
                or (section == "covariance" and text != "COVARIANCE_STOP")
            ):
                continue
            if text == "META_START":
                if lines:
                    yield meta, lines
                meta, lines, section = {}, [], "meta"
            elif text in ("META_STOP", "COVARIANCE_STOP"):
                section = "data"
            elif text == "COVARIANCE_START":
                section = "covariance"
            elif section in ("header", "meta"):
                key, equals, value = text.partition("=")
                if not equals:
                    raise InputError(path, f"line {number}", repr(text[:40]), "KEYWORD = value")
                meta[key.strip().upper()] = value.strip()
            else:
                cells = text.split()
                if len(cells) not in (7, 10):
                    raise InputError(
                        path, f"line {number}", number_of(len(cells), "value"), "a time, 3 km and 3 km/s"
                    )
                lines.append((number, cells))
                total += 1
                if total > MOST_STATES:
                    raise InputError(
                        path, None, f"more than {MOST_STATES:,} states", f"at most {MOST_STATES:,}"
                    )
    if lines:
        yield meta, lines


def _times(path: Path, texts: list[tuple[int, str]], scale: str, late_s: float) -> Time:
    plain = []
    for number, text in texts:
        match = EPOCH.fullmatch(text)
        if match is None:
            place = f"line {number}" if number else None
            raise InputError(path, place, repr(text[:40]), "a time such as 2024-01-01T00:00:00.000")
        year, month, day, day_of_year, clock = match.groups()
        date = f"{year}-{month}-{day}" if month else _calendar(path, year, day_of_year)
        plain.append(f"{date}T{clock.rstrip('.')}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ErfaWarning)
            times = Time(np.array(plain), format="isot", scale=scale)
            return cast(Time, times + TimeDelta(late_s, format="sec") if late_s else times)
    except ValueError as error:
        raise InputError(
            path, None, f"a time that does not exist ({error})"[:200], "calendar dates"
        ) from None


def _calendar(path: Path, year: str, day_of_year: str) -> str:
    date = np.datetime64(f"{year}-01-01") + np.timedelta64(int(day_of_year) - 1, "D")
    if not str(date).startswith(year):
        raise InputError(path, None, f"day {day_of_year} of {year}", "a day of the year")
    return str(date)


def _states(path: Path, lines: list[tuple[int, list[str]]]) -> np.ndarray:
    """(N, 6), km and km/s."""
    states = np.empty((len(lines), 6))
    for row, (number, cells) in enumerate(lines):
        try:
            states[row] = decimals(cells[1:7])
        except ValueError:
            raise InputError(path, f"line {number}", repr(" ".join(cells[1:7])[:60]), "six numbers") from None
    if not (np.abs(states) < 1e9).all():
        number = lines[int(np.flatnonzero(~(np.abs(states) < 1e9).all(-1))[0])][0]
        raise InputError(path, f"line {number}", "a state that is not finite", "km and km/s")
    return states


def _in_gcrs(
    path: Path, meta: Mapping[str, str], time: Time, states: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (N, 3) along the axes of GCRS."""
    frame = meta.get("REF_FRAME", "").upper()
    position, velocity = states[:, :3], states[:, 3:]
    if re.fullmatch(rf"({'|'.join(CELESTIAL)})\d?", frame):
        return position, velocity
    if frame != "TEME" and not re.fullmatch(r"ITRF[- ]?(\d{2}|\d{4})?", frame):
        raise InputError(path, "REF_FRAME", repr(frame[:40]), f"{', '.join(CELESTIAL)}, TEME or ITRF")
    oriented = earth.orientation(time)
    turn = oriented.gcrs_from_teme if frame == "TEME" else oriented.gcrs_from_itrs
    position, velocity = (np.einsum("tij,tj->ti", turn, vector) for vector in (position, velocity))
    if frame != "TEME":
        velocity = velocity + earth.ROTATION_RATE * np.cross(oriented.axis, position)
    return position, velocity


def _elapsed(time: Time, origin: Time) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ErfaWarning)
        return np.asarray((time - origin).to_value(u.s))
