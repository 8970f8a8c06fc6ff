"""How probable a recording is under a model: residuals, gains, noise, upper limits, priors.

Magnitudes are compared as magnitudes, linearly in flux where the model is more than 5 mag fainter than the datum, so
that a dark model (flux 0 in eclipse) has a finite residual and slope. Curves whose quoted errors follow the measured
flux are compared on a power of the flux instead (:mod:`torchlc.inference.error_law`): a row that noise has made faint has a large
error, and one below 0 has no magnitude, so that without upper limits a row counts given that its flux is above 0.

An upper limit says that the measurement would have come out fainter than it: a magnitude above it, a flux below it. Such
a row counts by the probability of that under the row's noise; it enters no gain, no level of noise and no difference of
successive rows. Relative flux has the gain of each curve profiled over its measured rows, sum(f m / s2) / sum(m2 / s2).
Without an error column each curve has its own level of noise, log-uniform, which is integrated out: in closed form for
normal noise, by quadrature with outliers or upper limits; beside red noise it is that of the steps between rows. Limits
under red noise count by their joint probability given the measured rows (:mod:`torchlc.inference.orthant`). Letters: B batch, T rows, P parameters, C curves, K nodes.
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

from torchlc.effects.red_noise import WITH_OUTLIERS, too_many
from torchlc.errors import InputError
from torchlc.inference.error_law import MAG_PER_LN, error_powers
from torchlc.inference.orthant import log_orthant
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.stages.effect import Noise
from torchlc.tensors.least_squares import Colours

HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)
FAINTEST_RATIO = 1e-2
"""Ratio of model to datum below which a magnitude residual continues linearly in flux."""
NODES, LEVELS = 64, 4
"""Of the quadrature over the level of noise: each level looks closer at where the one before found the integrand."""
LEAST_LOG_P = math.log(1e-3)
"""Probability of an upper limit below which it is told that the model is too bright for it."""
CUT_SEEN = 8.0
"""Standard deviations from the centre beyond which a cut takes less than rounding off a normal distribution."""
NEGLIGIBLE = 40.0
"""In ln, below the largest value of the integrand: 4e-18."""


@dataclass(frozen=True)
class Residuals:
    """Datum minus model, (..., T), with the standard deviation of each row, (..., T) or (T,), in the
    recording's own unit (mag or relative flux); ``scale`` (..., T) turns a magnitude of noise into that unit;
    ``gain`` (..., number of curves) for flux; ``prediction`` (..., T) of the datum.

    Of a magnitude with a power beta of its curve's errors, ``delta`` is 1.0857 ((F_model / F)^beta - 1) / beta,
    which is datum minus prediction to first order.
    """

    delta: Tensor
    sigma: Tensor
    scale: Tensor
    gain: Tensor | None
    prediction: Tensor


@dataclass(frozen=True)
class CorrelatedRows:
    """Rows (n,) of one curve, of which the first ``count`` are measured and the others upper limits, with the lower
    Cholesky factor (..., n, n) of their noise's covariance."""

    rows: Tensor
    count: int
    factor: Tensor

    @property
    def measured(self) -> Tensor:
        """Factor of the measured rows' covariance."""
        return self.factor[..., : self.count, : self.count]

    @property
    def limits(self) -> Tensor:
        """Factor of the upper limits' covariance, given the measured rows."""
        return self.factor[..., self.count :, self.count :]

    def whitened(self, delta: Tensor) -> tuple[Tensor, Tensor]:
        """Of residuals (..., T) the measured rows' with unit variance, and the upper limits' less what the measured
        rows say of them."""
        delta = delta[..., self.rows]
        white = torch.linalg.solve_triangular(self.measured, delta[..., : self.count, None], upper=False)
        expected = self.factor[..., self.count :, : self.count] @ white
        return white[..., 0], delta[..., self.count :] - expected[..., 0]


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
        self.limit = torch.as_tensor(recording.upper_limit)
        self.measured = ~self.limit
        self.censored = bool(self.limit.any())
        self.fainter = -1.0 if self.kind == "mag" else 1.0
        """Sign of a fainter object in the recording's unit."""
        self.count = torch.bincount(self.curve[self.measured], minlength=self.curves).to(like)
        self.fitted_errors = recording.error is None
        self.noise_level = _successive(recording, self.curves).to(like)
        self.error = (
            self.noise_level[self.curve]
            if recording.error is None
            else torch.as_tensor(recording.error).to(like)
        )
        self.observed_flux = 10 ** (-0.4 * (self.observed - like))
        self.gains = int((self.count > 0).sum()) if self.kind == "flux" else 0
        self.power = self._power(recording)
        whole = self.by_curve(self.limit.to(like))[self.curve] == 0
        self.selected = None if self.power is None else whole & (self.power > 0)

    @property
    def rows(self) -> int:
        return len(self.observed)

    def _power(self, recording: Recording) -> Tensor | None:
        """Power of each row's errors, (T,); None where all are 0."""
        if recording.error is None or recording.kind != "mag":
            return None
        flux = 10 ** (-0.4 * recording.observed)
        powers = error_powers(flux, recording.error, recording.curve, ~recording.upper_limit)
        return torch.as_tensor(powers).to(self.observed) if powers.any() else None

    def remarks(self, theta: Tensor) -> list[str]:
        """What a reader of a fit at theta (P,) should know of how its rows are taken."""
        told = []
        ids = self.model.recording.curve_ids
        if self.power is not None:
            curves = torch.unique(self.curve[self.power > 0]).tolist()
            told.append(
                f"the quoted errors follow the measured flux in {_named([ids[c] for c in curves])}: its rows are compared "
                "in flux to a power, not in magnitudes"
            )
        mute = [ids[c] for c in torch.nonzero(self.count == 0)[:, 0].tolist()]
        if mute and (self.kind == "flux" or self.fitted_errors):
            what = "error" if self.fitted_errors else "gain"
            told.append(f"upper limits alone, from which no {what} can be found, say nothing: {_named(mute)}")
        if self.censored and not self.fitted_errors:
            with torch.no_grad():
                found = self.residuals(theta)
                log_p = self.log_below(found.delta / widened(found, self.model.noise(theta)))
            broken = int((log_p < LEAST_LOG_P).sum())
            if broken:
                told.append(
                    f"the model is brighter than {broken} of {int(self.limit.sum())} upper limits allow"
                )
        return told

    @property
    def degrees_of_freedom(self) -> int:
        """Measured rows less free parameters less gains."""
        return int(self.measured.sum()) - len(self.model.names) - self.gains

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
        fainter = magnitude_difference(ratio)
        if self.power is None:
            scale = flux.new_ones(()).expand(flux.shape)
            return Residuals(-fainter, self.error, scale, None, self.observed + fainter)
        delta, scale = power_difference(ratio, self.power)
        return Residuals(delta, self.error, scale, None, self.observed + fainter)

    def _flux_residuals(self, flux: Tensor) -> Residuals:
        gain = self.profile_gain(flux)
        prediction = gain[..., self.curve] * flux
        usual = self.observed[self.measured] if self.gains else self.observed
        scale = torch.clamp(prediction, min=0.25 * usual.abs().median()) / MAG_PER_LN
        return Residuals(self.observed - prediction, self.error, scale, gain, prediction)

    def profile_gain(self, flux: Tensor) -> Tensor:
        """Best scale of each curve's measured rows, (..., curves), of model flux (..., T); 0 for a curve without
        any, whose limits then say nothing."""
        weight = torch.where(self.measured, 1 / self.error**2, 0.0)
        top = self.by_curve(weight * self.observed * flux)
        bottom = self.by_curve(weight * flux * flux)
        return top / torch.where(bottom > 0, bottom, 1.0)

    def by_curve(self, rows: Tensor) -> Tensor:
        """Sums over the rows of each curve, (..., C), of (..., T)."""
        if self.curves == 1:
            return rows.sum(-1, keepdim=True)
        zero = rows.new_zeros(*rows.shape[:-1], self.curves)
        return zero.index_add(-1, self.curve, rows)

    def squares(self, delta: Tensor) -> Tensor:
        """Sum of squares of each curve's measured rows, (..., C), of residuals (..., T)."""
        return self.by_curve(torch.where(self.limit, 0.0, delta) ** 2 if self.censored else delta**2)

    # ------------------------------------------------------------------ probability

    def chi2(self, theta: Tensor) -> Tensor:
        """Sum of squared residuals of the measured rows over the quoted errors, (...); over each curve's fitted
        level where errors are fitted. Residuals that are cut off at a flux of 0 count as the normal ones of the same
        probability."""
        found = self.residuals(theta)
        if self.fitted_errors:
            level = self.fitted_levels(found.delta)
            return (self.squares(found.delta) / level**2).sum(-1)
        u = found.delta / found.sigma
        if self.selected is not None:
            u = torch.where(self.selected, uncut(u, self.above_zero(found, found.sigma)), u)
        return self.squares(u).sum(-1)

    def fitted_levels(self, delta: Tensor) -> Tensor:
        """Noise level of each curve, (..., curves), from the residuals delta (..., T) of a model fitted to
        its measured rows."""
        share = len(self.model.names) * self.count / self.measured.sum().clamp(min=1)
        share = torch.minimum(share + (1 if self.gains else 0), self.count - 1)
        level = torch.sqrt(self.squares(delta) / (self.count - share).clamp(min=1.0))
        return torch.maximum(level, 1e-3 * self.noise_level)

    def white_levels(self, delta: Tensor) -> Tensor:
        """Noise level of each curve, (..., curves), from the steps between successive residuals delta (...,
        T) of measured rows, which red noise hardly changes: their root mean square over sqrt 2."""
        order = torch.argsort(self.curve, stable=True)
        order = order[self.measured[order]]
        step = torch.diff(delta[..., order]) * (torch.diff(self.curve[order]) == 0)
        step = torch.zeros_like(delta).index_copy(-1, order[1:], step)
        level = torch.sqrt(self.by_curve(step**2) / (2 * (self.count - 1).clamp(min=1.0)))
        return torch.maximum(level, 1e-3 * self.noise_level)

    def log_below(self, u: Tensor) -> Tensor:
        """ln of the probability of each upper limit, (..., T), at residuals over their standard deviation u (...,
        T), limit minus model: that noise is above u in magnitudes, below it in flux; 0 for measured rows."""
        fainter = self.fainter * torch.where(self.limit, u, 0.0)
        return torch.where(self.limit, torch.special.log_ndtr(fainter), 0.0)

    def normalised(self, found: Residuals) -> Tensor:
        """Residuals over their errors, (..., T); for an upper limit the square root of its deviance."""
        return self.deviance_rows(found.delta / found.sigma)

    def deviance_rows(self, u: Tensor) -> Tensor:
        """u (..., T) with sqrt(-2 ln P) in place of upper limits, whose sum of squares is -2 ln density."""
        if not self.censored:
            return u
        return torch.where(self.limit, torch.sqrt((-2 * self.log_below(u)).clamp(min=1e-300)), u)

    def log_likelihood(self, theta: Tensor, noise: Noise | None = None) -> Tensor:
        """Log density of the recording, (...), at natural values theta (..., P)."""
        return self.density(self.residuals(theta), self.model.noise(theta) if noise is None else noise)

    def density(self, found: Residuals, noise: Noise) -> Tensor:
        """Log density (...) of residuals under a noise model."""
        if noise.red is not None:
            return self._correlated(found, noise)
        if self.fitted_errors:
            return self._integrated_level(found, noise)
        sigma = widened(found, noise)
        u = found.delta / sigma
        if noise.outliers is None and not self.censored and self.selected is None:
            peak = -torch.log(sigma) - 0.5 * math.log(2 * math.pi)
            return peak.sum(-1) - 0.5 * u.square().sum(-1)
        total = self._rows(u, torch.log(sigma), noise)
        if self.selected is not None:
            total = total - self._log_positive(found, sigma, noise)
        return total.sum(-1)

    def _rows(self, u: Tensor, log_sigma: Tensor, noise: Noise) -> Tensor:
        """Log density (..., T) of residuals u over standard deviations: of a measured row its height, of an upper
        limit its probability; both are mixtures with outliers."""
        normal = self._normal_rows(u, log_sigma)
        if noise.outliers is None or noise.width is None:
            return normal
        wide = self._normal_rows(u / noise.width, log_sigma + torch.log(noise.width))
        return torch.logaddexp(torch.log1p(-noise.outliers) + normal, torch.log(noise.outliers) + wide)

    def _normal_rows(self, u: Tensor, log_sigma: Tensor) -> Tensor:
        normal = -0.5 * u * u - log_sigma - HALF_LOG_2PI
        return torch.where(self.limit, self.log_below(u), normal) if self.censored else normal

    def _log_positive(self, found: Residuals, sigma: Tensor, noise: Noise) -> Tensor:
        """ln of the probability, (..., T), that a measured flux is above 0, without which there is no magnitude,
        where no upper limit of the curve stands for such rows; 0 for other rows."""
        assert self.selected is not None  # asked of such curves only
        k = self.above_zero(found, sigma)
        above = torch.special.log_ndtr(k)
        if noise.outliers is not None and noise.width is not None:
            wide = torch.special.log_ndtr(k / noise.width)
            above = torch.logaddexp(torch.log1p(-noise.outliers) + above, torch.log(noise.outliers) + wide)
        return torch.where(self.selected, above, 0.0)

    def above_zero(self, found: Residuals, sigma: Tensor) -> Tensor:
        """Standard deviations (..., T) by which the model is above a flux of 0 in curves of which rows are there
        only if their flux is above 0; 100, as good as infinite, in others."""
        assert self.power is not None and self.selected is not None  # asked of such curves only
        power = torch.where(self.selected, self.power, 1.0)
        return torch.where(self.selected, MAG_PER_LN * found.scale / (power * sigma), 100.0)

    def _correlated(self, found: Residuals, noise: Noise) -> Tensor:
        """Rows that err together; the level of errors that are fitted is that of the steps between rows."""
        most = int(self.by_curve(self.limit.to(torch.long)).max())
        problem = WITH_OUTLIERS if noise.outliers is not None else too_many(most)
        if problem is not None:
            raise InputError(self.model.recording.source, None, f"red_noise cannot be applied: {problem}")
        if self.fitted_errors:
            sigma = self.white_levels(found.delta)[..., self.curve]
        else:
            sigma = widened(found, noise)
        total = torch.zeros_like(found.delta[..., 0])
        for part in self.correlated_parts(found, sigma, noise):
            white, left = part.whitened(found.delta)
            log_det = torch.log(torch.diagonal(part.measured, dim1=-2, dim2=-1)).sum(-1)
            total = total - 0.5 * white.square().sum(-1) - log_det - HALF_LOG_2PI * white.shape[-1]
            if left.shape[-1]:
                total = total + log_orthant(part.limits, self.fainter * left)
        return total

    def correlated_parts(self, found: Residuals, sigma: Tensor, noise: Noise) -> list[CorrelatedRows]:
        """Each curve's rows with a Matern-3/2 process of ``noise.red`` mag and ``noise.tau`` min, independent
        between curves, beside white noise sigma (..., T)."""
        assert noise.red is not None and noise.tau is not None  # both come from one effect
        seconds = self.model.assembly.context.seconds
        red = noise.red * found.scale
        sigma = sigma.expand(found.delta.shape)
        parts = []
        for one in torch.unique(self.curve).tolist():
            rows = torch.nonzero(self.curve == one)[:, 0]
            rows = torch.cat([rows[self.measured[rows]], rows[self.limit[rows]]])
            gap = (seconds[rows, None] - seconds[None, rows]).abs() / 60.0
            covariance = matern32(gap, noise.tau[..., None]) * red[..., rows, None] * red[..., None, rows]
            covariance = covariance + torch.diag_embed(sigma[..., rows] ** 2)
            parts.append(
                CorrelatedRows(rows, int(self.measured[rows].sum()), torch.linalg.cholesky(covariance))
            )
        return parts

    def _integrated_level(self, found: Residuals, noise: Noise) -> Tensor:
        """A level s of each curve under d ln s, of N measured rows less the gain: Gamma(N/2) / 2 (pi S)^(-N/2) with S
        the sum of squares; with outliers or upper limits by quadrature. A curve of limits alone says nothing.

        S has a share of 1e-3 of the starting level, so that a perfect model has a finite density.
        """
        soft = self.count * (1e-3 * self.noise_level) ** 2
        squares = self.squares(found.delta) + soft
        freedom = (self.count - (1 if self.gains else 0)).clamp(min=1.0)
        if noise.outliers is not None or self.censored:
            return self._level_by_quadrature(found.delta, noise, squares, soft, freedom)
        half = 0.5 * freedom
        constant = torch.lgamma(half) - math.log(2.0) - half * math.log(math.pi)
        return (constant - half * torch.log(squares)).sum(-1)

    def _level_by_quadrature(
        self, delta: Tensor, noise: Noise, squares: Tensor, soft: Tensor, freedom: Tensor
    ) -> Tensor:
        """ln of the integral over ln s of each curve, (...), by the rows' densities at every level."""
        mixture = noise.outliers is not None
        across = {name: getattr(noise, name) for name in ("outliers", "width")}
        nodes = Noise(**{name: None if one is None else one[..., None, :] for name, one in across.items()})
        counted = self.limit | mixture  # rows that are not in the sum of squares
        lost = torch.where(self.count > 0, self.count - freedom, 0.0)

        def log_density(level: Tensor) -> Tensor:
            """(..., K, C) at ln s (..., K, C)."""
            log_sigma = level[..., self.curve]
            rows = self._rows(delta[..., None, :] * torch.exp(-log_sigma), log_sigma, nodes)
            total = self.by_curve(torch.where(counted, rows, 0.0))
            smooth = -0.5 * (soft if mixture else squares)[..., None, :] * torch.exp(-2 * level)
            normal = 0.0 if mixture else -self.count * (level + HALF_LOG_2PI)
            return total + smooth + normal + lost * (level + HALF_LOG_2PI)

        with torch.no_grad():
            hidden = self.by_curve(torch.where(self.limit, delta, 0.0) ** 2)
            known = torch.where(self.count > 0, squares, 1.0)
            lowest = 0.5 * torch.log(known / freedom) - (9 / torch.sqrt(2 * freedom)).clamp(max=2.3)
            if noise.width is not None:
                lowest = lowest - torch.log(noise.width)
            highest = 0.5 * torch.log((known + hidden) / freedom) + 36 / freedom + 9 / torch.sqrt(2 * freedom)
        found = log_integral(log_density, lowest, highest)
        return torch.where(self.count > 0, found, 0.0).sum(-1)

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


