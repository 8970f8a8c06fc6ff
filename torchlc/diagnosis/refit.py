"""Fits of one hypothesis (a list of effects) and what they leave, in the linear form that evidence and
held-out scores need."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from torchlc.effects import effect_class
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import polish
from torchlc.lightcurve.assembly import Assembly, assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.parameters import ParameterSet
from torchlc.stages.effect import Entry
from torchlc.tensors.least_squares import differences

LADDER = torch.tensor([1.0, -1.0, 0.3, -0.3, 3.0, -3.0, 2.0, -2.0], dtype=torch.float64, device="cpu")
"""Sizes of an effect that are tried, in units of its typical one."""
MANY_PAIRS = 4096
"""Of facet and instant or direction, a row."""
LEAST_PRECISION = 1e-6
"""Of a prior's coordinate that the others leave no room."""
MODE_APART = 0.01
MODE_DEPTH = 20.0
"""Minima of one hypothesis count as distinct beyond, and compete within, these differences of the objective."""


@dataclass(frozen=True)
class Hypothesis:
    """A list of effects beyond the scene's own, each ``name`` or ``name[target]``."""

    added: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(Entry.parse(entry).name for entry in self.added)

    @property
    def plain(self) -> tuple[str, ...]:
        """The entries without the widths of divided offsets."""
        return tuple(Entry.parse(entry).plain for entry in self.added)

    def with_effect(self, entry: str) -> Hypothesis:
        return Hypothesis((*self.added, entry))


@dataclass(frozen=True)
class Refit:
    """A hypothesis at one minimum: natural theta (P,), flat y (P,), the datum's ``prediction`` (T,), residuals delta
    (T,) = datum - model, slopes (T, P) = d model / d y, quoted sigma (T,), scale (T,) of a magnitude of noise, and the prior about y
    as a Gaussian (mean (P,), precision (P, P)), of which peaked priors are ``prior_rows`` (n, P), unit variance each.

    ``held`` marks coordinates at a bound, whose columns of slopes are zero; ``others`` are further minima that the
    data leave possible.
    """

    hypothesis: Hypothesis
    likelihood: Likelihood
    theta: Tensor
    y: Tensor
    prediction: Tensor
    delta: Tensor
    slopes: Tensor
    sigma: Tensor
    scale: Tensor
    prior_mean: Tensor
    prior_precision: Tensor
    prior_rows: Tensor
    held: Tensor
    chi2: float
    objective: float
    others: tuple[Refit, ...] = ()

    @property
    def model(self) -> LightCurve:
        return self.likelihood.model

    @property
    def names(self) -> list[str]:
        return self.model.names

    @property
    def off_mag(self) -> Tensor:
        """Datum minus prediction, mag (T,)."""
        off = self.likelihood.observed - self.prediction
        return off if self.likelihood.kind == "mag" else off / self.scale

    @property
    def log_mass(self) -> float:
        """Log of the posterior mass about the minimum, up to what all minima of a hypothesis share."""
        white = (self.slopes / self.sigma[:, None])[:, ~self.held]
        _, prior = self.prior
        width = torch.linalg.slogdet(white.T @ white + prior)[1] - torch.linalg.slogdet(prior)[1]
        return -0.5 * (self.objective + float(width))

    @cached_property
    def prior(self) -> tuple[Tensor, Tensor]:
        """Mean (K,) less y, and precision (K, K), of the coordinates that are not held."""
        keep = ~self.held
        precision = self.prior_precision[keep][:, keep]
        force = (self.prior_precision @ (self.prior_mean - self.y))[keep]
        return torch.linalg.solve(precision, force), precision

    def covariance(self) -> Tensor:
        """Posterior covariance (P, P) of y in the linear form; held coordinates have none."""
        white = self.slopes / self.sigma[:, None]
        keep = torch.nonzero(~self.held)[:, 0]
        precision = white.T @ white + self.prior_precision
        found = torch.zeros_like(precision)
        if len(keep):
            found[keep[:, None], keep[None]] = torch.linalg.inv(precision[keep][:, keep])
        return found


