"""How the body is turned: each mode a pure function of the geometry, rotations with v_gcrs = R v_body.

Letters: T rows; leading axes (...) are batches or instants. Modes map vectors (..., 3) to rotations
(..., 3, 3), whose columns are the body axes in GCRS.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from torchlc.errors import InputError
from torchlc.files.numbers import Free, value_of
from torchlc.geometry.orbit import State
from torchlc.geometry.orbit.earth import LIGHT_KM_S, icrs_from_ecliptic
from torchlc.geometry.rotation.matrices import (
    frame_turned_about_y,
    frame_turned_about_z,
    rotation_about,
    rotation_of,
)
from torchlc.geometry.rotation.quaternions import Slerp, read_quaternions
from torchlc.geometry.rotation.rigid_body import free_rotation
from torchlc.readers import seconds_since
from torchlc.scene.timestamps import UnreadableTime, instant
from torchlc.shapes.part import frame_about
from torchlc.tensors.autodiff_state import readable, transformed
from torchlc.tensors.vectors import dot, unit

if TYPE_CHECKING:
    from torchlc.readers import Recording
    from torchlc.scene import Scene

ALIGNED = 1e-12
"""Square of the sine below which two directions do not define a plane."""
TURNING = ("spin-pole", "rigid-body")
"""Modes of a body that turns about a direction in space by itself, with a period."""
FURTHER = frozenset(("attitude.period_rate",))
"""Numbers of these modes that a scene need not have, and an effect may bring."""
MS_A_DAY = 1e-3 / 86400.0
SLIGHT = 1e-4
"""Relative change of the period up to which the turns are taken by a series: its first term left out is 1e-17."""
SHORTEST = 1e-6
"""Share of the period at the epoch below which a period that falls is held: it would reach 0."""


def nadir(position: Tensor, velocity: Tensor) -> Tensor:
    """+Z to Earth's centre, +X along the velocity made orthogonal to it, +Y against the orbit normal."""
    z = unit(-position)
    y = _unit_cross(z, velocity)
    return torch.stack([torch.linalg.cross(y, z), y, z], dim=-1)


def yaw_steering(position: Tensor, sun: Tensor) -> Tensor:
    """+Z to Earth's centre, +Y = unit(Z x Sun), +X = Y x Z; any Y where the Sun is along Z."""
    z = unit(-position)
    y = _unit_cross(z, unit(sun))
    return torch.stack([torch.linalg.cross(y, z), y, z], dim=-1)


def sun_pointing(sun: Tensor) -> Tensor:
    """+Z to the Sun, X = unit(z_gcrs x Z), Y = Z x X."""
    z = unit(sun)
    x = _unit_cross(z.new_tensor([0.0, 0.0, 1.0]).expand_as(z), z)
    return torch.stack([x, torch.linalg.cross(z, x), z], dim=-1)


def inertial(x_angle_deg: Tensor) -> Tensor:
    """Z along z_gcrs, X in its equator at ``x_angle_deg`` (...,) from x_gcrs; (..., 3, 3)."""
    return frame_turned_about_z(torch.deg2rad(x_angle_deg)).transpose(-1, -2)


def spin_pole(longitude_deg: Tensor, latitude_deg: Tensor, turn: Tensor) -> Tensor:
    """Body from inertial, Rz(turn) Ry(90 deg - latitude) Rz(longitude), each turning the frame; ``turn`` in
    revolutions, the angles in degrees.
    """
    return frame_turned_about_z(2 * torch.pi * turn) @ _about_pole(longitude_deg, latitude_deg)


def _about_pole(longitude_deg: Tensor, latitude_deg: Tensor) -> Tensor:
    """Ry(90 deg - latitude) Rz(longitude): from inertial to the frame whose z is a pole."""
    longitude, colatitude = torch.deg2rad(longitude_deg), torch.deg2rad(90.0 - latitude_deg)
    return frame_turned_about_y(colatitude) @ frame_turned_about_z(longitude)


def turns(elapsed_s: Tensor, period_s: Tensor, rate: Tensor | None = None) -> Tensor:
    """Turns in ``elapsed_s`` of a body whose period is ``period_s`` + ``rate`` times the time elapsed: ln(1 + rate t / P) /
    rate. ``rate``, s/s, may be 0. A period that falls is held at SHORTEST of its start: without a torque it would not."""
    steady = elapsed_s / period_s
    return steady if rate is None else grown(steady, rate * steady)


