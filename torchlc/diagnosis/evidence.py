"""Evidence and held-out prediction of a refit under white noise and every other kind of the library, in closed
form where noise is normal.

About a refit the recording is linear-Gaussian: r = delta - M x with x ~ N(mu - y, V) a priori and C the
noise. With one factorisation of C the log evidence log N(r; M (mu - y), C + M V M') and the predictive
density of every held-out block given the rest follow. Blocks are longer than three correlation times, with a
gap of one, so that a process has forgotten and physics has not.

Under a law of errors that is not the normal one (outliers, say) the rows of a block have no joint density in closed
form. Theirs is the product of every row's density given the rest and the block's rows before it, the law blurred by what
is not known of x, with x kept as normal in between (assumed density filtering; Opper 1998, in On-line Learning in Neural
Networks, 363): a product of densities is a density whatever is kept, and with few outliers it is that of the normal.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import torch
from torch import Tensor

from torchlc.diagnosis.refit import Refit
from torchlc.effects import registry
from torchlc.noise import Noise
from torchlc.noise.kind import Facts, NoiseKind
from torchlc.stages.effect import Context
from torchlc.stages.noise import Law, Process

LONGEST_TAU_MIN = 120.0
LOG_2PI = math.log(2 * math.pi)
MEMBERSHIPS = 5
"""Times that the rows of the rest are weighed anew; the weights of later ones differ by less than a hundredth."""


NUMBER_COST = 2.5
"""Log prior width spent on each number of a noise model: ln 12, of a value known to a twelfth of its prior."""


@dataclass(frozen=True)
class NoiseModel:
    """A ``kind`` of noise at some ``values`` of its quantities; no kind is white noise, as quoted."""

    noise: Noise
    kind: NoiseKind | None = None
    values: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, kind: NoiseKind, values: Mapping[str, float], context: Context) -> NoiseModel:
        numbers = {name: context.seconds.new_tensor([value]) for name, value in values.items()}
        return cls(kind.noise(Noise(), numbers, context), kind, values)

    @property
    def name(self) -> str:
        return "white" if self.kind is None else self.kind.name

    @property
    def penalty(self) -> float:
        """Log prior width spent on its numbers, taken off the maximised evidence."""
        return NUMBER_COST * len(self.values)

    @property
    def correlates(self) -> bool:
        return bool(self.noise.processes)


WHITE = NoiseModel(Noise())


@dataclass(frozen=True)
class Score:
    """How a refit fares under its best noise model: log evidence, and the held-out log density by block; both, the
    latter in total, under ``white`` noise and ``by_kind`` of noise that was tried.

    ``unseen``, where errors are fitted, is the root mean square, mag, of the parts of curves predicted from the
    other parts.
    """

    noise: NoiseModel
    log_evidence: float
    heldout: Tensor
    white: tuple[float, float]
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

    def __init__(self, context: Context, blocks: Blocks) -> None:
        seconds, curve = context.seconds, context.curve
        self.context, self.seconds, self.blocks = context, seconds, blocks
        self.fitted_errors = not context.errors
        self.groups = [torch.nonzero(curve == one)[:, 0] for one in torch.unique(curve)]
        self.kinds = {
            name: cls().prepared(context)
            for name, cls in registry().items()
            if issubclass(cls, NoiseKind) and cls().missing(context) is None
        }
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
        self._correlations: dict[tuple[int, Hashable], Tensor] = {}

    # ------------------------------------------------------------------ noise models

    def score(self, refit: Refit) -> Score:
        """Evidence under each noise model at its best parameters, and the held-out density under the best of
        them."""
        models = [WHITE, *(self._fitted(refit, kind) for kind in self.kinds.values())]
        scored = {
            model.name: (model, self.log_evidence(refit, model) - model.penalty)
            for model in models
            if model is not None
        }
        best = max(scored.values(), key=lambda item: item[1])
        by_kind = {
            name: (value, float(self.heldout(refit, model).sum())) for name, (model, value) in scored.items()
        }
        white = by_kind.pop(WHITE.name)
        unseen = self.heldout_rms(refit, self.parts) if self.fitted_errors else math.nan
        return Score(best[0], best[1], self.heldout(refit, best[0]), white, by_kind, unseen)

    def model(self, kind: str, **values: float) -> NoiseModel:
        """A kind of the library at some values of its quantities."""
        return NoiseModel.of(self.kinds[kind], values, self.context)

    def _fitted(self, refit: Refit, kind: NoiseKind) -> NoiseModel | None:
        """A kind at its best values of those that it tries; None if it tries none."""
        sigma = float((refit.sigma / refit.scale).median())
        facts = Facts(
            sigma=sigma,
            spread=float((refit.delta / refit.scale).std()),
            excess=float(((refit.delta**2 - refit.sigma**2) / refit.scale**2).mean()),
            taus=self.taus,
        )
        trials = kind.trials(facts)
        if not trials:
            return None
        best = self._best(refit, kind, trials)
        closer = kind.closer(best.values, facts)
        return self._best(refit, kind, closer) if closer else best

    def _best(self, refit: Refit, kind: NoiseKind, trials: Sequence[Mapping[str, float]]) -> NoiseModel:
        models = [NoiseModel.of(kind, values, self.context) for values in trials]
        return max(models, key=lambda model: self._merit(refit, model))

    def _merit(self, refit: Refit, model: NoiseModel) -> float:
        """What values of a kind are compared by: evidence, or of a law that is not normal its density as it stands."""
        if model.noise.normal:
            return self.log_evidence(refit, model)
        return float(self._row_densities(refit, model).sum())

    def _row_densities(self, refit: Refit, model: NoiseModel) -> Tensor:
        sigma = model.noise.sigma(refit.sigma, refit.scale)
        return model.noise.law.log_mixed(refit.delta / sigma, sigma)

    # ------------------------------------------------------------------ linear-Gaussian algebra

    def weights(self, refit: Refit, model: NoiseModel) -> Tensor:
        """Effective standard deviation of each row (T,), by its weight under the law of errors."""
        return model.noise.law.weighted(refit.delta, model.noise.sigma(refit.sigma, refit.scale))

    def _whitened(
        self, refit: Refit, model: NoiseModel, rows: Tensor | None = None
    ) -> tuple[Tensor, Tensor, float]:
        """Rows (delta, slopes) divided by the root of C, and log det C / 2, of all rows or some."""
        sigma = self.weights(refit, model)
        columns = torch.cat([refit.delta[:, None], refit.slopes], 1)
        if not model.correlates:
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
            covariance = torch.diag(sigma[kept] ** 2)
            for process in model.noise.processes:
                sd = (process.sd * refit.scale)[kept]
                shared = self._correlation(number, process)[mask][:, mask]
                covariance = shared * sd[:, None] * sd[None] + covariance
            factor = torch.linalg.cholesky(covariance)
            pieces.append(torch.linalg.solve_triangular(factor, columns[kept], upper=False))
            log_det += float(torch.log(torch.diagonal(factor)).sum())
        white = torch.cat(pieces)
        return white[:, 0], white[:, 1:], log_det

    def whitened(self, refit: Refit, model: NoiseModel) -> Refit:
        """The refit with rows of unit variance under a noise model, in place of its own; rows keep their
        order."""
        r, m, _ = self._whitened(refit, model)
        if model.correlates:
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

    def _correlation(self, number: int, process: Process) -> Tensor:
        """Correlation of all rows of a group under a process; kept, if the process can be told from others."""
        if process.key is None:
            return process.correlation(self.groups[number])
        key = (number, process.key)
        if key not in self._correlations:
            self._correlations[key] = process.correlation(self.groups[number])
        return self._correlations[key]

    def log_evidence(self, refit: Refit, model: NoiseModel) -> float:
        """log N(delta; M (mu - y), C + M V M'). Under a law that is not normal a lower bound of it, close where it is
        clear how much each row weighs: the density is at least its value at the refit times the change of the weighted
        squares, as for every mixture of normals of one centre."""
        r, m, log_det = self._whitened(refit, model)
        if model.noise.normal:
            return _log_marginal(r, m, refit) - log_det - 0.5 * len(r) * LOG_2PI
        density = float(self._row_densities(refit, model).sum())
        return density + (_log_marginal(r, m, refit) + 0.5 * float((r * r).sum()))

    def heldout(self, refit: Refit, model: NoiseModel) -> Tensor:
        """Log predictive density of each block given the rest (less the gap): parameters from the rest, the
        process forgotten."""
        if not model.noise.normal:
            return self._heldout_filtered(refit, model)
        scores = []
        keep = torch.nonzero(~refit.held)[:, 0]
        everything = torch.arange(len(refit.delta))
        shift, precision = refit.prior
        for rows, removed in zip(self.blocks.rows, self.blocks.removed, strict=True):
            rest = everything[~torch.isin(everything, removed)]
            r, m, _ = self._whitened(refit, model, rest)
            m = m[:, keep]
            system = precision + m.T @ m
            factor = stable_cholesky(system)
            x = torch.cholesky_solve((m.T @ r + precision @ shift)[:, None], factor)[:, 0]
            rb, mb, log_det = self._whitened(refit, model, rows)
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

    def _heldout_filtered(self, refit: Refit, model: NoiseModel) -> Tensor:
        """Log density of each block's rows, one after the other, all blocks abreast: rows of the rest are weighed by
        how far they are from what the rest alone says."""
        keep = torch.nonzero(~refit.held)[:, 0]
        everything = torch.arange(len(refit.delta))
        slopes = refit.slopes[:, keep]
        shift, precision = refit.prior
        law, every_sigma = model.noise.law, model.noise.sigma(refit.sigma, refit.scale)
        means, covariances = [], []
        for removed in self.blocks.removed:
            rest = everything[~torch.isin(everything, removed)]
            delta, sigma, m = refit.delta[rest], every_sigma[rest], slopes[rest]
            error = law.weighted(delta, sigma)
            for _ in range(MEMBERSHIPS):
                white = m / error[:, None]
                factor = stable_cholesky(precision + white.T @ white)
                pull = white.T @ (delta / error) + precision @ shift
                x = torch.cholesky_solve(pull[:, None], factor)[:, 0]
                error = law.weighted(delta - m @ x, sigma)
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
            every_sigma[index],
            inside,
            law,
        )


def filtered_log_density(
    mean: Tensor,
    covariance: Tensor,
    delta: Tensor,
    slopes: Tensor,
    sigma: Tensor,
    inside: Tensor,
    law: Law,
) -> Tensor:
    """Log density (N,) of N sequences of rows delta = slopes x + noise, (N, n), whose noise over sigma follows a law
    that is the same for all rows, where x is normal with mean (N, K) and covariance (N, K, K): each row's density given
    those before, after which x is the normal of the same mean and covariance. Rows not ``inside`` (N, n) are skipped."""
    total = torch.zeros_like(delta[:, 0])
    for row in range(delta.shape[1]):
        m, there = slopes[:, row], inside[:, row]
        spread = (covariance @ m[..., None])[..., 0]
        known = (m * spread).sum(-1)
        left = delta[:, row] - (m * mean).sum(-1)
        log_row, slope, shrink = law.blurred(left, sigma[:, row], known)
        total = total + torch.where(there, log_row, 0.0)
        mean = mean + torch.where(there, slope, 0.0)[:, None] * spread
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
