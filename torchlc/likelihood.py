"""How probable a recording is under a model: residuals, gains, noise, priors.

Magnitudes are compared as magnitudes while the model is within 5 mag of the datum and linearly in flux below,
so that a dark model (flux 0 in eclipse) has a finite residual and slope. Relative flux has the gain of each
curve profiled, sum(f m / s2) / sum(m2 / s2). Without an error column each curve has its own noise level,
log-uniform, integrated out in closed form. Letters: B batch, T rows, P parameters.
"""

from __future__ import annotations

import math
import os
import shutil
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchlc.effects.base import Noise
from torchlc.least_squares import Colours
from torchlc.model import LightCurve

MAG_PER_LN = 2.5 / math.log(10)
FAINTEST_RATIO = 1e-2
"""Ratio of model to datum below which a magnitude residual continues linearly in flux."""


@dataclass(frozen=True)
class Residuals:
    """Datum minus model, (..., T), with the standard deviation of each row, (..., T) or (T,), in the
    recording's own unit (mag or relative flux); ``scale`` (..., T) turns a magnitude of noise into that unit;
    ``gain`` (..., number of curves) for flux."""

    delta: Tensor
    sigma: Tensor
    scale: Tensor
    gain: Tensor | None


class Likelihood:
    """Log-likelihood, prior and posterior of a :class:`LightCurve` for its recording; batched over theta
    (..., P).

    ``noise_level`` (number of curves,) is the starting noise of curves without errors, in the recording's
    unit.
    """

    def __init__(self, model: LightCurve) -> None:
        self.model = model
        recording = model.recording
        like = model.assembly.sun_magnitude
        self.kind = recording.kind
        self.observed = torch.as_tensor(recording.observed).to(like)
        self.curve = model.assembly.context.curve
        self.curves = len(recording.curve_ids)
        self.count = torch.bincount(self.curve, minlength=self.curves).to(like)
        self.fitted_errors = recording.error is None
        self.noise_level = _successive(recording.observed, recording.curve, self.curves, recording.kind).to(
            like
        )
        self.error = (
            self.noise_level[self.curve]
            if recording.error is None
            else torch.as_tensor(recording.error).to(like)
        )
        self.limit = torch.as_tensor(recording.upper_limit)
        self.measured = ~self.limit
        self.censored = bool(self.limit.any())
        self.observed_flux = 10 ** (-0.4 * (self.observed - like))
        self.gains = self.curves if self.kind == "flux" else 0

    @property
    def rows(self) -> int:
        return len(self.observed)

    @property
    def degrees_of_freedom(self) -> int:
        """Rows less free parameters less gains."""
        return self.rows - len(self.model.names) - self.gains

    @property
    def chi2_sd(self) -> float:
        """Standard deviation of chi-square; that of a single row where parameters outnumber the rows."""
        return math.sqrt(2 * max(self.degrees_of_freedom, 1))

    def colours(self, prior_rows: bool) -> Colours | None:
        """Columns of the Jacobian that belong to single curves, stations or nights, grouped by parameter;
        None if there are none.

        A curve with a profiled gain ties its rows together, so a division that cuts through curves is left as
        it is. ``prior_rows`` appends a row for each peaked prior, in the order of
        :meth:`ParameterSet.prior_residuals`.
        """
        names = self.model.names
        groups: dict[str, list[int]] = {}
        rows = torch.ones(len(names), self.rows, dtype=torch.bool)
        for division, (index, ids) in self.model.assembly.row_index.items():
            if self.gains and not all(
                len(set(index[self.curve == c].tolist())) == 1 for c in range(self.curves)
            ):
                continue
            for column, free in enumerate(self.model.parameter_set.free):
                origin = free.origin
                if origin.division == division and origin.member is not None:
                    groups.setdefault(free.name.removesuffix(f"[{origin.member}]"), []).append(column)
                    rows[column] = index == list(ids).index(origin.member)
        if not any(len(group) > 1 for group in groups.values()):
            return None
        grouped = {column for group in groups.values() for column in group}
        every = [tuple(group) for group in groups.values()] + [
            (c,) for c in range(len(names)) if c not in grouped
        ]
        if prior_rows:
            peaked = [i for i, free in enumerate(self.model.parameter_set.free) if free.prior.peaked]
            own = torch.tensor(
                [[i == column or column not in grouped for i in peaked] for column in range(len(names))]
            )
            rows = torch.cat([rows, own.reshape(len(names), len(peaked))], 1)
        return Colours(tuple(every), rows)

    # ------------------------------------------------------------------ residuals

    def residuals(self, theta: Tensor) -> Residuals:
        """Residuals at natural values theta (..., P), with the quoted (or starting) errors."""
        flux = self.model.brightness(theta).flux
        if self.kind == "flux":
            return self._flux_residuals(flux)
        ratio = flux * (10 ** (-0.4 * self.model.zero_point(theta)) / self.observed_flux)
        scale = flux.new_ones(()).expand(flux.shape)
        return Residuals(-magnitude_difference(ratio), self.error, scale, None)

    def _flux_residuals(self, flux: Tensor) -> Residuals:
        gain = self.profile_gain(flux)
        prediction = gain[..., self.curve] * flux
        floor = 0.25 * self.observed.abs().median()
        return Residuals(
            self.observed - prediction, self.error, torch.clamp(prediction, min=floor) / MAG_PER_LN, gain
        )

    def profile_gain(self, flux: Tensor) -> Tensor:
        """Best scale of each curve, (..., curves), of model flux (..., T)."""
        weight = 1 / self.error**2
        top = self.by_curve(weight * self.observed * flux)
        bottom = self.by_curve(weight * flux * flux)
        return top / torch.where(bottom > 0, bottom, 1.0)

    def by_curve(self, rows: Tensor) -> Tensor:
        if self.curves == 1:
            return rows.sum(-1, keepdim=True)
        zero = rows.new_zeros(*rows.shape[:-1], self.curves)
        return zero.index_add(-1, self.curve, rows)

    # ------------------------------------------------------------------ probability

    def chi2(self, theta: Tensor) -> Tensor:
        """Sum of squared residuals over the quoted errors, (...); over each curve's fitted level where errors
        are fitted."""
        found = self.residuals(theta)
        if self.fitted_errors:
            level = self.fitted_levels(found.delta)
            return ((found.delta / level[..., self.curve]) ** 2).sum(-1)
        return (self.normalised(found) ** 2).sum(-1)

    def fitted_levels(self, delta: Tensor) -> Tensor:
        """Noise level of each curve, (..., curves), from the residuals delta (..., T) of a model fitted to
        them."""
        share = (len(self.model.names) * self.count / self.rows + (1 if self.gains else 0)).clamp(
            max=self.count - 1
        )
        level = torch.sqrt(self.by_curve(delta**2) / (self.count - share).clamp(min=1.0))
        return torch.maximum(level, 1e-3 * self.noise_level)

    def white_levels(self, delta: Tensor) -> Tensor:
        """Noise level of each curve, (..., curves), from the steps between successive residuals delta (...,
        T), which red noise hardly changes: their root mean square over sqrt 2."""
        order = torch.argsort(self.curve, stable=True)
        step = torch.diff(delta[..., order]) * (torch.diff(self.curve[order]) == 0)
        step = torch.zeros_like(delta).index_copy(-1, order[1:], step)
        level = torch.sqrt(self.by_curve(step**2) / (2 * (self.count - 1).clamp(min=1.0)))
        return torch.maximum(level, 1e-3 * self.noise_level)

    def normalised(self, found: Residuals) -> Tensor:
        """Normalised residuals with a censored row's counted as the square root of its deviance."""
        u = found.delta / found.sigma
        if not self.censored:
            return u
        below = -2 * torch.special.log_ndtr(torch.where(self.limit, -u, 0.0))
        return torch.where(self.limit, torch.sqrt(below.clamp(min=1e-300)), u)

    def log_likelihood(self, theta: Tensor, noise: Noise | None = None) -> Tensor:
        """Log density of the recording, (...), at natural values theta (..., P)."""
        return self.density(self.residuals(theta), self.model.noise(theta) if noise is None else noise)

    def density(self, found: Residuals, noise: Noise) -> Tensor:
        """Log density (...) of residuals under a noise model."""
        if self.fitted_errors:
            return self._integrated_level(found, noise)
        sigma = found.sigma
        if noise.jitter is not None:
            sigma = torch.sqrt(sigma**2 + (noise.jitter * found.scale) ** 2)
        if noise.red is not None:
            return correlated_log_density(
                found, sigma, noise, self.model.assembly.context.seconds, self.curve
            )
        u = found.delta / sigma
        peak = -torch.log(sigma) - 0.5 * math.log(2 * math.pi)
        if noise.outliers is None and not self.censored:
            return peak.sum(-1) - 0.5 * u.square().sum(-1)
        normal = peak - 0.5 * u * u
        if noise.outliers is not None and noise.width is not None:
            wide = (
                -0.5 * (u / noise.width) ** 2 - torch.log(sigma * noise.width) - 0.5 * math.log(2 * math.pi)
            )
            normal = torch.logaddexp(torch.log1p(-noise.outliers) + normal, torch.log(noise.outliers) + wide)
        if self.censored:
            censored = torch.special.log_ndtr(torch.where(self.limit, -u, 0.0))
            normal = torch.where(self.limit, censored, normal)
        return normal.sum(-1)

    def _integrated_level(self, found: Residuals, noise: Noise) -> Tensor:
        """A level s of each curve under d ln s: Gamma(N/2) / 2 (pi S)^(-N/2) with S the sum of squares and N
        less the gain."""
        if noise.red is not None:
            white = self.white_levels(found.delta)[..., self.curve]
            return correlated_log_density(
                found, white, noise, self.model.assembly.context.seconds, self.curve
            )
        squares = self.by_curve(found.delta**2) + self.count * (1e-3 * self.noise_level) ** 2
        if noise.outliers is not None and noise.width is not None:
            level = torch.sqrt(squares / self.count)[..., self.curve]
            u = found.delta / level
            p, width = noise.outliers, noise.width
            mixture = torch.logaddexp(
                torch.log1p(-p) - 0.5 * u * u, torch.log(p) - 0.5 * (u / width) ** 2 - torch.log(width)
            )
            return (mixture - torch.log(level) - 0.5 * math.log(2 * math.pi)).sum(-1)
        half = 0.5 * (self.count - (1 if self.gains else 0)).clamp(min=1.0)
        constant = torch.lgamma(half) - math.log(2.0) - half * math.log(math.pi)
        return (constant - half * torch.log(squares)).sum(-1)

    def log_prob(self, theta: Tensor) -> Tensor:
        """Log posterior density (...), up to the evidence, of natural theta (..., P); -inf out of bounds,
        never NaN. Large batches are cut as the model's are."""
        if theta.ndim > 1 and not self.model.geometry_free:
            pieces = theta.reshape(-1, theta.shape[-1]).split(self.model.batch_size())
            if len(pieces) > 1:
                return torch.cat([self._log_prob(piece) for piece in pieces]).reshape(theta.shape[:-1])
        return self._log_prob(theta)

    def _log_prob(self, theta: Tensor) -> Tensor:
        prior = self.model.parameter_set.log_prior(theta)
        inside = torch.isfinite(prior)
        safe = torch.where(inside[..., None], theta, self.model.parameter_set.start())
        total = self.log_likelihood(safe) + torch.where(inside, prior, 0.0)
        return torch.where(inside & torch.isfinite(total), total, -math.inf)


