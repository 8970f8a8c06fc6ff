"""Evidence: the integral of a density, and its draws, by importance sampling about its maxima.

The proposal is a mixture of Student's t distributions, one about each maximum with the curvature there. The ratio of the
density to it gives the integral, its standard error, and the shape k of the largest ratios: below 0.7 the mean of the
ratios is to be believed (Vehtari, Simpson, Gelman, Yao & Gabry 2024, J. Mach. Learn. Res. 25, 72). Where it is not, the
mixture is fitted to its own weighted draws and drawn from again (population Monte Carlo: Cappe, Douc, Guillin, Marin &
Robert 2008, Stat. Comput. 18, 447). Where that is not enough, the draws are led from the mixture to the density by steps
(sequential Monte Carlo: Del Moral, Doucet & Jasra 2006, J. R. Statist. Soc. B 68, 411).

Letters: M components, P dimensions, N draws.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

TAILS = 5
"""Degrees of freedom of the proposal: its tails fall off as a power, so that no ratio grows without bound where the
density has tails of a normal one, or of one known by a few rows."""
TRUSTED_K = 0.7
"""Of the Pareto tail of importance weights (Vehtari et al. 2024, JMLR 25, 72): beyond, their mean does not settle."""
THIN = 0.1
"""Share of effective draws below which a proposal is adapted once more although its weights are to be trusted: where a density is bent, the draws
that miss it altogether are in no weight."""
SHRINK = 0.1
"""Share of its former covariance that an adapted component keeps, so that few heavy draws do not make it flat."""


LEFT = 0.5
"""Share of the draws that a step of a tempered sequence leaves effective, as is usual (Del Moral et al.)."""
MOVES = 6
"""Of every draw at every step. With one, what draws share by descent makes the evidence of a plateau 0.3 off."""
MOST_STEPS = 40
"""Of the temperature, from the proposal to the posterior."""


@dataclass(frozen=True)
class Evidence:
    """``log_z`` with its standard ``error``, the shape ``pareto_k`` of the largest weights, and the ``draws`` (N, P) with
    the logarithms of their normalised weights (N,); ``linear`` where residuals were taken as linear about a minimum."""

    log_z: float
    error: float
    pareto_k: float
    draws: Tensor
    log_weight: Tensor
    linear: bool = False

    @property
    def trusted(self) -> bool:
        return self.pareto_k < TRUSTED_K and math.isfinite(self.log_z)

    @property
    def effective(self) -> float:
        """How many independent draws the weighted ones are worth."""
        return float(torch.exp(-torch.logsumexp(2 * self.log_weight, 0)))


class StudentMixture:
    """Student's t of ``dof`` degrees of freedom about ``mean`` (M, P) with scale ``covariance`` (M, P, P), in shares whose
    logarithms are ``log_share`` (M,)."""

    def __init__(self, mean: Tensor, covariance: Tensor, log_share: Tensor, dof: int = TAILS) -> None:
        self.mean, self.covariance = mean, covariance
        self.log_share = log_share - torch.logsumexp(log_share, 0)
        self.dof = dof
        self.factor = torch.linalg.cholesky(covariance)

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """``count`` draws (count, P): of each component as many as its share asks for, rounded at random."""
        share = torch.exp(self.log_share)
        edges = torch.cumsum(share, 0) / share.sum()
        position = (torch.arange(count) + torch.rand((), generator=generator)) / count
        member = torch.searchsorted(edges, position.to(edges)).clamp(max=len(edges) - 1)
        normal = torch.randn(count, self.mean.shape[-1], generator=generator, dtype=self.mean.dtype)
        others = torch.randn(count, self.dof, generator=generator, dtype=self.mean.dtype)
        wide = normal * torch.sqrt(self.dof / others.square().sum(-1))[:, None]
        return self.mean[member] + (self.factor[member] @ wide[..., None])[..., 0]

    def log_parts(self, x: Tensor) -> Tensor:
        """ln of share times density of every component, (N, M), at x (N, P)."""
        size, dof = self.mean.shape[-1], self.dof
        apart = (x[:, None] - self.mean).transpose(0, 1).mT
        square = torch.linalg.solve_triangular(self.factor, apart, upper=False).square().sum(-2).T
        log_det = torch.log(torch.diagonal(self.factor, dim1=-2, dim2=-1)).sum(-1)
        constant = math.lgamma((dof + size) / 2) - math.lgamma(dof / 2) - 0.5 * size * math.log(dof * math.pi)
        return self.log_share + constant - log_det - 0.5 * (dof + size) * torch.log1p(square / dof)

    def log_density(self, x: Tensor) -> Tensor:
        """(N,) at x (N, P)."""
        return torch.logsumexp(self.log_parts(x), -1)

    def adapted(self, draws: Tensor, log_weight: Tensor) -> StudentMixture:
        """The mixture fitted to weighted draws (N, P), one step of expectation and maximisation."""
        parts = self.log_parts(draws)
        member = torch.exp(parts - torch.logsumexp(parts, -1, keepdim=True) + log_weight[:, None])
        apart = (draws[:, None] - self.mean).transpose(0, 1)
        square = torch.linalg.solve_triangular(self.factor, apart.mT, upper=False).square().sum(-2).T
        near = (self.dof + draws.shape[-1]) / (self.dof + square)
        total = member.sum(0).clamp(min=1e-12)
        pull = member * near
        mean = (pull.T @ draws) / pull.sum(0).clamp(min=1e-300)[:, None]
        apart = (draws[:, None] - mean).transpose(0, 1)
        spread = torch.einsum("nm,mnp,mnq->mpq", pull, apart, apart) / total[:, None, None]
        heavy = (torch.exp(-torch.logsumexp(2 * log_weight, 0)) * total > 2 * draws.shape[-1])[:, None]
        mean = torch.where(heavy, mean, self.mean)
        covariance = torch.where(
            heavy[..., None], (1 - SHRINK) * spread + SHRINK * self.covariance, self.covariance
        )
        return StudentMixture(mean, covariance, torch.log(total), self.dof)


def importance(
    log_density: Callable[[Tensor], Tensor],
    proposal: StudentMixture,
    draws: int,
    generator: torch.Generator,
    *,
    adaptations: int = 2,
    moving: bool = True,
) -> Evidence:
    """The integral of exp(log_density), which maps (N, P) to (N,), by ``draws`` draws of a proposal, adapted to them as
    long as their weights are not to be trusted; if they are not then either, by two tempered sequences, unless ``moving`` is
    False because these take some forty times as many calls."""
    evidence = _weighed(log_density, proposal, draws, generator)
    for _ in range(adaptations):
        thin = evidence.effective < THIN * draws
        if (evidence.trusted and not thin) or not bool(torch.isfinite(evidence.log_weight).any()):
            break
        adapted = proposal.adapted(evidence.draws, evidence.log_weight)
        again = _weighed(log_density, adapted, draws, generator)
        better = (
            again.effective > evidence.effective if evidence.trusted else again.pareto_k < evidence.pareto_k
        )
        if better and (again.trusted or not evidence.trusted):
            evidence, proposal = again, adapted
    if evidence.trusted or not moving:
        return evidence
    first, second = (tempered(log_density, proposal, draws, generator) for _ in range(2))
    mean = float(torch.logsumexp(torch.tensor([first.log_z, second.log_z]), 0)) - math.log(2)
    # what draws share by descent is in no run's own error
    error = max(0.5 * abs(first.log_z - second.log_z), math.hypot(first.error, second.error) / 2)
    return replace(first, log_z=mean, error=error, pareto_k=max(first.pareto_k, second.pareto_k))


def tempered(
    log_density: Callable[[Tensor], Tensor], proposal: StudentMixture, draws: int, generator: torch.Generator
) -> Evidence:
    """The integral by draws that are led from the proposal's density q to exp(log_density) = p along q^(1-b) p^b.

    Each step in b leaves LEFT of the draws effective; they are drawn anew by their weights and moved MOVES times along
    differences of two others (ter Braak 2006, Stat. Comput. 16, 239), which needs no scale. The error is that of the
    steps' weights, as if draws were independent after their moves; ``pareto_k`` is that of the worst step.
    """
    x = proposal.draw(draws, generator)
    log_q, log_p = proposal.log_density(x), torch.nan_to_num(log_density(x), nan=-math.inf)
    even = torch.full_like(log_p, -math.log(draws))
    if not bool(torch.isfinite(log_p).any()):
        return Evidence(-math.inf, math.inf, math.inf, x, even)
    reached, log_z, variance, worst = 0.0, 0.0, 0.0, -math.inf
    for _ in range(MOST_STEPS):
        ratio = log_p - log_q
        step = _step(ratio, 1.0 - reached)
        log_weight = step * ratio
        log_z += float(torch.logsumexp(log_weight, 0)) - math.log(draws)
        variance += 1 / _effective(log_weight) - 1 / draws
        worst = max(worst, smoothed(log_weight)[1])
        reached += step
        kept = _resampled(log_weight, generator)
        x, log_q, log_p = x[kept], log_q[kept], log_p[kept]
        for number in range(2 * MOVES):
            half, other = (torch.arange(start, draws, 2) for start in (number % 2, 1 - number % 2))
            moved = x[half] + _differences(x[other], len(half), generator)
            moved_q = proposal.log_density(moved)
            moved_p = torch.nan_to_num(log_density(moved), nan=-math.inf)
            gain = (1 - reached) * (moved_q - log_q[half]) + reached * (moved_p - log_p[half])
            taken = torch.log(torch.rand(len(half), generator=generator, dtype=x.dtype)) < gain
            x[half[taken]] = moved[taken]
            log_q[half[taken]], log_p[half[taken]] = moved_q[taken], moved_p[taken]
        if reached >= 1.0:
            return Evidence(log_z, math.sqrt(max(variance, 0.0)), worst, x, even)
    return Evidence(-math.inf, math.inf, math.inf, x, even)


def _effective(log_weight: Tensor) -> float:
    return float(torch.exp(2 * torch.logsumexp(log_weight, 0) - torch.logsumexp(2 * log_weight, 0)))


def _step(ratio: Tensor, most: float) -> float:
    """The largest power of the ratios exp(ratio) (N,), up to ``most``, that leaves LEFT of the draws effective."""
    aim = LEFT * len(ratio)
    if _effective(most * ratio) >= aim:
        return most
    low, high = 0.0, most
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _effective(middle * ratio) >= aim else (low, middle)
    return max(low, 1e-9)


def _resampled(log_weight: Tensor, generator: torch.Generator) -> Tensor:
    """Places (N,) of draws in proportion to their weights, by one uniform number (systematic resampling)."""
    count = len(log_weight)
    edges = torch.cumsum(torch.softmax(log_weight, 0), 0)
    position = (torch.arange(count) + torch.rand((), generator=generator)) / count
    return torch.searchsorted(edges / edges[-1], position.to(edges)).clamp(max=count - 1)


def _differences(x: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """``count`` moves (count, P) along differences of two of the draws x (N, P), which do not move themselves meanwhile: of the
    length that suits a normal distribution, one in ten of the whole difference, which leads from one maximum to another."""
    size = x.shape[1]
    first, second = torch.randint(len(x), (2, count), generator=generator)
    whole = torch.rand(count, 1, generator=generator, dtype=x.dtype) < 0.1
    length = torch.where(whole, 1.0, 2.38 / math.sqrt(2 * size))
    noise = torch.randn(count, size, generator=generator, dtype=x.dtype)
    return length * (x[first] - x[second]) + 1e-4 * x.std(0) * noise


def _weighed(
    log_density: Callable[[Tensor], Tensor], proposal: StudentMixture, draws: int, generator: torch.Generator
) -> Evidence:
    x = proposal.draw(draws, generator)
    log_ratio = torch.nan_to_num(log_density(x) - proposal.log_density(x), nan=-math.inf)
    smooth, k = smoothed(log_ratio)
    log_sum = torch.logsumexp(smooth, 0)
    log_weight = smooth - log_sum
    spread = float(torch.exp(torch.logsumexp(2 * log_weight, 0))) - 1 / draws
    return Evidence(float(log_sum) - math.log(draws), math.sqrt(max(spread, 0.0)), k, x, log_weight)


def smoothed(log_ratio: Tensor) -> tuple[Tensor, float]:
    """ln of importance ratios (N,) with the largest replaced by quantiles of the generalised Pareto distribution that
    fits them, and its shape k; infinite where fewer than five are above 0."""
    count = len(log_ratio)
    finite = int(torch.isfinite(log_ratio).sum())
    tail = min(count // 5, math.ceil(3 * math.sqrt(count)))
    if tail < 5 or finite <= tail:
        return log_ratio, math.inf
    order = torch.argsort(log_ratio)
    largest = order[-tail:]
    top, cut = log_ratio[order[-1]], log_ratio[order[-tail - 1]]
    excess = torch.exp(log_ratio[largest] - top) - torch.exp(cut - top)
    if float(excess[-1]) <= 1e-12:
        return log_ratio, -math.inf
    k, scale = pareto(excess.clamp(min=1e-300))
    p = (torch.arange(tail, dtype=log_ratio.dtype) + 0.5) / tail
    quantile = -scale * torch.log1p(-p) if abs(k) < 1e-9 else scale * torch.expm1(-k * torch.log1p(-p)) / k
    smooth = log_ratio.clone()
    smooth[largest] = torch.log(quantile + torch.exp(cut - top)).clamp(max=0.0) + top
    return smooth, k


def pareto(excess: Tensor) -> tuple[float, float]:
    """Shape k and scale of the generalised Pareto distribution of excesses (n,) in ascending order, by the empirical
    Bayes estimate of Zhang & Stephens (2009, Technometrics 51, 316), k drawn to 1/2 by ten draws' worth as Vehtari et
    al. do."""
    count = len(excess)
    trials = 30 + int(math.sqrt(count))
    quarter = excess[max(int(count / 4 + 0.5) - 1, 0)].clamp(min=1e-300)
    grid = torch.arange(1, trials + 1, dtype=excess.dtype)
    b = 1 / excess[-1] + (1 - torch.sqrt(trials / (grid - 0.5))) / (3 * quarter)
    k = torch.log1p(-b[:, None] * excess).mean(-1)
    profile = count * (torch.log(-b / k) - k - 1)
    weight = torch.softmax(torch.nan_to_num(profile, nan=-math.inf), 0)
    best = float((weight * b).sum())
    shape = float(torch.log1p(-best * excess).mean())
    return (count * shape + 5.0) / (count + 10.0), -shape / best
