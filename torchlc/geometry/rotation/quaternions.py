"""A recorded attitude: quaternions from a CSV file, and rotations between them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from astropy.time import Time
from torch import Tensor, nn

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.geometry.rotation.matrices import rotation_about
from torchlc.readers import Recording, seconds_since
from torchlc.readers.formats import read_header
from torchlc.readers.table import Header, read_columns, read_numbers, row_place
from torchlc.scene.timestamps import JULIAN_DATE, UnreadableTime, julian_dates_of_iso, julian_dates_of_numbers

COMPONENTS = ("q0", "q1", "q2", "q3")
MAX_NORM_ERROR = 0.01
"""Of a quaternion; more than rounding is a sign that the columns hold something else."""
SPAN_SLACK_S = 1e-3
"""By which a row may miss the span of the quaternions: Julian dates are rounded to 4e-5 s."""


class Slerp(nn.Module):
    """Spherical linear interpolation of rotations ``start`` (K, 3, 3) at ``knots`` (K,), s: between two
    knots the body turns about a fixed body ``axis`` (K - 1, 3) at a steady rate, by ``angle`` (K - 1,) in
    all. Beyond the ends it turns on.
    """

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
    """Read time,q0,q1,q2,q3, times in the recording's scale and in any order; all its rows must be inside."""
    first: Any = recording.time[0]
    times, quaternions = _rows(path, first.scale)
    seconds = seconds_since(times, first)
    order = np.argsort(seconds)
    seconds, quaternions = seconds[order], quaternions[order]
    norm = np.linalg.norm(quaternions, axis=-1)
    wrong = np.flatnonzero(~(np.abs(norm - 1) < MAX_NORM_ERROR))
    if wrong.size:
        place = row_place(int(order[wrong[0]]), "q0")
        raise InputError(path, place, f"a quaternion of length {norm[wrong[0]]:.4g}", "length 1")
    repeated = np.flatnonzero(np.diff(seconds) <= 0)
    if repeated.size:
        place = row_place(int(order[repeated[0] + 1]), "time")
        raise InputError(path, place, "the time of another row", "distinct times")
    early, late = seconds[0] - SPAN_SLACK_S, seconds[-1] + SPAN_SLACK_S
    outside = np.flatnonzero((recording.seconds < early) | (recording.seconds > late))
    if outside.size:
        iso = times.isot
        where = recording.time.isot[outside[0]]
        found = f"{number_of(outside.size, 'row')} of the recording outside, the first at {where}"
        span = f"{iso[order[0]]} to {iso[order[-1]]}"
        raise InputError(path, None, found, f"quaternions for all rows (these span {span})")
    return Slerp(seconds, quaternions / norm[:, None])


def _rows(path: Path, scale: str) -> tuple[Time, np.ndarray]:
    def read_times(header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
        try:
            if JULIAN_DATE.fullmatch(cells[0]):
                dates = julian_dates_of_numbers(read_numbers(header, name, cells, start), scale)
            else:
                dates = julian_dates_of_iso(cells, scale)
        except UnreadableTime as error:
            place = row_place(start + error.index, name)
            raise InputError(path, place, repr(error.found[:40]), error.expected) from None
        return np.stack(dates, axis=-1)

    header = read_header(path)
    stated = str(header.meta.get("time_scale", scale)).strip().lower()
    if stated != scale:
        raise InputError(path, "metadata time_scale", repr(stated[:40]), f"{scale}, as in the recording")
    for name in ("time", *COMPONENTS):
        if name not in header.names:
            raise InputError(path, "header", f"no column {name}", "time," + ",".join(COMPONENTS))
    _, columns = read_columns(header, {"time": read_times, **dict.fromkeys(COMPONENTS, read_numbers)})
    jd1, jd2 = columns["time"].T
    if jd1.size < 2:
        raise InputError(path, None, "1 row", "at least 2")
    times: Any = Time(jd1, jd2, format="jd", scale=scale)
    return times, np.stack([columns[name] for name in COMPONENTS], axis=-1)
