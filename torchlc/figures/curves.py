"""Recording beside model, residuals below, in as many panels as there are nights, or curves of relative
flux.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from torchlc.figures.style import BEFORE, DATA, MARK, MODEL, PALETTE, plain, style
from torchlc.readers import Recording, iso_times

MOST_PANELS = 24
"""What fits on a page; the first are shown."""
LONGEST_GAP = 5.0
"""A line breaks where the time between rows exceeds this many times their median."""
SHORTEST_BREAK_S = 60.0
"""No line breaks at a shorter gap: it would not be seen."""
UNITS = (("hours", 3600.0, 7200.0), ("minutes", 60.0, 300.0), ("seconds", 1.0, 0.0))
"""Of the time axis: name, length in s, and the shortest stretch it is used for."""
CROWDED = 600
"""Rows in a panel beyond which error bars are drawn faint."""


@dataclass(frozen=True)
class Comparison:
    """A recording with what a model predicts for its rows, (T,), in its unit; ``error`` (T,) of each row.

    ``band`` (2, T) bounds the prediction; ``before`` (T,) is the prediction of a model that lacks
    something, and ``marked`` (T,) tells the rows where that shows, ``outlying`` (T,) those that are probably bad.
    """

    recording: Recording
    prediction: np.ndarray
    error: np.ndarray
    band: np.ndarray | None = None
    before: np.ndarray | None = None
    marked: np.ndarray | None = None
    outlying: np.ndarray | None = None


@dataclass(frozen=True)
class Stretch:
    """Rows drawn in one panel: their index, the time since their first in ``unit``, and a title."""

    rows: np.ndarray
    elapsed: np.ndarray
    unit: str
    title: str


def stretches(recording: Recording) -> list[Stretch]:
    """Rows by night, or by curve where each curve has a gain of its own, in order of time."""
    by_night = recording.kind == "mag"
    key = recording.night if by_night else recording.curve
    ids = recording.night_ids if by_night else recording.curve_ids
    index = [(np.flatnonzero(key == code), ids[code]) for code in dict.fromkeys(key.tolist())]
    seconds = [recording.seconds[rows] - recording.seconds[rows[0]] for rows, _ in index]
    longest = max(float(elapsed[-1]) for elapsed in seconds)
    unit, length = next((name, length) for name, length, least in UNITS if longest >= least)
    return [
        Stretch(rows, elapsed / length, unit, title)
        for (rows, title), elapsed in zip(index, seconds, strict=True)
    ]


def curve_size(recording: Recording) -> tuple[float, float]:
    """Inches of the figure that :func:`draw_curves` fills."""
    panels = min(len(stretches(recording)), MOST_PANELS)
    return (8.2, 4.8) if panels == 1 else (8.2, 0.6 + 2.5 * -(-panels // _columns(panels)))


def draw_curves(shown: Comparison, figure: Figure) -> list[Axes]:
    """A pair of axes for each stretch, at most MOST_PANELS."""
    panels = stretches(shown.recording)[:MOST_PANELS]
    columns = _columns(len(panels))
    with matplotlib.rc_context(style(10 if len(panels) == 1 else 7.5)):
        grid = figure.add_gridspec(-(-len(panels) // columns), columns, hspace=0.42, wspace=0.36)
        axes: list[Axes] = []
        for k in range(len(panels)):
            cell = grid[k // columns, k % columns].subgridspec(2, 1, height_ratios=(3, 1), hspace=0.08)
            axes.append(figure.add_subplot(cell[0]))
            axes.append(figure.add_subplot(cell[1], sharex=axes[-1]))
        draw_on(shown, axes)
    return axes


def draw_on(shown: Comparison, axes: Sequence[Axes]) -> None:
    """Fill given pairs of axes, upper and lower, one pair a stretch."""
    panels = stretches(shown.recording)[: len(axes) // 2]
    for k, stretch in enumerate(panels):
        upper, lower = axes[2 * k], axes[2 * k + 1]
        _draw_rows(shown, stretch, upper, lower)
        _draw_model(shown, stretch, upper, lower)
        _label(shown, stretch, upper, lower, alone=len(panels) == 1, first=k == 0)


def _columns(panels: int) -> int:
    return min(panels, 4 if panels > 4 else 2)


def _draw_rows(shown: Comparison, stretch: Stretch, upper: Axes, lower: Axes) -> None:
    recording, rows, elapsed = shown.recording, stretch.rows, stretch.elapsed
    limit = recording.upper_limit[rows]
    stations = np.unique(recording.station)
    left = (recording.observed - shown.prediction)[rows]
    if shown.before is not None:
        missed = (recording.observed - shown.before)[rows]
        lower.plot(elapsed[~limit], missed[~limit], ".", ms=3, color=BEFORE, zorder=1)
    for station in stations:
        here = (recording.station[rows] == station) & ~limit
        alone = len(stations) == 1
        options = {
            "fmt": "o", "ms": 2.6, "lw": 0, "elinewidth": 0.7, "alpha": 0.75, "zorder": 2, "rasterized": len(rows) > 3000,
            "color": DATA if alone else PALETTE[(int(station) + 3) % len(PALETTE)],
        }  # fmt: skip
        label = "recording" if alone else plain(recording.station_ids[station])
        error = shown.error[rows][here]
        for axes, values in ((upper, recording.observed[rows]), (lower, left)):
            drawn = axes.errorbar(elapsed[here], values[here], error, label=label, **options)
            if len(rows) > CROWDED:
                drawn[2][0].set_alpha(0.15)
    if limit.any():
        upper.plot(
            elapsed[limit], recording.observed[rows][limit], "v", ms=4, color=DATA, label="upper limit"
        )


def _draw_model(shown: Comparison, stretch: Stretch, upper: Axes, lower: Axes) -> None:
    recording, rows, elapsed = shown.recording, stretch.rows, stretch.elapsed
    named = "model" if shown.before is None else "with what it lacked"
    for number, piece in enumerate(_pieces(recording, rows)):
        label = None if number else named
        upper.plot(elapsed[piece], shown.prediction[rows][piece], color=MODEL, lw=1.4, zorder=3, label=label)
        if shown.before is not None:
            label = None if number else "model as given, refitted"
            upper.plot(
                elapsed[piece],
                shown.before[rows][piece],
                color=BEFORE,
                lw=1.4,
                ls="--",
                zorder=2.5,
                label=label,
            )
        if shown.band is not None:
            low, high = shown.band[:, rows[piece]]
            upper.fill_between(elapsed[piece], low, high, color=MODEL, alpha=0.2, lw=0)
    lower.axhline(0.0, color=MODEL, lw=1.0)
    if shown.marked is not None:
        for first, last in _runs(shown.marked[rows]):
            for axes in (upper, lower):
                axes.axvspan(elapsed[first], elapsed[last], color=MARK, alpha=0.22, lw=0, zorder=0)
    if shown.outlying is not None and bool(shown.outlying[rows].any()):
        bad = shown.outlying[rows]
        values = recording.observed[rows][bad]
        for axes, y in ((upper, values), (lower, values - shown.prediction[rows][bad])):
            axes.plot(
                elapsed[bad],
                y,
                "o",
                mfc="none",
                mec=BEFORE,
                ms=8,
                clip_on=False,  # at the edge of the axes half a ring would be lost
                label="outlier" if axes is upper else None,
            )


def _label(
    shown: Comparison, stretch: Stretch, upper: Axes, lower: Axes, *, alone: bool, first: bool
) -> None:
    recording = shown.recording
    unit = "magnitude" if recording.kind == "mag" else "relative flux"
    if recording.kind == "mag":
        observed, predicted = (values[stretch.rows] for values in (recording.observed, shown.prediction))
        visible = np.concatenate([observed, predicted[np.isfinite(predicted)]])
        pad = 0.06 * max(float(np.ptp(visible)), 0.1)
        upper.set_ylim(min(visible.max(), observed.max() + 2.0) + pad, visible.min() - pad)
    if first:
        upper.set_ylabel(unit)
        upper.legend(loc="best" if alone else (0.0, 1.2), ncols=1 if alone else 4, fontsize=8)
        lower.set_ylabel(
            ("obs. − model" if alone else "o − m") + (", mag" if recording.kind == "mag" else "")
        )
    if not alone:
        upper.set_title(plain(stretch.title), fontsize=8)
        lower.yaxis.set_major_locator(MaxNLocator(3))
        upper.yaxis.set_major_locator(MaxNLocator(4))
    start = iso_times(recording)[stretch.rows[0]][:16].replace("T", " ")
    scale = recording.time.scale.upper()
    lower.set_xlabel(f"{stretch.unit} after {start} {scale}" if alone else stretch.unit)
    upper.tick_params(labelbottom=False)
    for axes in (upper, lower):
        axes.grid(visible=True)


def _pieces(recording: Recording, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Places within ``rows`` that a line may join: one curve, no long gap."""
    for code in np.unique(recording.curve[rows]):
        positions = np.flatnonzero(recording.curve[rows] == code)
        step = np.diff(recording.seconds[rows][positions])
        longest = LONGEST_GAP * float(np.median(step)) if len(step) else 0.0
        yield from np.split(positions, np.flatnonzero(step > max(longest, SHORTEST_BREAK_S)) + 1)


def _runs(marked: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last place of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(int), [0]])))
    yield from ((int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True))
