"""The posterior density of one model, what is known of it at a minimum, and its linear form there.

Everything uncertain is a coordinate g with a standard normal prior (:mod:`torchlc.inference.normal_scores`): materials,
sizes, attitude, zero points, the effects' parameters, and those of the noise, among them a factor of the quoted errors.

Letters: S starts, T rows, P coordinates.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchlc.inference.evidence import TAILS, Evidence, StudentMixture
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.normal_scores import FARTHEST, NormalScores
from torchlc.inference.whitening import noise_columns, whitener
from torchlc.lightcurve.model import LightCurve
from torchlc.noise import Noise, Residuals
from torchlc.stages.noise import Law, Normal
from torchlc.tensors.least_squares import Colours
from torchlc.tensors.normal_tail import HALF_LOG_2PI
from torchlc.tensors.work import Work

SCALE_SIGMA = 0.3
"""What is believed of quoted errors: a third too small or too large."""
NEAR_ZERO = 1e-3
"""Deviate below which a deviance residual is taken as linear, for its square root has no slope at 0."""
AT_ONCE = 256
"""Draws that are worked out together."""
MOST_SHARED_S = 60.0
"""CPU seconds of a first geometry, with the tables that all share, beyond which no second is asked for what each takes alone."""
DEAR_S = 4e-3
"""CPU seconds of one new geometry beyond which draws are taken from the linear form instead."""
AFFORDED_S = 0.03
"""CPU seconds of one geometry of few facets from which on it is saved like any other: a refit takes some hundred of them."""
BAD_ROW = 0.5
"""Probability above which a row is taken as, and told to be, an outlier."""


class Posterior:
    """Log density of the coordinates g (..., P) of a likelihood, those of its model, then one for the scale of the quoted
    errors where ``scaled``."""

    def __init__(self, likelihood: Likelihood, scaled: bool) -> None:
        self.likelihood = likelihood
        self.scores = NormalScores(likelihood.model.parameter_set)
        self.scaled = scaled and not likelihood.fitted_errors
        self.own = len(likelihood.model.names)
        self.size = self.own + self.scaled
        self.noise_columns = [*noise_columns(likelihood), *([self.own] if self.scaled else [])]
        self.physical = [i for i in range(self.size) if i not in self.noise_columns]

    @property
    def seconds_each(self) -> float:
        """CPU seconds that a new geometry takes, as far as fits and probes have to save them: 0 where it is fixed, or of so few facets
        that a search affords them all, unless what light does between them takes AFFORDED_S."""
        afforded = self.model.evaluator.gridded and self.geometry_seconds < AFFORDED_S
        return 0.0 if afforded else self.geometry_seconds

    @cached_property
    def geometry_seconds(self) -> float:
        """CPU seconds that a new geometry takes; 0 where it is fixed. Much is decided by them: they are counted, not timed, so that every
        machine decides alike."""
        if not self.model.geometry_free:
            return 0.0
        # effects keep what they made of the last geometries: those counted here are no others' but this model's
        shift = 1e-6 * (1 + zlib.crc32(" ".join(self.model.names).encode()) / 2**32)
        g = self.coordinates(self.model.parameter_set.start())[None]
        with torch.no_grad():
            with Work() as shared:
                self.residuals(g - shift)  # what all geometries share is made here
            if shared.seconds > MOST_SHARED_S:
                self.model.forget()
                return shared.seconds
            with Work() as each:
                self.residuals(g + shift)
        self.model.forget()
        return each.seconds

    @property
    def dear(self) -> bool:
        return self.seconds_each > DEAR_S

    @property
    def slow(self) -> bool:
        """Whether steps are worth a linear form, whatever it costs beside a geometry."""
        return self.geometry_seconds > DEAR_S

    @property
    def model(self) -> LightCurve:
        return self.likelihood.model

    def theta(self, g: Tensor) -> Tensor:
        return self.scores.theta(g[..., : self.own])

    def coordinates(self, theta: Tensor) -> Tensor:
        """Coordinates of natural values (..., P), errors as quoted."""
        g = self.scores.scores(theta)
        return torch.cat([g, g.new_zeros(*g.shape[:-1], self.size - self.own)], -1)

    def factor(self, g: Tensor) -> Tensor | float:
        """What the quoted errors are multiplied by, (..., 1)."""
        return torch.exp(SCALE_SIGMA * g[..., self.own : self.own + 1]) if self.scaled else 1.0

    def residuals(self, g: Tensor) -> Residuals:
        """Residuals at coordinates (..., P)."""
        residuals = self.likelihood.residuals(self.theta(g))
        return replace(residuals, sigma=residuals.sigma * self.factor(g)) if self.scaled else residuals

    def turning(self, columns: Sequence[int]) -> list[int]:
        """Places in ``columns`` of those that move the geometry."""
        geometry = self.model.assembly.geometry_columns
        return [index for index, column in enumerate(columns) if column in geometry]

    def under(self, found: Residuals, g: Tensor, new: Tensor) -> Residuals:
        """Residuals found at g (P,) as they are at new coordinates (P,) that differ in the noise alone."""
        return (
            replace(found, sigma=found.sigma * (self.factor(new) / self.factor(g))) if self.scaled else found
        )

    def noise(self, g: Tensor) -> Noise:
        """The noise at coordinates (..., P), of which it has few."""
        columns = [column for column in self.noise_columns if column < self.own]
        theta = self._start.expand(*g.shape[:-1], -1) if columns else self._start
        return self.model.noise(theta if not columns else self.scores.put(theta, g, columns))

    @cached_property
    def _start(self) -> Tensor:
        return self.model.parameter_set.start()

    def log_density(self, g: Tensor) -> Tensor:
        """ln of likelihood times prior, (N,), at coordinates (N, P)."""
        return torch.cat([self._log_density(piece) for piece in g.split(AT_ONCE)])

    def _log_density(self, g: Tensor) -> Tensor:
        total = self.held_density(self.residuals(g), g)
        return torch.nan_to_num(total, nan=-math.inf)

    def held_density(self, found: Residuals, g: Tensor) -> Tensor:
        """The same of residuals that are worked out already, with sigma as at g."""
        prior = -0.5 * g.square().sum(-1) - HALF_LOG_2PI * self.size
        return self.likelihood.density(found, self.noise(g)) + prior

    def colours(self) -> Colours | None:
        """Physical coordinates that belong to single curves, whose slopes of rows and priors are taken together; None if
        there are none."""
        given = self.likelihood.colours(prior_rows=False)
        if given is None:
            return None
        index_of = {column: number for number, column in enumerate(self.physical)}
        groups = [tuple(index_of[column] for column in group if column in index_of) for group in given.groups]
        prior_rows = torch.eye(len(index_of), dtype=torch.bool)
        return Colours(
            tuple(group for group in groups if group),
            torch.cat([given.touched[self.physical], prior_rows], 1),
        )


@dataclass(frozen=True)
class Fitted:
    """A ``hypothesis``, whatever stands for one, at one minimum g (P,): its residuals ``found`` with sigma (T,) as fitted, its ``noise``, the ``slopes``
    (T, P) = d residual / d g, ``peak``, the log density there, and the Laplace ``covariance`` (P, P). ``others`` are
    further minima that the data leave possible, ``evidence`` what importance sampling made of them all, ``missed`` what Laplace's method
    misses of the log evidence of the same set under another noise."""

    hypothesis: Any
    posterior: Posterior
    g: Tensor
    found: Residuals
    noise: Noise
    slopes: Tensor
    peak: float
    covariance: Tensor
    others: tuple[Fitted, ...] = ()
    evidence: Evidence | None = None
    missed: float = 0.0

    @property
    def likelihood(self) -> Likelihood:
        return self.posterior.likelihood

    @property
    def model(self) -> LightCurve:
        return self.posterior.model

    @property
    def names(self) -> list[str]:
        return self.model.names

    @cached_property
    def theta(self) -> Tensor:
        return self.posterior.theta(self.g)

    @property
    def delta(self) -> Tensor:
        return self.found.delta

    @property
    def scale(self) -> Tensor:
        return self.found.scale.expand(self.found.delta.shape)

    @cached_property
    def sigma(self) -> Tensor:
        """Standard deviation of each row, (T,), for its weight under the law of errors."""
        return self.noise.law.weighted(self.delta, self.wide)

    @property
    def wide(self) -> Tensor:
        """Standard deviation of each row, (T,), of the quoted errors as fitted with what noise adds."""
        sigma = self.found.sigma
        if self.likelihood.fitted_errors:
            sigma = self.likelihood.fitted_levels(self.delta)[self.likelihood.curve]
        return self.noise.sigma(sigma, self.scale).expand(self.delta.shape)

    @property
    def quoted(self) -> Tensor:
        """Standard deviation of each row, (T,), as quoted, or as fitted where none is."""
        if self.likelihood.fitted_errors:
            return self.likelihood.fitted_levels(self.delta)[self.likelihood.curve]
        return self.likelihood.error.expand(self.delta.shape)

    @cached_property
    def basis(self) -> Tensor:
        """Orthonormal columns (T + P, P) of what its own numbers can take up of whitened rows and priors."""
        return torch.linalg.qr(self.tangent)[0]

    @cached_property
    def residual_rows(self) -> Tensor:
        """Residuals over their errors, then the prior's coordinates, (T + P,)."""
        return torch.cat([self.delta / self.sigma, self.g])

    @property
    def prediction(self) -> Tensor:
        return self.found.prediction

    @property
    def off_mag(self) -> Tensor:
        """Datum minus prediction, mag (T,)."""
        off = self.likelihood.observed - self.prediction
        return off if self.likelihood.kind == "mag" else off / self.scale

    @cached_property
    def chi2(self) -> float:
        """Sum of squared residuals over the quoted errors."""
        return float((self.delta / self.quoted).square().sum())

    @property
    def log_z(self) -> float:
        """Log evidence: of all the minima by importance sampling, or by Laplace's method as long as that is not done."""
        if self.evidence is not None and math.isfinite(self.evidence.log_z):
            return self.evidence.log_z
        return self.laplace_of_all + self.missed

    @cached_property
    def laplace_of_all(self) -> float:
        """Log evidence of all the minima by Laplace's method."""
        return float(torch.logsumexp(torch.tensor([minimum.laplace for minimum in (self, *self.others)]), 0))

    @cached_property
    def laplace(self) -> float:
        log_det = float(torch.linalg.slogdet(self.covariance)[1]) if self.posterior.size else 0.0
        return self.peak + HALF_LOG_2PI * self.posterior.size + 0.5 * log_det

    @property
    def minima(self) -> tuple[Fitted, ...]:
        return (self, *self.others)

    @cached_property
    def left(self) -> float:
        """What a step to where the slopes point would gain in log density; inf where they do not say, for want of a law of
        errors whose weights they have."""
        index = torch.tensor(self.posterior.physical, dtype=torch.long)
        if not len(index):
            return 0.0
        tangent = self.tangent[:, index]
        u = torch.cat([self.whitened(self.delta[:, None])[:, 0], self.g])
        free = (self.g[index].abs() < FARTHEST).to(u)
        gradient = free * (tangent.T @ u)
        return float(0.5 * gradient @ torch.linalg.solve(tangent.T @ tangent, gradient))

    def whitened(self, columns: Tensor) -> Tensor:
        """Columns (T, n) divided by the root of the noise's covariance about this minimum."""
        if not self.noise.processes:
            return columns / self.sigma[:, None]
        rows = whitener(self.likelihood, self.found, self.noise, fitted=True)
        return rows(replace(self.found, delta=columns.T, sigma=self.found.sigma, scale=self.found.scale)).T

    @cached_property
    def tangent(self) -> Tensor:
        """Whitened slopes (T, P), those of noise 0, above the prior's rows (P, P)."""
        return torch.cat([self.whitened(self.slopes), torch.eye(self.posterior.size, dtype=self.g.dtype)])

    def outlying(self) -> Tensor:
        """Probability (T,) that a row is one of the wide ones of its law, from its weight; 0 under a normal law."""
        weight = self.noise.law.weight(self.delta / self.wide)
        widest = torch.as_tensor(self.noise.law.widest).to(weight)
        least = 1 / widest**2
        return ((1 - weight) / (1 - least).clamp(min=1e-9)).clamp(0, 1) * (widest > 1)

    def draws(self, count: int, seed: int = 0) -> Tensor:
        """``count`` equally likely draws of theta (count, P)."""
        return self.posterior.theta(self.points(count, seed))

    def points(self, count: int, seed: int = 0) -> Tensor:
        """``count`` equally likely draws of g (count, P): the weighted ones of the evidence, resampled, or of the
        normal approximation about each minimum."""
        generator = torch.Generator().manual_seed(seed)
        if self.evidence is not None and self.evidence.effective > 20:
            weight = torch.exp(self.evidence.log_weight)
            return self.evidence.draws[
                torch.multinomial(weight, count, replacement=True, generator=generator)
            ]
        return mixture_of(self.minima, dof=200).draw(count, generator)


