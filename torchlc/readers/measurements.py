"""The measurements of a recording: one checked array per quantity."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self, cast

import astropy.units as u
import numpy as np
from astropy.time import Time
from erfa import ErfaWarning

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.readers.groups import compact


@dataclass(frozen=True, eq=False, repr=False)
class Measurements:
    """Rows of one recording in order of time; T rows, vectors (T, 3) km and km/s in ``frame``.

    ``seconds`` count from ``time[0]``; ``first_time`` is the first finite row of the file and stays when rows
    are dropped. ``station``, ``curve`` and ``night`` index ``station_ids``, ``curve_ids`` and ``night_ids``.
    ``object`` indexes ``object_ids`` where the recording says of which object each row is, else None.
    ``error`` is None when the errors have to be fitted. ``sun`` and ``obs`` go from the object to the Sun and
    to the observer; ``position`` and ``velocity`` are geocentric; ``alt`` and ``az`` are in degrees and
    ``height`` in km above the ellipsoid. ``dropped`` counts the rows left out by the reason; ``dropped_at`` says where these
    stand, and ``place`` (T,) where the others do: lines of ``source`` counted from 1, or rows where ``placed_by`` is "row". ``sha256`` is the hash of the bytes that were read from ``source``.
    """

    time: Time
    seconds: np.ndarray
    first_time: Time
    kind: str
    observed: np.ndarray
    error: np.ndarray | None
    station: np.ndarray
    station_ids: tuple[str, ...]
    curve: np.ndarray
    curve_ids: tuple[str, ...]
    night: np.ndarray
    night_ids: tuple[str, ...]
    upper_limit: np.ndarray
    exptime: np.ndarray | None = None
    band: np.ndarray | None = None
    object: np.ndarray | None = None
    object_ids: tuple[str, ...] = ()
    sun: np.ndarray | None = None
    obs: np.ndarray | None = None
    position: np.ndarray | None = None
    velocity: np.ndarray | None = None
    alt: np.ndarray | None = None
    az: np.ndarray | None = None
    height: np.ndarray | None = None
    frame: str | None = None
    light_time_corrected: bool = False
    meta: Mapping[str, Any] = field(default_factory=dict)
    dropped: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    source: Path | None = None
    sha256: str | None = None
    place: np.ndarray | None = None
    dropped_at: Mapping[str, np.ndarray] = field(default_factory=dict)
    placed_by: str = "line"

    def __len__(self) -> int:
        return len(self.observed)

    @property
    def error_source(self) -> str:
        """ "recording" when the file gives the errors, "fitted" when they must be found with the model."""
        return "fitted" if self.error is None else "recording"

    def check_measured(self) -> None:
        """Raise InputError unless every row has a finite value and, if errors are quoted, a finite one above 0. A recording
        from a file has; one that was made in memory, to say only when to look, need not."""
        for name, column, least in (
            (self.kind, self.observed, -np.inf),
            (f"{self.kind}_err", self.error, 0.0),
        ):
            if column is None:
                continue
            wrong = ~(np.isfinite(column) & (column > least))
            if wrong.any():
                row = int(np.argmax(wrong))
                raise InputError(
                    self.source,
                    f"row {row + 1} of {len(self)} ({iso_times(self)[row]}), {name}",
                    f"{column[row]:g}" + (f", as in {wrong.sum()} rows" if wrong.sum() > 1 else ""),
                    "finite numbers" + (" above 0" if column is self.error else ""),
                    "The magnitudes of a simulated curve are in its table: give simulate(..., noise=0.02).to_table(). "
                    "Recording.keep leaves rows out",
                )

    def keep(self, mask: np.ndarray, reason: str) -> Self:
        """The rows where ``mask`` (T,) is true; the others are counted in ``dropped`` under ``reason``."""
        lost = int(np.size(mask) - np.count_nonzero(mask))
        if not lost:
            return self
        dropped, dropped_at = (
            {**self.dropped, reason: self.dropped.get(reason, 0) + lost},
            dict(self.dropped_at),
        )
        if self.place is not None:
            before = dropped_at.get(reason, self.place[:0])
            dropped_at[reason] = np.union1d(before, self.place[~mask])
        if lost == len(self):
            raise no_usable_row(self.source, dropped)
        return replace(self._rows(np.flatnonzero(mask)), dropped=dropped, dropped_at=dropped_at)

    def _rows(self, index: np.ndarray) -> Self:
        arrays = {
            name: value[index]
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray) and name not in ("seconds", "curve", "night", "object")
        }
        curve, curve_ids = compact(self.curve[index], self.curve_ids)
        night, night_ids = compact(self.night[index], self.night_ids)
        time = cast(Time, self.time[index])
        objects, object_ids = self.object, self.object_ids
        if objects is not None:
            objects, object_ids = compact(objects[index], object_ids)
        return replace(
            self,
            **arrays,
            object=objects,
            object_ids=object_ids,
            time=time,
            seconds=seconds_since(time, cast(Time, time[:1])),
            curve=curve,
            curve_ids=curve_ids,
            night=night,
            night_ids=night_ids,
        )


MOST_RUNS = 6
"""Lines, or stretches of lines, that one sentence lists."""
REASONS = {
    "non-finite": "without a number",
    "marked as missing": "marked as missing, as by -99",
    "beyond 90 mag": "beyond 90 mag, which stands for no measurement",
    "duplicate": "the same as another",
}
"""Reasons for which rows are dropped that are said in other words than they are counted under."""
KEPT_IF = {
    "non-finite": ("with finite numbers", "A row is left out if a cell is blank, NaN or infinite in any column that is read"),
    **dict.fromkeys(
        ("beyond 90 mag", "marked as missing"),
        ("with a measurement", "Numbers such as 99.999 and -99 stand for none"),
    ),
    "flagged as bad": (
        "whose flag is 0",
        "The flag is the column bad, catflags of ZTF, or the one that you name as bad. "
        "If its numbers say something else, do not name it, or give the column another name",
    ),
    "upper limit, which a diagnosis does not use": ("with a measured value", None),
    "below the horizon": (
        "with the object above the horizon of its station",
        "Check that the station has its latitude and longitude in degrees, east positive; that the times are UTC; and that the "
        "orbit is that of this object, near the date of the recording",
    ),
}  # fmt: skip
"""Reason for which rows are dropped: what a row needs to be kept, and what to do."""


def seconds_since(time: Time, origin: Time) -> np.ndarray:
    """Elapsed SI seconds (T,) from ``origin``, leap seconds counted."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*dubious year", category=ErfaWarning)
        return np.asarray((time - origin).to_value(u.s))


