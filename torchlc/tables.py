"""Simulated curves as tables: the columns of curve.ecsv, and the geometry that lets it be read as a
recording again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.table import MaskedColumn, Table

from torchlc.recording import Recording
from torchlc.recording.declared import VECTORS

if TYPE_CHECKING:
    from torchlc.results import SimulatedCurve

UNITS = {
    "mag": "mag", "mag_err": "mag", "range_km": "km", "phase_angle_deg": "deg", "elevation_deg": "deg", "exptime": "s",
    "alt": "deg", "az": "deg", "height": "km",
}  # fmt: skip
DIGITS = {
    "mag": ".6f",
    "mag_err": ".6g",
    "range_km": ".6f",
    "phase_angle_deg": ".6f",
    "elevation_deg": ".6f",
    "airmass": ".6f",
}


def curve_table(curve: SimulatedCurve) -> Table:
    """Time, station, the columns of the simulation in FORMATS' order, a ``share <component>`` each, then
    what the recording brought.
    """
    recording = curve.recording
    columns: dict[str, Any] = {
        "time": iso_times(recording),
        "station": np.array(recording.station_ids, dtype=str)[recording.station],
    }
    rows = len(recording)
    for name, values in curve.columns.items():
        columns[name] = masked(values, rows, name)
    for name, values in curve.shares.items():
        columns[f"share {name}"] = masked(values, rows, "")
    columns |= _brought(recording)
    meta: dict[str, Any] = {"object": curve.name, "time_scale": recording.time.scale}
    if recording.light_time_corrected:
        meta["light_time_corrected"] = True
    if recording.sun is not None and recording.frame:
        meta["frame"] = recording.frame
    return Table(columns, meta=meta)


def iso_times(recording: Recording) -> np.ndarray:
    """Times of the rows as ISO text to the microsecond, (T,), in the recording's scale."""
    time = recording.time.copy(format="isot")
    time.precision = 6
    return np.asarray(time.value, dtype=str)


def masked(values: np.ndarray | None, rows: int, name: str) -> MaskedColumn:
    """A column (T,) whose unknown (None) or non-finite cells are masked."""
    data = np.full(rows, np.nan) if values is None else np.asarray(values, dtype=float)
    hidden = ~np.isfinite(data)
    return MaskedColumn(
        np.where(hidden, 0.0, data), mask=hidden, unit=UNITS.get(name), format=DIGITS.get(name, ".9g")
    )


def _brought(recording: Recording) -> dict[str, Any]:
    """Columns that the model needs to see the same geometry again."""
    rows = len(recording)
    found: dict[str, Any] = {"curve": np.array(recording.curve_ids, dtype=str)[recording.curve]}
    if recording.band is not None:
        found["band"] = recording.band.astype(str)
    for name in ("exptime", "alt", "az", "height"):
        values = getattr(recording, name)
        if values is not None:
            found[name] = masked(values, rows, name)
    for field, prefix in VECTORS.items():
        vectors = getattr(recording, field)
        if vectors is not None:
            unit = "km / s" if field == "velocity" else "km"
            for i, axis in enumerate("xyz"):
                found[f"{prefix}_{axis}"] = MaskedColumn(vectors[:, i], unit=unit, format=".15g")
    return found
