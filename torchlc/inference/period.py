"""An unknown spin from a recording alone: Lomb-Scargle, candidates, and the aliases each could be instead.

What changes slowly is taken off first: the range (and the Sun's distance) where the recording holds vectors, and a trend
in time, phase angle and airmass, fitted together with two harmonics of the best period so that neither biases the other.

The period is synodic: it is that of the light, whose pattern follows the bisector of Sun and observer. The sidereal period
differs by up to one turn in the time in which the bisector turns once, and by that if it turns about the body's pole. A body with two
like sides shows two maxima a turn: its period is twice what the periodogram prefers, and the notes say so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from torchlc.digits import number_of
from torchlc.errors import InputError, option
from torchlc.geometry.orbit.earth import DAY_S
from torchlc.inference.periodogram import Alias, Candidate, Periodogram, spoken
from torchlc.inference.slow_changes import MIN_ROWS, Detrended
from torchlc.readers import Recording

if TYPE_CHECKING:
    from astropy.timeseries import LombScargle

OVERSAMPLING = 4
"""Frequencies in 1/span: a peak is 1/span wide, and missed by 1/8 of it at most, where 5 % of its power are gone."""
MOST_FREQUENCIES = 2_000_000
"""Twice 9 s of the fast method."""
FEW_FREQUENCIES, BLOCK = 2000, 100_000
"""Up to which astropy chooses the method; and of a block, 90 MB of its fast one."""
FEW_ROWS = 120
"""Sums took 37 ns a row and frequency, astropy's fast method 4.5 us a frequency."""
LEAST_TURNS = 2.0
"""Turns that the longest uninterrupted run must hold, unless the search is asked for more."""
RUN_GAP_H = 6.0
"""Between two nights there are more hours, within one there are fewer."""
MOST_CANDIDATES = 5
"""That a person looks through; what is no candidate is an alias of one, or weaker."""
MOST_GROUPS, MOST_PEAKS = 15, 8
"""Peaks that are refined, and those beside each that may be other counts of turns."""
HARMONICS = (("double", 0.5), ("half", 2.0), ("three times", 1 / 3), ("four times", 0.25))
"""What a period could be instead, and the factor on its frequency: bodies with two, three or four like
sides.
"""
DAILY = (
    (1, "one turn a day more"),
    (-1, "one turn a day fewer"),
    (2, "two turns a day more"),
    (-2, "two turns a day fewer"),
)
EQUAL = 0.8
"""Share of a peak's power from which a frequency beyond Nyquist is listed: uneven steps tell it apart below."""
SAME = 0.01
"""Peaks nearer than this in relative frequency differ in the number of turns between runs, and are aliases
of the higher.
"""
MOST_COUNTS = 3


def find_period(
    recording: Recording, *, shortest_s: float | None = None, longest_s: float | None = None
) -> Periodogram:
    """Candidate periods of a recording, each curve taken about its own trend.

    The search goes from twice the median cadence to half of the longest uninterrupted run unless told
    otherwise.
    """
    recording.check_measured()
    rows = np.flatnonzero(~recording.upper_limit)
    if len(rows) < MIN_ROWS:
        raise InputError(
            recording.source,
            None,
            number_of(len(rows), "measured row"),
            f"at least {MIN_ROWS} to find a period",
        )
    seconds = recording.seconds[rows]
    span = float(np.ptp(seconds))
    if span <= 0:
        raise InputError(recording.source, "column time", "all rows at one time", "a stretch of time")
    low, high, warnings = _search_range(recording, seconds, span, shortest_s, longest_s)
    about = Detrended(recording, rows)
    search, unit = about.search(None), about.unit
    highest = low + MOST_FREQUENCIES / (OVERSAMPLING * span)
    if high > highest:
        high = highest
        warnings.append(
            f"periods below {spoken(1 / high)} were left out: {MOST_FREQUENCIES:,} frequencies are the most that are tried. "
            f"Give the period's range with {option('shortest')} and {option('longest')}, or a shorter stretch of the recording"
        )
    frequency = np.linspace(low, high, max(100, math.ceil(OVERSAMPLING * span * (high - low))))
    power = _powers(search, frequency)
    search = about.search(float(frequency[np.argmax(power)]))
    power = _powers(search, frequency)
    sampling = float(np.median(np.diff(np.unique(seconds))))
    turned = _bisector_turns(recording, rows)
    candidates = [
        candidate
        if turned is None
        else replace(candidate, sidereal_within_s=turned / span * candidate.period_s**2)
        for candidate in _candidates(search, frequency, power, sampling, span, len(recording.night_ids) > 1)
    ]
    fast = [
        alias
        for candidate in candidates[:1]
        for alias in candidate.aliases
        if alias.relation.startswith("beyond")
    ]
    if fast:
        periods = ", ".join(spoken(alias.period_s) for alias in fast)
        warnings.append(
            f"rows are {spoken(sampling)} apart: turns faster than one in {spoken(2 * sampling)} look like slower ones, "
            f"and {periods} would explain the best candidate as well"
        )
    searched = (1 / high, 1 / low)
    return Periodogram(candidates, len(rows), span, searched, unit, warnings, sampling, about.trend_per_hour)


