"""Candidate periods with what each could be instead, as a search finds them: words, a table, JSON, a folded plot."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from torchlc.digits import number_of
from torchlc.inference.slow_changes import phase_curve
from torchlc.readers import Recording
from torchlc.readers.stations import NO_STATION

if TYPE_CHECKING:
    from astropy.table import Table
    from matplotlib.axes import Axes

SCHEMA = "torchlc-period/1"
MOST_TRENDS = 4
"""Curves whose trends are told one by one."""


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
    the sinusoid; ``sidereal_within_s`` bounds how far the sidereal period is from this synodic one if the light repeats once a turn
    (m times that for m like sides), None where the recording has no vectors.
    """

    period_s: float
    period_sd_s: float
    power: float
    false_alarm_probability: float
    amplitude: float
    aliases: Sequence[Alias] = field(default_factory=tuple)
    sidereal_within_s: float | None = None


@dataclass(frozen=True)
class Periodogram:
    """The search: candidates best first, with the range of periods (s) that was looked at; ``sampling_s`` is the median
    step between rows, ``trend_per_hour`` the slope in time that was taken off, by curve, in ``unit``."""

    candidates: Sequence[Candidate]
    rows: int
    span_s: float
    searched_s: tuple[float, float]
    unit: str
    warnings: Sequence[str]
    sampling_s: float = math.nan
    trend_per_hour: Mapping[str, float] = field(default_factory=dict)
    measured: str = "synodic"

    def to_table(self) -> Table:
        """One row a candidate, best first: period_s, period_sd_s, power, false_alarm_probability, amplitude."""
        from astropy.table import Table

        names = ("period_s", "period_sd_s", "power", "false_alarm_probability", "amplitude")
        return Table({name: [getattr(candidate, name) for candidate in self.candidates] for name in names})

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
        from torchlc.files.writing import without_nan

        candidates = [
            vars(candidate) | {"aliases": [vars(alias) for alias in candidate.aliases]}
            for candidate in self.candidates
        ]
        return without_nan(
            {
                "schema": SCHEMA,
                "rows": self.rows,
                "span_s": self.span_s,
                "searched_s": list(self.searched_s),
                "amplitude_unit": self.unit,
                "measured": self.measured,
                "sampling_s": self.sampling_s,
                "trend_per_hour": dict(self.trend_per_hour),
                "candidates": candidates,
                "notes": self.notes(),
                "warnings": list(self.warnings),
            }
        )

    def __repr__(self) -> str:
        low, high = (spoken(seconds) for seconds in self.searched_s)
        lines = [
            f"Periodogram: {number_of(self.rows, 'row')} over {spoken(self.span_s)}, periods from {low} to {high}"
        ]
        for candidate in self.candidates:
            size = f"amplitude {candidate.amplitude:.3g} {self.unit}".rstrip()
            lines.append(
                f"  {spoken(candidate.period_s)} ({candidate.period_s:.6g} ± {candidate.period_sd_s:.2g} s): {size}, "
                f"power {candidate.power:.3f}, false alarm {candidate.false_alarm_probability:.1g}"
            )
            lines += [
                f"      or {spoken(a.period_s)}, {a.relation} (power {a.power:.3f})"
                for a in candidate.aliases
            ]
        return "\n".join(
            [*lines, *(f"  {text}" for text in self.notes()), *(f"  ! {text}" for text in self.warnings)]
        )

    def notes(self) -> list[str]:
        """What was measured, and what was taken off before."""
        known = [
            candidate.sidereal_within_s
            for candidate in self.candidates[:1]
            if candidate.sidereal_within_s is not None
        ]
        sentences = [
            "periods are synodic, as the light shows them; the sidereal period of the first differs by at most "
            f"{known[0]:.2g} s if it is a whole turn (the bisector of Sun and observer turned; m times that for m like sides)"
            if known
            else "periods are synodic, as the light shows them; without vectors of Sun and observer in the recording the "
            "difference to the sidereal period is not known"
        ]
        if self.candidates:
            period = self.candidates[0].period_s
            sentences.append(
                f"light alone does not tell a period from a part of a turn: a body with two like sides turns once in {spoken(2 * period)}, "
                "not in half of that"
            )
        return [*sentences, f"taken off before: {self._trends()}"]

    def _trends(self) -> str:
        """The slopes, each with its curve where there are several; a station that nobody named is none of a curve's name."""
        slopes = [f"{slope:+.3g} {self.unit}/h" for slope in self.trend_per_hour.values()]
        if len(slopes) == 1:
            return f"a trend of {slopes[0]}"
        curves = [curve.removeprefix(f"{NO_STATION} ") for curve in self.trend_per_hour]
        named = [f"{slope} ({curve})" for slope, curve in zip(slopes, curves, strict=True)]
        more = f" and {len(named) - MOST_TRENDS} more" if len(named) > MOST_TRENDS else ""
        return f"trends of {', '.join(named[:MOST_TRENDS])}{more}"


def spoken(seconds: float) -> str:
    """A length of time in the unit a person would take."""
    for name, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.6g} {name}"
    return f"{seconds:.6g} s"
