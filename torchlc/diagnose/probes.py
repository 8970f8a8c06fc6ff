"""Probes: what an effect would do to a refit, at many values of its parameters, without a refit of its own."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.diagnose.gate import residual_projection
from torchlc.diagnose.refit import Refit, Workbench, effect_columns, effect_starts, is_slow
from torchlc.effects import registry
from torchlc.effects.base import Entry
from torchlc.likelihood import Likelihood

GRID = 24
"""Values that are tried of an effect of one or two parameters, and for each parameter of one that has more."""
SLOW_GRID = 16
MOST_SCANNED = 400
"""Rows at which an effect is tried that no descent would find the row of."""
PARTS = 24
"""Of the recording's span, that the best of those rows must stand apart."""


@dataclass(frozen=True)
class Probe:
    """Finite-step signatures of one candidate at a refit: values psi (G, k) that were tried, unit signatures
    (G, T) off everything the refit can absorb, and the score (g'r)^2 / g'g of each (G,)."""

    entry: str
    psi: Tensor
    signatures: Tensor
    scores: Tensor
    together: float = 0.0
    """What the parts of a divided offset score together, less the one that each would in pure noise."""

    @property
    def score(self) -> float:
        return float(self.scores.max()) if len(self.scores) else self.together


def probe(bench: Workbench, at: Refit, entry: str, seed: int) -> Probe:
    """Signatures of ``entry`` added to a refit, over a ladder or cloud of its parameters; of a divided offset
    only what its parts score together."""
    hypothesis = at.hypothesis.with_effect(entry)
    likelihood = bench.likelihood(hypothesis)
    columns = effect_columns(likelihood.model.parameter_set, entry)
    per = Entry.parse(entry).per
    theta = bench.start(hypothesis, at.theta[None], at.names)
    psi = _tried(bench, likelihood, entry, seed) if per is None else theta[:, columns] + divided_step(entry)
    theta = theta.repeat(len(psi), 1)
    theta[:, columns] = psi
    with torch.no_grad():
        change = (at.delta - likelihood.residuals(theta).delta) / at.sigma
    likelihood.model.forget()
    change = torch.nan_to_num(change)
    if per is not None:
        context = bench.base.context
        part = context.curve if per == "curve" else context.night
        change = torch.where(part == torch.unique(part)[:, None], change, 0.0)
    basis = residual_projection(at)
    padded = torch.cat([change, change.new_zeros(len(change), len(at.prior_rows))], 1)
    projected = padded - (padded @ basis) @ basis.T
    norm = torch.linalg.vector_norm(projected, dim=1)
    raw = torch.linalg.vector_norm(change, dim=1)
    usable = (norm > 1e-3) & (norm > 1e-7 * raw)
    unit = projected[usable] / norm[usable, None]
    u = torch.cat([at.delta / at.sigma, at.model.parameter_set.prior_residuals(at.theta)])
    u[len(at.delta) :] = -u[len(at.delta) :]
    scores = (unit @ u) ** 2
    signatures = unit[:, : len(at.delta)]
    if per is not None:
        return Probe(entry, psi[:0], signatures[:0], scores[:0], max(float((scores - 1.0).sum()), 0.0))
    return Probe(entry, psi[usable], signatures, scores)


def _tried(bench: Workbench, likelihood: Likelihood, entry: str, seed: int) -> Tensor:
    """Values psi (G, k) to probe: of an effect that begins at some row all rows, at its typical size."""
    column = scanned_column(entry)
    if column is not None:
        hours = scanned_hours(bench)
        quantities = registry()[Entry.parse(entry).name].quantities
        sizes = [torch.full_like(hours, one.typical or 0.0) for one in quantities]
        return torch.stack([*sizes[:column], hours, *sizes[column + 1 :]], -1)
    dimensions = len(effect_columns(likelihood.model.parameter_set, entry))
    count = GRID * (dimensions if dimensions > 2 else 1) if dimensions else 1
    if is_slow(likelihood.model):
        count = min(count, SLOW_GRID)
    return effect_starts(likelihood, entry, count, torch.Generator().manual_seed(seed))


def divided_step(entry: str) -> float:
    """The offset by which every part of a divided effect is moved to see what it does."""
    (quantity,) = registry()[Entry.parse(entry).name].quantities
    return quantity.typical - quantity.off  # pyright: ignore[reportOperatorIssue]


def scanned_column(entry: str) -> int | None:
    """Which of an effect's own parameters has to be tried at every row, if one has."""
    cls = registry()[Entry.parse(entry).name]
    names = [quantity.name for quantity in cls.quantities]
    return names.index(cls.scanned) if cls.scanned else None


def scanned_hours(bench: Workbench) -> Tensor:
    """The middles between rows, or between MOST_SCANNED of them, h after the first."""
    stamps = torch.unique(bench.base.context.seconds).to(torch.float64) / 3600
    middle = 0.5 * (stamps[1:] + stamps[:-1])
    if len(middle) > MOST_SCANNED:
        middle = middle[torch.linspace(0, len(middle) - 1, MOST_SCANNED).long()]
    return middle


def apart(bench: Workbench, entry: str, ranked: Tensor) -> Tensor:
    """Probed values (G, k), best first; of an effect that was tried at every row, those that stand apart."""
    column = scanned_column(entry)
    if column is None or not len(ranked):
        return ranked
    seconds = bench.base.context.seconds
    least = float(seconds.max() - seconds.min()) / 3600 / PARTS
    chosen: list[int] = []
    for index, hour in enumerate(ranked[:, column].tolist()):
        if all(abs(hour - float(ranked[other, column])) > least for other in chosen):
            chosen.append(index)
    return ranked[chosen]