class Workbench:
    """Builds models of hypotheses on one scene and recording, sharing track, attitude and shape."""

    def __init__(self, base: Assembly, seed: int = 0) -> None:
        self.base = base
        self.seed = seed
        self._likelihoods: dict[tuple[str, ...], Likelihood] = {}

    def likelihood(self, hypothesis: Hypothesis) -> Likelihood:
        if hypothesis.added not in self._likelihoods:
            self._likelihoods[hypothesis.added] = Likelihood(self._model(hypothesis))
        return self._likelihoods[hypothesis.added]

    def _model(self, hypothesis: Hypothesis) -> LightCurve:
        if not hypothesis.added:
            return LightCurve(self.base.scene, self.base.recording, assembly=self.base)
        own = [effect.entry for effect in self.base.effects]
        assembly = assemble(self.base.scene, self.base.recording, [*own, *hypothesis.added], base=self.base)
        model = LightCurve(self.base.scene, self.base.recording, assembly=assembly)
        for other in self._likelihoods.values():
            if other.model.tables_key == model.tables_key:
                return LightCurve(
                    self.base.scene, self.base.recording, assembly=assembly, sibling=other.model
                )
        return model

    def start(self, hypothesis: Hypothesis, theta: Tensor, names: Sequence[str]) -> Tensor:
        """Values of a smaller model's theta (S, P') carried over to a hypothesis; its further parameters at
        their starts."""
        parameters = self.likelihood(hypothesis).model.parameter_set
        found = parameters.start().expand(len(theta), -1).clone()
        for column, name in enumerate(parameters.names):
            if name in names:
                found[:, column] = theta[:, list(names).index(name)]
        return found


def is_slow(model: LightCurve) -> bool:
    """True if every new geometry costs a computation of what parts take from, or give to, each other, or of very many
    pairs of facet and direction, as curved shapes have under a Sun with a disc."""
    return model.geometry_free and (model.parts_meet or many_pairs(model))


def many_pairs(model: LightCurve) -> bool:
    """True if a row has more than MANY_PAIRS pairs of facet and instant or direction."""
    return model.assembly.pairs > MANY_PAIRS * model.assembly.T


def is_heavy(model: LightCurve) -> bool:
    """True if a single value of the parameters fills the buffers of a batched call, as the Earth's tiles do."""
    return not model.geometry_free and model.batch_size() == 1


def is_dear(model: LightCurve) -> bool:
    """True if refits have to do with few starts and steps."""
    return is_slow(model) or is_heavy(model)


