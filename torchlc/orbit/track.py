"""From scene and recording to where object, observer and Sun are: ``make_track`` once, then ``Track.at``
for any offsets.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from astropy.utils import iers
from astropy.utils.exceptions import AstropyWarning
from erfa import ErfaWarning
from torch import Tensor, nn

from torchlc.errors import InputError
from torchlc.orbit import earth
from torchlc.orbit.elements import ElementSet
from torchlc.orbit.motion import EarthFixed, Motion, Straight, TwoBody, inverse_semi_major_axis

if TYPE_CHECKING:
    from torchlc.recording import Recording
    from torchlc.scene import Scene

LONGEST_TURN_DEG = 5.0
"""Between neighbouring rows of a curve whose difference may serve as a rate: the chord is then 0.1 % short.
"""
GROUND_KM = (-1.0, 50.0)
"""Ellipsoidal heights at which an observer turns with the Earth."""


@dataclass(frozen=True)
class State:
    """Geometry with leading axes (..., T), GCRS (ICRS axes): ``time`` s since the recording's first row, of
    the light leaving the object; ``position`` km and ``velocity`` km/s, geocentric, None where unknown;
    ``sun`` and ``observer`` km, from the object. Offsets of different shapes leave the fields in different
    shapes, which broadcast.
    """

    time: Tensor
    position: Tensor | None
    velocity: Tensor | None
    sun: Tensor
    observer: Tensor


class Track(nn.Module):
    """Motions of observer, object and Sun about the T rows of a recording; frozen, moved between devices
    with ``to``.

    ``seconds`` (T,) are the stamps, ``zenith`` (T, 3) the observer's vertical, ``elevation_deg`` and
    ``airmass`` (T,) its use, None where the observer's place on the Earth is unknown; ``range_km`` and
    ``phase_angle_deg`` (T,); all at the stamps, offsets zero.
    """

    seconds: Tensor
    seconds_per_radian: Tensor
    zenith: Tensor | None
    range_km: Tensor
    phase_angle_deg: Tensor
    elevation_deg: Tensor | None
    airmass: Tensor | None

    def __init__(
        self,
        seconds: Tensor,
        *,
        observer: Motion,
        object_: Motion,
        sun: Motion,
        known: frozenset[str],
        seconds_per_radian: Tensor | None = None,
        zenith: Tensor | None = None,
        warnings: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.observer, self.object, self.sun = observer, object_, sun
        self.warnings = warnings
        self._known = known
        slowness = torch.zeros_like(seconds) if seconds_per_radian is None else seconds_per_radian
        state = {"seconds": seconds, "seconds_per_radian": slowness, "zenith": zenith}
        for name, tensor in state.items():
            self.register_buffer(name, tensor, persistent=False)
        at_stamps = self.at(0.0, 0.0, 0.0)
        elevation = None if zenith is None else elevation_deg(zenith, -at_stamps.observer)
        derived = {
            "range_km": torch.linalg.norm(at_stamps.observer, dim=-1),
            "phase_angle_deg": torch.rad2deg(angle_between(at_stamps.sun, at_stamps.observer)),
            "elevation_deg": elevation,
            "airmass": None if elevation is None else airmass(elevation),
        }
        for name, tensor in derived.items():
            self.register_buffer(name, tensor, persistent=False)

    def supports(self, what: str) -> bool:
        """Whether the recording lets one know "position", "velocity", "elevation", or move "time_offset" or
        "along_track".
        """
        return what in self._known

    def at(
        self, observer_offset: Tensor | float, object_offset: Tensor | float, ahead: Tensor | float
    ) -> State:
        """State with the observer at stamp + ``observer_offset``, the object and the Sun at stamp +
        ``object_offset`` (s, (..., T)), and the object ``ahead`` rad of mean anomaly further along its
        orbit (the Sun's and the spin's clocks are not touched).
        """
        observer_offset, object_offset, ahead = (
            torch.as_tensor(offset, dtype=self.seconds.dtype, device=self.seconds.device)
            for offset in (observer_offset, object_offset, ahead)
        )
        position, velocity = self.object(object_offset + ahead * self.seconds_per_radian)
        observer, _ = self.observer(observer_offset)
        sun, _ = self.sun(object_offset)
        return State(
            time=self.seconds + object_offset,
            position=position if self.supports("position") else None,
            velocity=velocity if self.supports("velocity") else None,
            sun=sun - position,
            observer=observer - position,
        )


def make_track(scene: Scene, recording: Recording) -> Track:
    """Everything that SGP4 and astropy have to say about the rows; from bundled tables, never from the
    network.
    """
    with warnings.catch_warnings(), iers.conf.set_temp("auto_download", False):
        warnings.simplefilter("ignore", AstropyWarning)
        warnings.simplefilter("ignore", ErfaWarning)
        if scene.orbit.tle is not None:
            return _track_of_elements(scene, recording, scene.orbit.tle)
        if scene.orbit.altaz:
            return _track_of_altaz(scene, recording)
        return _track_of_vectors(scene, recording)


def above_horizon(track: Track) -> np.ndarray:
    """Rows (T,) at which the object is above the geometric horizon; all of them where the elevation is
    unknown.
    """
    if track.elevation_deg is None:
        return np.ones(track.seconds.shape[0], dtype=bool)
    return (track.elevation_deg > 0).cpu().numpy()


def angle_between(a: Tensor, b: Tensor) -> Tensor:
    """Angle (...,), rad, between vectors (..., 3), accurate at 0 and pi, where its gradient is taken as
    zero.
    """
    cross2 = (torch.linalg.cross(a, b) ** 2).sum(-1)
    apart = cross2 > 0
    sine = torch.where(apart, torch.sqrt(torch.where(apart, cross2, 1.0)), 0.0)
    return torch.atan2(sine, (a * b).sum(-1))


def elevation_deg(zenith: Tensor, to_object: Tensor) -> Tensor:
    """Geometric elevation (...,), degrees; refraction, 0.5 deg at the horizon, is neglected."""
    return 90.0 - torch.rad2deg(angle_between(zenith.expand_as(to_object), to_object))


def airmass(elevation: Tensor) -> Tensor:
    """Kasten & Young (1989), Appl. Opt. 28, 4735, of a geometric elevation (...,) in degrees; below the
    horizon that of the horizon, 38.
    """
    height = elevation.clamp(min=0.0)
    return 1.0 / (torch.sin(torch.deg2rad(height)) + 0.50572 * (height + 6.07995) ** -1.6364)


def _track_of_elements(scene: Scene, recording: Recording, lines: tuple[str, str]) -> Track:
    elements = ElementSet(lines, scene.source)
    elements.check(recording.time)
    frame = earth.orientation(recording.time)
    exposure_s = 0.0 if recording.exptime is None else float(np.nanmax(recording.exptime, initial=0.0))
    observer_itrs = _stations(scene)[recording.station]
    return Track(
        torch.from_numpy(recording.seconds),
        observer=_earth_fixed(_turn(frame.gcrs_from_itrs, observer_itrs), frame),
        object_=elements.motion(recording.time, recording.seconds, frame.gcrs_from_teme, exposure_s),
        sun=_geocentric_sun(recording),
        known=frozenset({"position", "velocity", "time_offset", "along_track", "elevation"}),
        seconds_per_radian=torch.full(
            (len(recording.seconds),), 1.0 / elements.mean_motion, dtype=torch.float64
        ),
        zenith=torch.from_numpy(_turn(frame.gcrs_from_itrs, earth.vertical_itrs(observer_itrs))),
        warnings=(*elements.age_warning(recording.time), *frame.warnings),
    )


def _track_of_altaz(scene: Scene, recording: Recording) -> Track:
    """Rows placed from the station; nothing tells how the object moves on, so it stands still under
    offsets.
    """
    if recording.alt is None or recording.az is None or recording.height is None:
        raise InputError(
            recording.source, "columns", "no alt, az and height", "all three, for a scene with altaz = true"
        )
    frame = earth.orientation(recording.time)
    observer_itrs = _stations(scene)[recording.station]
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
        known=frozenset({"time_offset"}),
    )


def _geocentric_track(
    recording: Recording,
    sun: np.ndarray,
    observer: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray | None,
) -> Track:
    known = {"position"}
    if velocity is not None:
        known |= {"velocity", "time_offset"}
        rate = velocity
    else:
        rate, everywhere = _rates(recording, position)
        known |= {"time_offset"} if everywhere else set()
    place, moving = torch.from_numpy(position), torch.from_numpy(rate)
    per_axis = inverse_semi_major_axis(place, moving)
    bound = bool((per_axis > 0).all()) and "time_offset" in known
    object_ = TwoBody(place, moving) if bound else Straight(place, moving)
    if bound and velocity is not None:
        known.add("along_track")
    frame = earth.orientation(recording.time)
    observer_place = position + observer
    itrs = _turn(np.swapaxes(frame.gcrs_from_itrs, -1, -2), observer_place)
    height = earth.height_km(itrs)
    zenith = None
    if ((height > GROUND_KM[0]) & (height < GROUND_KM[1])).all():
        known.add("elevation")
        zenith = torch.from_numpy(_turn(frame.gcrs_from_itrs, earth.vertical_itrs(itrs)))
        observer_motion: Motion = _earth_fixed(observer_place, frame)
    else:
        observer_rate, _ = _rates(recording, observer_place)
        observer_motion = Straight(torch.from_numpy(observer_place), torch.from_numpy(observer_rate))
    _, sun_rate = earth.sun_of_earth(recording.time)
    return Track(
        torch.from_numpy(recording.seconds),
        observer=observer_motion,
        object_=object_,
        sun=Straight(torch.from_numpy(position + sun), torch.from_numpy(sun_rate)),
        known=frozenset(known),
        seconds_per_radian=1 / object_.mean_motion if isinstance(object_, TwoBody) else None,
        zenith=zenith,
        warnings=frame.warnings,
    )


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
    """Time derivative (T, 3) of ``vector`` from the neighbouring rows of the same curve, and whether every
    row had a neighbour.

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
