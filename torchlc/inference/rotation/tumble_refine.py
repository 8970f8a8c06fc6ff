"""States of free rotation made better by least squares, with the light of facets and the reflectances profiled; and joined.

First each pass has both of its phases to itself; then the whole turns about the angular momentum and round the body between
passes are counted, and one rotation is fitted to all. Bodies are coordinates in the logarithms of their second moments of
mass, so that every point is a possible body; with both frequencies these say the nutation, so that a step in the body leaves
the phases where they are. Letters: B states, N passes, T rows, P coordinates, L lobes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.geometry.rotation.rigid_body import free_rotation, frequencies
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.pole_grid import frame_of
from torchlc.inference.rotation.refine import LEAST_N, MOST_N, START_N, Refiner
from torchlc.inference.rotation.tumble_grid import TumbleState, wander
from torchlc.inference.rotation.two_frequencies import FrequencyPair
from torchlc.tensors.least_squares import Minimum, minimise
from torchlc.tensors.vectors import unit

STAGES = ((6, 0.5), (7, 0.25), (25, 0.1))
"""Iterations, and the share of the starts that is kept after them."""
LEAST_KEPT = 4
"""Starts, whatever share is kept."""
SETTLING, SETTLED = 80, 1e-7
"""Iterations, and the relative gain at which they end, on the way down a valley."""
MOST_LOG = 6.0
"""Bound of the logarithm of a ratio of second moments of mass: a rod of 1 to 20."""
PHASE_FLOOR = 2e-3
"""Error of a phase, turns, that the light of facets has of itself."""
WIDTH = 4.0
"""Standard deviations of a phase within which whole turns are looked for: one in 16,000 lies outside."""
WIDENED = (1.0, 16.0, 256.0)
"""Factors of the covariance of phases, in turn, until a count joins them: that of a bent valley is too narrow."""
MOST_COUNTS = 400
"""Kept at each pass; where there are more it is told that not all were looked at."""
JOINED = 10
"""Counts of turns that one rotation is fitted to."""
FIXED = 6
"""Coordinates that the passes share: L (2), the turns of the long axis, the body (2), the ways round the body."""
HALVINGS, SECANTS = 10, 5
"""Steps to the nutation of a ratio of frequencies: to a thousandth by halving, then to rounding."""
ROUNDING, NEARBY = 1e-11, 1e-3
"""Relative error of a ratio that is none, and the first step, rad, from a nutation that is near."""
EDGE = 1e-4
"""Nutations within this of the ends of a mode, rad, are not tried."""


@dataclass(frozen=True)
class Tumble:
    """A state of free rotation: unit ``pole`` of L, mean turns of the long axis ``long`` 1/s, ``moments`` (3,), nutation rad;
    phases ``turn`` and ``way`` (E,) in turns at the seconds ``at`` (E,): of each pass, or one for all. ``counts``: whole turns and
    ways, or halves, by which each pass is joined to the one before; ``possible``, how many such counts are within reach."""

    pole: Tensor
    long: float
    moments: Tensor
    nutation: float
    turn: Tensor
    way: Tensor
    at: Tensor
    exponents: Tensor
    weights: Tensor
    chi2: float
    counts: tuple[tuple[float, float], ...] = ()
    possible: int = 1
    complete: bool = True

    @property
    def pair(self) -> FrequencyPair:
        """Its two frequencies."""
        motion = frequencies(
            self.moments, self.moments.new_tensor(self.nutation), self.moments.new_tensor(1 / self.long)
        )
        return FrequencyPair(self.long, float(motion.polhode), bool(motion.short_axis_mode), 1.0)


def moments_of(logs: Tensor) -> Tensor:
    """Moments of inertia (..., 3), the third 1, of logarithms (..., 2) of second moments of mass along x and y over that along z."""
    mass = torch.exp(torch.cat([logs, torch.zeros_like(logs[..., :1])], -1))
    moments = mass.sum(-1, keepdim=True) - mass
    return moments / moments[..., 2:]


def logs_of(moments: Tensor) -> Tensor:
    """The inverse of :func:`moments_of`, (..., 2)."""
    mass = (moments.sum(-1, keepdim=True) / 2 - moments).clamp(min=1e-4)
    return torch.log(mass[..., :2] / mass[..., 2:])


@dataclass(frozen=True)
class _Base:
    """What the coordinates of a start are about: L, both frequencies, the mode, the nutation."""

    pole: Tensor
    long: float
    polhode: float
    short_axis_mode: bool
    nutation: float

    @classmethod
    def of(cls, pole: Tensor, long: float, moments: Tensor, nutation: float) -> _Base:
        motion = frequencies(moments, moments.new_tensor(nutation), moments.new_tensor(1 / long))
        return cls(pole, long, float(motion.polhode), bool(motion.short_axis_mode), nutation)


def nutation_at(moments: Tensor, ratio: Tensor, short_axis_mode: bool, near: float | None = None) -> Tensor:
    """The nutation (B,), rad, of a body (B, 3) in a mode whose ways round the body are ``ratio`` (B,) of the turns of the long
    axis; that nearest to it where none is. Quicker where all are ``near`` one nutation."""
    small, middle, large = torch.sort(moments, dim=-1).values.unbind(-1)
    sine2 = (1 / middle - 1 / large) / (1 / small - 1 / large).clamp(min=1e-12)
    border = torch.asin(torch.sqrt(sine2.clamp(0.0, 1.0)))
    slow = (border - EDGE if short_axis_mode else border + EDGE).clamp(
        EDGE, math.pi / 2 - EDGE
    )  # the ratio is 0 at the border
    fast = torch.full_like(border, EDGE if short_axis_mode else math.pi / 2 - EDGE)

    def over(angle: Tensor) -> Tensor:
        motion = frequencies(moments, angle, torch.ones_like(angle))
        return motion.polhode / motion.precession_long - ratio

    least, most = torch.minimum(slow, fast), torch.maximum(slow, fast)

    def crossed(a: Tensor, at_a: Tensor, b: Tensor, at_b: Tensor) -> tuple[Tensor, Tensor]:
        """Secants until nothing moves, within the mode; and what is then left of the ratio."""
        for _ in range(SECANTS):
            slope = at_b - at_a
            moves = slope.abs() > 1e-14
            new = b - at_b * torch.where(moves, (b - a) / torch.where(moves, slope, 1.0), 0.0)
            new = torch.minimum(torch.maximum(new, least), most)
            a, at_a, b, at_b = b, at_b, new, over(new)
            if bool((at_b.abs() <= ROUNDING * ratio).all()):
                break
        return b, at_b

    if near is not None:
        a = torch.minimum(torch.maximum(torch.full_like(ratio, near), least), most)
        b = torch.where(a + NEARBY < most, a + NEARBY, a - NEARBY)
        nutation, left = crossed(a, over(a), b, over(b))
        if bool((left.abs() <= ROUNDING * ratio).all()):
            return nutation
    for _ in range(HALVINGS):
        trial = (slow + fast) / 2
        above = over(trial) > 0
        slow, fast = torch.where(above, slow, trial), torch.where(above, trial, fast)
    return crossed(slow, over(slow), fast, over(fast))[0]


class TumbleRefiner:
    """Least squares of states; ``floor`` is the relative error that the light of facets has."""

    def __init__(self, rows: Rows, body: FacetLight, floor: float) -> None:
        self.rows, self.body = rows, body
        self.lobes = sum(body.lobed)
        self.compared = Refiner(rows, body, floor).compared
        self.longest = float(rows.span.max().clamp(min=1e-3))
        self.total = float((rows.seconds.max() - rows.seconds.min()).clamp(min=1e-3))
        self.symmetric = body.symmetry(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)) % 2 == 0 and (
            body.symmetry(torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)) % 2 == 0
        )

    def refined(
        self, starts: Sequence[TumbleState], progress: Callable[[float], None] | None = None
    ) -> list[tuple[Tumble, Tensor, Tensor]]:
        """The best states with phases of each pass, with coordinates (P,) and normal matrices (P, P); best first."""
        begin, bases = [], []
        log_n = torch.full((self.lobes,), math.log(START_N), dtype=torch.float64)
        for guess in starts:
            phases = torch.tensor([*guess.phases, *guess.ways], dtype=torch.float64)
            shared = [0.0, 0.0, 0.0, *logs_of(guess.moments).tolist(), 0.0]
            begin.append(torch.cat([torch.tensor(shared, dtype=torch.float64), phases, log_n]))
            bases.append(_Base.of(guess.pole, guess.long, guess.moments, guess.nutation))
        at = self.rows.middle
        best: dict[int, Minimum] = {}
        left = list(range(len(starts)))
        for stage, (iterations, kept) in enumerate(STAGES):
            for number, k in enumerate(left):
                start = best[k].y if k in best else begin[k][None]
                best[k] = self._minimised(start, bases[k], at, self.longest, iterations)
                if progress is not None:
                    progress((stage + number / len(left)) / len(STAGES))
            left = sorted(left, key=lambda k: float(best[k].cost[0]))
            left = left[: max(LEAST_KEPT, round(len(starts) * kept))]
        solutions = []
        for k in left:
            jacobian = best[k].jacobian[0]
            state = self._state(best[k].y, bases[k], at, self.longest, float(best[k].cost[0]))
            solutions.append((state, best[k].y[0], jacobian.T @ jacobian))
        return sorted(solutions, key=lambda solution: solution[0].chi2)

    def settled(self, local: tuple[Tumble, Tensor, Tensor]) -> tuple[Tumble, Tensor, Tensor]:
        """A solution at the bottom of its valley: bodies and frequencies are exchanged along one that is flat and bent, and phases
        of other passes are foretold from where it ends."""
        state, y, _ = local
        base = _Base.of(state.pole, state.long, state.moments, state.nutation)
        y = y.clone()
        y[:3] = y[5] = 0.0  # of the state itself
        at = self.rows.middle
        best = self._minimised(y[None], base, at, self.longest, SETTLING, SETTLED)
        jacobian = best.jacobian[0]
        bottom = self._state(best.y, base, at, self.longest, float(best.cost[0]))
        return bottom, best.y[0], jacobian.T @ jacobian

    def joined(self, local: tuple[Tumble, Tensor, Tensor]) -> list[Tumble]:
        """One rotation for all passes of a solution, with each of the likeliest counts of turns; best first."""
        state, y, normal = local
        reference = self.rows.longest
        if self.rows.passes == 1:
            return [state]
        scale = torch.sqrt(torch.diagonal(normal).clamp(min=1e-9))
        covariance = (
            torch.linalg.pinv(normal / scale[:, None] / scale, hermitian=True) / scale[:, None] / scale
        )
        base = _Base.of(state.pole, state.long, state.moments, state.nutation)
        y = y.clone()
        y[:3] = y[5] = 0.0  # of the state itself
        step = 1e-6 * torch.eye(len(y), dtype=torch.float64)
        off = self._gaps(y[None], base)[0]
        slope = ((self._gaps(y + step, base) - self._gaps(y - step, base)) / 2e-6).T  # (C, P)
        spread = slope @ covariance @ slope.T
        spread.diagonal().add_(2 * PHASE_FLOOR**2)
        for widened in WIDENED:
            counts, complete = _counts(off, widened * spread, self.symmetric)
            if counts:
                break
        else:
            return []
        tumbles = []
        for _, count in counts[:JOINED]:
            moved = y + covariance @ slope.T @ torch.linalg.solve(spread, count - off)
            shared = torch.cat([moved[:FIXED], moved[FIXED + reference, None]])
            way = moved[FIXED + self.rows.passes + reference, None]
            shared[[2, 5]] *= self.total / self.longest
            start = torch.cat([shared, way, moved[FIXED + 2 * self.rows.passes :]])
            at = self.rows.middle[reference, None]
            best = self._minimised(start[None], base, at, self.total, 40)
            joined = self._state(best.y, base, at, self.total, float(best.cost[0]))
            pairs = tuple((float(a), float(b)) for a, b in count.reshape(-1, 2))
            tumbles.append(
                Tumble(**{**vars(joined), "counts": pairs, "possible": len(counts), "complete": complete})
            )
        return sorted(tumbles, key=lambda tumble: tumble.chi2)

    def _minimised(
        self, start: Tensor, base: _Base, at: Tensor, length: float, iterations: int, tolerance: float = 1e-4
    ) -> Minimum:
        low, high = torch.full_like(start[0], -math.inf), torch.full_like(start[0], math.inf)
        low[:2], high[:2] = -1.5, 1.5
        low[3:5], high[3:5] = -MOST_LOG, MOST_LOG
        lobes = FIXED + 2 * len(at)
        low[lobes:], high[lobes:] = math.log(LEAST_N), math.log(MOST_N)

        def residual(y: Tensor) -> Tensor:
            return self._light(y, base, at, length)[0]

        return minimise(residual, start, low, high, iterations=iterations, tolerance=tolerance)

    def _split(self, y: Tensor, base: _Base, length: float) -> tuple[Tensor, ...]:
        """Pole (B, 3), turns of the long axis a second (B,), moments (B, 3), nutation (B,) of coordinates (B, P)."""
        frame = frame_of(base.pole)
        pole = unit(base.pole + y[:, :1] * frame[0] + y[:, 1:2] * frame[1])
        long, moments = base.long + y[:, 2] / length, moments_of(y[:, 3:5])
        ratio = (base.polhode + y[:, 5] / length) / long
        return pole, long, moments, nutation_at(moments, ratio, base.short_axis_mode, base.nutation)

    def _light(self, y: Tensor, base: _Base, at: Tensor, length: float) -> tuple[Tensor, Tensor]:
        """Residuals (B, T) and reflectances (B, K)."""
        pole, long, moments, nutation = self._split(y, base, length)
        epochs = len(at)
        turn, way = y[:, FIXED : FIXED + epochs], y[:, FIXED + epochs : FIXED + 2 * epochs]
        exponent = torch.exp(y[:, FIXED + 2 * epochs :])
        frame = frame_of(pole)
        columns = y.new_zeros(len(y), len(self.rows.flux), self.body.columns)
        for passed in range(epochs):
            here = self.rows.of(passed) if epochs > 1 else torch.arange(len(self.rows.flux))
            elapsed = (self.rows.seconds[here] - at[passed]).expand(len(y), len(here))
            rotation = free_rotation(
                elapsed,
                moments,
                nutation[:, None],
                1 / long[:, None],
                turn[:, passed, None],
                way[:, passed, None],
            )
            body = rotation.mT @ frame[:, None]
            sun, observer = (
                torch.einsum("btij,tj->bti", body, way_[here])
                for way_ in (self.rows.to_sun, self.rows.to_observer)
            )
            columns[:, here] = self.body.light(sun, observer, exponent[:, None])
        return self.compared(columns)

    def _state(self, y: Tensor, base: _Base, at: Tensor, length: float, chi2: float) -> Tumble:
        with torch.no_grad():
            pole, long, moments, nutation = self._split(y, base, length)
            _, weights = self._light(y, base, at, length)
        epochs = len(at)
        return Tumble(
            pole[0], float(long[0]), moments[0], float(nutation[0]), y[0, FIXED : FIXED + epochs],
            y[0, FIXED + epochs : FIXED + 2 * epochs], at, torch.exp(y[0, FIXED + 2 * epochs :]), weights[0], chi2,
        )  # fmt: skip

    def _gaps(self, y: Tensor, base: _Base) -> Tensor:
        """Turns and ways (B, 2 (N - 1)) by which the phases of a pass differ from those that the pass before leads to; whole
        numbers if one rotation joins them."""
        _, long, moments, nutation = self._split(y, base, self.longest)
        passes = self.rows.passes
        turn, way = y[:, FIXED : FIXED + passes], y[:, FIXED + passes : FIXED + 2 * passes]
        order = torch.argsort(self.rows.middle).tolist()
        gaps = []
        for a, b in itertools.pairwise(order):
            elapsed = (self.rows.middle[b] - self.rows.middle[a]).expand(len(y))
            reached_turn, reached_way = advanced(moments, nutation, long, turn[:, a], way[:, a], elapsed)
            # the turn is that at the phase of the way which the pass itself has
            wandered = wander(moments, nutation, way[:, b]) - wander(moments, nutation, reached_way)
            gaps += [reached_turn + wandered - turn[:, b], reached_way - way[:, b]]
        return torch.stack(gaps, -1)


def advanced(
    moments: Tensor, nutation: Tensor, long: Tensor, turn: Tensor, way: Tensor, elapsed: Tensor
) -> tuple[Tensor, Tensor]:
    """Phases (B,) of turn and way, in turns, not taken modulo 1, after ``elapsed`` (B,) s."""
    motion = frequencies(moments, nutation, 1 / long)
    mean = motion.precession_long + torch.where(motion.short_axis_mode, 0.0, motion.polhode)
    reached = way + motion.polhode * elapsed
    change = wander(moments, nutation, reached) - wander(moments, nutation, way)
    return turn + mean * elapsed + change, reached


def _counts(off: Tensor, spread: Tensor, symmetric: bool) -> tuple[list[tuple[float, Tensor]], bool]:
    """Whole numbers (C,) near ``off`` (C,), with squared distances in its covariance, nearest first, and whether all within
    WIDTH standard deviations are among them. ``symmetric``: also half a turn and half a way together."""
    beams: list[tuple[float, Tensor]] = [(0.0, off.new_zeros(0))]
    complete = True
    parts = (0.0, 0.5) if symmetric else (0.0,)
    for index in range(0, len(off), 2):
        grown: list[tuple[float, Tensor]] = []
        for _, known in beams:
            for part in parts:
                for first in _near(off, spread, known, part):
                    with_it = torch.cat([known, off.new_tensor([first])])
                    for second in _near(off, spread, with_it, part):
                        whole = torch.cat([with_it, off.new_tensor([second])])
                        k = len(whole)
                        delta = whole - off[:k]
                        grown.append((float(delta @ torch.linalg.solve(spread[:k, :k], delta)), whole))
                        if len(grown) > 20 * MOST_COUNTS:
                            complete = False
                            break
        grown = [beam for beam in sorted(grown, key=lambda beam: beam[0]) if beam[0] < WIDTH**2 + index + 2]
        complete = complete and len(grown) <= MOST_COUNTS
        beams = grown[:MOST_COUNTS]
    return beams, complete


def _near(off: Tensor, spread: Tensor, known: Tensor, part: float) -> list[float]:
    """Whole numbers, plus ``part``, within WIDTH standard deviations of the next of ``off``, given those before."""
    k = len(known)
    mean, variance = float(off[k]), float(spread[k, k])
    if k:
        solved = torch.linalg.solve(spread[:k, :k], spread[:k, k])
        mean += float(solved @ (known - off[:k]))
        variance -= float(solved @ spread[:k, k])
    reach = min(WIDTH * math.sqrt(max(variance, 1e-12)), 60.0)
    low, high = math.ceil(mean - reach - part), math.floor(mean + reach - part)
    return [whole + part for whole in range(low, high + 1)]
