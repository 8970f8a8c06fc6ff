"""Upper limits of the slots of a steady cadence in which a camera did not see the object.

A pipeline that writes a row only where it found the object leaves the faint part of a turn out: what is left is bright
by selection. Within a curve the slots between two rows are as many as fit; those in which nothing was found become rows
that say "fainter than the limit".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from torchlc.digits import number_of
from torchlc.readers import groups

LONGEST_GAP_S = 5.0
"""A tracker that has not seen an object for longer may have lost it: among the tracks of tumbling bodies of
Mini-MegaTORTORA gaps are up to 3.7 s, and then 7.5 s and more."""
FAINTEST = 0.05
"""The limit is the median of the faintest tenth of a curve's rows. One row, the very faintest, owes its
place to its noise."""
FEWEST_ROWS = 20
"""Rows of a curve below which its faintest tenth is one or none."""
LOST_FRAMES = 0.1
"""Share of slots that may be empty for reasons of the camera: up to 5 % in 45 curves of Mini-MegaTORTORA
of objects that are 3 mag brighter than what it reaches, and half as much again for safety."""
FAINTER_P = 3e-4
"""Probability of the rank test below which the rows beside gaps are fainter than the curve's rows are: small,
for files hold hundreds of curves. (FLTSATCOM 2, whose faint half is hidden: 1e-4.)"""
OFF_SLOT = 0.2
"""Of the cadence: how far a row may be from its slot."""
STEADY = 0.95
"""Share of a curve's rows that have to be in slots for it to have a cadence."""
MOST_LISTED = 5
CLOSE = 1.5
"""Times the shortest step between rows (its 5th percentile), below which a step is one slot."""


@dataclass(frozen=True)
class EmptySlots:
    """Rows to be added: ``before`` (N,), the row that each follows, ``share`` (N,), how far it is on the way to the
    curve's next row ``after`` (N,), and ``limit`` (N,) in the recording's brightness; ``notes`` for the reader.
    """

    before: np.ndarray
    after: np.ndarray
    share: np.ndarray
    limit: np.ndarray
    notes: tuple[str, ...]


def empty_slots(
    seconds: np.ndarray,
    brightness: np.ndarray,
    curve: np.ndarray,
    curve_ids: Sequence[str],
    unit: str,
    *,
    fainter: int,
    measured: np.ndarray,
    view: np.ndarray,
    unusable: np.ndarray,
    longest_gap: float = LONGEST_GAP_S,
) -> EmptySlots:
    """The empty slots of each ``curve`` (T,) of rows in order of time at ``seconds`` (T,).

    ``fainter`` is +1 where larger numbers are fainter (magnitudes), else -1; rows that are not ``measured`` (T,) are
    limits already. A slot is not empty if it holds a row of another curve of the same ``view`` (T,), as of another
    camera that saw the object there, or one at ``unusable`` (M,) s, which was there and has been dropped.
    """
    pieces: list[tuple[np.ndarray, ...]] = []
    notes = _Notes()
    for code in np.unique(curve):
        rows = np.flatnonzero(curve == code)
        times, values, seen = seconds[rows], fainter * brightness[rows], measured[rows]
        name = curve_ids[int(code)]
        if seen.sum() < FEWEST_ROWS or not (np.diff(times) > 0).any():
            continue
        grid = _slots(times, longest_gap)
        if not grid.steady:
            notes.unsteady.append(name)
            continue
        meanwhile = slice(rows[0], rows[-1] + 1)
        held = np.concatenate([seconds[meanwhile][np.isin(view[meanwhile], view[rows])], unusable])
        before, share = grid.empty(held)
        if not len(before):
            continue
        part = len(before) / (len(before) + len(rows))
        gaps = np.unique(before)
        edge = 0.5 * (values[gaps] + values[gaps + 1])
        if part <= LOST_FRAMES and _chance_of_fainter(edge, values[seen]) > FAINTER_P:
            notes.lost.append(f"{len(before)} of {len(before) + len(rows)} in {name}")
            continue
        limit = float(fainter * np.quantile(values[seen], 1 - FAINTEST))
        pieces.append((rows[before], rows[before + 1], share, np.full(len(before), limit)))
        longer = grid.gaps_left
        notes.made.append(
            f"{len(before)} of {grid.cadence:.3g} s in {name} at {limit:.6g}{unit}"
            + (f" ({longer} gap{'s' * (longer > 1)} longer than {longest_gap:g} s left)" if longer else "")
        )
    columns = (
        [np.concatenate(column) for column in zip(*pieces, strict=True)] if pieces else [np.zeros(0)] * 4
    )
    return EmptySlots(
        columns[0].astype(np.int64),
        columns[1].astype(np.int64),
        columns[2],
        columns[3],
        notes.sentences("faintest" if fainter > 0 else "lowest"),
    )


