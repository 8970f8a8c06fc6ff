"""Passes of objects over stations with their light, the times of their moments and the names of their objects.

Letters: R rows of a pass, Q quantiles of :data:`~torchlc.prediction.brightness.LEVELS`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from torchlc.geometry.orbit.earth import after, in_scale
from torchlc.prediction.glints import Glint
from torchlc.prediction.passes import Orbiter, Pass, Span, along_track_sd_s


@dataclass(frozen=True)
class PredictedPass:
    """A pass with its light: ``mag`` (Q, R), infinite where no light comes, ``brightest`` (Q,) of the pass's brightest row,
    and the ``row`` that is brightest at the median, None if all is dark."""

    path: Pass
    mag: np.ndarray
    brightest: np.ndarray
    row: int | None
    glints: Sequence[Glint] = ()

    @property
    def visible(self) -> bool:
        return self.row is not None


@dataclass(frozen=True)
class PredictedPasses:
    """Passes of objects over stations, brightest first, and how they were asked for."""

    name: str
    span: Span
    orbiters: Sequence[Orbiter]
    passes: Sequence[PredictedPass]
    uncertainty: str
    """Where the intervals come from: "posterior", "priors" or "none", to which the scatter is added."""
    draws: int
    scatter_mag: float
    extinction: float
    elevation_deg: float
    sun_deg: float
    faintest_mag: float | None = None
    warnings: Sequence[str] = ()
    seed: int = 0
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def iso(self, seconds: float | np.ndarray) -> Any:
        """ISO UTC of seconds after the start of the span, to the millisecond."""
        seconds = np.asarray(seconds, dtype=float)
        if self._leaps:
            time: Any = in_scale(after(self.span.time[0], seconds), "utc")  # pyright: ignore[reportArgumentType]
            return time.isot
        milliseconds = np.rint(1e3 * (seconds + self._start[1])).astype(np.int64)
        found = (self._start[0] + milliseconds.astype("timedelta64[ms]")).astype(str)
        return found if found.ndim else str(found)

    @cached_property
    def _start(self) -> tuple[np.datetime64, float]:
        """The start of the span: its millisecond, and what is left, s."""
        first: Any = self.span.time[0]
        whole = first.copy(format="isot")
        whole.precision = 3
        return np.datetime64(whole.value, "ms"), float((first - type(first)(whole.value, scale="utc")).sec)

    @cached_property
    def _leaps(self) -> bool:
        """Is there a leap second in the span, which dates alone do not count?"""
        last: Any = self.span.time[-1]
        if ":60" in last.isot:
            return True
        elapsed = (np.datetime64(last.isot[:23], "ms") - self._start[0]) / np.timedelta64(1, "s")
        return abs(elapsed - self.span.seconds[-1]) > 0.5

    def time_sd_s(self, orbiter: Orbiter) -> float:
        """How far ahead or behind on its way an object may be, s: see :func:`along_track_sd_s`."""
        return along_track_sd_s(orbiter)

    def _name(self, one: PredictedPass) -> str:
        return self.orbiters[one.path.orbiter].name

    @cached_property
    def _shared_names(self) -> set[str]:
        """Names that several objects have, such as all rocket bodies of one kind."""
        counts = Counter(orbiter.name for orbiter in self.orbiters)
        return {name for name, count in counts.items() if count > 1}

    def _called(self, one: PredictedPass, most: int | None = None) -> str:
        """What a person tells the object by: its name, cut to ``most`` letters, with its number where others share that."""
        orbiter = self.orbiters[one.path.orbiter]
        if orbiter.name not in self._shared_names or not orbiter.number:
            return orbiter.name[:most]
        room = None if most is None else most - len(orbiter.number) - 1
        return f"{orbiter.name[:room].rstrip()} {orbiter.number}"

    def _station(self, one: PredictedPass) -> str:
        return self.span.stations[one.path.station].id
