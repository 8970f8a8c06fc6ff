"""Where the object, the station and the Sun are: SGP4, the Earth's rotation and an apparent Sun, in GCRS.

Times are UTC seconds since 2000-01-01T00:00:00 at 86400 s a day (resolution 1e-7 s); leap seconds enter only
where terrestrial time is needed. Arrays keep their leading shape (...); positions are km, velocities km/s.

Approximations: UT1 = UTC (at most 0.9 s: 13" of Earth rotation, 0.4 km at the station); no polar motion
(0.3", 10 m); precession IAU 1976 and the ten largest nutation terms of IAU 1980 (0.1"); the frame bias is
left out (0.02"). The Sun comes from ERFA's ``epv00`` (0.01"), with annual aberration to first order (20.5"
kept, 0.001" lost).
"""

from __future__ import annotations

import erfa
import numpy as np
from numpy.typing import NDArray
from sgp4.api import WGS72, Satrec

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EPOCH_JD = 2451544.5  # of second 0
DAY_S = 86400.0
AU_KM = 149597870.7
LIGHT_KM_S = 299792.458
SUN_RADIUS_KM = 695700.0
EARTH_RADIUS_KM = 6378.137
EARTH_FLATTENING = 1.0 / 298.257223563
ARCSEC = np.pi / 648000.0

# IAU 1980 nutation: multiples of l, l', F, D, Om; dpsi in 0.0001", its rate, deps, its rate (largest ten)
_NUTATION = np.array(
    [
        [0, 0, 0, 0, 1, -171996, -174.2, 92025, 8.9],
        [0, 0, 2, -2, 2, -13187, -1.6, 5736, -3.1],
        [0, 0, 2, 0, 2, -2274, -0.2, 977, -0.5],
        [0, 0, 0, 0, 2, 2062, 0.2, -895, 0.5],
        [0, 1, 0, 0, 0, 1426, -3.4, 54, -0.1],
        [1, 0, 0, 0, 0, 712, 0.1, -7, 0.0],
        [0, 1, 2, -2, 2, -517, 1.2, 224, -0.6],
        [0, 0, 2, 0, 1, -386, -0.4, 200, 0.0],
        [1, 0, 2, 0, 2, -301, 0.0, 129, -0.1],
        [0, -1, 2, -2, 2, 217, -0.5, -95, 0.3],
    ]
)


def seconds(iso: str) -> float:
    """Seconds since 2000-01-01 UTC of an ISO date without an offset."""
    since = np.datetime64(iso, "us") - np.datetime64("2000-01-01", "us")
    return float(since / np.timedelta64(1, "us")) * 1e-6


def iso(second: float) -> str:
    """The ISO date, to the millisecond, of a time in seconds since 2000-01-01 UTC."""
    return str(np.datetime64("2000-01-01", "ms") + np.timedelta64(round(second * 1000), "ms"))


