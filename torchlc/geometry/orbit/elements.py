"""Two-line elements: SGP4 (WGS-72), and where it stops being an orbit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from astropy.time import Time
from sgp4.api import SGP4_ERRORS, WGS72, Satrec

from torchlc.digits import rounded
from torchlc.errors import InputError
from torchlc.geometry.orbit.earth import julian_dates
from torchlc.geometry.orbit.ephemeris_polynomials import CELLS_PER_REVOLUTION, piecewise
from torchlc.geometry.orbit.motion import Piecewise

FRESH_DAYS = 30.0
"""Objects in high orbits get elements a few times a month; older ones are told with their likely error."""
SAMPLES_PER_REVOLUTION, MOST_SAMPLES = 16, 20_000
"""Between the epoch and the instants asked for, where SGP4 is tried: a perigee below the ground takes more than
a sixteenth of a revolution, and the days in which a decayed orbit has no position are as long as those before.
"""
DECAYED, OFF_THE_ORBIT = 6, 7
"""SGP4's code of a decayed orbit, and ours of a distance that the orbit does not have."""
REASONS = {**SGP4_ERRORS, OFF_THE_ORBIT: "the distance from the Earth is beyond perigee and apogee"}
WIDER, WIDER_KM = 0.1, 500.0
"""By how much perigee and apogee may change between the epoch and the recording, as a share and in km. Drag
takes less in a month unless the orbit decays; the Sun and the Moon change the eccentricity of a high orbit
by some hundredths a year. SGP4's own failures are off by factors.
"""
REACHED = ", which the light curve or an offset in time may reach"


def along_track_error_deg(age_days: float) -> tuple[float, float]:
    """Likely least and largest error along the track, deg, of elements of this age.

    Rule, without manoeuvres: 0.02 deg up to 3 days, then 0.01 to 0.1 deg more a day.
    """
    beyond = max(age_days - 3.0, 0.0)
    return min(0.02 + 0.01 * beyond, 180.0), min(0.02 + 0.1 * beyond, 180.0)


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
        """Positions in TEME, km, (T, 3), and codes (T,) of ``REASONS``, 0 where there is nothing wrong.

        The drag of SGP4 is a polynomial in time. Beyond the decay of an orbit it rises again, and SGP4 gives
        positions, without an error, that are those of no orbit: no instant counts that is further from the
        epoch than one at which SGP4 fails.
        """
        codes, position, _ = self._satellite.sgp4_array(*julian_dates(time, "utc"))
        days = self._days(time)
        for sign in (1.0, -1.0):
            failed_after, code = self._failure(sign, float((sign * days).max(initial=0.0)))
            codes = np.where((codes == 0) & (sign * days > failed_after), code, codes)
        radius = np.linalg.norm(position, axis=-1)
        lowest, highest = self._radii_km
        beyond = (codes == 0) & ~((radius >= lowest) & (radius <= highest))
        return position, np.where(beyond, OFF_THE_ORBIT, codes)

    @property
    def _radii_km(self) -> tuple[float, float]:
        """Distances from the Earth's centre between which the orbit may be."""
        axis, e = self._satellite.a * self._satellite.radiusearthkm, self._satellite.ecco
        return (1 - WIDER) * axis * (1 - e) - WIDER_KM, (1 + WIDER) * axis * (1 + e) + WIDER_KM

    def _failure(self, sign: float, days: float) -> tuple[float, int]:
        """Days from the epoch, forward (``sign`` 1) or back (-1) and at most ``days``, after which SGP4 has
        failed, and its code; infinity and 0 where it does not.
        """
        revolutions = days * 86400.0 * self.mean_motion / (2 * np.pi)
        count = int(min(np.ceil(revolutions * SAMPLES_PER_REVOLUTION), MOST_SAMPLES))
        if not count:
            return np.inf, 0
        away = np.linspace(0.0, days, count + 1)
        satellite = self._satellite
        jd = np.full(count + 1, satellite.jdsatepoch)
        codes, _, _ = satellite.sgp4_array(jd, satellite.jdsatepochF + sign * away)
        bad = np.flatnonzero(codes)
        return (float(away[bad[0]]), int(codes[bad[0]])) if bad.size else (np.inf, 0)

    def check(self, time: Time) -> None:
        """Raise InputError at the first of the rows' times for which there is no orbit."""
        self.refuse(time, self.positions(time)[1], "")

    def refuse(self, time: Time, codes: np.ndarray, why: str = REACHED) -> None:
        """Raise InputError at the first instant of ``time`` (T,) that has one of the ``codes`` (T,); ``why``
        it was asked for.
        """
        bad = np.flatnonzero(codes)
        if not bad.size:
            return
        instant: Any = time[bad[0]]
        days = float(self._days(time)[bad[0]])
        side = "before" if days >= 0 else "after"
        epoch: Any = Time(self._satellite.jdsatepoch, self._satellite.jdsatepochF, format="jd", scale="utc")
        reason = REASONS[int(codes[bad[0]])]
        if codes[bad[0]] == DECAYED:
            state = "has decayed" if days >= 0 else "is below the ground"
            reason = f"the orbit of these elements {state} ({reason})"
        raise InputError(
            self.source,
            "orbit.tle",
            f"SGP4 fails at {instant.utc.isot} UTC{why}: {reason}",
            "elements of the time of the recording",
            f"The epoch of these is {epoch.isot[:19]}, {abs(days):.1f} days {side} it.",
        )

    def _days(self, time: Time) -> np.ndarray:
        """Days (T,) of UTC after the epoch."""
        jd1, jd2 = julian_dates(time, "utc")
        return (jd1 - self._satellite.jdsatepoch) + (jd2 - self._satellite.jdsatepochF)

    def age_days(self, time: Time) -> float:
        """Longest time between the epoch of the elements and a row, days."""
        return float(np.abs(self._days(time)).max())

    def age_warning(self, time: Time) -> tuple[str, ...]:
        """A sentence when the elements are old."""
        age = self.age_days(time)
        if age <= FRESH_DAYS:
            return ()
        low, high = along_track_error_deg(age)
        return (
            f"the TLE is {age:.0f} days from the recording: an along-track error of {rounded(low, 1)} to {rounded(high, 2)} "
            "deg is likely (0.02 deg, plus 0.01 to 0.1 deg a day beyond 3 days); find elements of the date, "
            "or put along_track_offset in the model",
        )

    def motion(
        self, time: Time, seconds: np.ndarray, gcrs_from_teme: np.ndarray, exposure_s: float
    ) -> Piecewise:
        """The orbit around rows at ``time``, ``seconds`` (T,) after the first, in GCRS."""
        chosen = np.zeros(len(seconds), dtype=np.int64)
        return piecewise([self], chosen, time, seconds, gcrs_from_teme, exposure_s)
