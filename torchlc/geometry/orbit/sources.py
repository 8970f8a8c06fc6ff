"""From scene and recording to a Track: elements, vectors in the recording, or altitude and azimuth."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from astropy.time import Time
from astropy.utils import iers
from astropy.utils.exceptions import AstropyWarning
from erfa import ErfaWarning
from torch import Tensor

from torchlc.errors import InputError
from torchlc.geometry.orbit import earth
from torchlc.geometry.orbit.elements import ElementSet
from torchlc.geometry.orbit.ephemeris import LOWEST_KM, Ephemeris
from torchlc.geometry.orbit.ephemeris_polynomials import Source, piecewise
from torchlc.geometry.orbit.motion import EarthFixed, Motion, Straight, TwoBody, inverse_semi_major_axis
from torchlc.geometry.orbit.track import Track
from torchlc.scene.tle import Elements, nearest, read_elements

if TYPE_CHECKING:
    from torchlc.readers import Recording
    from torchlc.scene import Scene

LONGEST_TURN_DEG = 5.0
"""Between neighbouring rows of a curve whose difference may serve as a rate; it is then 0.1 % short."""
GROUND_KM = (-1.0, 50.0)
"""Ellipsoidal heights at which an observer turns with the Earth."""


def make_track(scene: Scene, recording: Recording) -> Track:
    """All that SGP4 and astropy have to say about the rows, from bundled tables, never from the network."""
    with warnings.catch_warnings(), iers.conf.set_temp("auto_download", False):
        warnings.simplefilter("ignore", AstropyWarning)
        warnings.simplefilter("ignore", ErfaWarning)
        if scene.orbit.known:
            return _track_of_orbit(scene, recording)
        if scene.orbit.altaz:
            return _track_of_altaz(scene, recording)
        return _track_of_vectors(scene, recording)


def _track_of_orbit(scene: Scene, recording: Recording) -> Track:
    sources, chosen, warnings = _sources(scene, recording)
    frame = earth.orientation(recording.time)
    exposure_s = 0.0 if recording.exptime is None else float(np.nanmax(recording.exptime, initial=0.0))
    observer_itrs = _stations(scene)[recording.station]
    turn = np.eye(3) + np.zeros_like(frame.gcrs_from_teme) if scene.orbit.oem_file else frame.gcrs_from_teme
    slowness = np.array([1.0 / source.mean_motion for source in sources])[chosen]
    return Track(
        torch.from_numpy(recording.seconds),
        observer=_earth_fixed(_turn(frame.gcrs_from_itrs, observer_itrs), frame),
        object_=piecewise(sources, chosen, recording.time, recording.seconds, turn, exposure_s),
        sun=_geocentric_sun(recording),
        known=frozenset({"position", "velocity", "motion", "along_track", "elevation"}),
        seconds_per_radian=torch.from_numpy(slowness),
        zenith=torch.from_numpy(_turn(frame.gcrs_from_itrs, earth.vertical_itrs(observer_itrs))),
        warnings=(*warnings, *frame.warnings),
    )


def _sources(scene: Scene, recording: Recording) -> tuple[list[Source], np.ndarray, tuple[str, ...]]:
    """Sources of positions, which of them each row (T,) takes, and what is to be said of them."""
    orbit, time = scene.orbit, recording.time
    chosen = np.zeros(len(recording.seconds), dtype=np.int64)
    if orbit.oem_file is not None:
        ephemeris = Ephemeris(scene.file_path(orbit.oem_file), time)
        ephemeris.check(time)
        return [ephemeris], chosen, ()
    said: tuple[str, ...] = ()
    if orbit.tle is not None:
        sets = [ElementSet(orbit.tle, scene.source)]
    else:
        assert orbit.tle_file is not None  # the scene is checked
        path = scene.file_path(orbit.tle_file)
        on_file = read_elements(path)
        jd = np.add(*earth.julian_dates(time, "utc"))
        middle = np.array([jd[recording.night == night].mean() for night in range(len(recording.night_ids))])
        used, chosen = np.unique(nearest(on_file, middle)[recording.night], return_inverse=True)
        sets = [ElementSet(on_file[k].lines, path) for k in used]
        said = (_nearest_told(path, [on_file[k] for k in used], len(on_file), middle),)
    for k, elements in enumerate(sets):
        rows = cast(Time, time[chosen == k])
        elements.check(rows)
    oldest = max(range(len(sets)), key=lambda k: sets[k].age_days(cast(Time, time[chosen == k])))
    said += sets[oldest].age_warning(cast(Time, time[chosen == oldest]))
    return list(sets), chosen, said


def _nearest_told(path: Path, used: list[Elements], count: int, middle: np.ndarray) -> str:
    """Which element sets of a file are taken: for each night the nearest to its middle (Julian dates)."""
    epochs = np.array([elements.epoch for elements in used])
    away = np.abs(middle[:, None] - epochs).min(-1).max()
    listed = ", ".join(str(Time(epoch, format="jd", scale="utc").isot)[:16] for epoch in np.sort(epochs)[:3])
    more = f" and {len(used) - 3} more" if len(used) > 3 else ""
    return (
        f"{path.name}: of {count} element sets the nearest to each night is taken: {listed}{more} (at most "
        f"{away:.1f} days from the middle of the night)"
    )


def _track_of_altaz(scene: Scene, recording: Recording) -> Track:
    """Rows placed from the station. Nothing tells how the object moves on: it stands still under offsets."""
    if recording.alt is None or recording.az is None or recording.height is None:
        raise InputError(
            recording.source, "columns", "no alt, az and height", "all three, for a scene with altaz = true"
        )
    frame = earth.orientation(recording.time)
    observer_itrs = _stations(scene)[recording.station]
    low = np.flatnonzero(recording.height <= earth.height_km(observer_itrs))
    if low.size:
        found = f"{recording.height[low[0]]:g} km at {recording.time.isot[low[0]]}, below the station"
        raise InputError(recording.source, "column height", found, "km above the ellipsoid")
    direction = earth.horizontal_itrs(observer_itrs, recording.alt, recording.az)
    distance = earth.range_to_height(observer_itrs, direction, recording.height)
    position = torch.from_numpy(_turn(frame.gcrs_from_itrs, observer_itrs + distance[:, None] * direction))
    return Track(
        torch.from_numpy(recording.seconds),
        observer=_earth_fixed(_turn(frame.gcrs_from_itrs, observer_itrs), frame),
        object_=Straight(position, torch.zeros_like(position)),
        sun=_geocentric_sun(recording),
        known=frozenset({"position", "elevation"}),
        zenith=torch.from_numpy(_turn(frame.gcrs_from_itrs, earth.vertical_itrs(observer_itrs))),
        warnings=frame.warnings,
    )


def _track_of_vectors(scene: Scene, recording: Recording) -> Track:
    if recording.sun is None or recording.obs is None:
        raise InputError(
            recording.source,
            "columns",
            "no sun_x ... obs_z",
            "vectors, for a scene with vectors",
            "Or give a TLE in [orbit].",
        )
    turn = earth.icrs_from_ecliptic() if scene.orbit.vectors == "ecliptic" else np.eye(3)
    sun, observer = recording.sun @ turn.T, recording.obs @ turn.T
    if recording.position is None:
        return _heliocentric_track(recording, sun, observer)
    if (np.linalg.norm(recording.position, axis=-1) < LOWEST_KM).any():
        raise InputError(recording.source, "columns r_x, r_y, r_z", "a place inside the Earth", "km")
    velocity = None if recording.velocity is None else recording.velocity @ turn.T
    return _geocentric_track(recording, sun, observer, recording.position @ turn.T, velocity)


def _heliocentric_track(recording: Recording, sun: np.ndarray, observer: np.ndarray) -> Track:
    """No geocentre: each row has the object at the origin, moving against a Sun that stands still."""
    towards_sun, _ = _rates(recording, sun)
    towards_observer, _ = _rates(recording, observer)
    fixed, stamps = torch.zeros(sun.shape, dtype=torch.float64), torch.from_numpy(recording.seconds)
    return Track(
        stamps,
        observer=Straight(torch.from_numpy(observer), torch.from_numpy(towards_observer - towards_sun)),
        object_=Straight(fixed, torch.from_numpy(-towards_sun)),
        sun=Straight(torch.from_numpy(sun), fixed),
        known=frozenset({"motion"}),
    )


def _geocentric_track(
    recording: Recording,
    sun: np.ndarray,
    observer: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray | None,
) -> Track:
    """Two-body motion from each row; where only positions are known, from the rate between rows."""
    rate, everywhere = _rates(recording, position) if velocity is None else (velocity, True)
    start, moving = torch.from_numpy(position), torch.from_numpy(rate)
    bound = everywhere and bool((inverse_semi_major_axis(start, moving) > 0).all())
    object_ = TwoBody(start, moving) if bound else Straight(start, moving)
    frame = earth.orientation(recording.time)
    observer_motion, zenith = _observer(recording, position + observer, frame)
    _, sun_rate = earth.sun_of_earth(recording.time)
    known = {
        "position": True,
        "velocity": velocity is not None,
        "motion": everywhere,
        "along_track": velocity is not None and bound,
        "elevation": zenith is not None,
    }
    return Track(
        torch.from_numpy(recording.seconds),
        observer=observer_motion,
        object_=object_,
        sun=Straight(torch.from_numpy(position + sun), torch.from_numpy(sun_rate)),
        known=frozenset(name for name, true in known.items() if true),
        seconds_per_radian=1 / object_.mean_motion if isinstance(object_, TwoBody) else None,
        zenith=zenith,
        warnings=frame.warnings,
    )


def _observer(
    recording: Recording, position: np.ndarray, frame: earth.Orientation
) -> tuple[Motion, Tensor | None]:
    """Motion and zenith (T, 3) of an observer of whom the geocentric ``position`` (T, 3) is known."""
    itrs = _turn(np.swapaxes(frame.gcrs_from_itrs, -1, -2), position)
    height = earth.height_km(itrs)
    if ((height > GROUND_KM[0]) & (height < GROUND_KM[1])).all():
        zenith = _turn(frame.gcrs_from_itrs, earth.vertical_itrs(itrs))
        return _earth_fixed(position, frame), torch.from_numpy(zenith)
    rate, _ = _rates(recording, position)
    return Straight(torch.from_numpy(position), torch.from_numpy(rate)), None


def _stations(scene: Scene) -> np.ndarray:
    """Terrestrial positions (S, 3), km."""
    if not scene.stations:
        raise InputError(scene.source, "stations", "none", "the place of the observer")
    places = np.array(
        [[station.latitude, station.longitude, station.height] for station in scene.stations], dtype=float
    )
    return earth.station_itrs(*places.T)


def _earth_fixed(position: np.ndarray, frame: earth.Orientation) -> EarthFixed:
    return EarthFixed(torch.from_numpy(position), torch.from_numpy(frame.axis), earth.ROTATION_RATE)


def _geocentric_sun(recording: Recording) -> Straight:
    position, velocity = earth.sun_of_earth(recording.time)
    return Straight(torch.from_numpy(position), torch.from_numpy(velocity))


def _turn(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """rotation (T, 3, 3) times vector (T, 3)."""
    return np.einsum("tij,tj->ti", rotation, vector)


def _rates(recording: Recording, vector: np.ndarray) -> tuple[np.ndarray, bool]:
    """Time derivative (T, 3) of ``vector`` from neighbouring rows of the same curve; had every row one?

    Second order where both neighbours are near (less than LONGEST_TURN_DEG apart in direction), else first;
    zero without any.
    """
    order = np.lexsort((recording.seconds, recording.curve))
    x, t, curve = vector[order], recording.seconds[order], recording.curve[order]
    step = np.diff(t)
    unit = x / np.linalg.norm(x, axis=-1, keepdims=True)
    near = np.sum(unit[1:] * unit[:-1], axis=-1) > np.cos(np.radians(LONGEST_TURN_DEG))
    linked = (np.diff(curve) == 0) & (step > 0) & near
    slope = np.where(linked[:, None], np.diff(x, axis=0) / np.where(linked, step, 1.0)[:, None], 0.0)
    # of two slopes the one over the shorter step weighs more, as in the parabola through three points
    weight = np.where(linked, 1.0 / np.where(linked, step, 1.0), 0.0)
    before, after = np.append(0.0, weight), np.append(weight, 0.0)
    total = before + after
    slopes = np.pad(slope, ((1, 1), (0, 0)))
    rate = (before[:, None] * slopes[:-1] + after[:, None] * slopes[1:]) / np.where(total > 0, total, 1.0)[
        :, None
    ]
    result = np.empty_like(rate)
    result[order] = rate
    return result, bool((total > 0).all())
