"""The figures of a fit, in matplotlib: each takes a result and draws; none computes physics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchlc.recording import Recording
from torchlc.simulated import SimulatedCurve, iso_times
from torchlc.style import DATA, MODEL, PALETTE, component_colour, plain, style

if TYPE_CHECKING:
    from torchlc.results import FitResult

MOST_PANELS = 24
MOST_CORNER = 10
LONGEST_GAP = 5.0
"""A line breaks where the time between rows exceeds this many times their median."""


@dataclass(frozen=True)
class Stretch:
    """Rows drawn in one panel: their index, hours since their first, and a title."""

    rows: np.ndarray
    hours: np.ndarray
    title: str


def stretches(recording: Recording) -> list[Stretch]:
    """Rows by night, or by curve where each curve has a gain of its own, in order of time."""
    key, ids = (
        (recording.night, recording.night_ids)
        if recording.kind == "mag"
        else (recording.curve, recording.curve_ids)
    )
    found = []
    for one in dict.fromkeys(key.tolist()):
        rows = np.flatnonzero(key == one)
        found.append(Stretch(rows, (recording.seconds[rows] - recording.seconds[rows[0]]) / 3600, ids[one]))
    return found


def curve(
    result: FitResult, axes: Sequence[Axes] | None = None, figure: Figure | None = None
) -> Sequence[Axes]:
    """Recording and model with its 90 % band, residuals below: a pair of axes for each night, or curve of
    relative flux.
    """
    panels = stretches(result.recording)[:MOST_PANELS]
    with matplotlib.rc_context(style()):
        if axes is None:
            columns = _columns(len(panels))
            bands = -(-len(panels) // columns)
            figure = figure if figure is not None else _figure(curve_size(len(panels)))
            grid = figure.add_gridspec(bands, columns, hspace=0.45, wspace=0.3)
            made: list[Axes] = []
            for k in range(len(panels)):
                cell = grid[k // columns, k % columns].subgridspec(2, 1, height_ratios=(3, 1), hspace=0.08)
                made.append(figure.add_subplot(cell[0]))
                made.append(figure.add_subplot(cell[1], sharex=made[-1]))
            axes = made
        for k, stretch in enumerate(panels):
            _curve_panel(result, stretch, axes[2 * k], axes[2 * k + 1], titled=len(panels) > 1, first=k == 0)
    return axes


def curve_size(panels: int) -> tuple[float, float]:
    """Inches of the light curve's figure."""
    return (8.2, 4.8) if panels == 1 else (8.2, 0.6 + 2.5 * -(-panels // _columns(panels)))


def _columns(panels: int) -> int:
    return min(panels, 4 if panels > 4 else 2)


def _curve_panel(
    result: FitResult, stretch: Stretch, upper: Axes, lower: Axes, *, titled: bool, first: bool
) -> None:
    recording, rows, hours = result.recording, stretch.rows, stretch.hours
    error = result.error[rows]
    observed, predicted = recording.observed[rows], result.prediction[rows]
    limit = recording.upper_limit[rows]
    stations = np.unique(recording.station)
    for station in stations:
        here = (recording.station[rows] == station) & ~limit
        colour = DATA if len(stations) == 1 else PALETTE[(int(station) + 3) % len(PALETTE)]
        label = "recording" if len(stations) == 1 else plain(recording.station_ids[station])
        for ax, values in ((upper, observed), (lower, result.delta[rows])):
            ax.errorbar(
                hours[here], values[here], error[here], fmt="o", ms=2.6, lw=0, elinewidth=0.7, color=colour,
                alpha=0.75, label=label if ax is upper else None, zorder=2, rasterized=len(rows) > 3000,
            )  # fmt: skip
    if limit.any():
        upper.plot(hours[limit], observed[limit], "v", ms=4, color=DATA, label="upper limit")
    band = result.band
    for piece in _pieces(recording, rows):
        upper.plot(
            hours[piece],
            predicted[piece],
            color=MODEL,
            lw=1.4,
            zorder=3,
            label="model" if piece[0] == 0 else None,
        )
        if band is not None:
            upper.fill_between(
                hours[piece], band[0, rows][piece], band[2, rows][piece], color=MODEL, alpha=0.2, lw=0
            )
    lower.axhline(0.0, color=MODEL, lw=1.0)
    if recording.kind == "mag":
        visible = np.concatenate([observed[np.isfinite(observed)], predicted[np.isfinite(predicted)]])
        pad = 0.06 * max(np.ptp(visible), 0.1)
        upper.set_ylim(min(visible.max(), observed.max() + 2.0) + pad, visible.min() - pad)
        upper.set_ylabel("magnitude" if first else "")
    else:
        upper.set_ylabel("relative flux" if first else "")
    if first:
        upper.legend(loc="best", fontsize=8)
        lower.set_ylabel("obs. − model" if not titled else "o − m")
    if titled:
        upper.set_title(plain(stretch.title), fontsize=9)
    start = iso_times(recording)[rows[0]][:16].replace("T", " ")
    lower.set_xlabel(f"hours after {start} {recording.time.scale.upper()}" if not titled else "h", fontsize=9)
    upper.tick_params(labelbottom=False)
    for ax in (upper, lower):
        ax.grid(visible=True)


def _pieces(recording: Recording, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Places within ``rows`` that a line may join: one curve, no long gap."""
    for one in np.unique(recording.curve[rows]):
        place = np.flatnonzero(recording.curve[rows] == one)
        step = np.diff(recording.seconds[rows][place])
        longest = LONGEST_GAP * np.median(step) if len(step) else 0.0
        yield from np.split(place, np.flatnonzero(step > max(longest, 60.0)) + 1)


def shares(result: FitResult, axes: Axes | None = None, figure: Figure | None = None) -> Axes:
    """Share of each component in the light, along the rows in order of time."""
    names = result.model.assembly.components
    panels = stretches(result.recording)
    with matplotlib.rc_context(style()):
        if axes is None:
            axes = (figure if figure is not None else _figure((9.0, 3.0))).subplots()
        if len(panels) == 1:
            x, label = panels[0].hours, "hours after the first row"
        else:
            x, label = np.arange(len(result.recording)), "row, in order of time"
        order = np.argsort(x, kind="stable")
        axes.stackplot(
            x[order], result.shares[:, order], labels=[plain(name) for name in names],
            colors=[component_colour(k) for k in range(len(names))], alpha=0.9, lw=0,
        )  # fmt: skip
        axes.set(
            xlim=(x.min(), max(x.max(), x.min() + 1e-6)),
            ylim=(0, 1),
            xlabel=label,
            ylabel="share of the light",
        )
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.18), ncols=min(len(names), 6), fontsize=8)
    return axes


def corner_plot(result: FitResult, figure: Figure | None = None) -> Figure:
    """Posterior of every pair of the (at most MOST_CORNER, informed first) parameters, logarithmic where
    the prior is.
    """
    import corner

    posterior = result.posterior
    if posterior is None:
        raise ValueError("nothing was free: there is no posterior")
    chosen = corner_names(result)
    columns, labels = [], []
    for name in chosen:
        index = posterior.names.index(name)
        values = posterior.flat[:, index].numpy()
        logarithmic = _wide(result, index)
        columns.append(np.log10(values) if logarithmic else values)
        unit = result.model.parameter_set.free[index].unit
        labels.append(plain(f"log10 {name}" if logarithmic else name) + (f"\n({unit})" if unit else ""))
    data = np.stack(columns, -1)[:: max(1, len(posterior.flat) // 20_000)]
    spread = data.std(0) > 0
    with matplotlib.rc_context(style(8)):
        side = 1.2 + 1.35 * len(chosen)
        figure = figure if figure is not None else _figure((side, side))
        span = [
            (a, b) if ok else (a - 1e-6, b + 1e-6)
            for a, b, ok in zip(data.min(0), data.max(0), spread, strict=True)
        ]
        corner.corner(
            data, labels=labels, fig=figure, color=PALETTE[0], range=span, plot_datapoints=False,
            fill_contours=False, plot_density=False, levels=(0.393, 0.865), smooth=1.0, bins=24,
            max_n_ticks=3, labelpad=0.05, quiet=True,
            hist_kwargs={"lw": 1.2}, contour_kwargs={"linewidths": 1.1},
        )  # fmt: skip
    return figure


def _wide(result: FitResult, index: int) -> bool:
    """Whether a parameter is better drawn on a logarithmic axis: its prior is, and its draws span more than
    a factor of 4.
    """
    assert result.posterior is not None  # its callers checked
    values = result.posterior.flat[:, index]
    return result.model.parameter_set.free[index].prior.logarithmic and float(values.max() / values.min()) > 4


def corner_names(result: FitResult) -> list[str]:
    """The parameters of the corner plot: all, or MOST_CORNER with the informed before the others."""
    informed = result.insight.informed
    first = sorted(result.names, key=lambda name: not informed.get(name, False))[:MOST_CORNER]
    return [name for name in result.names if name in first]


def traces(result: FitResult, figure: Figure | None = None) -> Figure:
    """Every walker's way after burn-in, a panel a parameter."""
    posterior = result.posterior
    if posterior is None:
        raise ValueError("nothing was free: there is no posterior")
    names = posterior.names[:MOST_PANELS]
    columns = 2 if len(names) > 1 else 1
    bands = -(-len(names) // columns)
    step = posterior.burn + posterior.thin * np.arange(posterior.theta.shape[1])
    with matplotlib.rc_context(style(8)):
        figure = figure if figure is not None else _figure((9.0, 0.5 + 1.15 * bands))
        grid = figure.subplots(bands, columns, squeeze=False, sharex=True)
        for ax, name, index in zip(grid.flat, names, range(len(names)), strict=False):
            ax.plot(
                step,
                posterior.theta[..., index].T.numpy(),
                lw=0.4,
                alpha=0.35,
                color=PALETTE[0],
                rasterized=True,
            )
            ax.set_title(plain(name), fontsize=8, loc="left", pad=2)
            if _wide(result, index):
                ax.set_yscale("log")
        for ax in grid.flat[len(names) :]:
            ax.set_visible(False)
        for ax in grid[-1]:
            ax.set_xlabel("step")
        figure.subplots_adjust(hspace=0.55, wspace=0.22)
    return figure


def simulated(curve: SimulatedCurve, axes: Axes | None = None, figure: Figure | None = None) -> Axes:
    """Magnitude of a simulated curve along time, a line a station."""
    recording = curve.recording
    with matplotlib.rc_context(style()):
        if axes is None:
            axes = (figure if figure is not None else _figure((9.0, 3.6))).subplots()
        hours = recording.seconds / 3600
        for k, station in enumerate(np.unique(recording.station)):
            rows = recording.station == station
            mag = np.where(np.isfinite(curve.mag), curve.mag, np.nan)
            axes.plot(
                hours[rows],
                mag[rows],
                ".-",
                ms=2,
                lw=0.8,
                color=component_colour(k),
                label=plain(recording.station_ids[station]),
            )
        axes.invert_yaxis()
        axes.set(
            xlabel=f"hours after {iso_times(recording)[0][:16]} {recording.time.scale.upper()}",
            ylabel="magnitude",
        )
        axes.grid(visible=True)
        axes.legend(fontsize=8)
    return axes


def _figure(size: tuple[float, float]) -> Figure:
    """A figure that a notebook shows."""
    import matplotlib.pyplot as plt

    return plt.figure(figsize=size)
