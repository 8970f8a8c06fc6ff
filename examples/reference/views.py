"""Geometry of rows: where object, Sun and station are at each instant, and how body and wings are turned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import sky
from body import Part, Scene, body_axes, rotation_about, spin, wing_pose
from curve import Effects
from sky import Array, apply, unit


@dataclass(frozen=True)
class View:
    """Geometry of rows at K instants (T, K, ...), directions in the body frame."""

    to_sun: Array  # (T, K, 3) unit
    sun_distance_km: Array  # (T, K)
    to_observer: Array  # (T, K, 3) unit
    range_km: Array  # (T, K)
    to_body: Array  # (T, K, 3, 3) from GCRS
    position: Array  # (T, K, 3) GCRS, km
    to_earth_axis: Array  # (T, K, 3, 3) from GCRS, z the axis of date
    poses: list[Array | None]
    zenith: Array  # (T, K, 3) GCRS
    station_to_sun: Array  # (T, K, 3) GCRS

    def _each(self, pick: Callable[[Any], Any]) -> View:
        """``pick`` applied to every array."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        poses = [None if pose is None else pick(pose) for pose in values.pop("poses")]
        return View(poses=poses, **{name: pick(value) for name, value in values.items()})

    def rows(self, rows: slice) -> View:
        return self._each(lambda values: values[rows])

    def at(self, instant: int) -> View:
        """One instant, without the axis K."""
        return self._each(lambda values: values[:, instant])


def view_of(
    scene: Scene, parts: list[Part], t: Array, first: float, station: Array, effects: Effects
) -> View:
    clock = t + effects.get("time_offset", {}).get("s", 0.0)
    site, zenith = np.zeros((*t.shape, 3)), np.zeros((*t.shape, 3))
    for name in np.unique(station):
        rows = station == name
        site[rows], zenith[rows] = sky.station(clock[rows], *scene.stations[str(name)])
    orbit = sky.Orbit(scene.tle)
    ahead = effects.get("along_track_offset", {}).get("deg", 0.0) / 360.0 * orbit.period_s
    emitted = clock
    if "light_time" in effects:
        for _ in range(2):
            emitted = clock - np.linalg.norm(orbit.state(emitted + ahead)[0] - site, axis=-1) / sky.LIGHT_KM_S
    position, velocity = orbit.state(emitted + ahead)
    to_sun = sky.sun(emitted) - position
    to_observer = site - position
    sun_distance, range_km = np.linalg.norm(to_sun, axis=-1), np.linalg.norm(to_observer, axis=-1)
    sun_unit = to_sun / sun_distance[..., None]

    attitude = scene.attitude
    nominal = body_axes(attitude, position, velocity, sun_unit)
    if "spin_axis" in attitude:
        rate = effects.get("spin_rate_offset", {}).get("rev_per_hour", 0.0)
        nominal = nominal @ spin(attitude, emitted, first, rate)
    tilt = np.zeros((*t.shape, 3))
    if "attitude_offset" in effects:
        tilt = tilt + np.deg2rad([effects["attitude_offset"].get(axis, 0.0) for axis in "xyz"])
    if "attitude_jump" in effects:
        jump = effects["attitude_jump"]
        tilt = tilt + (clock > jump["time"])[..., None] * np.deg2rad([jump.get(axis, 0.0) for axis in "xyz"])
    if "wobble" in effects:
        wobble = effects["wobble"]
        turns = (emitted - first) / (60.0 * wobble["period_min"]) + wobble.get("phase_deg", 0.0) / 360.0
        axis = np.eye(3)["xyz".index(wobble["axis"])]
        tilt = tilt + np.deg2rad(wobble["deg"]) * np.sin(2.0 * np.pi * turns)[..., None] * axis
    actual = nominal
    if np.any(tilt):
        angle = np.linalg.norm(tilt, axis=-1)
        axis = np.where(angle[..., None] > 0, tilt, [0.0, 0.0, 1.0])
        actual = nominal @ rotation_about(axis, angle)
    to_body = np.swapaxes(actual, -1, -2)
    body_sun = apply(to_body, sun_unit)

    offset = effects.get("panel_offset", {}).get("deg", 0.0)
    split = effects.get("wing_split", {}).get("deg", 0.0)
    cant = np.deg2rad(effects.get("panel_cant", {}).get("deg", 0.0))
    poses: list[Array | None] = []
    wing = 0
    for part in parts:
        own = offset + (split if wing % 2 == 0 else -split)
        wing += part.axis is not None
        poses.append(wing_pose(part, body_sun, np.deg2rad(own), cant))
    return View(
        to_sun=body_sun,
        sun_distance_km=sun_distance,
        to_observer=apply(to_body, to_observer / range_km[..., None]),
        range_km=range_km,
        to_body=to_body,
        position=position,
        to_earth_axis=np.swapaxes(sky.teme_to_gcrs(clock), -1, -2),
        poses=poses,
        zenith=zenith,
        station_to_sun=unit(to_sun + position - site),
    )
