"""Figures of a rotation search: periodogram, poles on the sky, folded curve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from torchlc.figures.style import BEFORE, DATA, MODEL, style

PNG_DPI = 150
SAME_LABEL = 8.0
"""Degrees between poles whose numbers would lie on each other in the figure."""


def periodogram(period_s: np.ndarray, power: np.ndarray, marks_s: Sequence[float]) -> Figure:
    """Share of the variance (N,) that two harmonics of a period of light (N,) explain; ``marks_s`` are turns found."""
    with _styled():
        figure = Figure(figsize=(7, 3.2), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(period_s, power, color=DATA, lw=0.8)
        for number, mark in enumerate(marks_s):
            axes.axvline(mark, color=MODEL, lw=1, label=None if number else "periods of the best rotation")
        axes.set(xscale="log", xlabel="period, s", ylabel="share of variance that it explains", ylim=(0, 1))
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        if len(marks_s):
            axes.legend(loc="lower right", bbox_to_anchor=(1, 1))
    return figure


def poles(directions: np.ndarray, misfit: np.ndarray, modes: np.ndarray) -> Figure:
    """Misfits (D,) of the grid at unit vectors (D, 3), and the modes (M, 3), best first: right ascension, declination."""
    with _styled():
        figure = Figure(figsize=(7, 3.8), layout="constrained")
        axes = figure.add_subplot()
        ra, dec = _angles(directions)
        shown = axes.scatter(ra, dec, c=np.log10(np.maximum(misfit, 1e-300)), cmap="viridis_r", s=28)
        figure.colorbar(shown, ax=axes, label="log10 misfit of the grid")
        ra, dec = _angles(modes)
        axes.scatter(ra, dec, marker="x", s=80, color=MODEL)
        for first, numbers in _close_together(modes).items():
            text = ", ".join(str(number + 1) for number in numbers)
            axes.annotate(
                text, (ra[first], dec[first]), xytext=(5, 5), textcoords="offset points", color=MODEL
            )
        axes.set(xlim=(360, 0), ylim=(-90, 90), xlabel="right ascension, deg", ylabel="declination, deg")
    return figure


def folded(
    phase: np.ndarray,
    observed: np.ndarray,
    model: np.ndarray,
    number: np.ndarray,
    meaning: str = "phase of a turn",
) -> Figure:
    """Magnitudes (T,) and the best model's over a phase (T,) with its ``meaning``, a panel for each pass ``number`` (T,)."""
    passes = np.unique(number)[:8]
    with _styled():
        figure = Figure(figsize=(7, 1.2 + 1.9 * len(passes)), layout="constrained")
        for row, axes in enumerate(np.atleast_1d(np.asarray(figure.subplots(len(passes), sharex=True)))):
            here = number == passes[row]
            axes.plot(phase[here], observed[here], ".", color=DATA, ms=3, label="recorded")
            axes.plot(phase[here], model[here], ".", color=BEFORE, ms=2, label="best model")
            axes.invert_yaxis()
            axes.set_ylabel(f"pass {row + 1}, mag")
            if row == 0:
                axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)
            if row == len(passes) - 1:
                axes.set_xlabel(meaning)
    return figure


def _styled() -> Any:
    return matplotlib.rc_context(style())


def _close_together(directions: np.ndarray) -> dict[int, list[int]]:
    """Indices of unit vectors (M, 3) by the first of those within SAME_LABEL of them."""
    groups: dict[int, list[int]] = {}
    for number, direction in enumerate(directions):
        near = [first for first in groups if directions[first] @ direction > np.cos(np.radians(SAME_LABEL))]
        groups.setdefault(near[0] if near else number, []).append(number)
    return groups


def _angles(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (
        np.degrees(np.arctan2(directions[:, 1], directions[:, 0])) % 360,
        np.degrees(np.arcsin(np.clip(directions[:, 2], -1, 1))),
    )
