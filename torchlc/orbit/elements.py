"""Two-line elements: SGP4 (WGS-72) on a grid around the rows, as polynomials that can be differentiated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from astropy.time import Time
from sgp4.api import SGP4_ERRORS, WGS72, Satrec

from torchlc.errors import InputError
from torchlc.orbit.earth import after, julian_dates
from torchlc.orbit.motion import Piecewise

CELLS_PER_REVOLUTION = 400
"""At the angular rate of perigee."""
STENCIL = np.arange(-2, 4)
"""Nodes, in cells, that fix the polynomial of a cell: degree 5, error below 1e-6 km (measured in tests)."""
REACH_S = 3660.0
"""Offset in time that a row must bear: the bound of time_offset, and light time."""
REACH_REVOLUTIONS = 10.0 / 360.0
"""The bound of along_track_offset."""
FRESH_DAYS = 30.0


class ElementSet:
    """One satellite: its two lines, checked, and SGP4 on them."""

    def __init__(self, lines: tuple[str, str], source: str | Path | None) -> None:
        self.source = source
        # the catalogue number does not enter the theory, and papers blank it out
        self._satellite = Satrec.twoline2rv(*(f"{line[:2]}00000{line[7:]}" for line in lines), WGS72)
        if self._satellite.error:
            raise InputError(source, "orbit.tle", SGP4_ERRORS[self._satellite.error], "elements SGP4 can use")

    @property
    def mean_motion(self) -> float:
        """Radians per second."""
        return self._satellite.no_kozai / 60.0

    @property
    def step_s(self) -> float:
        """Length of a cell: an equal part of a revolution at the rate of perigee."""
        e = self._satellite.ecco
        perigee_rate = self.mean_motion * (1 + e) ** 2 / (1 - e**2) ** 1.5
        return 2 * np.pi / perigee_rate / CELLS_PER_REVOLUTION

    def positions(self, time: Time) -> tuple[np.ndarray, np.ndarray]:
        """Positions in TEME, km, (T, 3), and SGP4's error codes (T,), 0 where there is none."""
        codes, position, _ = self._satellite.sgp4_array(*julian_dates(time, "utc"))
        return position, codes

    def check(self, time: Time) -> None:
        """Raise InputError at the first of the rows' times for which SGP4 gives up."""
        _, codes = self.positions(time)
        bad = np.flatnonzero(codes)
        if bad.size:
            raise InputError(
                self.source,
                "orbit.tle",
                f"SGP4 fails at {time.isot[bad[0]]}: {SGP4_ERRORS[int(codes[bad[0]])]}",
                "elements of the time of the recording",
                f"These are {self.age_days(time):.0f} days off.",
            )

    def age_days(self, time: Time) -> float:
        """Longest time between the epoch of the elements and a row, days."""
        jd1, jd2 = julian_dates(time, "utc")
        age = (jd1 - self._satellite.jdsatepoch) + (jd2 - self._satellite.jdsatepochF)
        return float(np.abs(age).max())

    def age_warning(self, time: Time) -> tuple[str, ...]:
        """A sentence when the elements are old.

        Rule, without manoeuvres: 0.02 deg along the track up to 3 days, then 0.01 to 0.1 deg more a day.
        """
        age = self.age_days(time)
        if age <= FRESH_DAYS:
            return ()
        low, high = (min(0.02 + rate * (age - 3.0), 180.0) for rate in (0.01, 0.1))
        return (
            f"the TLE is {age:.0f} days from the recording: an along-track error of {low:.1g} to {high:.2g} "
            "deg is likely (0.02 deg, plus 0.01 to 0.1 deg a day beyond 3 days); find elements of the date, "
            "or put along_track_offset in the model",
        )

    def motion(
        self, time: Time, seconds: np.ndarray, gcrs_from_teme: np.ndarray, exposure_s: float
    ) -> Piecewise:
        """The orbit around rows at ``time``, ``seconds`` (T,) after the first, in GCRS."""
        step = self.step_s
        reach = REACH_S + exposure_s + REACH_REVOLUTIONS * 2 * np.pi / self.mean_motion
        width = int(np.ceil(reach / step)) + 1
        place = seconds / step
        cell = np.floor(place)
        runs = _runs(cell.astype(np.int64), width)
        origin: Any = time[0]
        coefficients = [self._coefficients(origin, first, last, step) for first, last in runs]
        starts = np.array([first for first, _ in runs])
        stored = np.concatenate([[0], np.cumsum([last - first + 1 for first, last in runs])])
        run = np.searchsorted(starts, cell, side="right") - 1
        return Piecewise(
            torch.from_numpy(np.concatenate(coefficients)),
            torch.from_numpy(cell.astype(np.int64) - starts[run] + stored[run]),
            torch.from_numpy(place - cell),
            torch.from_numpy(gcrs_from_teme),
            step_s=step,
            first=-width,
            last=width,
        )

    def _coefficients(self, origin: Time, first: int, last: int, step: float) -> np.ndarray:
        """Polynomial coefficients (C, 3, 6) of the cells ``first`` to ``last``. Where SGP4 fails beyond the
        rows they are NaN.
        """
        nodes = np.arange(first + STENCIL[0], last + STENCIL[-1] + 1)
        position, codes = self.positions(after(origin, nodes * step))
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