def compiled(likelihood: Likelihood, theta: Tensor) -> Callable[[Tensor], Tensor]:
    """``log_prob`` without gradients by ``torch.compile``, for batches of the size of theta (B, P) and a fixed
    geometry, several times as fast; the plain one, with a warning, where there is no C++ compiler.

    Compiling costs as much as two thousand calls; another size is compiled anew.
    """
    plain = torch.no_grad()(likelihood.log_prob)
    if shutil.which(os.environ.get("CXX", "g++")) is None:
        warnings.warn("no C++ compiler: log_prob is used uncompiled", stacklevel=2)
        return plain
    plain(theta)  # tables are made here, not traced
    fast = torch.compile(plain, dynamic=False)
    fast(theta)
    return fast


def magnitude_difference(ratio: Tensor) -> Tensor:
    """-2.5 log10 of model over datum flux; below FAINTEST_RATIO the tangent, linear in flux, so that a dark
    model stays finite."""
    bright = ratio.clamp(min=FAINTEST_RATIO)
    return -MAG_PER_LN * (torch.log(bright) + (ratio - bright) / FAINTEST_RATIO)


def correlated_log_density(
    found: Residuals, sigma: Tensor, noise: Noise, seconds: Tensor, group: Tensor
) -> Tensor:
    """Log density of residuals with a Matern-3/2 process of ``noise.red`` mag and ``noise.tau`` min,
    independent between groups."""
    assert noise.red is not None and noise.tau is not None  # both come from one effect
    total = torch.zeros(found.delta.shape[:-1], dtype=found.delta.dtype, device=found.delta.device)
    red = noise.red * found.scale
    sigma = sigma.expand(found.delta.shape)
    for one in torch.unique(group).tolist():
        rows = torch.nonzero(group == one)[:, 0]
        gap = (seconds[rows, None] - seconds[None, rows]).abs() / 60.0
        covariance = matern32(gap, noise.tau[..., None]) * red[..., rows, None] * red[..., None, rows]
        covariance = covariance + torch.diag_embed(sigma[..., rows] ** 2)
        factor = torch.linalg.cholesky(covariance)
        white = torch.linalg.solve_triangular(factor, found.delta[..., rows, None], upper=False)[..., 0]
        log_det = torch.log(torch.diagonal(factor, dim1=-2, dim2=-1)).sum(-1)
        total = total - 0.5 * (white**2).sum(-1) - log_det - 0.5 * len(rows) * math.log(2 * math.pi)
    return total


def matern32(gap_min: Tensor, tau_min: Tensor) -> Tensor:
    """Correlation (1 + x) exp(-x), x = sqrt(3) gap / tau."""
    x = math.sqrt(3.0) * gap_min / tau_min
    return (1 + x) * torch.exp(-x)


def _successive(observed: np.ndarray, curve: np.ndarray, curves: int, kind: str) -> Tensor:
    """1.4826 median |successive difference| / sqrt 2 of each curve, (curves,); at least 1e-4 mag or 1e-4 of
    the mean."""
    level = np.empty(curves)
    for one in range(curves):
        values = observed[curve == one]
        steps = np.abs(np.diff(values))
        floor = 1e-4 if kind == "mag" else 1e-4 * abs(float(np.mean(values))) + 1e-300
        level[one] = max(1.4826 * float(np.median(steps)) / math.sqrt(2) if len(steps) else floor, floor)
    return torch.as_tensor(level)
