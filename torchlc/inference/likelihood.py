"""How probable a recording is under a model: residuals, gains, noise, upper limits, priors.

Magnitudes are compared as magnitudes, linearly in flux where the model is more than 5 mag fainter than the datum, so
that a dark model (flux 0 in eclipse) has a finite residual and slope. Curves whose quoted errors follow the measured
flux are compared on a power of the flux instead (:mod:`torchlc.noise.error_law`): a row that noise has made faint has a large
error, and one below 0 has no magnitude, so that without upper limits a row counts given that its flux is above 0.

An upper limit says that the measurement would have come out fainter than it: a magnitude above it, a flux below it. Such
a row counts by the probability of that under the row's noise; it enters no gain, no level of noise and no difference of
successive rows. Relative flux has the gain of each curve profiled over its measured rows, sum(f m / s2) / sum(m2 / s2).
What residuals are worth under the noise is worked out in :mod:`torchlc.noise`. Letters: B batch, T rows, P parameters,
C curves.
"""

from __future__ import annotations

import math
import os
import shutil
import warnings
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from torchlc.lightcurve.model import LightCurve
from torchlc.noise import Noise, Residuals, Rows, log_density
from torchlc.noise.error_law import FAINTEST_RATIO, MAG_PER_LN, power_difference, power_shift
from torchlc.readers import Recording
from torchlc.tensors.least_squares import Colours
from torchlc.tensors.moving import on

LEAST_LOG_P = math.log(1e-3)
"""Probability of an upper limit below which it is told that the model is too bright for it."""
WEAK_MAG, LEFT_WEAK_MAG = 0.4, 0.05
"""Errors above which the scale of flux leaves something, and how much: photons alone in a curve that fades from a
signal-to-noise ratio of 2 to 1. At 3 and better 0.01 mag are left."""
CUT_MAG = 0.3
"""Errors of measured rows beside upper limits above which chi-square is told to be cut: p is 1e-29 for clean rows of a
signal-to-noise ratio of 3 to 1 whose limits are at three errors."""
DOUBTFUL_SHIFT_MAG = 0.05
"""Bias of magnitudes that is told: a signal-to-noise ratio below 6."""
CUT_SEEN = 8.0
"""Standard deviations from the centre beyond which a cut takes less than rounding off a normal distribution."""


