"""Two-line elements: SGP4 (WGS-72)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from astropy.time import Time
from sgp4.api import SGP4_ERRORS, WGS72, Satrec

from torchlc.errors import InputError
from torchlc.orbit.cells import CELLS_PER_REVOLUTION, piecewise
from torchlc.orbit.earth import julian_dates
from torchlc.orbit.motion import Piecewise

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
        chosen = np.zeros(len(seconds), dtype=np.int64)
        return piecewise([self], chosen, time, seconds, gcrs_from_teme, exposure_s)
