"""The Earth's orientation, the stations on it and the Sun seen from its centre.

Numpy and astropy's ERFA, from bundled tables only: nothing here reaches for the network.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import astropy.units as u
import erfa
import numpy as np
from astropy.time import Time, TimeDelta
from astropy.utils import iers

OBLIQUITY_J2000_ARCSEC = 84381.448
"""Of the ecliptic J2000 of DAMIT, Horizons and the Minor Planet Center (IAU 1976)."""
ROTATION_RATE = 2 * np.pi * 1.00273781191135448 / 86400.0
"""Rate of the Earth Rotation Angle, rad per second of UT1."""
AU_KM = 149597870.7
LIGHT_KM_S = 299792.458
DAY_S = 86400.0
WGS84 = 1
"""The ellipsoid, in the numbering of ERFA."""
UNKNOWN_UT1 = "UT1 - UTC is not tabulated for all these times and taken as 0: stations may be off by 400 m"


def icrs_from_ecliptic() -> np.ndarray:
    """Rotation (3, 3) of ecliptic J2000 components into ICRS components; neglects the frame bias, 0.02"."""
    obliquity = np.radians(OBLIQUITY_J2000_ARCSEC / 3600)
    cos, sin = np.cos(obliquity), np.sin(obliquity)
    return np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])


def in_scale(time: Time, scale: str) -> Time:
    """``time`` in another scale."""
    return getattr(time, scale)


def julian_dates(time: Time, scale: str) -> tuple[np.ndarray, np.ndarray]:
    """Two-part Julian dates (T,), (T,) of ``time`` in another scale."""
    converted: Any = getattr(time, scale)
    return converted.jd1, converted.jd2


def after(instant: Time, seconds: np.ndarray) -> Time:
    """Instants ``seconds`` (N,) of elapsed time after one instant, in TAI."""
    return in_scale(instant, "tai") + TimeDelta(seconds, format="sec")


@dataclass(frozen=True)
class Orientation:
    """Rotations (T, 3, 3) between terrestrial and celestial axes and the Earth's axis (T, 3) in GCRS."""

    gcrs_from_itrs: np.ndarray
    gcrs_from_teme: np.ndarray
    axis: np.ndarray
    warnings: tuple[str, ...]


def orientation(time: Time) -> Orientation:
    """Earth orientation at ``time`` (T,): IAU 2006/2000A with the bundled UT1 and polar motion.

    TEME, by the IAU 1982 sidereal time, reaches the celestial frame through the terrestrial one, as in
    Vallado et al. (2006), AIAA 2006-6753, and in astropy. Rows of one instant, as of many objects, share the work.
    """
    instants, row = _distinct(time)
    distinct = _orientation(instants)
    return replace(
        distinct,
        gcrs_from_itrs=distinct.gcrs_from_itrs[row],
        gcrs_from_teme=distinct.gcrs_from_teme[row],
        axis=distinct.axis[row],
    )


def _distinct(time: Time) -> tuple[Time, np.ndarray]:
    """The different instants among ``time`` (T,), and which of them each row is, (T,)."""
    days = np.stack([np.asarray(time.jd1), np.asarray(time.jd2)], axis=-1)
    _, first, row = np.unique(days, axis=0, return_index=True, return_inverse=True)
    return cast(Time, time[first]), row.reshape(-1)


def _orientation(time: Time) -> Orientation:
    tt, utc = julian_dates(time, "tt"), julian_dates(time, "utc")
    ut1_minus_utc, xp, yp, known = _earth_orientation_parameters(utc)
    ut1 = utc[0], utc[1] + ut1_minus_utc / DAY_S
    cirs_from_gcrs = erfa.c2i06a(*tt)
    itrs_from_gcrs = erfa.c2tcio(cirs_from_gcrs, erfa.era00(*ut1), erfa.pom00(xp, yp, erfa.sp00(*tt)))
    itrs_from_teme = erfa.c2tcio(np.eye(3), erfa.gmst82(*ut1), erfa.pom00(xp, yp, 0.0))
    gcrs_from_itrs = np.swapaxes(itrs_from_gcrs, -1, -2)
    return Orientation(
        gcrs_from_itrs=gcrs_from_itrs,
        gcrs_from_teme=gcrs_from_itrs @ itrs_from_teme,
        axis=cirs_from_gcrs[..., 2, :],
        warnings=() if known else (UNKNOWN_UT1,),
    )