def turn(axis: int, angle: Array) -> Array:
    """Matrix (..., 3, 3) that turns the frame about coordinate axis 0, 1 or 2 by ``angle`` (rad)."""
    angle = np.asarray(angle, float)
    out = np.zeros((*angle.shape, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1.0
    out[..., i, i] = out[..., j, j] = np.cos(angle)
    out[..., i, j], out[..., j, i] = np.sin(angle), -np.sin(angle)
    return out


def apply(matrix: Array, vector: Array) -> Array:
    """matrix (..., 3, 3) times vector (..., 3)."""
    return np.einsum("...ij,...j->...i", matrix, vector)


def unit(vector: Array) -> Array:
    """vector (..., 3) made of length 1."""
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def basis(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors (..., 3) that complete unit ``direction`` (..., 3)."""
    helper = np.where(np.abs(direction[..., :1]) < 0.8, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = unit(np.cross(direction, helper))
    return first, np.cross(direction, first)


def _terrestrial(t: Array) -> tuple[float, Array]:
    """Terrestrial time as a two-part Julian date."""
    year, month, day = (int(x) for x in iso(float(np.min(t)))[:10].split("-"))
    leap = float(erfa.dat(year, month, day, 0.0))
    return EPOCH_JD, (np.asarray(t) + leap + 32.184) / DAY_S


def sidereal_angle(t: Array) -> Array:
    """Greenwich mean sidereal time, rad, IAU 1982 (Aoki et al. 1982), with UT1 = UTC."""
    century = (EPOCH_JD - 2451545.0 + np.asarray(t) / DAY_S) / 36525.0
    second = 67310.54841 + (876600.0 * 3600.0 + 8640184.812866) * century + 0.093104 * century**2
    return np.mod(second - 6.2e-6 * century**3, DAY_S) * (2.0 * np.pi / DAY_S)


def teme_to_gcrs(t: Array) -> Array:
    """Matrices (..., 3, 3) from the true equator, mean equinox of date to the mean system of J2000."""
    jd1, jd2 = _terrestrial(t)
    c = (jd1 - 2451545.0 + jd2) / 36525.0
    degrees = np.stack(
        [
            134.96298139 + 477198.8673981 * c,  # l, Moon's mean anomaly
            357.52772333 + 35999.0503400 * c,  # l', Sun's
            93.27191028 + 483202.0175381 * c,  # F
            297.85036306 + 445267.1114800 * c,  # D
            125.04452222 - 1934.1362608 * c,  # Om
        ],
        axis=-1,
    )
    phase = np.deg2rad(degrees) @ _NUTATION[:, :5].T
    dpsi = ((_NUTATION[:, 5] + _NUTATION[:, 6] * c[..., None]) * np.sin(phase)).sum(-1) * 1e-4 * ARCSEC
    deps = ((_NUTATION[:, 7] + _NUTATION[:, 8] * c[..., None]) * np.cos(phase)).sum(-1) * 1e-4 * ARCSEC
    obliquity = (84381.448 - 46.8150 * c - 0.00059 * c**2) * ARCSEC
    zeta = (2306.2181 * c + 0.30188 * c**2) * ARCSEC
    z = (2306.2181 * c + 1.09468 * c**2) * ARCSEC
    theta = (2004.3109 * c - 0.42665 * c**2) * ARCSEC
    precession = turn(2, -z) @ turn(1, theta) @ turn(2, -zeta)
    nutation = turn(0, -(obliquity + deps)) @ turn(2, -dpsi) @ turn(0, obliquity)
    equinox = turn(2, dpsi * np.cos(obliquity))
    return np.swapaxes(equinox @ nutation @ precession, -1, -2)


def sun(t: Array) -> Array:
    """Apparent geocentric Sun (..., 3), km, GCRS: aberration of the Earth's motion included.

    Interpolated between nodes 10 min apart where that saves work (0.3 km).
    """
    t = np.asarray(t, float)
    count = int(np.ceil(np.ptp(t) / 600.0)) + 2
    if count < t.size:
        nodes = np.linspace(t.min(), t.max(), count)
        at_nodes = sun(nodes)
        return np.stack([np.interp(t, nodes, at_nodes[:, k]) for k in range(3)], axis=-1)
    heliocentric, barycentric = erfa.epv00(*_terrestrial(t))
    geometric = -heliocentric["p"]
    distance = np.linalg.norm(geometric, axis=-1, keepdims=True)
    velocity = barycentric["v"] * (AU_KM / DAY_S / LIGHT_KM_S)
    return unit(geometric / distance + velocity) * distance * AU_KM


def station_fixed(latitude_deg: float, longitude_deg: float, height_m: float) -> Array:
    """Earth-fixed position (3,), km, on the WGS-84 ellipsoid."""
    lat, lon = np.deg2rad(latitude_deg), np.deg2rad(longitude_deg)
    e2 = EARTH_FLATTENING * (2.0 - EARTH_FLATTENING)
    normal = EARTH_RADIUS_KM / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
    height = height_m / 1000.0
    return np.array(
        [
            (normal + height) * np.cos(lat) * np.cos(lon),
            (normal + height) * np.cos(lat) * np.sin(lon),
            (normal * (1.0 - e2) + height) * np.sin(lat),
        ]
    )


def station(t: Array, latitude_deg: float, longitude_deg: float, height_m: float) -> tuple[Array, Array]:
    """Position (..., 3), km, and zenith (..., 3) of a station, GCRS."""
    lat, lon = np.deg2rad(latitude_deg), np.deg2rad(longitude_deg)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    to_gcrs = teme_to_gcrs(t) @ turn(2, -sidereal_angle(t))
    return to_gcrs @ station_fixed(latitude_deg, longitude_deg, height_m), to_gcrs @ up


class Orbit:
    """SGP4 (WGS-72, as the elements were fitted) behind a function of time."""

    def __init__(self, tle: tuple[str, str]) -> None:
        lines = [line.replace("xxxxx", "99999") for line in tle]
        self.satellite = Satrec.twoline2rv(lines[0], lines[1], WGS72)
        self.period_s = 2.0 * np.pi / self.satellite.no_kozai * 60.0

    def state(self, t: Array) -> tuple[Array, Array]:
        """Position and velocity (..., 3), GCRS."""
        t = np.asarray(t, float)
        day = np.floor(t.ravel() / DAY_S)
        code, position, velocity = self.satellite.sgp4_array(EPOCH_JD + day, t.ravel() / DAY_S - day)
        if np.any(code):
            raise ValueError(f"SGP4 error code {int(np.max(code))}")
        to_gcrs = teme_to_gcrs(t)
        shape = (*t.shape, 3)
        return apply(to_gcrs, position.reshape(shape)), apply(to_gcrs, velocity.reshape(shape))


def airmass(elevation_deg: Array) -> Array:
    """Kasten & Young (1989) at the geometric elevation; nan below the horizon."""
    up = np.where(elevation_deg > 0, elevation_deg, np.nan)
    return 1.0 / (np.sin(np.deg2rad(up)) + 0.50572 * (up + 6.07995) ** -1.6364)
