"""Is anything missing? One calibrated p-value from a battery of statistics on the residuals of the baseline.

Under "nothing missing" the whitened residuals (prior rows included) are R z with z standard normal and R the
projection off everything the baseline can absorb. The battery's null is drawn from that, every statistic gets
a marginal p with an exponential tail beyond the draws, and the smallest of them is referred to its own null,
so the look-elsewhere effect is paid once and in full.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from torchlc.inference.density import BAD_ROW, Fitted

DRAWS = 2000
LAGS = (1, 2, 4, 8)
BINS = 16


@dataclass(frozen=True)
class Gate:
    """``global_p``, the marginal p of each statistic, and the windows (start, stop, p) of rows in time order
    whose sum of squares or of residuals is beyond the family-wise 95 %."""

    global_p: float
    marginal: Mapping[str, float]
    windows: Sequence[tuple[int, int, float]]


class Battery:
    """Statistics of normalised residuals u (B, T), fixed for one recording: time order and curves,
    coordinates, signatures."""

    def __init__(
        self,
        seconds: Tensor,
        curve: Tensor,
        coordinates: Mapping[str, Tensor],
        signatures: Mapping[str, Tensor],
        with_chi2: bool,
    ) -> None:
        self.order = torch.argsort(curve.to(torch.float64) * (seconds.max() - seconds.min() + 1e6) + seconds)
        sorted_curve = curve[self.order]
        self.same = {
            lag: (sorted_curve[lag:] == sorted_curve[:-lag]).to(seconds) for lag in LAGS if lag < len(curve)
        }
        self.coordinates = {name: torch.argsort(value) for name, value in coordinates.items()}
        self.signatures = signatures
        self.with_chi2 = with_chi2
        rows = len(seconds)
        self.lengths = [n for n in (3, 6, 12, 25, 50, 100, 200, 400) if n <= rows // 2]

    def statistics(self, u: Tensor, prior: Tensor) -> dict[str, Tensor]:
        """Each statistic (B,), large when structure is left, of residuals u (B, T) and prior rows (B, n)."""
        statistics: dict[str, Tensor] = {}
        square = (u * u).sum(-1)
        if self.with_chi2:
            statistics["chi2"] = square + (prior * prior).sum(-1)
            statistics["too_small"] = -square
        ordered = u[:, self.order]
        for lag, same in self.same.items():
            pairs = ordered[:, lag:] * ordered[:, :-lag] * same
            statistics[f"lag {lag}"] = pairs.sum(-1) / square
        sums, squares = self._windows(ordered)
        statistics["window"] = sums.amax(-1)
        statistics["window of squares"] = squares.amax(-1)
        for name, order in self.coordinates.items():
            statistics[f"along {name}"] = _binned(u[:, order])
        for name, signature in self.signatures.items():
            statistics[f"signature {name}"] = (u @ signature.T).square().amax(-1)
        return statistics

    def _windows(self, ordered: Tensor) -> tuple[Tensor, Tensor]:
        """Largest over positions of (sum u)^2 / n and of (sum u^2 - n) / sqrt(2 n), for each length: (B,
        number of lengths)."""
        zero = ordered.new_zeros(len(ordered), 1)
        total = torch.cat([zero, ordered.cumsum(-1)], -1)
        power = torch.cat([zero, (ordered * ordered).cumsum(-1)], -1)
        sums = [(total[:, n:] - total[:, :-n]).square().amax(-1) / n for n in self.lengths]
        squares = [(power[:, n:] - power[:, :-n] - n).amax(-1) / math.sqrt(2 * n) for n in self.lengths]
        if not self.lengths:
            return zero, zero
        return torch.stack(sums, -1), torch.stack(squares, -1)

    def beyond(self, u: Tensor, null: Tensor) -> list[tuple[int, int, float]]:
        """Windows (first, last row in time order, p) whose |sum| is beyond 95 % of the largest window sums of
        null draws (B, T)."""
        if not self.lengths:
            return []
        limit = torch.quantile(self._windows(null[:, self.order])[0].amax(-1), 0.95)
        ordered = u[self.order]
        total = torch.cat([ordered.new_zeros(1), ordered.cumsum(-1)])
        marked = torch.zeros(len(ordered), dtype=torch.bool)
        for n in self.lengths:
            over = torch.nonzero((total[n:] - total[:-n]).square() / n > limit)[:, 0]
            for first in over.tolist():
                marked[first : first + n] = True
        return [(int(self.order[a]), int(self.order[b]), 0.05) for a, b in runs(marked)]


def _binned(u: Tensor) -> Tensor:
    """Sum over equal-count bins of (sum u)^2 / n, of residuals (B, T) sorted along a coordinate."""
    bins = min(BINS, max(2, u.shape[-1] // 8))
    edges = [round(u.shape[-1] * k / bins) for k in range(bins + 1)]
    total = torch.cat([u.new_zeros(len(u), 1), u.cumsum(-1)], -1)
    sums = torch.stack([total[:, b] - total[:, a] for a, b in pairwise(edges)], -1)
    counts = torch.tensor([b - a for a, b in pairwise(edges)], dtype=u.dtype)
    return (sums**2 / counts).sum(-1)


def runs(mask: Tensor) -> list[tuple[int, int]]:
    """First and last index of every run of True in a mask (T,)."""
    padded = torch.cat([mask.new_zeros(1), mask, mask.new_zeros(1)]).to(torch.int8)
    step = torch.diff(padded)
    return list(
        zip(
            torch.nonzero(step == 1)[:, 0].tolist(),
            (torch.nonzero(step == -1)[:, 0] - 1).tolist(),
            strict=True,
        )
    )


def normal_scores(at: Fitted) -> Tensor:
    """Residuals (T,) as standard normal numbers if the noise is right: the normal deviates of the law's own, whitened where
    rows err together."""
    if at.noise.processes:
        return at.whitened(at.delta[:, None])[:, 0]
    u = at.delta / at.wide
    if at.noise.normal:
        return u
    below = torch.exp(at.noise.law.log_below(-u.abs()))
    return torch.sign(u) * -torch.special.ndtri(below.clamp(min=1e-300))


def gate(at: Fitted, battery: Battery, seed: int = 0, draws: int = DRAWS) -> Gate:
    """The battery on a fit's residuals against draws of its null, under its noise.

    Strained peaked priors count as rows of their own; how a flat one is strained says nothing. Rows that are more likely bad
    than not count nothing: clouds make them in runs, and a run that is more than that is an event of its own
    (:mod:`torchlc.diagnosis.discrepancy`).
    """
    basis = at.basis
    rows = len(at.delta)
    free = at.model.parameter_set.free
    peaked = [rows + index for index, parameter in enumerate(free) if parameter.prior.peaked]
    generator = torch.Generator().manual_seed(seed)
    z = torch.randn(draws, len(basis), generator=generator, dtype=at.delta.dtype)
    z = z - (z @ basis) @ basis.T
    good = (at.outlying() < BAD_ROW).to(z)
    u, null_u = normal_scores(at)[None] * good, z[:, :rows] * good
    prior, null_prior = at.g[None, [index - rows for index in peaked]], z[:, peaked]
    if at.likelihood.fitted_errors:
        u, null_u = (
            _studentised(scores, at.likelihood.curve, at.likelihood.curves) for scores in (u, null_u)
        )
    observed = battery.statistics(u, prior)
    null = battery.statistics(null_u, null_prior)
    marginal, null_minimum = {}, torch.zeros(draws, dtype=u.dtype)
    for name, values in null.items():
        ordered = torch.sort(values).values
        log_p = log_tail(ordered, observed[name])
        marginal[name] = math.exp(float(log_p[0]))
        null_minimum = torch.minimum(null_minimum, log_tail(ordered, values))
    smallest = min(math.log(max(p, 1e-300)) for p in marginal.values())
    strength = torch.sort(-null_minimum).values
    global_p = math.exp(float(log_tail(strength, torch.tensor([-smallest], dtype=strength.dtype))[0]))
    return Gate(global_p, marginal, battery.beyond(u[0], null_u))


def _studentised(u: Tensor, curve: Tensor, curves: int) -> Tensor:
    """Residuals (B, T) divided by each curve's own root mean square."""
    count = torch.bincount(curve, minlength=curves).to(u)
    power = u.new_zeros(len(u), curves).index_add(1, curve, u * u) / count
    return u / torch.sqrt(power.clamp(min=1e-300))[:, curve]


def log_tail(ordered: Tensor, value: Tensor) -> Tensor:
    """log p of each value (N,) against sorted null draws (B,): the rank below the top 5 %, an exponential
    fitted to the top 5 % beyond.

    An exponential is heavier than every statistic's own tail here (squares of Gaussians), so p is not too
    small.
    """
    draws = len(ordered)
    above = draws - torch.searchsorted(ordered, value.contiguous(), right=False)
    rank = torch.log((above.to(ordered) + 0.5) / (draws + 1.0))
    threshold = ordered[int(0.95 * draws)]
    mean_excess = (ordered[int(0.95 * draws) :] - threshold).mean().clamp(min=1e-12)
    tail = math.log(0.05) - (value - threshold) / mean_excess
    return torch.where(
        value > threshold, torch.minimum(tail, torch.tensor(math.log(0.05), dtype=tail.dtype)), rank
    )
