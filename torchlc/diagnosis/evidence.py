"""Evidence and held-out prediction of a refit under white noise, jitter, red noise or outliers, in closed
form.

About a refit the recording is linear-Gaussian: r = delta - M x with x ~ N(mu - y, V) a priori and C the
noise. With one factorisation of C the log evidence log N(r; M (mu - y), C + M V M') and the predictive
density of every held-out block given the rest follow. Blocks are longer than three correlation times, with a
gap of one, so that a process has forgotten and physics has not.

Outliers are a mixture, under which the rows of a block have no joint density in closed form. Theirs is the product
of every row's density given the rest and the block's rows before it, mixtures of two normals each, with x kept as
normal in between (assumed density filtering; Opper 1998, in On-line Learning in Neural Networks, 363): a product of
densities is a density whatever is kept, and with few outliers it is that of the normal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import torch
from torch import Tensor

from torchlc.diagnosis.refit import Refit
from torchlc.inference.likelihood import matern32
from torchlc.inference.optimiser import lightened

LONGEST_TAU_MIN = 120.0
JITTER_SCALE = 0.05
LOG_2PI = math.log(2 * math.pi)
MEMBERSHIPS = 5
"""Times that the rows of the rest are weighed anew; the weights of later ones differ by less than a hundredth."""


@dataclass(frozen=True)
class NoiseModel:
    """``kind`` white, jitter, red_noise or outliers, with its parameters (mag, minutes, fraction, width)."""

    kind: str
    jitter: float = 0.0
    red: float = 0.0
    tau_min: float = 0.0
    fraction: float = 0.0
    width: float = 1.0

    @property
    def penalty(self) -> float:
        """Log prior width spent on its parameters, taken off the maximised evidence."""
        return {"white": 0.0, "jitter": 2.5, "red_noise": 5.0, "outliers": 5.0}[self.kind]


@dataclass(frozen=True)
class Score:
    """How a refit fares under its best noise model: log evidence, and the held-out log density by block.

    ``unseen``, where errors are fitted, is the root mean square, mag, of the parts of curves predicted from the
    other parts.
    """

    noise: NoiseModel
    log_evidence: float
    heldout: Tensor
    by_kind: dict[str, tuple[float, float]]
    unseen: float = math.nan

    @property
    def heldout_total(self) -> float:
        return float(self.heldout.sum())


@dataclass(frozen=True)
class Blocks:
    """Rows of each held-out block, and the rows that must be forgotten with it (the block and its gaps)."""

    rows: Sequence[Tensor]
    removed: Sequence[Tensor]


def make_blocks(seconds: Tensor, group: Tensor, count: int = 8) -> Blocks:
    """Whole groups (curves or nights) if there are at least four, dealt into at most ``count`` blocks; else
    runs of rows of equal number, with a gap of 5 % of the rows on either side."""
    ids = torch.unique(group)
    if len(ids) >= 4:
        folds = min(count, len(ids))
        rows = [torch.nonzero(torch.isin(group, ids[fold::folds]))[:, 0] for fold in range(folds)]
        return Blocks(rows, rows)
    order = torch.argsort(seconds)
    total = len(order)
    folds = min(count, max(2, total // 4))
    edges = [round(total * k / folds) for k in range(folds + 1)]
    gap = max(1, round(0.025 * total))
    rows = [order[a:b] for a, b in pairwise(edges)]
    removed = [order[max(0, a - gap) : min(total, b + gap)] for a, b in pairwise(edges)]
    return Blocks(rows, removed)


def parts_of(seconds: Tensor, groups: Sequence[Tensor], count: int = 4) -> Blocks:
    """Every group's rows cut in time into ``count`` runs, of which each block has one of every group."""
    cuts: list[list[Tensor]] = [[] for _ in range(count)]
    for group in groups:
        order = group[torch.argsort(seconds[group])]
        edges = [round(len(order) * k / count) for k in range(count + 1)]
        for cut, (a, b) in zip(cuts, pairwise(edges), strict=True):
            cut.append(order[a:b])
    rows = [torch.cat(cut) for cut in cuts]
    return Blocks(rows, rows)


