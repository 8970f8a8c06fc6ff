"""How the quoted errors of magnitudes follow the measured flux, and the scale on which noise is then normal.

An error worked out from the measured flux, 1.0857 sigma / F, is small where noise has made a row bright, and large
where it has made it faint. Taken as the error of a magnitude it favours the bright rows: by 1.5 (sigma / F)^2 of the
flux, 0.015 mag at a signal-to-noise ratio of 10 and 0.16 mag at 3. If errors go as F^-beta, their size on the scale
F^beta does not depend on the noise (Box & Cox 1964, J. R. Stat. Soc. B 26, 211): beta is 1 for noise of the sky or
the detector, which is normal in flux, 1/2 for photons, and 0 for an error that is a share of the light, which is
normal in magnitudes.

Letters: T rows, C curves.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import stdtrit

MAG_PER_LN = 2.5 / math.log(10)
LEAST_STEPS = 3
"""Steps between rows from which a power is worked out: one or two agree with a line too easily."""
CHANCE = 1e-4
"""Probability, by Student's t, below which a relation of errors to light is not taken for chance."""
LEAST_SHIFT_MAG = 1e-3
"""Magnitudes are kept where they are biased by less, a tenth of what absolute photometry reaches: at a
signal-to-noise ratio above some 40."""


def error_powers(
    flux: np.ndarray, error_mag: np.ndarray, curve: np.ndarray, measured: np.ndarray
) -> np.ndarray:
    """The power beta of each row's curve, (T,), 0 to 1, from measured flux, errors in mag and curve (T,) of rows
    in order of time; ``measured`` (T,) is false for upper limits.

    It is minus the slope of ln error against ln flux over the steps between neighbouring rows, in which noise
    outweighs the object's own changes where the signal is weak; rows count by the square of their relative error.
    Curves of fewer than five rows share a power. Errors that come from something else than the measured flux give 0.
    """
    powers = np.zeros(len(flux))
    rows = [np.flatnonzero((curve == one) & measured) for one in np.unique(curve)]
    few = [index for index in rows if len(index) <= LEAST_STEPS + 1]
    for curves in [*([index] for index in rows if len(index) > LEAST_STEPS + 1), few]:
        power = _power(curves, flux, error_mag)
        for index in curves:
            powers[np.isin(curve, curve[index])] = power
    return powers


def _power(curves: list[np.ndarray], flux: np.ndarray, error_mag: np.ndarray) -> float:
    """One power for rows of several curves, an array of indices each."""
    first = np.concatenate([np.empty(0, dtype=int), *(index[:-1] for index in curves)])
    second = np.concatenate([np.empty(0, dtype=int), *(index[1:] for index in curves)])
    if len(first) < LEAST_STEPS:
        return 0.0
    step = np.log(flux[second] / flux[first])
    change = np.log(error_mag[second] / error_mag[first])
    square = np.minimum(error_mag / MAG_PER_LN, 1.0) ** 2
    weight = square[first] + square[second]
    spread = float((weight * step**2).sum())
    if spread == 0:
        return 0.0
    slope = -float((weight * step * change).sum()) / spread
    freedom = len(first) - 1
    error = math.sqrt(float((weight * (change + slope * step) ** 2).sum()) / freedom / spread)
    power = min(max(slope, 0.0), 1.0)
    shift = 1.5 * MAG_PER_LN * power * float(square[np.concatenate(curves)].mean())
    sure = slope > float(stdtrit(freedom, 1 - CHANCE)) * error
    return power if sure and shift > LEAST_SHIFT_MAG else 0.0
