"""What changes slowly in a recording, taken off before its period is looked for, and the recording folded with a period."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from torchlc.noise.error_law import MAG_PER_LN
from torchlc.readers import Recording

if TYPE_CHECKING:
    from astropy.timeseries import LombScargle

MIN_ROWS = 8
"""Of a curve that has an offset and a slope of its own: as many rows as are left for a period."""
LOWEST_DEG = 3.0
"""Elevation below which the airmass counts as that there: 1/sin grows without end."""


class Detrended:
    """Rows of a recording as magnitudes, or flux over its curve's mean, about what changes slowly.

    ``trend_per_hour`` holds the slopes in time, by curve.
    """

    def __init__(self, recording: Recording, rows: np.ndarray) -> None:
        self.unit = "mag" if recording.kind == "mag" else ""
        self.seconds = recording.seconds[rows]
        self.values = recording.observed[rows].copy()
        self.error = None if recording.error is None else recording.error[rows].copy()
        self.curve, self.ids = recording.curve[rows], recording.curve_ids
        self.trend_per_hour: dict[str, float] = {}
        distance = _distances(recording, rows)
        for curve in np.unique(self.curve):
            here = self.curve == curve
            if recording.kind == "flux":
                self.values[here] *= distance[here] ** 2 / np.mean(distance[here] ** 2)
                scale = abs(float(self.values[here].mean())) or 1.0
                self.values[here] = self.values[here] / scale - 1.0
                if self.error is not None:
                    self.error[here] *= distance[here] ** 2 / np.mean(distance[here] ** 2) / scale
            else:
                self.values[here] -= 5 * np.log10(distance[here] / distance[here].mean())
                self.values[here] -= self.values[here].mean()
        self.slow = _slow_columns(recording, rows)

    def search(self, frequency: float | None) -> LombScargle:
        """The periodogram about the trend, which is fitted beside two harmonics of ``frequency`` if that is given."""
        from astropy.timeseries import LombScargle

        slow = self.slow
        design = slow
        if frequency is not None:
            angle = 2 * np.pi * frequency * self.seconds[:, None] * np.array([1.0, 2.0])
            design = np.concatenate([slow, np.cos(angle), np.sin(angle)], axis=1)
        weight = np.ones(len(self.values)) if self.error is None else 1 / self.error
        size = np.linalg.norm(design * weight[:, None], axis=0)
        size[size == 0] = 1.0
        coefficients = (
            np.linalg.lstsq(design * weight[:, None] / size, self.values * weight, rcond=1e-9)[0] / size
        )
        trend = slow @ coefficients[: slow.shape[1]]
        for number in np.unique(self.curve):
            here = self.curve == number
            hours = self.seconds[here] / 3600
            slope = np.polyfit(hours, trend[here], 1)[0] if np.ptp(hours) > 0 else 0.0
            self.trend_per_hour[self.ids[number]] = float(slope)
        return LombScargle(self.seconds, self.values - trend, self.error)


def _distances(recording: Recording, rows: np.ndarray) -> np.ndarray:
    """What brightness falls with the square of, (N,): range times the Sun's distance where they are known, else 1."""
    known = [vectors[rows] for vectors in (recording.sun, recording.obs) if vectors is not None]
    return (
        np.prod([np.linalg.norm(vectors, axis=1) for vectors in known], axis=0)
        if known
        else np.ones(len(rows))
    )


def _slow_columns(recording: Recording, rows: np.ndarray) -> np.ndarray:
    """Design (N, K) of what changes slowly: an offset and a slope in time for each curve of at least MIN_ROWS rows, phase
    angle and airmass for all."""
    curve, hours = recording.curve[rows], recording.seconds[rows] / 3600
    columns = []
    for number in np.unique(curve):
        here = (curve == number).astype(float)
        columns.append(here)
        if here.sum() >= MIN_ROWS:
            columns.append(here * (hours - hours[here > 0].mean()))
    if recording.sun is not None and recording.obs is not None:
        units = [
            vectors[rows] / np.linalg.norm(vectors[rows], axis=1)[:, None]
            for vectors in (recording.sun, recording.obs)
        ]
        columns.append(np.arccos(np.clip((units[0] * units[1]).sum(1), -1, 1)))
    if recording.alt is not None:
        columns.append(1 / np.sin(np.radians(np.maximum(recording.alt[rows], LOWEST_DEG))))
    return np.stack(columns, axis=1)


def phase_curve(recording: Recording, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Phase in [0, 1) and the values about each curve's mean, (T,) each, sorted by phase."""
    search = Detrended(recording, np.arange(len(recording))).search(1 / period_s)
    phase = (recording.seconds / period_s) % 1.0
    order = np.argsort(phase)
    values = np.asarray(search.y)
    return phase[order], (
        values if recording.kind == "mag" else -MAG_PER_LN * np.log1p(np.maximum(values, -0.99))
    )[order]