class Scorer:
    """Scores refits of one recording: its blocks, and the groups (curves) within which noise is
    correlated."""

    def __init__(self, seconds: Tensor, curve: Tensor, blocks: Blocks, fitted_errors: bool) -> None:
        self.seconds, self.blocks, self.fitted_errors = seconds, blocks, fitted_errors
        self.groups = [torch.nonzero(curve == one)[:, 0] for one in torch.unique(curve)]
        self.parts = parts_of(seconds, self.groups)
        span_min = float(max((seconds[g].max() - seconds[g].min()) for g in self.groups)) / 60
        steps = torch.cat([torch.diff(torch.sort(seconds[g]).values) for g in self.groups])
        cadence_min = float(steps.median()) / 60 if len(steps) else 1.0
        longest = min(LONGEST_TAU_MIN, span_min / 4)
        shortest = max(2 * cadence_min, 1e-3)
        self.taus = (
            []
            if longest <= shortest
            else torch.logspace(math.log10(shortest), math.log10(longest), 5, dtype=torch.float64).tolist()
        )
        self._kernels: dict[tuple[int, float], Tensor] = {}

    # ------------------------------------------------------------------ noise models

    def score(
        self, refit: Refit, kinds: Sequence[str] = ("white", "jitter", "red_noise", "outliers")
    ) -> Score:
        """Evidence under each noise model at its best parameters, and the held-out density under the best of
        them."""
        found: dict[str, tuple[NoiseModel, float]] = {}
        for kind in kinds:
            if kind == "jitter" and self.fitted_errors:
                continue
            noise = self._fitted(refit, kind)
            if noise is not None:
                found[kind] = (noise, self.log_evidence(refit, noise) - noise.penalty)
        best = max(found.values(), key=lambda item: item[1])
        by_kind = {
            kind: (value, float(self.heldout(refit, noise).sum())) for kind, (noise, value) in found.items()
        }
        unseen = self.heldout_rms(refit, self.parts) if self.fitted_errors else math.nan
        return Score(best[0], best[1], self.heldout(refit, best[0]), by_kind, unseen)

    def _fitted(self, refit: Refit, kind: str) -> NoiseModel | None:
        if kind == "white":
            return NoiseModel("white")
        sigma = float((refit.sigma / refit.scale).median())
        if kind == "jitter":
            excess = refit.delta**2 - refit.sigma**2
            guess = math.sqrt(max(float((excess / refit.scale**2).mean()), (0.1 * sigma) ** 2))
            trials = [NoiseModel("jitter", jitter=guess * f) for f in (0.3, 0.55, 0.8, 1.0, 1.25, 1.8)]
            return self._best(refit, trials)
        if kind == "red_noise":
            if not self.taus:
                return None
            spread = max(float((refit.delta / refit.scale).std()), 0.3 * sigma)
            rough = [
                NoiseModel("red_noise", red=spread * f, tau_min=tau)
                for tau in self.taus
                for f in (0.25, 0.7, 1.3)
            ]
            first = self._best(refit, rough)
            around = [
                NoiseModel("red_noise", red=first.red * f, tau_min=first.tau_min)
                for f in (0.6, 0.8, 1.0, 1.25, 1.6)
            ]
            return self._best(refit, around)
        u = refit.delta / refit.sigma
        trials = [
            NoiseModel("outliers", fraction=f, width=w)
            for f in (0.01, 0.03, 0.1, 0.2)
            for w in (3.0, 6.0, 15.0, 40.0)
        ]
        values = [self._mixture(u, noise).sum() for noise in trials]
        return trials[int(torch.stack(values).argmax())]

    def _best(self, refit: Refit, trials: Sequence[NoiseModel]) -> NoiseModel:
        return max(trials, key=lambda noise: self.log_evidence(refit, noise))

    def _mixture(self, u: Tensor, noise: NoiseModel) -> Tensor:
        core = math.log1p(-noise.fraction) - 0.5 * u * u
        tail = math.log(noise.fraction) - 0.5 * (u / noise.width) ** 2 - math.log(noise.width)
        return torch.logaddexp(core, tail)

    # ------------------------------------------------------------------ linear-Gaussian algebra

    def weights(self, refit: Refit, noise: NoiseModel) -> Tensor:
        """Effective standard deviation of each row; outliers as the width their posterior membership
        implies."""
        if noise.kind == "jitter":
            return torch.sqrt(refit.sigma**2 + (noise.jitter * refit.scale) ** 2)
        if noise.kind == "outliers":
            return lightened(refit.delta, refit.sigma, noise.fraction, noise.width)
        return refit.sigma

    def _whitened(
        self, refit: Refit, noise: NoiseModel, rows: Tensor | None = None
    ) -> tuple[Tensor, Tensor, float]:
        """Rows (delta, slopes) divided by the root of C, and log det C / 2, of all rows or some."""
        sigma = self.weights(refit, noise)
        columns = torch.cat([refit.delta[:, None], refit.slopes], 1)
        if noise.kind != "red_noise":
            pick = slice(None) if rows is None else rows
            white = columns[pick] / sigma[pick, None]
            return white[:, 0], white[:, 1:], float(torch.log(sigma[pick]).sum())
        pieces, log_det = [], 0.0
        inside = (
            torch.ones(len(refit.delta), dtype=torch.bool)
            if rows is None
            else torch.zeros(len(refit.delta), dtype=torch.bool).index_fill(0, rows, True)
        )
        for number, group in enumerate(self.groups):
            mask = inside[group]
            if not bool(mask.any()):
                continue
            kept = group[mask]
            kernel = self._kernel(number, noise.tau_min)[mask][:, mask]
            red = noise.red * refit.scale[kept]
            covariance = kernel * red[:, None] * red[None] + torch.diag(sigma[kept] ** 2)
            factor = torch.linalg.cholesky(covariance)
            pieces.append(torch.linalg.solve_triangular(factor, columns[kept], upper=False))
            log_det += float(torch.log(torch.diagonal(factor)).sum())
        white = torch.cat(pieces)
        return white[:, 0], white[:, 1:], log_det

    def whitened(self, refit: Refit, noise: NoiseModel) -> Refit:
        """The refit with rows of unit variance under a noise model, in place of its own; rows keep their
        order."""
        r, m, _ = self._whitened(refit, noise)
        if noise.kind == "red_noise":
            order = torch.argsort(torch.cat(self.groups))
            r, m = r[order], m[order]
        one = torch.ones_like(r)
        return replace(refit, delta=r, slopes=m, sigma=one, scale=one)

    def heldout_rms(self, refit: Refit, blocks: Blocks | None = None) -> float:
        """Root mean square, mag, of the residuals of each block (its own, if none are given) predicted from the
        rest."""
        blocks = blocks or self.blocks
        keep = torch.nonzero(~refit.held)[:, 0]
        everything = torch.arange(len(refit.delta))
        shift, precision = refit.prior
        total = 0.0
        for rows, removed in zip(blocks.rows, blocks.removed, strict=True):
            rest = everything[~torch.isin(everything, removed)]
            m = refit.slopes[rest][:, keep] / refit.sigma[rest, None]
            r = refit.delta[rest] / refit.sigma[rest]
            x = torch.linalg.solve(precision + m.T @ m, m.T @ r + precision @ shift)
            left = (refit.delta[rows] - refit.slopes[rows][:, keep] @ x) / refit.scale[rows]
            total += float((left * left).sum())
        return math.sqrt(total / len(refit.delta))

    def _kernel(self, number: int, tau_min: float) -> Tensor:
        key = (number, tau_min)
        if key not in self._kernels:
            times = self.seconds[self.groups[number]] / 60
            gap = (times[:, None] - times[None]).abs()
            self._kernels[key] = matern32(gap, torch.tensor(tau_min, dtype=gap.dtype))
        return self._kernels[key]

    def log_evidence(self, refit: Refit, noise: NoiseModel) -> float:
        """log N(delta; M (mu - y), C + M V M'). For outliers a lower bound of it, close where it is clear which
        rows are bad: the mixture is at least its value at the refit times the change of the weighted squares."""
        r, m, log_det = self._whitened(refit, noise)
        gaussian = _log_marginal(r, m, refit) - log_det - 0.5 * len(r) * LOG_2PI
        if noise.kind != "outliers":
            return gaussian
        u = refit.delta / refit.sigma
        mixture = float((self._mixture(u, noise) - torch.log(refit.sigma)).sum()) - 0.5 * len(u) * LOG_2PI
        return mixture + (_log_marginal(r, m, refit) + 0.5 * float((r * r).sum()))

    def heldout(self, refit: Refit, noise: NoiseModel) -> Tensor:
        """Log predictive density of each block given the rest (less the gap): parameters from the rest, the
        process forgotten."""
        if noise.kind == "outliers":
            return self._heldout_mixture(refit, noise)
        scores = []
        keep = torch.nonzero(~refit.held)[:, 0]
        everything = torch.arange(len(refit.delta))
        shift, precision = refit.prior
        for rows, removed in zip(self.blocks.rows, self.blocks.removed, strict=True):
            rest = everything[~torch.isin(everything, removed)]
            r, m, _ = self._whitened(refit, noise, rest)
            m = m[:, keep]
            system = precision + m.T @ m
            factor = stable_cholesky(system)
            x = torch.cholesky_solve((m.T @ r + precision @ shift)[:, None], factor)[:, 0]
            rb, mb, log_det = self._whitened(refit, noise, rows)
            mb = mb[:, keep]
            left = rb - mb @ x
            spread = torch.linalg.solve_triangular(factor, mb.T, upper=False)
            small = torch.eye(len(keep), dtype=m.dtype) + spread @ spread.T
            inner = torch.linalg.cholesky(small)
            projected = torch.linalg.solve_triangular(inner, spread @ left[:, None], upper=False)[:, 0]
            quadratic = left @ left - projected @ projected
            half = torch.log(torch.diagonal(inner)).sum() if len(keep) else 0.0
            scores.append(-0.5 * quadratic - half - log_det - 0.5 * len(rows) * LOG_2PI)
        return torch.stack([torch.as_tensor(score, dtype=refit.delta.dtype) for score in scores])

    def _heldout_mixture(self, refit: Refit, noise: NoiseModel) -> Tensor:
        """Log density of each block's rows, one after the other, all blocks abreast: rows of the rest are weighed by
        how far they are from what the rest alone says."""
        keep = torch.nonzero(~refit.held)[:, 0]
        everything = torch.arange(len(refit.delta))
        slopes = refit.slopes[:, keep]
        shift, precision = refit.prior
        means, covariances = [], []
        for removed in self.blocks.removed:
            rest = everything[~torch.isin(everything, removed)]
            delta, sigma, m = refit.delta[rest], refit.sigma[rest], slopes[rest]
            error = lightened(delta, sigma, noise.fraction, noise.width)
            for _ in range(MEMBERSHIPS):
                white = m / error[:, None]
                factor = stable_cholesky(precision + white.T @ white)
                pull = white.T @ (delta / error) + precision @ shift
                x = torch.cholesky_solve(pull[:, None], factor)[:, 0]
                error = lightened(delta - m @ x, sigma, noise.fraction, noise.width)
            means.append(x)
            covariances.append(torch.cholesky_inverse(factor))
        longest = max(len(rows) for rows in self.blocks.rows)
        index = torch.stack(
            [torch.nn.functional.pad(rows, (0, longest - len(rows))) for rows in self.blocks.rows]
        )
        inside = torch.stack([torch.arange(longest) < len(rows) for rows in self.blocks.rows])
        return filtered_log_density(
            torch.stack(means),
            torch.stack(covariances),
            refit.delta[index],
            slopes[index],
            refit.sigma[index],
            inside,
            noise,
        )