class Likelihood(Rows):
    """Log-likelihood, prior and posterior of a :class:`LightCurve` for its recording; batched over theta
    (..., P).

    ``noise_level`` (number of curves,) is the starting noise of curves without errors, in the recording's
    unit.
    """

    def __init__(self, model: LightCurve) -> None:
        self.model = model
        recording = model.recording
        sun_magnitude = model.assembly.sun_magnitude
        with on(model.assembly.device):
            super().__init__(recording, model.assembly.context.curve, sun_magnitude)
        self.kind = recording.kind
        self.faintest_light = (
            0.25 * _usual_flux(recording).to(sun_magnitude)[self.curve] if self.kind == "flux" else None
        )
        """Of each row's curve, (T,), the least light of which a magnitude of noise is taken as a share."""
        self.observed_flux = 10 ** (-0.4 * (self.observed - sun_magnitude))

    def remarks(self, theta: Tensor) -> list[str]:
        """What a reader of a fit at theta (P,) should know of how its rows are taken."""
        remarks = []
        ids = self.model.recording.curve_ids
        if self.power is not None:
            followed = self.power > 0
            faint = followed & self.measured & (self.error > WEAK_MAG)
            remarks.append(
                f"the quoted errors follow the measured flux in {_named(self._curves_of(followed))}: its rows are compared "
                "in flux to a power, not in magnitudes"
                + (
                    f", which leaves up to {LEFT_WEAK_MAG} mag where errors are above a third"
                    if faint.any()
                    else ""
                )
            )
        limited = self.by_curve(self.limit.to(self.error))[self.curve] > 0
        if (
            self.kind == "mag"
            and not self.fitted_errors
            and bool((limited & self.measured & (self.error > CUT_MAG)).any())
        ):
            remarks.append(
                "faint rows are upper limits, and the measured ones near them the bright part of the noise: chi-square and its p, "
                "which count these alone, are not those of noise; parameters and their intervals take the limits into account"
            )
        processes = self.model.noise(theta.detach()).processes if self.fitted_errors else ()
        if processes:
            remarks.append(
                f"without an error column, the white noise beside {' and '.join(process.name for process in processes)} is as large as the "
                "steps between rows say and is not fitted: what is not known of it is in no interval"
            )
        if self.kind == "mag" and not self.fitted_errors:
            remarks.extend(self._doubtful_law())
        mute = [ids[c] for c in torch.nonzero(self.count == 0)[:, 0].tolist()]
        if mute and (self.kind == "flux" or self.fitted_errors):
            what = "error" if self.fitted_errors else "gain"
            remarks.append(
                f"upper limits alone, from which no {what} can be found, say nothing: {_named(mute)}"
            )
        if self.censored and not self.fitted_errors:
            with torch.no_grad():
                residuals = self.residuals(theta)
                sigma = self.model.noise(theta).sigma(residuals.sigma, residuals.scale)
                log_p = self.log_below(residuals.delta / sigma)
            broken = int((log_p < LEAST_LOG_P).sum())
            if broken:
                remarks.append(
                    f"the model is brighter than {broken} of {int(self.limit.sum())} upper limits allow"
                )
        return remarks

    def _curves_of(self, rows: Tensor) -> list[str]:
        """Curves that some of the rows (T,) marked are in."""
        return [self.model.recording.curve_ids[c] for c in torch.unique(self.curve[rows]).tolist()]

    def _doubtful_law(self) -> list[str]:
        """Which curves of large errors are compared in magnitudes, and what that costs if noise is normal in flux."""
        kept = self.measured if self.power is None else self.measured & (self.power == 0)
        squares = self.by_curve(torch.where(kept, self.error, 0.0) ** 2)
        shift = 1.5 / MAG_PER_LN * squares / self.by_curve(kept.to(squares)).clamp(min=1.0)
        large = kept & (shift[self.curve] > DOUBTFUL_SHIFT_MAG)
        if not large.any():
            return []
        worst = float(shift[self.curve[large]].max())
        return [
            f"the quoted errors of {_named(self._curves_of(large))} are large and do not clearly follow the measured flux: rows are "
            f"compared in magnitudes, which is {min(worst, 0.3):.2g} mag too bright if the noise is of sky or detector"
        ]

    def expanded(self, theta: Tensor, covariance: Tensor) -> Likelihood:
        """The same likelihood with its free geometry worked out to second order about natural values theta (P,), for many calls
        near there: a chain, a search, an evidence.

        ``covariance`` (P, P) of theta says how far the calls will go: within ``model.evaluator.reach`` of its standard deviations
        light is off by at most ``model.evaluator.error_mag``, 2e-3 mag or less, and beyond it is exact. A call then costs 2 to 4
        times one of a fixed geometry; making it costs (d + 1)(d + 2) / 2 tables for d numbers that move the geometry, about a
        second and a half for one and ten for seven. Take the last word of any search from this likelihood, not from that one.

        Raises :class:`~torchlc.lightcurve.evaluators.expansion.UnsuitableError`, which says why, where the error would be larger
        or the geometry has no such expansion (light scattered between parts, meshes, more than twelve numbers).
        """
        return Likelihood(self.model.expanded(theta, covariance))

    @property
    def degrees_of_freedom(self) -> int:
        """Measured rows less free parameters less gains."""
        return int(self.measured.sum()) - len(self.model.names) - self.gains

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
            priors = torch.tensor(
                [[i == column or column not in grouped for i in peaked] for column in range(len(names))],
                dtype=torch.bool,
            )
            rows = torch.cat([rows, priors.reshape(len(names), len(peaked))], 1)
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
        delta = delta + power_shift(scale, self.power, self.error)
        return Residuals(delta, self.error, scale, None, self.observed + fainter)

    def _flux_residuals(self, flux: Tensor) -> Residuals:
        gain = self.profile_gain(flux)
        prediction = gain[..., self.curve] * flux
        assert self.faintest_light is not None  # of relative flux there is one
        scale = torch.maximum(prediction, self.faintest_light) / MAG_PER_LN
        return Residuals(self.observed - prediction, self.error, scale, gain, prediction)

    def profile_gain(self, flux: Tensor) -> Tensor:
        """Best scale of each curve's measured rows, (..., curves), of model flux (..., T); 0 for a curve without
        any, whose limits then say nothing."""
        weight = torch.where(self.measured, 1 / self.error**2, 0.0)
        top = self.by_curve(weight * self.observed * flux)
        bottom = self.by_curve(weight * flux * flux)
        return top / torch.where(bottom > 0, bottom, 1.0)

    # ------------------------------------------------------------------ probability

    def chi2(self, theta: Tensor) -> Tensor:
        """Sum of squared residuals of the measured rows over the quoted errors, (...); over each curve's fitted
        level where errors are fitted. Residuals that are cut off at a flux of 0 count as the normal ones of the same
        probability."""
        residuals = self.residuals(theta)
        if self.fitted_errors:
            level = self.fitted_levels(residuals.delta)
            return (self.squares(residuals.delta) / level**2).sum(-1)
        u = residuals.delta / residuals.sigma
        if self.selected is not None:
            u = torch.where(self.selected, uncut(u, self.above_zero(residuals, residuals.sigma)), u)
        return self.squares(u).sum(-1)

    def fitted_levels(self, delta: Tensor) -> Tensor:
        """Noise level of each curve, (..., curves), from the residuals delta (..., T) of a model fitted to
        its measured rows."""
        share = len(self.model.names) * self.count / self.measured.sum().clamp(min=1)
        share = torch.minimum(share + (1 if self.gains else 0), self.count - 1)
        return self.level_of(self.squares(delta) / (self.count - share).clamp(min=1.0))

    def log_likelihood(self, theta: Tensor, noise: Noise | None = None) -> Tensor:
        """Log density of the recording, (...), at natural values theta (..., P)."""
        return self.density(self.residuals(theta), self.model.noise(theta) if noise is None else noise)

    def density(self, found: Residuals, noise: Noise) -> Tensor:
        """Log density (...) of residuals under a noise model."""
        return log_density(self, found, noise)

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