def _named(curves: list[str]) -> str:
    shown = ", ".join(curves[:5]) + (f" and {len(curves) - 5} more" if len(curves) > 5 else "")
    return f"curve{'s' if len(curves) > 1 else ''} {shown}"


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


def power_difference(ratio: Tensor, power: Tensor) -> tuple[Tensor, Tensor]:
    """1.0857 (ratio^power - 1) / power, mag, of model over datum flux, and ratio^power; their tangents, linear in
    flux, below FAINTEST_RATIO, where a power below 1 has no slope at 0."""
    bright = ratio.clamp(min=FAINTEST_RATIO)
    log = torch.log(bright)
    some = power > 0
    safe = torch.where(some, power, 1.0)
    share = torch.where(some, torch.exp(safe * log), 1.0)
    difference = torch.where(some, torch.expm1(safe * log) / safe, log)
    below = share * (ratio - bright) / bright
    return MAG_PER_LN * (difference + below), share + power * below


def uncut(u: Tensor, k: Tensor) -> Tensor:
    """The standard normal deviate (...) that is beyond as large a share of its distribution as u is of one cut off
    at k, u < k."""
    near = k < CUT_SEEN
    u_near, k_near = torch.where(near, u, 0.0), torch.where(near, k, 1.0)
    whole = torch.special.ndtr(k_near)
    below = torch.special.ndtr(-u_near.abs())
    lower = torch.where(u_near < 0, below, (below - torch.special.ndtr(-k_near)).clamp(min=1e-300)) / whole
    deviate = torch.special.ndtri(lower.clamp(min=1e-300, max=1 - 1e-16))
    return torch.where(near & (u > -30), torch.where(u_near < 0, deviate, -deviate), u)


