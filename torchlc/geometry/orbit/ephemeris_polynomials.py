"""Places at any time as polynomials on cells of equal length, which can be differentiated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import torch
from astropy.time import Time

from torchlc.geometry.orbit.earth import after
from torchlc.geometry.orbit.motion import Piecewise

CELLS_PER_REVOLUTION = 400
"""At the angular rate of perigee."""
STENCIL = np.arange(-2, 4)
"""Nodes, in cells, that fix the polynomial of a cell: degree 5, error below 1e-6 km (measured in tests)."""
REACH_S = 3660.0
"""Offset in time that a row must bear: the bound of time_offset, and light time."""
REACH_REVOLUTIONS = 10.0 / 360.0
"""The bound of along_track_offset."""


class Source(Protocol):
    """Where an object is at any time."""

    @property
    def mean_motion(self) -> float:
        """Radians per second."""
        ...

    @property
    def step_s(self) -> float:
        """Length of a cell: an equal part of a revolution at the rate of perigee."""
        ...

    def positions(self, time: Time) -> tuple[np.ndarray, np.ndarray]:
        """Positions, km, (T, 3), and codes (T,), 0 where there is one."""
        ...

    def refuse(self, time: Time, codes: np.ndarray) -> None:
        """Raise InputError if one of the ``codes`` of these instants means that there is no orbit."""
        ...


def piecewise(
    sources: Sequence[Source],
    chosen: np.ndarray,
    time: Time,
    seconds: np.ndarray,
    turn: np.ndarray,
    exposure_s: float,
) -> Piecewise:
    """The orbit around rows at ``time``, ``seconds`` (T,) after the first; row t by ``sources[chosen[t]]``,
    turned by ``turn`` (T, 3, 3).
    """
    used = np.unique(chosen)
    step = min(sources[k].step_s for k in used)
    reach = REACH_S + exposure_s + REACH_REVOLUTIONS * 2 * np.pi / min(sources[k].mean_motion for k in used)
    width = int(np.ceil(reach / step)) + 1
    steps = seconds / step
    cell = np.floor(steps).astype(np.int64)
    origin: Any = time[0]
    index, coefficients, stored = np.empty_like(cell), [], 0
    for k in used:
        rows = chosen == k
        runs = _runs(cell[rows], width)
        coefficients += [_coefficients(sources[k], origin, first, last, step) for first, last in runs]
        starts = np.array([first for first, _ in runs])
        before = stored + np.cumsum([0, *(last - first + 1 for first, last in runs)])
        run = np.searchsorted(starts, cell[rows], side="right") - 1
        index[rows] = cell[rows] - starts[run] + before[run]
        stored = int(before[-1])
    return Piecewise(
        torch.from_numpy(np.concatenate(coefficients)),
        torch.from_numpy(index),
        torch.from_numpy(steps - cell),
        torch.from_numpy(turn),
        step_s=step,
        first=-width,
        last=width,
    )


def _coefficients(source: Source, origin: Time, first: int, last: int, step: float) -> np.ndarray:
    """Polynomial coefficients (C, 3, 6) of the cells ``first`` to ``last``; NaN where there is no position."""
    nodes = np.arange(first + STENCIL[0], last + STENCIL[-1] + 1)
    moments = after(origin, nodes * step)
    position, codes = source.positions(moments)
    source.refuse(moments, codes)
    position = np.where(codes[:, None] == 0, position, np.nan)
    stencils = np.lib.stride_tricks.sliding_window_view(position, STENCIL.size, axis=0)
    inverse = np.linalg.inv(np.vander(STENCIL.astype(float), increasing=True))
    return stencils @ inverse.T


def _runs(cell: np.ndarray, width: int) -> list[tuple[int, int]]:
    """First and last cell of each stretch without gaps when every row needs ``width`` cells on both sides
    of its own.
    """
    used = np.unique(cell)
    breaks = np.flatnonzero(np.diff(used) > 2 * width + 1)
    firsts, lasts = used[np.concatenate([[0], breaks + 1])], used[np.concatenate([breaks, [used.size - 1]])]
    return [(int(first) - width, int(last) + width) for first, last in zip(firsts, lasts, strict=True)]
