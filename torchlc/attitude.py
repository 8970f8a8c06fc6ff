"""How the body is turned: each mode a pure function of the geometry, rotations with v_gcrs = R v_body.

Letters: T rows; leading axes (...) are batches or instants. The columns of a rotation are the body axes in GCRS.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from astropy.time import Time
from torch import Tensor, nn

from torchlc.errors import InputError
from torchlc.orbit import State
from torchlc.orbit.earth import icrs_from_ecliptic
from torchlc.recording import seconds_since
from torchlc.recording.table import read_columns, read_header, row_place
from torchlc.timestamps import UnreadableTime, instant, julian_dates_of_iso, julian_dates_of_numbers

if TYPE_CHECKING:
    from torchlc.recording import Recording
    from torchlc.scene import Scene

LIGHT_KM_S = 299792.458
QUATERNION_COLUMNS = ("time", "q0", "q1", "q2", "q3")
MAX_NORM_ERROR = 0.01
"""Of a quaternion; beyond rounding it is a sign that the columns are something else."""
SPAN_SLACK_S = 1e-3
"""By which a row may miss the span of the quaternions: Julian dates are rounded to 4e-5 s."""
ALIGNED = 1e-12
"""Square of the sine below which two directions do not define a plane."""


def nadir(position: Tensor, velocity: Tensor) -> Tensor:
    """+Z to Earth's centre, +X along the velocity made orthogonal to it, +Y against the orbit normal; (..., 3) -> (..., 3, 3)."""
    z = _unit(-position)
    y = _unit_cross(z, velocity)
    return torch.stack([torch.linalg.cross(y, z), y, z], dim=-1)


def yaw_steering(position: Tensor, sun: Tensor) -> Tensor:
    """+Z to Earth's centre, +Y = unit(Z x Sun), +X = Y x Z on the Sun's side; any Y where the Sun is along Z."""
    z = _unit(-position)
    y = _unit_cross(z, _unit(sun))
    return torch.stack([torch.linalg.cross(y, z), y, z], dim=-1)


def sun_pointing(sun: Tensor) -> Tensor:
    """+Z to the Sun, X = unit(z_gcrs x Z), Y = Z x X."""
    z = _unit(sun)
    x = _unit_cross(z.new_tensor([0.0, 0.0, 1.0]).expand_as(z), z)
    return torch.stack([x, torch.linalg.cross(z, x), z], dim=-1)


def inertial(x_angle_deg: Tensor) -> Tensor:
    """Z along z_gcrs, X in its equator at ``x_angle_deg`` (...,) from x_gcrs; (..., 3, 3)."""
    return _frame_turned_about_z(torch.deg2rad(x_angle_deg)).transpose(-1, -2)


def rotation_about(axis: Tensor, angle: Tensor) -> Tensor:
    """Right-handed rotation (..., 3, 3) about unit vectors ``axis`` (..., 3) by ``angle`` (...,) rad (Rodrigues)."""
    x, y, z = axis.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    sine, versine = torch.sin(angle)[..., None, None], (2 * torch.sin(angle / 2) ** 2)[..., None, None]
    return torch.eye(3, dtype=axis.dtype, device=axis.device) + sine * cross + versine * (cross @ cross)


def spin_pole(longitude_deg: Tensor, latitude_deg: Tensor, turn: Tensor) -> Tensor:
    """Inertial to body, Rz(turn) Ry(90 deg - latitude) Rz(longitude), each turning the frame; ``turn`` (...,) in revolutions."""
    longitude, colatitude = torch.deg2rad(longitude_deg), torch.deg2rad(90.0 - latitude_deg)
    spin = _frame_turned_about_z(2 * torch.pi * turn)
    return spin @ _frame_turned_about_y(colatitude) @ _frame_turned_about_z(longitude)


def _frame_turned_about_z(angle: Tensor) -> Tensor:
    cos, sin, zero, one = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([cos, sin, zero, -sin, cos, zero, zero, zero, one], dim=-1).unflatten(-1, (3, 3))


def _frame_turned_about_y(angle: Tensor) -> Tensor:
    cos, sin, zero, one = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([cos, zero, -sin, zero, one, zero, sin, zero, cos], dim=-1).unflatten(-1, (3, 3))


def _unit(vector: Tensor) -> Tensor:
    return vector / torch.linalg.norm(vector, dim=-1, keepdim=True)


