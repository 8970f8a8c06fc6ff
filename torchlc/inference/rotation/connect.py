"""Which counts of turns between passes are possible: integers that join the phases of passes to one rotation.

phi(t) = phi0 + f (t - t0) + g (t - t0)^2 / 2, in turns; each pass says its frequency, and its phase but for whole turns, or
parts of one of which the body looks the same after each. The counts are found pass by pass, best first, and judged by the squared
distance in the covariance of phases and frequencies. Letters: N passes.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from torchlc.inference.rotation.passes import DAY_S, RATE_A_DAY, Rows
from torchlc.inference.rotation.refine import Local

WIDTH = 5.0
"""Standard deviations of the predicted phase within which counts are tried."""
MOST = 3000
"""Counts kept after each pass; beyond, passes cannot be connected."""


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


@dataclass(frozen=True)
class Connections:
    """Best first; ``complete`` false where there are more than can be listed."""

    found: tuple[Connection, ...]
    complete: bool


def connections(
    rows: Rows, local: Local, symmetry: int, *, changing: bool, bounds: tuple[float, float]
) -> Connections:
    """Counts of turns that join the passes of a solution; ``changing``: the period may change. ``bounds``: of f."""
    passes = rows.passes
    middles = rows.middle.numpy()
    reference = float(middles.mean())
    phases = local.phases.numpy()
    turning = local.frequencies.numpy()
    covariance = local.covariance.numpy().copy()
    own = np.arange(passes)
    covariance[passes + own, passes + own] += local.own_error**2
    covariance[own, own] += (0.3 * local.own_error / np.maximum(rows.span.numpy(), 1e-3)) ** 2
    prior = RATE_A_DAY / DAY_S * local.frequency
    free = 3 if changing else 2
    elapsed = middles - reference
    design = np.zeros((2 * passes + 1, 3))
    design[:passes] = np.stack([np.zeros(passes), np.ones(passes), elapsed], 1)
    design[passes:-1] = np.stack([np.ones(passes), elapsed, elapsed**2 / 2], 1)
    design[-1] = [0.0, 0.0, 1.0]
    full = np.zeros((2 * passes + 1, 2 * passes + 1))
    full[:-1, :-1], full[-1, -1] = covariance, prior**2
    extent, start = max(float(np.ptp(middles)), 1.0), np.array([0.0, local.frequency, 0.0])
    order = np.argsort(np.abs(middles - middles[np.argmax(rows.span.numpy())]), kind="stable")
    beams: list[dict[int, int]] = [{int(order[0]): 0}]
    complete = True

    def solved(known: dict[int, int]) -> tuple[np.ndarray, np.ndarray, float]:
        at = [*range(passes), *(passes + one for one in known), 2 * passes]
        values = np.array([*turning, *(phases[one] + k / symmetry for one, k in known.items()), 0.0])
        weight = np.linalg.inv(full[np.ix_(at, at)])
        part = design[at][:, :free]
        scale = np.array([1.0, 1 / extent, 1 / extent**2])[:free]
        scaled = part * scale
        inverse = np.linalg.pinv(scaled.T @ weight @ scaled, hermitian=True, rcond=1e-18)
        about = values - part @ start[:free]
        step = inverse @ (scaled.T @ weight @ about)
        left = about - scaled @ step
        result, spread = start.copy(), np.zeros((3, 3))
        result[:free] += scale * step
        spread[:free, :free] = inverse * scale[:, None] * scale
        return result, spread, float(left @ weight @ left)

    for one in order[1:]:
        one = int(one)
        row = design[passes + one]
        grown: list[tuple[float, dict[int, int]]] = []
        for known in beams:
            result, spread, _ = solved(known)
            sd = float(np.sqrt(row @ spread @ row + covariance[passes + one, passes + one]))
            expected = (row @ result - phases[one]) * symmetry
            reach = min(WIDTH * sd * symmetry, MOST)
            if WIDTH * sd * symmetry > MOST:
                complete = False
            around = range(int(np.ceil(expected - reach)), int(np.floor(expected + reach)) + 1)
            grown += [(abs(k - expected), {**known, one: k}) for k in around]
            if len(grown) > 4 * MOST:
                complete = False
                break
        judged = sorted(
            ((solved(known)[2], n, known) for n, (_, known) in enumerate(grown)), key=lambda entry: entry[:2]
        )
        if len(judged) > MOST:
            complete = False
        beams = [known for _, _, known in judged[:MOST]]
        if not beams:
            return Connections((), complete)
    found = []
    for known in beams:
        result, _, distance = solved(known)
        if bounds[0] <= result[1] <= bounds[1]:
            counts = tuple(known[one] for one in range(passes))
            found.append(
                Connection(counts, reference, float(result[0]), float(result[1]), float(result[2]), distance)
            )
    return Connections(tuple(sorted(found, key=lambda one: one.distance)), complete)


def differences(counts: tuple[int, ...], symmetry: int) -> tuple[float, ...]:
    """Turns by which each pass' count exceeds that of the pass before."""
    return tuple((b - a) / symmetry for a, b in itertools.pairwise(counts))