def filtered_log_density(
    mean: Tensor,
    covariance: Tensor,
    delta: Tensor,
    slopes: Tensor,
    sigma: Tensor,
    inside: Tensor,
    noise: NoiseModel,
) -> Tensor:
    """Log density (N,) of N sequences of rows delta = slopes x + noise, (N, n), with outliers of a share and width,
    where x is normal with mean (N, K) and covariance (N, K, K): each row's mixture given those before, after which
    x is the normal of the same mean and covariance as the mixture's. Rows not ``inside`` (N, n) are skipped."""
    width = delta.new_tensor([1.0, noise.width])
    share = torch.log(delta.new_tensor([1 - noise.fraction, noise.fraction]))
    total = torch.zeros_like(delta[:, 0])
    for row in range(delta.shape[1]):
        m, there = slopes[:, row], inside[:, row]
        spread = (covariance @ m[..., None])[..., 0]
        known = (m * spread).sum(-1)
        variance = known[:, None] + (sigma[:, row, None] * width) ** 2
        left = delta[:, row] - (m * mean).sum(-1)
        log_parts = share - 0.5 * left[:, None] ** 2 / variance - 0.5 * torch.log(variance) - 0.5 * LOG_2PI
        log_row = torch.logsumexp(log_parts, -1)
        total = total + torch.where(there, log_row, 0.0)
        member = torch.exp(log_parts - log_row[:, None])
        gain = (member / variance).sum(-1)
        # variance of the mixture: that within its parts, and that of their means about their own mean
        between = (member / variance**2).sum(-1) - gain**2
        shrink = gain - left**2 * between
        mean = mean + torch.where(there, gain * left, 0.0)[:, None] * spread
        reduction = spread[:, :, None] * spread[:, None, :]
        covariance = covariance - torch.where(there, shrink, 0.0)[:, None, None] * reduction
    return total


