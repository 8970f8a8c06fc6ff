"""Light curves over one night, and what is read off them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

import torchlc
from torchlc.geometry.orbit import angle_between
from torchlc.results.simulated_curve import SimulatedCurve

Array = NDArray[np.float64]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Night:
    """A simulated curve (T,) and its hours UT of the day it begins on."""

    curve: SimulatedCurve
    hour: Array

    @property
    def mag(self) -> Array:
        return self.curve.mag

    def known(self, column: str) -> Array:
        """A column of the geometry, which these orbits all have."""
        values = self.curve.columns[column]
        assert values is not None
        return values

    @cached_property
    def peak(self) -> tuple[float, float]:
        """Hour and magnitude of the brightest moment: vertex of the parabola through the brightest rows."""
        k = int(np.argmin(self.mag))
        if k in (0, len(self.mag) - 1):
            return float(self.hour[k]), float(self.mag[k])
        before, here, after = self.mag[k - 1 : k + 2]
        shift = 0.5 * (before - after) / (before - 2 * here + after)
        return float(self.hour[k] + shift * (self.hour[1] - self.hour[0])), float(
            here - 0.25 * (before - after) * shift
        )

    def at(self, hour: float) -> float:
        """Magnitude at an hour between two rows."""
        return float(np.interp(hour, self.hour, self.mag))

    @property
    def half_flux(self) -> Interval:
        """Hours between which the flux about the peak is above half of its maximum."""
        return span(self.hour, self.mag - self.peak[1] < 2.5 * np.log10(2.0))


def night(scene: torchlc.Scene, day: str = "2020-10-10", first: float = 12.0, last: float = 20.0) -> Night:
    """The bare curve of a scene between two hours UT, every 15 s; the paper's night by default."""
    minutes = round(60 * first)
    start = f"{day}T{minutes // 60:02d}:{minutes % 60:02d}:00"
    curve = torchlc.simulate(scene, start=start, hours=last - first, cadence=15.0)
    return Night(curve, first + curve.recording.seconds / 3600.0)


def span(hour: Array, inside: NDArray[np.bool_]) -> Interval:
    """First and last hour for which ``inside`` holds; not-a-number where it never does."""
    chosen = hour[inside]
    return (float(chosen[0]), float(chosen[-1])) if chosen.size else (float("nan"), float("nan"))


def glint_angles(scene: torchlc.Scene, seen: Night) -> dict[str, Array]:
    """Angle (T,), deg, between bisector and normal of each ``component/face``; not-a-number where the face is
    not both lit and seen.
    """
    model = torchlc.LightCurve(scene, seen.curve.recording)
    found = {}
    with torch.no_grad():
        view = model.view(model.values())
    to_sun, to_observer = view.to_sun[0], view.to_observer[0]
    for patch in view.patches:
        for face, normal in zip(patch.faces, patch.normal, strict=True):
            turned = normal.expand_as(to_sun)
            if patch.pose is not None:
                turned = torch.einsum("tij,j->ti", patch.pose[0], normal)
            visible = ((turned * to_sun).sum(-1) > 0) & ((turned * to_observer).sum(-1) > 0)
            angle = torch.rad2deg(angle_between(turned, to_sun + to_observer))
            found[f"{patch.component}/{face}"] = torch.where(visible, angle, torch.nan).numpy()
    return found


def closest(angles: dict[str, Array], hour: Array) -> dict[str, float | str]:
    """The smallest of the angles, its face and its hour."""
    face = min(
        angles, key=lambda name: np.nanmin(angles[name]) if np.isfinite(angles[name]).any() else np.inf
    )
    k = int(np.nanargmin(angles[face]))
    return {"deg": float(angles[face][k]), "hour": float(hour[k]), "face": face}
