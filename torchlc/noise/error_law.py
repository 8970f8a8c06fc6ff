"""How the quoted errors of magnitudes follow the measured flux, and the scale on which noise is then normal.

An error worked out from the measured flux, 1.0857 sigma / F, is small where noise has made a row bright, and large
where it has made it faint. Taken as the error of a magnitude it favours the bright rows: by 1.5 (sigma / F)^2 of the
flux, 0.015 mag at a signal-to-noise ratio of 10 and 0.16 mag at 3. A scale on which errors do not depend on the noise is
the integral of dF / sigma(F) (Bartlett 1947, Biometrics 3, 39). Errors in mag go as F^-beta about a row: beta is 1 for noise of
the sky or the detector, which is normal in flux, 1/2 for photons, between them for photons beside a sky, and 0 for an error that
is a share of the light, which is normal in magnitudes.

From 1/2 to 1 the variance of flux is a + b F, of which the object's photons are a share w = 2 (1 - beta) at the measured flux:
the scale is sqrt(a + b F) (Anscombe 1948, Biometrika 35, 246). Below 1/2 it is F^beta (Box & Cox 1964, J. R. Stat. Soc. B 26,
211). The two are one at 1/2.

Letters: T rows, C curves.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.special import stdtrit
from torch import Tensor

MAG_PER_LN = 2.5 / math.log(10)
LEAST_STEPS = 3
"""Steps between rows from which a power is worked out: one or two agree with a line too easily."""
CHANCE = 1e-2
"""Probability, by Student's t, below which a relation of errors to light is not taken for chance. Of curves of 20 rows at a
signal-to-noise ratio of 3, whose errors also scatter by 0.3, 4 % then miss the law of their noise (11 % at 1e-4), and the level is
0.008 mag off on average (0.015). Errors that have nothing to do with the light move it by 0.003 mag."""
LOG_RATIOS = np.linspace(-8.0, 8.0, 33)
"""ln of variance by photons over variance by the sky, at the median flux, from which the best is looked for: beyond, one of the
two is less than 0.04 % and is taken for none."""
FAINTEST_RATIO = 1e-2
"""Ratio of model to datum below which a residual continues linearly in flux."""
LOG_RATIO_TOLERANCE = 1e-5
"""Of the logarithm above: moves the scale by less than 1e-5 of an error."""
CLEARLY_BETTER = 0.5
"""Misfit of photons beside a sky over that of one power, at most. Errors worked out from counts leave next to none; where sizes
scatter by 0.3 or more, for other reasons, both leave the same to a tenth."""
LEAST_SHIFT_MAG = 1e-3
"""Magnitudes are kept where they are biased by less, a tenth of what absolute photometry reaches: at a
signal-to-noise ratio above some 40."""


def error_powers(
    flux: np.ndarray, error_mag: np.ndarray, curve: np.ndarray, measured: np.ndarray
) -> np.ndarray:
    """The power beta of each row, (T,), 0 to 1, from measured flux, errors in mag and curve (T,) of rows
    in order of time; ``measured`` (T,) is false for upper limits.

    A curve's is minus the slope of ln error against ln flux over the steps between neighbouring rows, in which noise
    outweighs the object's own changes where the signal is weak; rows count by the square of their relative error. Where it is
    above 1/2 the errors are those of photons beside a sky, and rows differ. Curves of fewer than five rows share a law. Errors
    that come from something else than the measured flux give 0.
    """
    powers = np.zeros(len(flux))
    rows = [np.flatnonzero((curve == number) & measured) for number in np.unique(curve)]
    few = [index for index in rows if len(index) <= LEAST_STEPS + 1]
    for curves in [*([index] for index in rows if len(index) > LEAST_STEPS + 1), few]:
        steps = _Steps(curves, flux, error_mag)
        power = _power(curves, steps)
        alike = np.isin(curve, curve[np.concatenate([np.empty(0, dtype=int), *curves])])
        photons = _photons_over_sky(steps, power) if power > 0.5 else None
        if photons is None:
            powers[alike] = power
        else:
            by_photons = photons * flux[alike]
            powers[alike] = np.where(np.isinf(by_photons), 0.5, (1 + 0.5 * by_photons) / (1 + by_photons))
    return powers


class _Steps:
    """Steps (S,) between neighbouring rows of several curves, an array of indices each: of ln flux and of ln error in mag, with
    their weights."""

    def __init__(self, curves: list[np.ndarray], flux: np.ndarray, error_mag: np.ndarray) -> None:
        self.first = np.concatenate([np.empty(0, dtype=int), *(index[:-1] for index in curves)])
        self.second = np.concatenate([np.empty(0, dtype=int), *(index[1:] for index in curves)])
        self.flux = flux
        self.of_light = np.log(flux[self.second] / flux[self.first])
        self.of_error = np.log(error_mag[self.second] / error_mag[self.first])
        self.square = np.minimum(error_mag / MAG_PER_LN, 1.0) ** 2
        self.weight = self.square[self.first] + self.square[self.second]

    def __len__(self) -> int:
        return len(self.first)

    def misfit(self, photons_over_sky: float) -> float:
        """Weighted sum of squares of what is left of the steps of errors by the variance 1 + ``photons_over_sky`` F of flux."""
        ratio = np.log1p(photons_over_sky * self.flux)
        expected = 0.5 * (ratio[self.second] - ratio[self.first]) - self.of_light
        return float((self.weight * (self.of_error - expected) ** 2).sum())

    def misfit_of_power(self, power: float) -> float:
        """The same by errors that go as F^-``power``."""
        return float((self.weight * (self.of_error + power * self.of_light) ** 2).sum())


def _power(curves: list[np.ndarray], steps: _Steps) -> float:
    """One power for the rows of the curves; 0 if errors do not follow the flux."""
    if len(steps) < LEAST_STEPS:
        return 0.0
    spread = float((steps.weight * steps.of_light**2).sum())
    if spread == 0:
        return 0.0
    slope = -float((steps.weight * steps.of_light * steps.of_error).sum()) / spread
    freedom = len(steps) - 1
    error = math.sqrt(steps.misfit_of_power(slope) / freedom / spread)
    power = min(max(slope, 0.0), 1.0)
    shift = 1.5 * MAG_PER_LN * power * float(steps.square[np.concatenate(curves)].mean())
    sure = slope > float(stdtrit(freedom, 1 - CHANCE)) * error
    return power if sure and shift > LEAST_SHIFT_MAG else 0.0


def _photons_over_sky(steps: _Steps, power: float) -> float | None:
    """b / a of the variance a + b F of flux that the steps fit best, 0 to infinity; None where they follow it no better than
    one power, as where errors differ from row to row for other reasons too."""
    usual = float(np.median(steps.flux[steps.first]))
    trials, gap = LOG_RATIOS, float(LOG_RATIOS[1] - LOG_RATIOS[0])
    while True:
        fits = [steps.misfit(math.exp(ratio) / usual) for ratio in trials]
        best = float(trials[int(np.argmin(fits))])
        if gap < LOG_RATIO_TOLERANCE:
            break
        trials = np.linspace(best - gap, best + gap, len(trials))
        gap = float(trials[1] - trials[0])
    misfits = {
        0.0: steps.misfit_of_power(1.0),
        math.inf: steps.misfit_of_power(0.5),
        math.exp(best) / usual: min(fits),
    }
    photons = min(misfits, key=lambda trial: misfits[trial])
    return photons if misfits[photons] <= CLEARLY_BETTER * steps.misfit_of_power(power) else None


def power_difference(ratio: Tensor, power: Tensor) -> tuple[Tensor, Tensor]:
    """Model less datum on the scale on which noise is normal, mag, from model over datum flux (..., T) and the power (T,) of the
    datum's error; and what a small magnitude of the model is worth on that scale, (..., T). Tangents, linear in flux, below
    FAINTEST_RATIO, where a power of 1/2 or less has no slope at 0."""
    bright = ratio.clamp(min=FAINTEST_RATIO)
    below = (ratio - bright) / bright
    by_photons, relative = _photons(power)
    root = torch.sqrt(1 + by_photons * (bright - 1))
    of_counts = 2 * (bright - 1) / (root + 1)
    worth_of_counts = bright / root
    log = torch.log(bright)
    some = relative > 0
    safe = torch.where(some, relative, 1.0)
    share = torch.where(some, torch.exp(safe * log), 1.0)
    of_share = torch.where(some, torch.expm1(safe * log) / safe, log)
    counted = power > 0.5
    worth = torch.where(counted, worth_of_counts, share)
    slope = torch.where(counted, 1 - 0.5 * by_photons * bright / root**2, relative)
    difference = torch.where(counted, of_counts, of_share)
    return MAG_PER_LN * (difference + worth * below), worth * (1 + slope * below)


def above_zero(worth: Tensor, power: Tensor) -> Tensor:
    """How far a model is above a flux of 0, mag, on the scale of :func:`power_difference` and from its second result ``worth``
    (..., T), for powers (T,) above 0."""
    by_photons, relative = _photons(power)
    root = _root(worth, by_photons)
    of_counts = 2 * worth * root / (root + torch.sqrt(1 - by_photons)).clamp(min=1e-300)
    return MAG_PER_LN * torch.where(power > 0.5, of_counts, worth / relative.clamp(min=1e-300))


def power_at(power: Tensor, ratio: Tensor) -> Tensor:
    """The power (..., T) of a row's error where its flux is ``ratio`` (..., T) times that at which it is ``power``."""
    by_photons, _ = _photons(power)
    there = by_photons * ratio / (1 + by_photons * (ratio - 1))
    return torch.where(power > 0.5, 1 - 0.5 * there, power)