def grown(steady: Tensor, growth: Tensor) -> Tensor:
    """Turns of a body whose period has grown by the share ``growth``, where without a growth they would be ``steady``."""
    x = growth.clamp(min=SHORTEST - 1.0)
    slight = x.abs() < SLIGHT
    larger = torch.where(slight, 1.0, x)
    series = 1 - x / 2 + x**2 / 3 - x**3 / 4
    return steady * torch.where(slight, series, torch.log1p(larger) / larger)


def _unit_cross(a: Tensor, b: Tensor) -> Tensor:
    """Unit vector along a x b (..., 3), ``a`` being unit; where they are parallel, one at right angles."""
    cross = torch.linalg.cross(a, b)
    parallel = (dot(cross, cross) <= ALIGNED * dot(b, b))[..., None]
    if not transformed() and readable(parallel) and not bool(parallel.any()):
        return unit(cross)
    x, y = (a.new_tensor(axis).expand_as(a) for axis in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    instead = torch.linalg.cross(a, torch.where(a[..., :1].abs() < 0.8, x, y))
    return unit(torch.where(parallel, instead, cross))


class Attitude(nn.Module):
    """The attitude of a scene at the rows of a recording.

    ``about_spin_axis``: right-handed rows of the body frame (3, 3), the last along the axis of spin: the body's own for +Z.
    """

    spin_axis: Tensor
    about_spin_axis: Tensor
    frame: Tensor
    slerp: Slerp

    def __init__(self, scene: Scene, recording: Recording) -> None:
        super().__init__()
        attitude = scene.attitude
        self.mode = attitude.mode
        numbers = attitude.numbers()
        self.numbers = {f"attitude.{key}": value_of(number) for key, number in numbers.items()}
        self._rates = _starting_rates(numbers)
        self._spinning = attitude.spin_axis is not None
        if attitude.spin_axis is not None:
            axis = torch.tensor(attitude.spin_axis, dtype=torch.float64)
            self.register_buffer("spin_axis", axis / torch.linalg.norm(axis), persistent=False)
        about = np.array([0.0, 0.0, 1.0] if self.mode in TURNING else attitude.spin_axis or [0.0, 0.0, 1.0])
        about = torch.from_numpy(frame_about(about / np.linalg.norm(about)))
        self.register_buffer("about_spin_axis", about, persistent=False)
        self._spin_epochs_s = epochs_seconds(scene, recording, "spin_epoch")
        self._retarded = self.mode in TURNING and not recording.light_time_corrected
        if self.mode in ("nadir", "yaw-steering"):
            _check_geometry(scene, recording, needs_velocity=self.mode == "nadir")
        elif self.mode in TURNING:
            self._epochs_s = epochs_seconds(scene, recording, "epoch")
            seconds = torch.from_numpy(recording.seconds)
            _check_rate(scene, recording, since_nearest(seconds, self._epochs_s).numpy())
            frame = icrs_from_ecliptic() if scene.orbit.vectors == "ecliptic" else np.eye(3)
            self.register_buffer("frame", torch.from_numpy(frame), persistent=False)
        elif self.mode == "quaternions":
            self.slerp = read_quaternions(scene.file_path(str(attitude.file)), recording)

    @property
    def spins(self) -> bool:
        """Whether there is a rate of spin, be it 0."""
        return self._spinning or self.mode in TURNING

    @property
    def spin_rate_at_start(self) -> float:
        """Rate of spin, rev/h, where the scene's numbers begin, the fastest if there are several; 0 without a spin."""
        return max(self._rates, key=abs) if self.spins else 0.0

    def rotation(self, state: State, values: Mapping[str, Tensor]) -> Tensor:
        """Body to GCRS, (..., T, 3, 3). ``values`` by full name, degrees, rev/h and hours, broadcast
        against (..., T); a name that is absent has the scene's value.
        """
        time = state.time
        if self.mode in TURNING:
            return self._turning(state, values)
        if self.mode == "quaternions":
            return self.slerp(time)
        if self.mode == "nadir":
            assert state.position is not None and state.velocity is not None
            start = nadir(state.position, state.velocity)
        elif self.mode == "yaw-steering":
            assert state.position is not None
            start = yaw_steering(state.position, state.sun)
        elif self.mode == "sun":
            start = sun_pointing(state.sun)
        else:
            x_angle = self._value("attitude.x_angle", values, time)
            start = inertial(torch.broadcast_tensors(x_angle, time)[0])
        return start @ self._spin(time, values) if self._spinning else start

    def _spin(self, time: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """The further spin: phase + 360 deg rate (t - epoch) about a body axis."""
        phase = self._value("attitude.spin_phase", values, time)
        rate = self._value("attitude.spin_rate", values, time)
        elapsed = since_nearest(time, self._spin_epochs_s)
        turn = rate * elapsed / 3600.0
        if "attitude.period_rate" in values:
            growth = MS_A_DAY * self._value("attitude.period_rate", values, time)
            turn = grown(turn, growth * rate.abs() * elapsed / 3600.0)
        angle = torch.deg2rad(phase) + 2 * torch.pi * turn
        return rotation_about(self.spin_axis.expand(*angle.shape, 3), angle)

    def _turning(self, state: State, values: Mapping[str, Tensor]) -> Tensor:
        time = state.time
        if self._retarded:
            time = time - torch.linalg.norm(state.observer, dim=-1) / LIGHT_KM_S
        number = {name: self._value(name, values, time) for name in (*self.numbers, *FURTHER & values.keys())}
        phase, period, longitude, latitude = (
            number[f"attitude.{name}"] for name in ("phase", "period", "pole_lon", "pole_lat")
        )
        rate = number.get("attitude.period_rate")
        elapsed = since_nearest(time, self._epochs_s)
        turn = turns(elapsed, 3600.0 * period, None if rate is None else MS_A_DAY * rate)
        if self.mode == "spin-pole":
            body_from_frame = spin_pole(*torch.broadcast_tensors(longitude, latitude, phase / 360.0 + turn))
            rotation = self.frame @ body_from_frame.transpose(-1, -2)
        else:
            about = _about_pole(*torch.broadcast_tensors(longitude, latitude)).transpose(-1, -2)
            rotation = self.frame @ about @ _free(turn, number)
        if "attitude.tilt_x" in number:
            tilt = torch.broadcast_tensors(*(number[f"attitude.tilt_{axis}"] for axis in "xyz"))
            rotation = rotation @ rotation_of(torch.deg2rad(torch.stack(tilt, -1)))
        return rotation

    def _value(self, name: str, values: Mapping[str, Tensor], like: Tensor) -> Tensor:
        value = values[name] if name in values else self.numbers[name]
        return torch.as_tensor(value, dtype=like.dtype, device=like.device)


def _free(turn: Tensor, number: Mapping[str, Tensor]) -> Tensor:
    """Principal axes to the frame with z along the angular momentum, (..., T, 3, 3), after ``turn`` (..., T) mean turns
    of the long axis; numbers (..., 1), or (..., T) where rows have their own.

    The phase is that of :func:`free_rotation`, but counted from the x axis where z has the largest moment, so that
    without nutation this is uniform spin, whichever of x and y has the smaller one.
    """
    phase, polhode, nutation, x, y = (
        number[f"attitude.{name}"]
        for name in ("phase", "polhode_phase", "nutation", "inertia_x", "inertia_y")
    )
    x, y, nutation = torch.broadcast_tensors(x, y, torch.deg2rad(nutation))
    moments = torch.stack([x, y, torch.ones_like(x)], -1)
    quarter = 0.25 * ((y < x) & (x < 1)).to(turn)
    phase, polhode, one = phase / 360.0 + quarter, polhode / 360.0, torch.ones_like(turn[..., :1])
    if nutation.ndim and nutation.shape[-1] > 1:  # every row its own state
        phase, polhode, turn = (part[..., None] for part in torch.broadcast_tensors(phase, polhode, turn))
        return free_rotation(turn, moments, nutation[..., None], one[..., None], phase, polhode)[..., 0, :, :]
    if nutation.ndim:
        moments = moments[..., 0, :]
    else:
        nutation = nutation[None]
    return free_rotation(turn, moments, nutation, one, phase, polhode)


def since_nearest(time: Tensor, epochs_s: Sequence[float]) -> Tensor:
    """Seconds ``time`` (...) since the nearest of the epochs, in order. It jumps halfway between two of them, where no
    row is."""
    elapsed = time - epochs_s[0]
    for before, after in itertools.pairwise(epochs_s):
        elapsed = elapsed - (after - before) * (time > (before + after) / 2).to(time)
    return elapsed


def _starting_rates(numbers: Mapping[str, float | Free]) -> list[float]:
    """Rates of spin, rev/h, at which the numbers of an attitude start: one, or those of nights, say."""

    def starts(name: str) -> tuple[float, ...]:
        number = numbers.get(name, 0.0)
        return number.starts if isinstance(number, Free) else (number,)

    return [1 / period for period in starts("period")] if "period" in numbers else list(starts("spin_rate"))


def _check_rate(scene: Scene, recording: Recording, elapsed: np.ndarray) -> None:
    """InputError if the scene's period falls to 0 within the recording."""
    numbers = scene.attitude.numbers()
    rates, periods = (_at_rows(numbers.get(name, 0.0), recording) for name in ("period_rate", "period"))
    worst = int((1 + MS_A_DAY * rates * elapsed / (3600.0 * periods)).argmin())
    rate, period = float(rates[worst]), 3600.0 * float(periods[worst])
    if 1 + MS_A_DAY * rate * float(elapsed[worst]) / period <= SHORTEST:
        raise InputError(
            scene.source,
            "attitude.period_rate",
            f"{rate:g} ms a day: a period of {period:g} s at the epoch is 0 at a row of the recording",
            "a rate, or an epoch nearer to the rows, with which the period stays above 0",
        )


def _at_rows(number: float | Free, recording: Recording) -> np.ndarray:
    """Where a number starts at each row, (T,)."""
    if not isinstance(number, Free) or number.values is None:
        return np.full(len(recording), value_of(number))
    index, ids = {
        "curve": (recording.curve, recording.curve_ids),
        "station": (recording.station, recording.station_ids),
        "night": (recording.night, recording.night_ids),
        "object": (recording.object, recording.object_ids),
    }[str(number.per)]
    each = np.array([number.of(member).value for member in ids])
    return np.full(len(recording), number.value) if index is None else each[index]


def _check_geometry(scene: Scene, recording: Recording, *, needs_velocity: bool) -> None:
    lacks_position = scene.orbit.vectors is not None and recording.position is None
    lacks_velocity = scene.orbit.altaz or (scene.orbit.vectors is not None and recording.velocity is None)
    if lacks_position or (needs_velocity and lacks_velocity):
        columns = "r_x r_y r_z and v_x v_y v_z" if needs_velocity else "r_x r_y r_z"
        raise InputError(
            scene.source,
            "attitude.mode",
            f'"{scene.attitude.mode}" with no {"position" if lacks_position else "velocity"} of the object',
            f"columns {columns} in the recording, or a TLE",
            'Mode "yaw-steering" needs no velocity.' if needs_velocity and not lacks_position else None,
        )


def epochs_seconds(scene: Scene, recording: Recording, key: str) -> list[float]:
    """Seconds from the recording's row 0 to the epochs of the scene, in order; by default to the first time of the file."""
    given = getattr(scene.attitude, key)
    first: Any = recording.time[0]
    several = given if isinstance(given, tuple) else (given,)
    try:
        moments = [
            recording.first_time if epoch is None else instant(epoch, first.scale) for epoch in several
        ]
    except UnreadableTime as error:
        raise InputError(scene.source, f"attitude.{key}", repr(error.found), error.expected) from None
    epochs = sorted(float(seconds_since(moment, first)) for moment in moments)
    if len(epochs) > 1:
        _check_nights(scene, recording, key, np.array(epochs))
    return epochs


def _check_nights(scene: Scene, recording: Recording, key: str, epochs: np.ndarray) -> None:
    """InputError where rows of one night are nearest to unlike epochs: the body would jump among them."""
    nearest = np.searchsorted((epochs[1:] + epochs[:-1]) / 2, recording.seconds)
    for number, name in enumerate(recording.night_ids):
        if len(np.unique(nearest[recording.night == number])) > 1:
            raise InputError(
                scene.source,
                f"attitude.{key}",
                f"two epochs for rows of the night {name}",
                "epochs such that all rows of a night are nearest to the same",
            )