def _usual_flux(recording: Recording) -> Tensor:
    """The median size of each curve's measured fluxes, (C,); of all its rows where none is measured. Every curve has
    a unit of its own."""
    usual = np.empty(len(recording.curve_ids))
    for number in range(len(usual)):
        rows = recording.curve == number
        measured = rows & ~recording.upper_limit
        sizes = np.abs(recording.observed[measured if measured.any() else rows])
        usual[number] = np.quantile(sizes, 0.5, method="lower")
    return torch.as_tensor(usual)


def _named(curves: list[str]) -> str:
    shown = ", ".join(curves[:5]) + (f" and {len(curves) - 5} more" if len(curves) > 5 else "")
    return f"curve{'s' if len(curves) > 1 else ''} {shown}"


def compiled(likelihood: Likelihood, theta: Tensor) -> Callable[[Tensor], Tensor]:
    """``log_prob`` without gradients by ``torch.compile``, for batches of the size of theta (B, P) and a fixed
    geometry, two to three times as fast; the plain one, with a warning, where there is no C++ compiler.

    For loops of one's own: it pays after 10,000 to 25,000 calls of one size (8 to 26 CPU s against 0.6 to 1.1 ms saved a call,
    840 rows and 32 to 64 walkers). A fit makes 2,400 in two sizes, so that no verb uses it. Another size is compiled anew.
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