def refit(
    likelihood: Likelihood, hypothesis: Hypothesis, starts: Tensor, *, iterations: int = 40, first: int = 10
) -> Refit:
    """The minimum with the largest posterior mass from natural starts (S, P): all get ``first`` steps, the best
    quarter (at least 3; 1 if dear) are brought to the end. Where errors are fitted, the deepest."""
    parameters = likelihood.model.parameter_set
    dear = is_dear(likelihood.model)
    if dear:
        first, iterations = 6, 20
    if not parameters.names:
        return linearised(likelihood, hypothesis, parameters.start())
    level_at = starts[0] if likelihood.fitted_errors else None
    with torch.no_grad():
        found = polish(likelihood, starts, None, iterations=first, level_at=level_at)
        best = torch.argsort(found.cost)[: 1 if dear else max(3, len(starts) // 4)]
        theta = parameters.from_flat(found.y[best])
        for _ in range(3 if likelihood.fitted_errors else 1):
            if likelihood.fitted_errors:
                level_at = theta[0]
            found = polish(likelihood, theta, None, iterations=iterations, level_at=level_at)
            order = torch.argsort(found.cost)
            theta = parameters.from_flat(found.y[order])
    return leading(likelihood, hypothesis, theta, found.cost[order])


def leading(likelihood: Likelihood, hypothesis: Hypothesis, theta: Tensor, cost: Tensor) -> Refit:
    """Of minima theta (S, P) in order of their cost (S,) the one with the largest posterior mass, with the others
    that the data leave possible; where errors are fitted, the deepest alone."""
    modes = [linearised(likelihood, hypothesis, theta[0])]
    last = cost[0]
    for one, own in zip(theta[1:], cost[1:], strict=True):
        if likelihood.fitted_errors or own - cost[0] > MODE_DEPTH:
            break
        if own - last > MODE_APART:
            modes.append(linearised(likelihood, hypothesis, one))
            last = own
    best = max(modes, key=lambda mode: mode.log_mass)
    return replace(best, others=tuple(mode for mode in modes if mode is not best))


def linearised(likelihood: Likelihood, hypothesis: Hypothesis, theta: Tensor) -> Refit:
    """Residuals, slopes and priors at natural theta (P,)."""
    parameters = likelihood.model.parameter_set
    low, high = parameters.flat_bounds()
    with torch.no_grad():
        y = parameters.to_flat(theta)
        found = likelihood.residuals(theta)
        sigma = found.sigma.expand(found.delta.shape)
        if likelihood.fitted_errors:
            sigma = likelihood.fitted_levels(found.delta)[likelihood.curve]
        span = torch.where(torch.isfinite(high - low), high - low, torch.inf)
        near = 1e-5 * torch.where(torch.isfinite(span), span, 0.0)
        held = (y <= low + near) | (y >= high - near)
        if parameters.names:
            slopes = -differences(
                lambda point: likelihood.residuals(parameters.from_flat(point)).delta,
                y[None],
                low,
                high,
                colours=likelihood.colours(prior_rows=False),
            )[0]
        else:
            slopes = found.delta.new_zeros(len(found.delta), 0)
        mean, precision, rows = gaussian_prior(parameters, y)
        u = found.delta / sigma
        pull = parameters.prior_residuals(theta)
        objective = float((u * u).sum() + (pull * pull).sum())
    slopes = torch.where(held, 0.0, slopes)
    return Refit(
        hypothesis,
        likelihood,
        theta,
        y,
        found.prediction,
        found.delta,
        slopes,
        sigma,
        found.scale.expand(found.delta.shape),
        mean,
        precision,
        rows,
        held,
        float((u * u).sum()),
        objective,
    )


def gaussian_prior(parameters: ParameterSet, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean (P,) and precision (P, P) of the prior about y (P,), and the slopes (n, P) of its peaked members' rows: a
    flat prior of width w counts as a Gaussian of variance w^2 / 12 about its middle, a peaked one by its slope,
    which for the second reflectance of a pair is one in both."""
    low, high = parameters.flat_bounds()
    peaked = [entry.prior.peaked for entry in parameters.free]
    flat = torch.where(torch.tensor(peaked, dtype=torch.bool, device=y.device), 0.0, 12.0 / (high - low) ** 2)
    middle = torch.where(flat > 0, 0.5 * (low + high), y)
    if not any(peaked):
        return middle, torch.diag(flat), y.new_zeros(0, len(y))

    def rows_at(point: Tensor) -> Tensor:
        return parameters.prior_residuals(parameters.from_flat(point))

    with torch.enable_grad():
        rows = torch.autograd.functional.jacobian(rows_at, y)
    assert isinstance(rows, Tensor)
    precision = torch.diag(flat + LEAST_PRECISION) + rows.T @ rows
    force = flat * (middle - y) - rows.T @ rows_at(y)
    return y + torch.linalg.solve(precision, force), precision, rows


def effect_starts(likelihood: Likelihood, effect: str, count: int, generator: torch.Generator) -> Tensor:
    """Values (count, k) for the parameters of one effect entry to start from: both signs and sizes 0.3 to 3
    of the typical, then draws from the prior, as for directions and other wide quantities; offsets of single
    curves start at none. k = 0 for an effect without parameters."""
    entry = Entry.parse(effect)
    quantities = {q.name: q for q in effect_class(effect).quantities}
    parameters = likelihood.model.parameter_set
    columns = []
    for column in effect_columns(parameters, effect):
        free = parameters.free[column]
        quantity = quantities[free.origin.quantity]
        u = torch.rand(count, generator=generator, dtype=torch.float64)
        draw = free.prior.quantile(0.02 + 0.96 * u)
        if entry.per is not None:
            draw = torch.full_like(draw, free.start)
        elif quantity.off is not None and quantity.typical is not None and math.isfinite(quantity.off):
            size = abs(quantity.typical - quantity.off)
            ladder = (quantity.off + size * LADDER)[:count]
            inside = (ladder > free.prior.low) & (ladder < free.prior.high)
            draw[: len(ladder)] = torch.where(inside, ladder, draw[: len(ladder)])
        columns.append(draw)
    return torch.stack(columns, -1) if columns else torch.zeros(count, 0, dtype=torch.float64)


def effect_columns(parameters: ParameterSet, effect: str) -> list[int]:
    """Indices in theta of the parameters of one effect entry."""
    entry = Entry.parse(effect)
    return [
        index
        for index, free in enumerate(parameters.free)
        if free.origin.role == "effects"
        and free.origin.owner == entry.name
        and entry.target in (None, free.origin.target)
    ]
