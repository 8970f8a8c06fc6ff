"""The proof: blocks of rows predicted by fits that have not seen them.

Each of a few models is fitted anew without the rows of every block, noise and all, from its minimum; the log density of the
block's rows under what is then known, parameters and their covariance, is added up. Under a law of errors that is not
normal the rows of a block have no joint density in closed form: theirs is the product of every row's density given the
rest and the block's rows before it, the law blurred by what is not known (assumed density filtering; Opper 1998, in
On-line Learning in Neural Networks, 363), which is a density whatever is kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from torchlc.inference.density import Fitted, Posterior
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.posterior import fit, fitted_at
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.stages.noise import Law
from torchlc.tensors.normal_tail import HALF_LOG_2PI

BLOCKS = 5
RUNS, SHORTEST_RUN = 3, 10
"""Runs of rows that a block is made of, where they have at least so many rows: one run of a fifth of the recording may hold all that is
known of a material, such as the only glint, and then tells how far a fit extrapolates, not what it leaves out."""
GAP = 0.025
"""Of the rows, left out on either side of a run of rows, so that noise that rows share is forgotten."""


@dataclass(frozen=True)
class Unseen:
    """How a model predicts rows that its fit has not seen: log density of each block, and the root mean square, mag."""

    log_density: Tensor
    rms: float

    @property
    def total(self) -> float:
        return float(self.log_density.sum())


def make_blocks(seconds: Tensor, group: Tensor, count: int = BLOCKS) -> list[tuple[Tensor, Tensor]]:
    """Rows of each block, and the rows left out with it: whole groups (curves or nights) if there are at least four, dealt
    into at most ``count`` blocks; else runs of rows of equal number, up to RUNS a block, with a gap on either side of each."""
    ids = torch.unique(group)
    if len(ids) >= 4:
        folds = min(count, len(ids))
        rows = [torch.nonzero(torch.isin(group, ids[fold::folds]))[:, 0] for fold in range(folds)]
        return [(block, block) for block in rows]
    order = torch.argsort(seconds)
    total = len(order)
    folds = min(count, max(2, total // 4))
    runs = folds * max(1, min(RUNS, total // (folds * SHORTEST_RUN)))
    edges = [round(total * k / runs) for k in range(runs + 1)]
    gap = max(1, round(GAP * total / (runs // folds)))
    spans = list(pairwise(edges))
    rows = [torch.cat([order[a:b] for a, b in spans[fold::folds]]) for fold in range(folds)]
    removed = [
        torch.unique(torch.cat([order[max(0, a - gap) : min(total, b + gap)] for a, b in spans[fold::folds]]))
        for fold in range(folds)
    ]
    return list(zip(rows, removed, strict=True))


def difference(first: Unseen, second: Unseen) -> tuple[float, float]:
    """How much more probable the first model makes the unseen rows, in log density, and its standard error from the spread
    of the blocks."""
    each = first.log_density - second.log_density
    return float(each.sum()), float(each.std()) * math.sqrt(len(each)) if len(each) > 1 else math.inf


def unseen(at: Fitted, blocks: Sequence[tuple[Tensor, Tensor]]) -> Unseen:
    """Every block predicted by a fit without it. A number of a group of rows that is left out whole, such as the offset of a curve,
    is known by its prior alone, which is wide: such a model pays for that in the density."""
    densities, squares, count = [], 0.0, 0
    for rows, removed in blocks:
        known = _without(at, removed)
        densities.append(log_density(known, known, rows))
        squares += float((known.off_mag[rows] ** 2).sum())
        count += len(rows)
    return Unseen(torch.stack(densities), math.sqrt(squares / max(count, 1)))


def _without(at: Fitted, removed: Tensor) -> Fitted:
    """The model of all rows at what the others tell of it, whose covariance is theirs too; as it is where nothing is free, or no two
    rows are left."""
    recording = at.model.recording
    kept = np.ones(len(recording), dtype=bool)
    kept[removed.numpy()] = False
    if not at.posterior.size or kept.sum() < 2:
        return at
    some = recording.keep(kept, "unseen")
    entries = [effect.entry for effect in at.model.effects]
    likelihood = Likelihood(
        LightCurve(at.model.scene, some, assembly=assemble(at.model.scene, some, entries))
    )
    # numbers of curves, nights or objects that have no row left are not in the others' model
    column_of = {name: column for column, name in enumerate(at.names)}
    columns = torch.tensor(
        [column_of[name] for name in likelihood.model.names] + [at.posterior.own] * at.posterior.scaled,
        dtype=torch.long,
    )
    slopes = at.slopes[torch.as_tensor(kept)][:, columns][None]
    rest = fit(
        at.hypothesis,
        Posterior(likelihood, at.posterior.scaled),
        at.g[None, columns],
        turns=1,
        slopes=slopes,
    )
    g = torch.zeros_like(at.g).index_copy(0, columns, rest.g)
    covariance = torch.eye(len(g), dtype=g.dtype)
    covariance[columns[:, None], columns] = rest.covariance
    return replace(fitted_at(at.hypothesis, at.posterior, g), covariance=covariance)


def log_density(known: Fitted, rest: Fitted, rows: Tensor) -> Tensor:
    """ln of the density of some rows of a fit at the values that the rest gave, whose covariance is the rest's."""
    physical = torch.tensor(known.posterior.physical, dtype=torch.long)
    spread = rest.covariance[physical][:, physical]
    slopes = known.slopes[rows][:, physical]
    delta, sigma = known.delta[rows], known.wide[rows]
    if known.noise.processes:
        covariance = torch.diag(sigma**2) + slopes @ spread @ slopes.T
        for process in known.noise.processes:
            sd = (process.sd * known.scale)[rows]
            member = process.members(known.likelihood.curve)[rows]
            same = member[:, None] == member
            covariance = covariance + process.correlation(rows) * same * sd[:, None] * sd
        return torch.distributions.MultivariateNormal(torch.zeros_like(delta), covariance).log_prob(delta)
    if known.noise.normal:
        root = torch.linalg.cholesky(spread) if len(physical) else spread
        inner = (slopes / sigma[:, None]) @ root
        u = delta / sigma
        small = torch.linalg.cholesky(torch.eye(len(physical), dtype=u.dtype) + inner.T @ inner)
        side = torch.linalg.solve_triangular(small, (inner.T @ u)[:, None], upper=False)
        half = torch.log(torch.diagonal(small)).sum()
        square = u @ u - side.square().sum()
        return -0.5 * square - half - torch.log(sigma).sum() - HALF_LOG_2PI * len(rows)
    everything = torch.ones(1, len(rows), dtype=torch.bool)
    mean = torch.zeros(1, len(physical), dtype=delta.dtype)
    return filtered_log_density(
        mean, spread[None], delta[None], -slopes[None], sigma[None], everything, known.noise.law
    )[0]


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