def _unit_cross(a: Tensor, b: Tensor) -> Tensor:
    """Unit vector along a x b (..., 3), ``a`` being unit; where they are parallel, one at right angles to a."""
    cross = torch.linalg.cross(a, b)
    parallel = (cross**2).sum(-1, keepdim=True) <= ALIGNED * (b**2).sum(-1, keepdim=True)
    x, y = (a.new_tensor(axis).expand_as(a) for axis in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    instead = torch.linalg.cross(a, torch.where(a[..., :1].abs() < 0.8, x, y))
    return _unit(torch.where(parallel, instead, cross))


class Attitude(nn.Module):
    """The attitude of a scene at the rows of a recording; ``rotation`` is where numbers of the scene may be replaced by tensors."""

    def __init__(self, scene: Scene, recording: Recording) -> None:
        super().__init__()
        attitude = scene.attitude
        self.mode = attitude.mode
        self._numbers = {
            name: getattr(number, "value", number)
            for name, number in scene.numbers().items()
            if name.startswith("attitude.")
        }
        self._spinning = attitude.spin_axis is not None
        if attitude.spin_axis is not None:
            axis = torch.tensor(attitude.spin_axis, dtype=torch.float64)
            self.register_buffer("spin_axis", axis / torch.linalg.norm(axis), persistent=False)
        self._spin_epoch_s = _seconds_of_epoch(scene, recording, "spin_epoch")
        self._retarded = self.mode == "spin-pole" and not recording.light_time_corrected
        if self.mode in ("nadir", "yaw-steering"):
            _check_geometry(scene, recording, needs_velocity=self.mode == "nadir")
        elif self.mode == "spin-pole":
            self._epoch_s = _seconds_of_epoch(scene, recording, "epoch")
            frame = icrs_from_ecliptic() if scene.orbit.vectors == "ecliptic" else np.eye(3)
            self.register_buffer("frame", torch.from_numpy(frame), persistent=False)
        elif self.mode == "quaternions":
            self.slerp = read_quaternions(scene.file_path(str(attitude.file)), recording)

    def rotation(self, state: State, values: Mapping[str, Tensor]) -> Tensor:
        """Body to GCRS, (..., T, 3, 3). ``values`` by full name, degrees, rev/h and hours, broadcast against (..., T); a name that
        is absent has the scene's value."""
        time = state.time
        if self.mode == "spin-pole":
            return self._spin_pole(state, values)
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
        angle = torch.deg2rad(phase) + 2 * torch.pi * rate * (time - self._spin_epoch_s) / 3600.0
        return rotation_about(self.spin_axis.expand(*angle.shape, 3), angle)

    def _spin_pole(self, state: State, values: Mapping[str, Tensor]) -> Tensor:
        time = state.time
        if self._retarded:
            time = time - torch.linalg.norm(state.observer, dim=-1) / LIGHT_KM_S
        phase, period, longitude, latitude = (
            self._value(f"attitude.{name}", values, time)
            for name in ("phase", "period", "pole_lon", "pole_lat")
        )
        turn = phase / 360.0 + (time - self._epoch_s) / (3600.0 * period)
        body_from_frame = spin_pole(*torch.broadcast_tensors(longitude, latitude, turn))
        return self.frame @ body_from_frame.transpose(-1, -2)

    def _value(self, name: str, values: Mapping[str, Tensor], like: Tensor) -> Tensor:
        value = values[name] if name in values else self._numbers[name]
        return torch.as_tensor(value, dtype=like.dtype, device=like.device)


class Slerp(nn.Module):
    """Spherical linear interpolation of rotations ``start`` (K, 3, 3) at ``knots`` (K,), s: between two knots the body turns about a
    fixed body ``axis`` (K - 1, 3) at a steady rate, by ``angle`` (K - 1,) in all. Beyond the ends it turns on."""

    knots: Tensor
    start: Tensor
    axis: Tensor
    angle: Tensor

    def __init__(self, knots: np.ndarray, quaternions: np.ndarray) -> None:
        super().__init__()
        w, v = quaternions[:-1, :1], quaternions[:-1, 1:]
        w_next, v_next = quaternions[1:, :1], quaternions[1:, 1:]
        # conj(q_k) q_(k+1), the turn in body axes; of q and -q the one with the shorter way
        cosine = (w * w_next + np.sum(v * v_next, axis=-1, keepdims=True))[:, 0]
        vector = (w * v_next - w_next * v - np.cross(v, v_next)) * np.where(cosine < 0, -1.0, 1.0)[:, None]
        sine = np.linalg.norm(vector, axis=-1)
        still = sine == 0
        tensors = {
            "knots": knots,
            "start": _matrices(quaternions),
            "axis": np.where(still[:, None], [0.0, 0.0, 1.0], vector / np.where(still, 1.0, sine)[:, None]),
            "angle": 2 * np.arctan2(sine, np.abs(cosine)),
        }
        for name, array in tensors.items():
            self.register_buffer(name, torch.from_numpy(array), persistent=False)

    def forward(self, time: Tensor) -> Tensor:
        """Rotations (..., 3, 3) at ``time`` (...,)."""
        last = self.knots.shape[0] - 2
        index = (torch.searchsorted(self.knots, time.detach().contiguous(), right=True) - 1).clamp(0, last)
        fraction = (time - self.knots[index]) / (self.knots[index + 1] - self.knots[index])
        return self.start[index] @ rotation_about(self.axis[index], self.angle[index] * fraction)


def _matrices(q: np.ndarray) -> np.ndarray:
    """Rotations (K, 3, 3), v' = q v q*, of Hamilton quaternions (K, 4), scalar first."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def read_quaternions(path: Path, recording: Recording) -> Slerp:
    """Read time,q0,q1,q2,q3 (times in the recording's scale), in any order of time; every row of the recording must be inside."""
    times, quaternions = _quaternion_rows(path, recording.time.scale)
    order = np.argsort((times - recording.time[0]).jd)
    seconds, quaternions = seconds_since(times, recording.time[0])[order], quaternions[order]
    norm = np.linalg.norm(quaternions, axis=-1)
    wrong = np.flatnonzero(~(np.abs(norm - 1) < MAX_NORM_ERROR))
    if wrong.size:
        place = row_place(int(order[wrong[0]]), "q0")
        raise InputError(path, place, f"a quaternion of length {norm[wrong[0]]:.4g}", "length 1")
    repeated = np.flatnonzero(np.diff(seconds) <= 0)
    if repeated.size:
        raise InputError(
            path, row_place(int(order[repeated[0] + 1]), "time"), "the time of another row", "distinct times"
        )
    first, last = seconds[0] - SPAN_SLACK_S, seconds[-1] + SPAN_SLACK_S
    outside = np.flatnonzero((recording.seconds < first) | (recording.seconds > last))
    if outside.size:
        span = f"{times[order[0]].isot} to {times[order[-1]].isot}"
        found = (
            f"the recording has {outside.size} rows outside, the first at {recording.time[outside[0]].isot}"
        )
        raise InputError(path, None, found, f"quaternions for all rows; these go from {span}")
    return Slerp(seconds, quaternions / norm[:, None])


def _quaternion_rows(path: Path, scale: str) -> tuple[Time, np.ndarray]:
    header = read_header(path)
    missing = [name for name in QUATERNION_COLUMNS if name not in header.names]
    if missing:
        raise InputError(path, "header", f"no column {missing[0]}", ",".join(QUATERNION_COLUMNS))
    kinds = dict.fromkeys(QUATERNION_COLUMNS, "number") | {"time": "text"}
    count, columns = read_columns(header, kinds)
    if count < 2:
        raise InputError(path, None, f"{count} row", "at least 2")
    try:
        jd1, jd2 = _julian_dates(columns["time"], scale)
    except UnreadableTime as error:
        raise InputError(path, row_place(error.index, "time"), repr(error.found), error.expected) from None
    quaternions = np.stack([columns[name] for name in QUATERNION_COLUMNS[1:]], axis=-1)
    return Time(jd1, jd2, format="jd", scale=scale), quaternions


def _julian_dates(texts: list[str], scale: str) -> tuple[np.ndarray, np.ndarray]:
    try:
        numbers = np.array(list(map(float, texts)))
    except ValueError:
        return julian_dates_of_iso(texts, scale)
    return julian_dates_of_numbers(numbers, scale)


def _check_geometry(scene: Scene, recording: Recording, *, needs_velocity: bool) -> None:
    lacks_position = scene.orbit.vectors is not None and recording.position is None
    lacks_velocity = scene.orbit.altaz or (scene.orbit.vectors is not None and recording.velocity is None)
    if lacks_position or (needs_velocity and lacks_velocity):
        columns = "r_x r_y r_z and v_x v_y v_z" if needs_velocity else "r_x r_y r_z"
        raise InputError(
            scene.source,
            "attitude.mode",
            f'"{scene.attitude.mode}" without the object\'s {"velocity" if not lacks_position else "position"}',
            f"columns {columns} in the recording, or a TLE",
            'Mode "yaw-steering" needs no velocity.' if needs_velocity and not lacks_position else None,
        )


def _seconds_of_epoch(scene: Scene, recording: Recording, key: str) -> float:
    """Seconds from the recording's row 0 to an epoch of the scene, by default the first time of the file."""
    epoch = getattr(scene.attitude, key)
    if epoch is None:
        return float(seconds_since(recording.first_time, recording.time[0]))
    try:
        return float(seconds_since(instant(epoch, recording.time.scale), recording.time[0]))
    except UnreadableTime as error:
        raise InputError(scene.source, f"attitude.{key}", repr(error.found), error.expected) from None