def widened(found: Residuals, noise: Noise) -> Tensor:
    """Standard deviation of each row, (..., T), with the jitter."""
    if noise.jitter is None:
        return found.sigma
    return torch.sqrt(found.sigma**2 + (noise.jitter * found.scale) ** 2)


def log_integral(log_density: Callable[[Tensor], Tensor], low: Tensor, high: Tensor) -> Tensor:
    """ln of the integral (..., C) of a density that is negligible at ``low`` and ``high`` (..., C), given its
    logarithm at nodes (..., K, C), by the trapezoidal rule; exact to rounding where the density is smooth between
    the last level's nodes."""
    with torch.no_grad():
        shape = torch.broadcast_shapes(low.shape, high.shape)
        low, high = low.expand(shape), high.expand(shape)
        share = torch.linspace(0, 1, NODES, dtype=low.dtype, device=low.device)[:, None]
        for _ in range(LEVELS - 1):
            nodes = low[..., None, :] + (high - low)[..., None, :] * share
            value = log_density(nodes)
            kept = (value > value.amax(-2, keepdim=True) - NEGLIGIBLE).to(low.dtype)
            step = (high - low) / (NODES - 1)
            low = low + step * (kept.argmax(-2) - 1)
            high = high - step * (kept.flip(-2).argmax(-2) - 1)
        nodes = low[..., None, :] + (high - low)[..., None, :] * share
    return torch.logsumexp(log_density(nodes), -2) + torch.log((high - low) / (NODES - 1))


def matern32(gap_min: Tensor, tau_min: Tensor) -> Tensor:
    """Correlation (1 + x) exp(-x), x = sqrt(3) gap / tau."""
    x = math.sqrt(3.0) * gap_min / tau_min
    return (1 + x) * torch.exp(-x)


def _successive(recording: Recording, curves: int) -> Tensor:
    """1.4826 median |successive difference| / sqrt 2 of each curve's measured rows, (curves,); at least 1e-4 mag or
    1e-4 of the mean."""
    level = np.empty(curves)
    for one in range(curves):
        rows = recording.curve == one
        measured = rows & ~recording.upper_limit
        values = recording.observed[measured if measured.any() else rows]
        steps = np.abs(np.diff(values)) if measured.any() else values[:0]
        floor = 1e-4 if recording.kind == "mag" else 1e-4 * abs(float(np.mean(values))) + 1e-300
        level[one] = max(1.4826 * float(np.median(steps)) / math.sqrt(2) if len(steps) else floor, floor)
    return torch.as_tensor(level)