def _earth_orientation_parameters(
    utc: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """UT1 - UTC (s), polar motion x and y (rad), (T,) each, and whether all times are tabulated."""
    table = _iers_table()
    ut1_minus_utc, status = table.ut1_utc(*utc, return_status=True)
    xp, yp, _ = table.pm_xy(*utc, return_status=True)
    known = np.asarray(status) >= 0
    return (
        np.where(known, ut1_minus_utc.to_value(u.s), 0.0),
        np.where(known, xp.to_value(u.rad), 0.0),
        np.where(known, yp.to_value(u.rad), 0.0),
        bool(known.all()),
    )


@cache
def _iers_table() -> Any:
    """UT1 - UTC and polar motion of 1973 to a year ahead: IERS Bulletin B where it gives a day, A elsewhere.

    Read by name, because astropy's own choice of a table may download one; and only the columns that are used, by
    their place in a line (astropy's ReadMe of the file), because its reader of all of them takes 0.8 s of every
    process that places a station, as long as the rest of a short simulation.
    """
    with Path(iers.IERS_A_FILE).open(encoding="ascii") as file:
        lines = [line for line in file if line[58:68].strip()]  # the last days have nothing but a date
    ut1, x, y = (
        np.array([float(line[later] if line[later].strip() else line[first]) for line in lines])
        for first, later in (
            (slice(58, 68), slice(154, 165)),
            (slice(18, 27), slice(134, 144)),
            (slice(37, 46), slice(144, 154)),
        )
    )
    days = np.array([float(line[7:15]) for line in lines])
    return iers.IERS({"MJD": days * u.d, "UT1_UTC": ut1 * u.s, "PM_x": x * u.arcsec, "PM_y": y * u.arcsec})


def sun_of_earth(time: Time) -> tuple[np.ndarray, np.ndarray]:
    """Apparent geocentric position, km, and velocity, km/s, of the Sun in GCRS, (T, 3) each.

    Aberration of the Earth's motion is included, that of an object about the Earth (at most 5") is neglected.
    """
    instants, row = _distinct(time)
    position, velocity = _sun_of_earth(instants)
    return position[row], velocity[row]


def _sun_of_earth(time: Time) -> tuple[np.ndarray, np.ndarray]:
    heliocentric, barycentric = erfa.epv00(*julian_dates(time, "tdb"))
    distance_au = np.linalg.norm(heliocentric["p"], axis=-1)
    beta = barycentric["v"] * (AU_KM / DAY_S / LIGHT_KM_S)
    lorentz = np.sqrt(1.0 - np.sum(beta**2, axis=-1))
    apparent = erfa.ab(-heliocentric["p"] / distance_au[:, None], beta, distance_au, lorentz)
    return apparent * distance_au[:, None] * AU_KM, -heliocentric["v"] * (AU_KM / DAY_S)


def station_itrs(latitude: np.ndarray, longitude: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Terrestrial position, km, (..., 3), of geodetic coordinates (degrees, m) on the WGS84 ellipsoid."""
    return erfa.gd2gc(WGS84, np.radians(longitude), np.radians(latitude), height_m) / 1000.0


def height_km(position: np.ndarray) -> np.ndarray:
    """Ellipsoidal height (T,), km, of terrestrial positions, km."""
    _, _, height = erfa.gc2gd(WGS84, position * 1000.0)
    return height / 1000.0


def vertical_itrs(position: np.ndarray) -> np.ndarray:
    """Upward normal (..., 3) of the ellipsoid through terrestrial positions, km."""
    longitude, latitude, _ = erfa.gc2gd(WGS84, position * 1000.0)
    return _direction(longitude, latitude)


def _direction(longitude: np.ndarray, latitude: np.ndarray) -> np.ndarray:
    cos = np.cos(latitude)
    return np.stack([cos * np.cos(longitude), cos * np.sin(longitude), np.sin(latitude)], axis=-1)


def horizontal_itrs(position: np.ndarray, altitude_deg: np.ndarray, azimuth_deg: np.ndarray) -> np.ndarray:
    """Terrestrial unit vector (..., 3) of altitude and azimuth (from north through east) at ``position``."""
    altitude, azimuth = np.radians(altitude_deg)[..., None], np.radians(azimuth_deg)[..., None]
    longitude, latitude, _ = erfa.gc2gd(WGS84, position * 1000.0)
    up, north = _direction(longitude, latitude), _direction(longitude, latitude + np.pi / 2)
    east = _direction(longitude + np.pi / 2, np.zeros_like(latitude))
    return np.cos(altitude) * (np.cos(azimuth) * north + np.sin(azimuth) * east) + np.sin(altitude) * up


def range_to_height(position: np.ndarray, direction: np.ndarray, target_km: np.ndarray) -> np.ndarray:
    """Distance, km, (T,), along ``direction`` from terrestrial ``position`` at which the ellipsoidal height
    becomes ``target_km``.

    Newton's iteration: along a ray the height changes by direction . normal. The start is the same question
    on a sphere.
    """
    radius = np.linalg.norm(position, axis=-1)
    outward = np.sum(position * direction, axis=-1)
    rise = np.maximum(target_km - height_km(position), 0.0)
    distance = -outward + np.sqrt(outward**2 + rise * (2 * radius + rise))
    for _ in range(6):
        point = position + distance[..., None] * direction
        longitude, latitude, height = erfa.gc2gd(WGS84, point * 1000.0)
        slope = np.sum(_direction(longitude, latitude) * direction, axis=-1)
        distance = distance - (height / 1000.0 - target_km) / np.maximum(slope, 1e-3)
    return distance
