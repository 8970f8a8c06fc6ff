"""Which counts of turns between passes are possible: integers that join the phases of passes to one rotation.

The period changes evenly: the frequency is f / (1 - x) and the phase phi0 - f t log(1 - x) / x, in turns, where x = g t / f and t is
counted from the middle of the passes. To second order that is phi0 + f t + g t^2 / 2; the next term, g^2 t^3 / (3 f), is 0.7 turns five days from the middle for
a turn of 5 s that grows by 5 ms a day. Each pass says its frequency, and its phase but for whole turns, or
parts of one of which the body looks the same after each. The counts are found pass by pass, best first, and judged by the squared
distance in the covariance of phases and frequencies. Letters: N passes.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from torchlc.inference.rotation.passes import DAY_S, RATE_A_DAY, Rows
from torchlc.inference.rotation.refine import Local

WIDTH = 5.0
"""Standard deviations of the predicted phase within which counts are tried."""
MOST = 3000
"""Counts kept after each pass; beyond, passes cannot be connected."""
CORRECTIONS, LEFT_TURNS = 3, 1e-5
"""How often the phases are corrected for what is beyond second order, and by how little they then may change; each takes a tenth off and more."""


@dataclass(frozen=True)
class Connection:
    """Parts of a turn, ``counts`` (N,), added to the phases of the passes, and the rotation they then have at ``middle``
    s: phase in turns, frequency 1/s and its change 1/s2; ``distance`` is the squared distance in standard deviations."""

    counts: tuple[int, ...]
    middle: float
    phase: float
    frequency: float
    change: float
    distance: float

    def at(self, seconds: float) -> tuple[float, float]:
        """Phase in turns, and frequency 1/s, at a time in seconds of the rows."""
        elapsed = np.array([seconds - self.middle])
        frequency, turns = _beyond_second_order(elapsed, self.frequency, self.change)
        frequency += self.frequency + self.change * elapsed
        turns += self.phase + self.frequency * elapsed + self.change * elapsed**2 / 2
        return float(turns[0]), float(frequency[0])

    @property
    def rate(self) -> float:
        """Change of the period, ms a day."""
        return -self.change / self.frequency**2 * DAY_S * 1e3


@dataclass(frozen=True)
class Connections:
    """Best first; ``complete`` false where there are more than can be listed."""

    found: tuple[Connection, ...]
    complete: bool


def connections(
    rows: Rows, local: Local, symmetry: int, *, changing: bool, bounds: tuple[float, float]
) -> Connections:
    """Counts of turns that join the passes of a solution; ``changing``: the period may change. ``bounds``: of f."""
    line = _PhaseLine(rows, local, symmetry, changing)
    # from the longest pass, whose phase and frequency are known best, to those ever farther from it
    order = np.argsort(np.abs(line.middles - line.middles[np.argmax(rows.span.numpy())]), kind="stable")
    kept: list[dict[int, int]] = [{int(order[0]): 0}]
    complete = True
    for passed in order[1:]:
        kept, all_of_them = _extended(line, kept, int(passed))
        complete = complete and all_of_them
    joined = []
    for known in kept:
        result, _, distance = line.solved(known)
        if bounds[0] <= result[1] <= bounds[1]:
            counts = tuple(known[index] for index in range(rows.passes))
            phase, frequency, change = (float(number) for number in result)
            joined.append(Connection(counts, line.reference, phase, frequency, change, distance))
    return Connections(tuple(sorted(joined, key=lambda connection: connection.distance)), complete)


class _PhaseLine:
    """phi0, f and g of the module's phi(t) by least squares from the frequencies of all passes and the phases of those whose counts
    are known. g is 0 unless ``changing``, and has a prior of RATE_A_DAY."""

    def __init__(self, rows: Rows, local: Local, symmetry: int, changing: bool) -> None:
        self.passes, self.symmetry = rows.passes, symmetry
        self.middles = rows.middle.numpy()
        self.reference = float(self.middles.mean())
        self.phases, self.frequencies = local.phases.numpy(), local.frequencies.numpy()
        self.free = 3 if changing else 2
        self.start = np.array([0.0, local.frequency, 0.0])
        self.covariance = _covariance(rows, local)
        self.design = _design(self.middles - self.reference)
        # solved in turns over the whole extent: in turns a second the normal matrix spans too many decades
        extent = max(float(np.ptp(self.middles)), 1.0)
        self.scale = np.array([1.0, 1 / extent, 1 / extent**2])[: self.free]

    def solved(self, known: Mapping[int, int]) -> tuple[np.ndarray, np.ndarray, float]:
        """(phi0, f, g), their covariance (3, 3), and the squared distance of the data from them, in standard deviations."""
        rows = [*range(self.passes), *(self.passes + passed for passed in known), 2 * self.passes]
        phases = [self.phases[passed] + count / self.symmetry for passed, count in known.items()]
        values = np.array([*self.frequencies, *phases, 0.0])
        weight = np.linalg.inv(self.covariance[np.ix_(rows, rows)])
        part = self.design[rows][:, : self.free]
        scaled = part * self.scale
        inverse = np.linalg.pinv(scaled.T @ weight @ scaled, hermitian=True, rcond=1e-18)
        to_best = inverse @ (scaled.T @ weight)
        result, beyond, about = (
            self.start.copy(),
            np.zeros(len(values)),
            values - part @ self.start[: self.free],
        )
        for _ in range(CORRECTIONS):
            left = about - beyond
            step = to_best @ left
            result[: self.free] = self.start[: self.free] + self.scale * step
            before, beyond = beyond, self.beyond(result)[rows]
            if np.abs(beyond - before)[self.passes : -1].max(initial=0.0) < LEFT_TURNS:
                break
        left = left - scaled @ step
        spread = np.zeros((3, 3))
        spread[: self.free, : self.free] = inverse * self.scale[:, None] * self.scale
        return result, spread, float(left @ weight @ left)

    def beyond(self, result: np.ndarray) -> np.ndarray:
        """What frequencies, phases and g (2 N + 1,) of (phi0, f, g) are more than those that are linear in them."""
        both = _beyond_second_order(self.middles - self.reference, float(result[1]), float(result[2]))
        return np.concatenate([*both, [0.0]])

    def expected_count(self, known: Mapping[int, int], passed: int) -> tuple[float, float]:
        """The count of a further pass, not rounded, and its standard deviation."""
        result, spread, _ = self.solved(known)
        index = self.passes + passed
        row = self.design[index]
        deviation = float(np.sqrt(row @ spread @ row + self.covariance[index, index]))
        expected = row @ result + self.beyond(result)[index]
        return float(expected - self.phases[passed]) * self.symmetry, deviation * self.symmetry


def _covariance(rows: Rows, local: Local) -> np.ndarray:
    """(2 N + 1, 2 N + 1) of the frequencies, the phases, and the prior of g; the first two with what the light of facets leaves out."""
    passes = rows.passes
    index = np.arange(passes)
    measured = local.covariance.numpy().copy()
    measured[passes + index, passes + index] += local.own_error**2
    measured[index, index] += (0.3 * local.own_error / np.maximum(rows.span.numpy(), 1e-3)) ** 2
    whole = np.zeros((2 * passes + 1, 2 * passes + 1))
    whole[:-1, :-1], whole[-1, -1] = measured, (RATE_A_DAY / DAY_S * local.frequency) ** 2
    return whole


def _beyond_second_order(
    elapsed: np.ndarray, frequency: float, change: float
) -> tuple[np.ndarray, np.ndarray]:
    """Of frequencies and phases (N,) of a period that changes evenly, what f + g t and f t + g t^2 / 2 leave out."""
    x = np.clip(
        change * elapsed / frequency, -0.5, 0.5
    )  # a period that halves or doubles between passes is no solution
    small = np.abs(x) < 1e-3
    safe = np.where(small, 0.5, x)
    more = np.where(small, x**2 / 3 + x**3 / 4 + x**4 / 5, -np.log1p(-safe) / safe - 1 - x / 2)
    return frequency * x**2 / (1 - x), frequency * elapsed * more


def _design(elapsed: np.ndarray) -> np.ndarray:
    """d (frequencies, phases, g) / d (phi0, f, g), (2 N + 1, 3), at ``elapsed`` (N,) s."""
    nothing, every = np.zeros_like(elapsed), np.ones_like(elapsed)
    frequencies = np.stack([nothing, every, elapsed], 1)
    phases = np.stack([every, elapsed, elapsed**2 / 2], 1)
    return np.concatenate([frequencies, phases, [[0.0, 0.0, 1.0]]])


def _extended(
    line: _PhaseLine, kept: Sequence[dict[int, int]], passed: int
) -> tuple[list[dict[int, int]], bool]:
    """The sets of counts with those of one more pass that may be right, best first, and whether these are all."""
    complete = True
    grown: list[tuple[float, dict[int, int]]] = []
    for known in kept:
        expected, deviation = line.expected_count(known, passed)
        reach = WIDTH * deviation
        if reach > MOST:
            reach, complete = MOST, False
        around = range(int(np.ceil(expected - reach)), int(np.floor(expected + reach)) + 1)
        grown += [(abs(k - expected), {**known, passed: k}) for k in around]
        if len(grown) > 4 * MOST:
            complete = False
            break
    judged = sorted(
        ((line.solved(known)[2], n, known) for n, (_, known) in enumerate(grown)), key=lambda entry: entry[:2]
    )
    return [known for _, _, known in judged[:MOST]], complete and len(judged) <= MOST


def differences(counts: tuple[int, ...], symmetry: int) -> tuple[float, ...]:
    """Turns by which each pass' count exceeds that of the pass before."""
    return tuple((b - a) / symmetry for a, b in itertools.pairwise(counts))
