"""Which periods a search has to look at: all of a bracket, or what the light's own period may be a multiple of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from astropy.timeseries import LombScargle

from torchlc.inference.rotation.passes import Rows

TERMS = 2
"""Of the Fourier series: two maxima a turn."""
PEAKS = 4
"""Highest maxima that are looked about."""
MULTIPLES = (1, 2, 3, 4)
"""Maxima of light that a turn may hold: of bodies with up to four like sides."""
WHOLE = 0.7
"""Turns over the longest pass by which the ends of a bracket may differ to be searched whole."""
OVERSAMPLING = 5
"""Frequencies in one over the longest pass: a peak is missed by a tenth of its width at most."""


def power(rows: Rows, frequency: np.ndarray, passes: Sequence[int] | None = None) -> np.ndarray:
    """Share of the variance, over all ``passes``, that two harmonics explain, about a mean and a slope of each pass."""
    explained, total = np.zeros(len(frequency)), 0.0
    for passed in range(rows.passes) if passes is None else passes:
        here = rows.of(passed).numpy()
        if len(here) < 2 * TERMS + 4:
            continue
        seconds = rows.seconds[here].numpy()
        light = -np.log(np.maximum(rows.flux[here].numpy(), 1e-300))
        light = light - np.polyval(np.polyfit(seconds - seconds.mean(), light, 1), seconds - seconds.mean())
        weight = float((light**2).sum())
        search = LombScargle(seconds, light, nterms=TERMS)
        explained += weight * np.asarray(
            search.power(frequency, method="fastchi2" if len(frequency) > 500 else "chi2")
        )
        total += weight
    return explained / max(total, 1e-300)


def windows(rows: Rows, low: float, high: float) -> tuple[list[tuple[float, float]], np.ndarray, np.ndarray]:
    """Ranges of the frequency of turns (1/s) between ``low`` and ``high`` to search, and the periodogram of the light,
    frequencies and powers."""
    longest = float(rows.span.max())
    count = max(200, int(OVERSAMPLING * longest * (4 * high - low / 2)))
    frequency = np.linspace(low / 2 if low > 0 else 0.5 / longest, 4 * high, min(count, 200_000))
    strength = power(rows, frequency)
    if (high - low) * longest < WHOLE:
        return [(low, high)], frequency, strength
    peaks = _peaks(frequency, strength, longest)
    # what may have changed by more than a step since the longest pass is looked for in each of them
    apart = [number for number in range(rows.passes) if float(rows.drift[number]) * high * longest > WHOLE]
    for passed in [rows.longest, *apart] if apart else []:
        alone = _peaks(frequency, power(rows, frequency, [passed]), longest)
        peaks += [peak for peak in alone if all(abs(peak - other) > 1.5 / longest for other in peaks)]
    reach = WHOLE / longest
    ranges: list[tuple[float, float]] = []
    for peak in peaks:
        for multiple in MULTIPLES:
            middle = peak / multiple
            first, last = max(low, middle - reach / 2), min(high, middle + reach / 2)
            if first < last and all(abs(middle - (a + b) / 2) > reach / 2 for a, b in ranges):
                ranges.append((first, last))
    return ranges or [(low, high)], frequency, strength


def _peaks(frequency: np.ndarray, strength: np.ndarray, longest: float) -> list[float]:
    """Frequencies of the highest maxima, highest first."""
    inner = np.flatnonzero((strength[1:-1] >= strength[:-2]) & (strength[1:-1] > strength[2:])) + 1
    peaks: list[float] = []
    for index in inner[np.argsort(-strength[inner])]:
        if all(abs(frequency[index] - other) > 1.5 / longest for other in peaks):
            peaks.append(float(frequency[index]))
        if len(peaks) == PEAKS:
            break
    return peaks
