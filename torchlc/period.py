"""An unknown spin from a recording alone: Lomb-Scargle, candidates, and the aliases each could be instead.

The period is apparent: the Sun and the observer move, so that a body's sidereal period differs by about one
turn in the time in which the bisector turns once. A body with two like sides shows two maxima a turn: its
period is twice what the periodogram prefers.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from torchlc.errors import InputError
from torchlc.likelihood import MAG_PER_LN
from torchlc.recording import Recording

if TYPE_CHECKING:
    from astropy.table import Table
    from astropy.timeseries import LombScargle
    from matplotlib.axes import Axes

SCHEMA = "torchlc-period/1"
OVERSAMPLING = 4
MOST_FREQUENCIES = 2_000_000
LEAST_TURNS = 2.0
"""Turns that the longest uninterrupted run must hold, unless the search is asked for more."""
RUN_GAP_H = 6.0
MOST_CANDIDATES = 5
MOST_GROUPS, MOST_PEAKS = 15, 8
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
DAY_S = 86400.0
MIN_ROWS = 8
SAME = 0.01
"""Peaks nearer than this in relative frequency differ in the number of turns between runs, and are aliases
of the higher.
"""
MOST_COUNTS = 3


@dataclass(frozen=True)
class Alias:
    """Another period that explains the recording about as well: ``power`` there, and how the two are
    related.
    """

    period_s: float
    power: float
    relation: str


@dataclass(frozen=True)
class Candidate:
    """A peak of the periodogram: the period with its formal error, s; ``power`` the share of the variance
    that a sinusoid explains; the false-alarm probability of the highest peak of noise; half of the range of
    the sinusoid.
    """

    period_s: float
    period_sd_s: float
    power: float
    false_alarm_probability: float
    amplitude: float
    aliases: Sequence[Alias] = field(default_factory=tuple)


@dataclass(frozen=True)
class Periodogram:
    """The search: candidates best first, with the range of periods (s) that was looked at."""

    candidates: Sequence[Candidate]
    rows: int
    span_s: float
    searched_s: tuple[float, float]
    unit: str
    warnings: Sequence[str]

    def to_table(self) -> Table:
        """One row a candidate, best first: period_s, period_sd_s, power, false_alarm_probability, amplitude."""
        from astropy.table import Table

        names = ("period_s", "period_sd_s", "power", "false_alarm_probability", "amplitude")
        return Table({name: [getattr(one, name) for one in self.candidates] for name in names})

    def plot(self, recording: Recording, axes: Axes | None = None) -> Axes:
        """``recording`` folded with the best period, brighter up."""
        if axes is None:
            import matplotlib.pyplot as plt

            axes = plt.subplots()[1]
        best = self.candidates[0].period_s
        phase, values = phase_curve(recording, best)
        axes.plot(phase, values, ".")
        axes.set(xlabel=f"phase of {spoken(best)}", ylabel="mag about the mean of its curve")
        axes.invert_yaxis()
        return axes

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"

    def to_json(self) -> dict[str, Any]:
        from torchlc.output import without_nan

        told = [vars(one) | {"aliases": [vars(alias) for alias in one.aliases]} for one in self.candidates]
        return without_nan(
            {
                "schema": SCHEMA,
                "rows": self.rows,
                "span_s": self.span_s,
                "searched_s": list(self.searched_s),
                "amplitude_unit": self.unit,
                "candidates": told,
                "warnings": list(self.warnings),
            }
        )

    def __repr__(self) -> str:
        low, high = (spoken(seconds) for seconds in self.searched_s)
        lines = [f"Periodogram: {self.rows} rows over {spoken(self.span_s)}, periods from {low} to {high}"]
        for one in self.candidates:
            size = f"amplitude {one.amplitude:.3g} {self.unit}".rstrip()
            lines.append(
                f"  {spoken(one.period_s)} ({one.period_s:.6g} ± {one.period_sd_s:.2g} s): {size}, "
                f"power {one.power:.3f}, false alarm {one.false_alarm_probability:.1g}"
            )
            lines += [
                f"      or {spoken(a.period_s)}, {a.relation} (power {a.power:.3f})" for a in one.aliases
            ]
        return "\n".join([*lines, *(f"  ! {text}" for text in self.warnings)])


def find_period(
    recording: Recording, *, shortest_s: float | None = None, longest_s: float | None = None
) -> Periodogram:
    """Candidate periods of a recording, each curve taken about its own mean.

    The search goes from twice the median cadence to half of the longest uninterrupted run unless told
    otherwise.
    """
    rows = np.flatnonzero(~recording.upper_limit)
    if len(rows) < MIN_ROWS:
        raise InputError(
            recording.source, None, f"{len(rows)} measured rows", f"at least {MIN_ROWS} to find a period"
        )
    seconds = recording.seconds[rows]
    span = float(np.ptp(seconds))
    if span <= 0:
        raise InputError(recording.source, "column time", "all rows at one time", "a stretch of time")
    low, high, warnings = _search_range(recording, seconds, span, shortest_s, longest_s)
    search, unit = _periodogram(recording, rows)
    count = max(100, math.ceil(OVERSAMPLING * span * (high - low)))
    if count > MOST_FREQUENCIES:
        high = low + MOST_FREQUENCIES / (OVERSAMPLING * span)
        count = MOST_FREQUENCIES
        warnings.append(
            f"the recording is long: periods below {spoken(1 / high)} were left out; --shortest looks further"
        )
    frequency = np.linspace(low, high, count)
    power = np.asarray(search.power(frequency, method="fast" if count > 2000 else "auto"))
    several_nights = len(recording.night_ids) > 1
    found: list[Candidate] = []
    taken: list[float] = []
    for group in _groups(search, frequency, power, span):
        peak, counts = group[0], group[1 : 1 + MOST_COUNTS]
        if any(abs(peak / other - 1) < SAME or abs(peak - other) < 1 / span for other in taken):
            continue
        candidate, related = _candidate(search, peak, counts, low, high, span, several_nights)
        taken += [peak, *related]
        found.append(candidate)
        if len(found) == MOST_CANDIDATES:
            break
    found.sort(key=lambda one: -one.power)
    return Periodogram(found, len(rows), span, (1 / high, 1 / low), unit, warnings)


def spoken(seconds: float) -> str:
    """A length of time in the unit a person would take."""
    for name, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.6g} {name}"
    return f"{seconds:.6g} s"


def _search_range(
    recording: Recording, seconds: np.ndarray, span: float, shortest: float | None, longest: float | None
) -> tuple[float, float, list[str]]:
    """Lowest and highest frequency, 1/s."""
    for name, value in (("--shortest", shortest), ("--longest", longest)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(None, name, f"{value:g} s", "a number > 0")
    runs = np.split(seconds, np.flatnonzero(np.diff(seconds) > RUN_GAP_H * 3600) + 1)
    longest_run = max(float(np.ptp(run)) for run in runs) or span
    steps = np.diff(np.unique(seconds))
    low = 1 / longest if longest is not None else LEAST_TURNS / longest_run
    high = 1 / shortest if shortest is not None else 0.5 / float(np.median(steps))
    if not low < high:
        raise InputError(
            recording.source,
            "--shortest, --longest",
            f"periods from {1 / high:.4g} to {1 / low:.4g} s",
            "a range of periods",
        )
    warnings = []
    if recording.exptime is not None and (smeared := float(np.median(recording.exptime))) > 0.5 / high:
        warnings.append(f"exposures of {smeared:.3g} s wash out periods below about {spoken(2 * smeared)}")
    return low, high, warnings


def _periodogram(recording: Recording, rows: np.ndarray) -> tuple[LombScargle, str]:
    """Lomb-Scargle on magnitudes, or flux over its curve's mean, each curve about its own mean."""
    from astropy.timeseries import LombScargle

    values = recording.observed[rows].copy()
    error = None if recording.error is None else recording.error[rows].copy()
    curve = recording.curve[rows]
    for one in np.unique(curve):
        here = curve == one
        mean = float(values[here].mean())
        if recording.kind == "flux":
            scale = abs(mean) or 1.0
            values[here] = (values[here] - mean) / scale
            if error is not None:
                error[here] /= scale
        else:
            values[here] -= mean
    return LombScargle(recording.seconds[rows], values, error), "mag" if recording.kind == "mag" else ""


