"""Shares, posterior and chain of a fit, and simulated curves, in matplotlib; no physics is computed here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchlc.figures.curves import stretches
from torchlc.figures.style import PALETTE, component_colour, plain, style
from torchlc.results.simulated_curve import SimulatedCurve, iso_times

if TYPE_CHECKING:
    from torchlc.results.fit_result import FitResult

MOST_TRACES = 24
MOST_CORNER = 10


def shares(result: FitResult, axes: Axes | None = None, figure: Figure | None = None) -> Axes:
    """Share of each component in the light, along the rows in order of time."""
    names = result.model.assembly.components
    panels = stretches(result.recording)
    with matplotlib.rc_context(style()):
        if axes is None:
            axes = (figure if figure is not None else _figure((9.0, 3.0))).subplots()
        if len(panels) == 1:
            x, label = panels[0].elapsed, f"{panels[0].unit} after the first row"
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
    names = posterior.names[:MOST_TRACES]
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