def deviance_rows(likelihood: Likelihood, noise: Noise, at: Residuals) -> Callable[[Residuals], Tensor]:
    """A function that turns residuals into rows whose sum of squares is minus twice the log density, up to a constant;
    noise and its scale are those of the residuals ``at``."""
    if noise.processes or likelihood.fitted_errors or likelihood.selected is not None:
        return whitener(likelihood, at, noise, fitted=True)

    def rows(residuals: Residuals) -> Tensor:
        return deviance(noise.law, residuals.delta / noise.sigma(residuals.sigma, at.scale))

    return rows


def deviance(law: Law, u: Tensor) -> Tensor:
    """The deviate, same shape, of which half the square is what the density of u is below that at 0."""
    if isinstance(law, Normal):
        return u
    near = torch.full_like(u[..., :1], NEAR_ZERO)
    slope = torch.sqrt(law.weight(near))
    apart = u.abs() > NEAR_ZERO
    below = law.log_density(torch.zeros_like(near)) - law.log_density(torch.where(apart, u, 1.0))
    return torch.where(apart, torch.sign(u) * torch.sqrt((2 * below).clamp(min=1e-300)), u * slope)


def mixture_of(minima: Sequence[Fitted], dof: int = TAILS) -> StudentMixture:
    return StudentMixture(
        torch.stack([minimum.g for minimum in minima]),
        torch.stack([minimum.covariance for minimum in minima]),
        torch.tensor([minimum.laplace for minimum in minima], dtype=minima[0].g.dtype),
        dof,
    )


class Linear(Posterior):
    """The posterior with residuals linear in g about a minimum, and further linear columns ``basis`` (T, m) in the
    recording's unit, each times a coordinate of its own with a standard normal prior."""

    def __init__(self, at: Fitted, basis: Tensor | None = None) -> None:
        super().__init__(at.likelihood, at.posterior.scaled)
        self.at = at
        self.basis = at.slopes.new_zeros(len(at.delta), 0) if basis is None else basis
        self.first = self.size
        self.size += self.basis.shape[1]
        self.physical = [*self.physical, *range(self.first, self.size)]
        self.plain = at.found.sigma / at.posterior.factor(at.g)

    @property
    def geometry_seconds(self) -> float:
        return 0.0

    def residuals(self, g):
        at = self.at
        delta = at.delta + (g[..., : self.first] - at.g) @ at.slopes.T - g[..., self.first :] @ self.basis.T
        sigma = (self.plain * self.factor(g)).expand(delta.shape)
        shape = delta.shape
        return replace(
            at.found,
            delta=delta,
            sigma=sigma,
            scale=at.scale.expand(shape),
            prediction=at.prediction.expand(shape),
        )

    def colours(self):
        return None
