"""Times that were reduced to the Sun or the barycentre, brought back to the observer."""

from __future__ import annotations

import warnings
from typing import Any, cast

import astropy.units as u
import numpy as np
from astropy.coordinates import EarthLocation, SkyCoord, get_body_barycentric
from astropy.time import Time
from astropy.utils import iers
from astropy.utils.exceptions import AstropyWarning
from erfa import ErfaWarning

KM_PER_DAY = 299792.458 * 86400.0
OBLIQUITY = np.radians(84381.448 / 3600.0)
"""Of the ecliptic of J2000 (IAU 1976), about the x axis of ICRS; its rotation to that is below 0.1 arcsec."""


def days_by_direction(
    time: Time, path: str, direction: tuple[float, float], station: tuple[float, float, float] | None
) -> np.ndarray:
    """Days (T,) that the reduction of ``time`` to the Sun ("heliocentric") or the barycentre added, for an object in
    the ICRS ``direction`` (deg), infinitely far, as such reductions take it.

    ``station`` is latitude, longitude (deg) and height (m); the geocentre stands for one that is not known, which
    moves times by up to 21 ms. An object that moves by 1 deg from the direction given is off by up to 8.7 s.
    """
    target = SkyCoord(direction[0], direction[1], unit=u.deg)
    if station is None:
        location = EarthLocation.from_geocentric(0.0, 0.0, 0.0, unit=u.m)
    else:
        location = EarthLocation.from_geodetic(station[1], station[0], station[2] * u.m)
    added: Any = np.zeros(len(time)) * u.day
    with BundledTables():
        for _ in range(3):  # each pass is some 1e-4 of the one before: 500 s, 0.05 s, 5 us
            moment: Any = time - added
            added = moment.light_travel_time(target, kind=path, location=location)
    return np.asarray(added.to_value(u.day))


def days_by_vectors(
    time: Time, path: str, sun: np.ndarray, observer: np.ndarray, frame: str | None
) -> np.ndarray:
    """The same from the vectors (T, 3), km, from the object to the ``sun`` and to the ``observer`` of each row."""
    towards = -observer / np.linalg.norm(observer, axis=-1, keepdims=True)
    location = observer - sun
    if path == "barycentric":
        with BundledTables():
            centre: Any = get_body_barycentric("sun", cast(Time, time.tdb))
        solar = np.asarray(centre.xyz.to_value(u.km)).T
        if frame == "ecliptic":
            cosine, sine = np.cos(OBLIQUITY), np.sin(OBLIQUITY)
            solar = solar @ np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
        location = location + solar
    return np.sum(location * towards, axis=-1) / KM_PER_DAY


class BundledTables:
    """Astropy without the network and without warnings of years that its tables do not reach."""

    def __enter__(self) -> None:
        self._caught = warnings.catch_warnings()
        self._caught.__enter__()
        warnings.simplefilter("ignore", AstropyWarning)
        warnings.simplefilter("ignore", ErfaWarning)
        self._download = iers.conf.set_temp("auto_download", False)
        self._download.__enter__()

    def __exit__(self, *error: Any) -> None:
        self._download.__exit__(*error)
        self._caught.__exit__(*error)