def power_shift(worth: Tensor, power: Tensor, error: Tensor) -> Tensor:
    """By how much the mean of measured fluxes on the scale of :func:`power_difference` lies below the mean flux there, (..., T),
    mag, from that function's second result ``worth`` (..., T) and the quoted errors (T,), mag.

    Measured fluxes scatter about the model's, and the root of photon counts is on average smaller than the root of
    their mean, by 1/8 of a count (Anscombe 1948, Biometrika 35, 246). To second order the share is
    power (1 - power) / 2 s^2, s the relative error at the model's flux; s^2 / (1 + s^2) takes its place where the model is
    fainter than the noise and the series means nothing. Neglects the third order: 0.005 mag for photons alone at a
    signal-to-noise ratio of 3, where the shift is 0.03 mag, 0.012 mag beside as much light of the sky. None for
    a power of 0, under which errors are those of magnitudes.
    """
    relative = error / MAG_PER_LN
    by_photons, _ = _photons(power)
    root = torch.where(power > 0.5, _root(worth, by_photons), worth)
    count = (by_photons * relative) ** 2
    shift = 0.5 * MAG_PER_LN * (power - 1) * relative**2 * root / (root**2 + count)
    return torch.where(power > 0, shift, 0.0)


def _photons(power: Tensor) -> tuple[Tensor, Tensor]:
    """Of powers (T,) above 1/2 the share of photons in the variance of flux, else 1; and powers below it, else 1/2."""
    return 2 * (1 - power.clamp(min=0.5)), power.clamp(max=0.5)


def _root(worth: Tensor, by_photons: Tensor) -> Tensor:
    """Root of the variance of flux at the model over that at the datum, (..., T), from what a magnitude is worth there."""
    square = by_photons**2 * worth**2 + 4 * (1 - by_photons)
    return 0.5 * (by_photons * worth + torch.sqrt(square.clamp(min=1e-300)))