def _candidates(
    search: LombScargle,
    frequency: np.ndarray,
    power: np.ndarray,
    sampling: float,
    span: float,
    several_nights: bool,
) -> list[Candidate]:
    """Peaks of the ``power`` at an even grid of frequencies (N,), highest first, but for those that are aliases of a higher one."""
    low, high = float(frequency[0]), float(frequency[-1])
    candidates: list[Candidate] = []
    taken: list[float] = []
    for group in _groups(search, frequency, power, span):
        peak, counts = group[0], group[1 : 1 + MOST_COUNTS]
        if any(abs(peak / other - 1) < SAME or abs(peak - other) < 1 / span for other in taken):
            continue
        candidate, related = _candidate(search, peak, counts, low, high, span, several_nights)
        if not candidate.amplitude <= np.ptp(search.y):
            continue  # rows at two phases of it only: at twice the step no sinusoid is told from its shift
        taken += [peak, *related]
        beyond = _beyond_nyquist(search, peak, candidate.power, sampling, span, high)
        candidates.append(replace(candidate, aliases=(*candidate.aliases, *beyond)))
        if len(candidates) == MOST_CANDIDATES:
            break
    return sorted(candidates, key=lambda item: -item.power)


def _powers(search: LombScargle, frequency: np.ndarray) -> np.ndarray:
    """The periodogram at an even grid of frequencies (N,), in blocks: astropy's fast method takes 0.9 kB a frequency, and
    for few rows more time than the sums themselves."""
    few = len(frequency) <= FEW_FREQUENCIES
    rows = len(np.atleast_1d(np.asarray(search.t)))
    method = "auto" if few else "fast" if rows > FEW_ROWS else "cython"
    blocks = np.array_split(frequency, -(-len(frequency) // BLOCK))
    return np.concatenate([np.asarray(search.power(block, method=method)) for block in blocks])


def _beyond_nyquist(
    search: LombScargle, frequency: float, power: float, sampling: float, span: float, high: float
) -> list[Alias]:
    """Frequencies that rows ``sampling`` seconds apart cannot tell from this one, and do not: k/sampling +- f for the
    first two k, where the power is at least EQUAL of the peak's."""
    aliases = []
    for k in (1, 2):
        for other in (k / sampling - frequency, k / sampling + frequency):
            if other <= high:
                continue
            refined = _refined(search, other, 1 / (OVERSAMPLING * span))
            reached = float(search.power(refined, method="cython"))
            if reached > EQUAL * power:
                relation = f"beyond Nyquist: {number_of(k, 'turn')} more or fewer between rows {sampling:.4g} s apart"
                aliases.append(Alias(1 / refined, reached, relation))
    return aliases


def _bisector_turns(recording: Recording, rows: np.ndarray) -> float | None:
    """Turns that the bisector of Sun and observer made in inertial space from the first row to the last, along its way;
    None without vectors."""
    if recording.sun is None or recording.obs is None:
        return None
    order = rows[np.argsort(recording.seconds[rows], kind="stable")]
    bisector = sum(
        vectors[order] / np.linalg.norm(vectors[order], axis=1)[:, None]
        for vectors in (recording.sun, recording.obs)
    )
    length = np.linalg.norm(bisector, axis=1)
    if not (length > 1e-9).all():
        return None
    unit = bisector / length[:, None]
    apart = np.linalg.norm(np.diff(unit, axis=0), axis=1)
    return float((2 * np.arcsin(np.minimum(apart / 2, 1.0))).sum()) / (2 * math.pi)


def _search_range(
    recording: Recording, seconds: np.ndarray, span: float, shortest: float | None, longest: float | None
) -> tuple[float, float, list[str]]:
    """Lowest and highest frequency, 1/s."""
    for name, value in (("shortest", shortest), ("longest", longest)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(None, option(name), f"{value:g} s", "a number > 0")
    runs = np.split(seconds, np.flatnonzero(np.diff(seconds) > RUN_GAP_H * 3600) + 1)
    longest_run = max(float(np.ptp(run)) for run in runs) or span
    steps = np.diff(np.unique(seconds))
    low = 1 / longest if longest is not None else LEAST_TURNS / longest_run
    high = 1 / shortest if shortest is not None else 0.5 / float(np.median(steps))
    if not low < high:
        raise InputError(
            recording.source,
            f"{option('shortest')}, {option('longest')}",
            f"periods from {1 / high:.4g} to {1 / low:.4g} s",
            "a range of periods",
        )
    warnings = []
    if recording.exptime is not None and (smeared := float(np.median(recording.exptime))) > 0.5 / high:
        warnings.append(f"exposures of {smeared:.3g} s wash out periods below about {spoken(2 * smeared)}")
    return low, high, warnings


def _groups(search: LombScargle, frequency: np.ndarray, power: np.ndarray, span: float) -> list[list[float]]:
    """The highest local maxima, 1/s, refined; those within SAME of a higher one go with it; highest first,
    also within.
    """
    inside = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    ends = [i for i, j in ((0, 1), (len(power) - 1, len(power) - 2)) if power[i] > power[j]]
    maxima = np.concatenate([inside, np.array(ends, dtype=int)]).astype(int)
    groups: list[list[float]] = []
    for peak in frequency[maxima[np.argsort(-power[maxima])]].tolist():
        near = (
            group for group in groups if abs(peak / group[0] - 1) < SAME or abs(peak - group[0]) < 1 / span
        )
        home = next(near, None)
        if home is None and len(groups) < MOST_GROUPS:
            groups.append([peak])
        elif home is not None and len(home) < MOST_PEAKS:
            home.append(peak)
        elif home is None:
            break
    step = 1 / (OVERSAMPLING * span)

    def by_power(peaks: list[float]) -> list[float]:
        refined = [_refined(search, peak, step) for peak in peaks]
        distinct = [
            value
            for i, value in enumerate(refined)
            if all(abs(value - other) > 0.5 / span for other in refined[:i])
        ]
        return sorted(distinct, key=lambda value: -float(search.power(value, method="cython")))

    groups = [by_power(group) for group in groups]
    return sorted(groups, key=lambda group: -float(search.power(group[0], method="cython")))


def _refined(search: LombScargle, frequency: float, step: float) -> float:
    """The maximum near a grid point, to a thousandth of a step."""
    for _ in range(3):
        trial = frequency + step * np.linspace(-1, 1, 21)
        trial = trial[trial > 0]
        frequency = float(trial[np.argmax(np.asarray(search.power(trial, method="cython")))])
        step /= 10
    return frequency


def _candidate(
    search: LombScargle,
    frequency: float,
    counts: Sequence[float],
    low: float,
    high: float,
    span: float,
    several_nights: bool,
) -> tuple[Candidate, list[float]]:
    """A candidate with its aliases, and the frequencies these stand for."""
    power = float(search.power(frequency, method="cython"))
    _, sine, cosine = search.model_parameters(frequency)
    amplitude = math.hypot(sine, cosine)
    left = np.asarray(search.y) - np.asarray(search.model(search.t, frequency))
    sd = math.sqrt(6 / len(left)) * float(left.std()) / (math.pi * span * max(amplitude, 1e-300))
    related = [(f"{name} the period", frequency * factor) for name, factor in HARMONICS]
    related += [("another number of turns between runs", other) for other in counts]
    if several_nights:
        shifted = ((text, abs(frequency + turns / DAY_S)) for turns, text in DAILY)
        related += [
            (text, _refined(search, other, 1 / (OVERSAMPLING * span)))
            for text, other in shifted
            if other > low / 4
        ]
    kept = [(text, other) for text, other in related if low / 5 <= other <= 4 * high]
    powers = [float(search.power(other, method="cython")) for _, other in kept]
    chance = float(
        search.false_alarm_probability(power, method="baluev", minimum_frequency=low, maximum_frequency=high)
    )
    made = Candidate(
        period_s=1 / frequency,
        period_sd_s=sd / frequency**2,
        power=power,
        false_alarm_probability=min(max(chance, 0.0), 1.0),
        amplitude=amplitude,
        aliases=[
            Alias(1 / other, alias_power, text)
            for (text, other), alias_power in zip(kept, powers, strict=True)
        ],
    )
    return made, [other for _, other in kept]