def iso_times(measurements: Measurements) -> list[str]:
    """Times of the T rows as ISO text to the microsecond, in the recording's scale."""
    time: Any = measurements.time.copy(format="isot")
    time.precision = 6
    return np.asarray(time.value, dtype=str).tolist()


def counted(dropped: Mapping[str, int]) -> str:
    """Rows by the reason for which they were dropped: "3 without a number, 1 the same as another"."""
    return ", ".join(f"{count} {REASONS.get(reason, reason)}" for reason, count in dropped.items())


def left_out(measurements: Measurements) -> list[str]:
    """The warning that rows were dropped: how many, why, and where they stand; empty if none were."""
    if not measurements.dropped:
        return []
    reasons = []
    for reason, count in measurements.dropped.items():
        where = places(measurements.dropped_at.get(reason, np.empty(0)), measurements.placed_by)
        reasons.append(f"{count} {REASONS.get(reason, reason)}{where and f' ({where})'}")
    total = sum(measurements.dropped.values())
    return [f"{number_of(total, 'row')} {'is' if total == 1 else 'are'} left out: {', '.join(reasons)}"]


def place_of_row(measurements: Measurements, row: int) -> str | None:
    """Where a row stands, such as "line 12"; None where that is not known."""
    return None if measurements.place is None else f"{measurements.placed_by} {measurements.place[row]}"


def places(numbers: np.ndarray, what: str) -> str:
    """Where rows stand that have these ascending ``numbers``: "line 7", "lines 3, 5 to 9 and 12", "rows 2, 4, 6 and 31
    more"; empty for none."""
    if not len(numbers):
        return ""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1)[:MOST_RUNS] + 1)
    texts = [f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs[:MOST_RUNS]]
    texts += [f"{len(run)} more" for run in runs[MOST_RUNS:]]
    listed = f"{', '.join(texts[:-1])} and {texts[-1]}" if len(texts) > 1 else texts[0]
    return f"{what}{'s' if len(numbers) > 1 else ''} {listed}"


def no_usable_row(source: Path | None, dropped: Mapping[str, int]) -> InputError:
    """The error of a recording of which nothing is left; says why the rows went."""
    return too_few_rows(source, 0, dropped, 1)


def too_few_rows(source: Path | None, rows: int, dropped: Mapping[str, int], least: int) -> InputError:
    """The error of a recording of which fewer than ``least`` rows are left; says why the others went and what keeps them."""
    usual = max(dropped, key=lambda reason: dropped[reason], default="")
    found = f"{number_of(rows, 'usable row') if rows else 'no usable row'}{f' ({counted(dropped)})' if dropped else ''}"
    needs, hint = KEPT_IF.get(usual, ("", None))
    return InputError(source, None, found, f"at least {least}{needs and f' {needs}'}", hint)