@dataclass(frozen=True)
class _Slots:
    """The steady cadence (s) of a curve's rows at ``times`` (T,): each ``step`` (T - 1,) to the next row, infinite between rows of one
    time, the number of ``slots`` in it, and whether it is short enough to be ``bridged``."""

    times: np.ndarray
    cadence: float
    step: np.ndarray
    slots: np.ndarray
    bridged: np.ndarray

    @property
    def steady(self) -> bool:
        """Whether enough rows are in their slots."""
        off = np.abs(self.step / self.cadence - self.slots)[self.bridged]
        return bool(np.mean(off < OFF_SLOT) >= STEADY)

    @property
    def gaps_left(self) -> int:
        """Gaps that are too long to be bridged."""
        return int(np.sum(np.isfinite(self.step) & (self.slots > 1) & ~self.bridged))

    def empty(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The slots (N,) that hold no row and none of the times ``held``: the row before each, and the share of its step."""
        gap = np.flatnonzero(self.bridged & (self.slots > 1))
        many = self.slots[gap].astype(np.int64) - 1
        inside = np.concatenate([np.arange(1, n + 1) for n in many]) if len(gap) else np.zeros(0)
        before = np.repeat(gap, many)
        share = inside / np.repeat(self.slots[gap], many)
        at = self.times[before] + share * self.step[before]
        free = ~_near(at, np.sort(held), 0.5 * self.cadence)
        return before[free], share[free]


def _slots(times: np.ndarray, longest_gap: float) -> _Slots:
    step = np.diff(times)
    step = np.where(step > 0, step, np.inf)
    shortest = np.percentile(step[np.isfinite(step)], 5)
    cadence = float(np.median(step[step < CLOSE * shortest]))
    slots = np.where(np.isfinite(step), np.round(step / cadence), 1)
    return _Slots(times, cadence, step, slots, np.isfinite(step) & (step <= longest_gap))


@dataclass(frozen=True)
class _Notes:
    """Names of curves without a cadence, of those whose empty slots are ``lost`` frames, and of those that limits were ``made`` for."""

    unsteady: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    made: list[str] = field(default_factory=list)

    def sentences(self, side: str) -> tuple[str, ...]:
        """``side``: faintest or lowest."""
        said = (
            (self.unsteady, "no steady cadence, so that no slot is known to be empty"),
            (self.lost, "empty slots beside rows as bright as others are taken as lost frames"),
            (
                self.made,
                f"empty slots are upper limits, at the median of the {side} tenth of the curve's rows",
            ),
        )
        return tuple(f"{text}: {_listed(names)}" for names, text in said if names)


def _chance_of_fainter(edge: np.ndarray, rows: np.ndarray) -> float:
    """Probability of values beside gaps as large as ``edge`` among those of ``rows``, by the rank test of Mann and Whitney."""
    from scipy.stats import mannwhitneyu  # loads for 0.4 s: only where slots are empty

    return float(mannwhitneyu(edge, rows, alternative="greater").pvalue)


def _near(at: np.ndarray, times: np.ndarray, within: float) -> np.ndarray:
    """Which of ``at`` have one of the sorted ``times`` nearer than ``within``."""
    first = np.searchsorted(times, at - within, side="right")
    return (first < len(times)) & (times[np.minimum(first, len(times) - 1)] < at + within)


def _listed(items: Sequence[str]) -> str:
    more = len(items) - MOST_LISTED
    return "; ".join(items[:MOST_LISTED]) + (f"; and {number_of(more, 'more curve')}" if more > 0 else "")


def rows_of_slots(
    slots: EmptySlots, columns: Mapping[str, np.ndarray], kind: str, curve: np.ndarray
) -> dict[str, np.ndarray]:
    """Columns of a row a slot, an upper limit each, of a recording with these ``columns``, of which ``curve`` (T,) says what belongs
    together.

    Other columns of such a row are those on the straight line between the rows beside it: at the longest gap, 5 s, a
    position in a low orbit is 30 m off, 0.003 deg at 500 km. An error is the median of the curve's.
    """
    before, after, share, days = slots.before, slots.after, slots.share, columns["time"]
    added = {name: column[before] for name, column in columns.items()}
    for name, column in columns.items():
        if column.dtype.kind == "f" and name != "time":
            added[name] = (1 - share) * column[before] + share * column[after]
    if "az" in columns:
        added["alt"], added["az"] = groups.between_directions(columns, before, after, share)
    step = (days[after] - days[before]).sum(-1)
    added["time"] = days[before] + np.stack([0 * step, share * step], -1)
    added[kind] = slots.limit
    added["upper_limit"] = np.ones(len(before), dtype=bool)
    if f"{kind}_err" in columns:
        measured = np.where(columns["upper_limit"], np.nan, columns[f"{kind}_err"])
        added[f"{kind}_err"] = groups.medians(measured, curve)[before]
    return added