def stable_cholesky(system: Tensor) -> Tensor:
    """Lower factor of a positive matrix whose scales may differ by many decades: factored at unit diagonal, a
    ridge of 1e-12 and, if that does not do, of 1e-8 added there."""
    root = torch.sqrt(torch.diagonal(system).clamp(min=1e-300))
    scaled = system / root[:, None] / root[None]
    eye = torch.eye(len(system), dtype=system.dtype)
    factor, info = torch.linalg.cholesky_ex(scaled + 1e-12 * eye)
    if int(info) != 0:
        factor = torch.linalg.cholesky(scaled + 1e-8 * eye)
    return factor * root[:, None]


def _log_marginal(r: Tensor, m: Tensor, refit: Refit) -> float:
    """log of the integral over x of exp(-|r - m x|^2 / 2) N(x; mu - y, V), held coordinates left out."""
    keep = torch.nonzero(~refit.held)[:, 0]
    m = m[:, keep]
    shift, precision = refit.prior
    factor = stable_cholesky(precision + m.T @ m)
    b = m.T @ r + precision @ shift
    root = torch.linalg.solve_triangular(factor, b[:, None], upper=False)[:, 0]
    quadratic = r @ r + shift @ precision @ shift - root @ root
    width = torch.log(torch.diagonal(factor)).sum() - 0.5 * torch.linalg.slogdet(precision)[1]
    return float(-0.5 * quadratic - width)
