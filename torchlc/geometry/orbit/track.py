"""Where object, observer and Sun are: ``Track.at`` for any offsets from the stamps."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from torchlc.geometry.orbit.motion import Motion


@dataclass(frozen=True)
class State:
    """Geometry with leading axes (..., T), vectors along GCRS axes.

    ``time`` s at the object since the recording's first row; ``position`` km and ``velocity`` km/s,
    geocentric, None where unknown; ``sun`` and ``observer`` km, from the object. Offsets of different shapes
    leave the fields in different shapes, which broadcast.
    """

    time: Tensor
    position: Tensor | None
    velocity: Tensor | None
    sun: Tensor
    observer: Tensor


class Track(nn.Module):
    """Motions of observer, object and Sun about the T rows of a recording; ``to`` moves it between devices.

    At the stamps ``seconds`` (T,), without offsets: ``range_km``, ``phase_angle_deg`` (T,), the observer's
    ``zenith`` (T, 3), and from it ``elevation_deg`` and ``airmass`` (T,), None where its place on the Earth
    is unknown.
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
        """Are "position", "velocity", "elevation" known; are "motion", "along_track" possible?"""
        return what in self._known

    def at_rows(self, rows: Tensor) -> Track:
        """The track of some rows (N,), which may repeat."""
        taken = copy.copy(self)
        taken._buffers = {
            name: None if buffer is None else buffer[rows] for name, buffer in self._buffers.items()
        }
        taken._modules = {
            name: motion.at_rows(rows) if isinstance(motion, Motion) else motion
            for name, motion in self._modules.items()
        }
        return taken

    def at(
        self, observer_offset: Tensor | float, object_offset: Tensor | float, ahead: Tensor | float
    ) -> State:
        """Observer at stamp + ``observer_offset``, object and Sun at stamp + ``object_offset`` s, (..., T).

        The object is ``ahead`` rad of mean anomaly further along its orbit, the Sun and its spin are not.
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


def above_horizon(track: Track) -> np.ndarray:
    """Rows (T,) with the object above the geometric horizon; all of them where the elevation is unknown."""
    if track.elevation_deg is None:
        return np.ones(track.seconds.shape[0], dtype=bool)
    return (track.elevation_deg > 0).cpu().numpy()


def sun_elevation_deg(track: Track) -> np.ndarray | None:
    """Geometric elevation (T,) of the Sun at the observer, degrees; None where the observer's place is unknown."""
    if track.zenith is None:
        return None
    state = track.at(0.0, 0.0, 0.0)
    return elevation_deg(track.zenith, state.sun - state.observer).cpu().numpy()


def angle_between(a: Tensor, b: Tensor) -> Tensor:
    """Angle (...,), rad, between vectors (..., 3); accurate at 0 and pi, where its gradient is put to 0."""
    cross2 = (torch.linalg.cross(a, b) ** 2).sum(-1)
    apart = cross2 > 0
    sine = torch.where(apart, torch.sqrt(torch.where(apart, cross2, 1.0)), 0.0)
    return torch.atan2(sine, (a * b).sum(-1))


def elevation_deg(zenith: Tensor, to_object: Tensor) -> Tensor:
    """Geometric elevation (...,), degrees; refraction, 0.5 deg at the horizon, is neglected."""
    return 90.0 - torch.rad2deg(angle_between(zenith.expand_as(to_object), to_object))


def airmass(elevation: Tensor) -> Tensor:
    """Airmass (...,) by Kasten & Young (1989), Appl. Opt. 28, 4735, of an ``elevation`` in degrees.

    Below the horizon it stays at that of the horizon, 38.
    """
    height = elevation.clamp(min=0.0)
    return 1.0 / (torch.sin(torch.deg2rad(height)) + 0.50572 * (height + 6.07995) ** -1.6364)