def _groups(search: LombScargle, frequency: np.ndarray, power: np.ndarray, span: float) -> list[list[float]]:
    """The highest local maxima, 1/s, refined; those within SAME of a higher one go with it; highest first,
    also within.
    """
    inside = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    ends = [i for i, j in ((0, 1), (len(power) - 1, len(power) - 2)) if power[i] > power[j]]
    maxima = np.concatenate([inside, np.array(ends, dtype=int)]).astype(int)
    groups: list[list[float]] = []
    for peak in frequency[maxima[np.argsort(-power[maxima])]].tolist():
        near = (one for one in groups if abs(peak / one[0] - 1) < SAME or abs(peak - one[0]) < 1 / span)
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
            one for i, one in enumerate(refined) if all(abs(one - two) > 0.5 / span for two in refined[:i])
        ]
        return sorted(distinct, key=lambda one: -float(search.power(one, method="cython")))

    groups = [by_power(one) for one in groups]
    return sorted(groups, key=lambda one: -float(search.power(one[0], method="cython")))


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
        aliases=[Alias(1 / other, one, text) for (text, other), one in zip(kept, powers, strict=True)],
    )
    return made, [other for _, other in kept]


def phase_curve(recording: Recording, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Phase in [0, 1) and the values about each curve's mean, (T,) each, sorted by phase."""
    search, _ = _periodogram(recording, np.arange(len(recording)))
    phase = (recording.seconds / period_s) % 1.0
    order = np.argsort(phase)
    values = np.asarray(search.y)
    return phase[order], (
        values if recording.kind == "mag" else -MAG_PER_LN * np.log1p(np.maximum(values, -0.99))
    )[order]
