"""Recordings to and from the time series of astropy and lightkurve."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.table import Column

from torchlc.errors import InputError, MissingExtraError
from torchlc.readers import declared
from torchlc.readers.astropy_tables import described
from torchlc.readers.reader import LIMITS, read_recording
from torchlc.readers.recording import Recording
from torchlc.readers.table import Header

if TYPE_CHECKING:
    from astropy.timeseries import TimeSeries

    from torchlc.scene import Scene

COLUMNS = (*LIMITS, "station", "band", "curve", "upper_limit")
"""What is read of a time series, beside its times; the rest is left."""
MAG_PER_LN = 2.5 / np.log(10)


def carried(recording: Recording) -> dict[str, Any]:
    """Columns (T,) that a model needs to see the same geometry again: curve, band, exptime, places."""
    found: dict[str, Any] = {"curve": Column(np.array(recording.curve_ids, dtype=str)[recording.curve])}
    if recording.band is not None:
        found["band"] = Column(recording.band.astype(str))
    for name in ("exptime", "alt", "az", "height"):
        values = getattr(recording, name)
        if values is not None:
            found[name] = Column(values, unit=declared.UNITS[name], format=".12g")
    for attribute, prefix in declared.VECTORS.items():
        vectors = getattr(recording, attribute)
        if vectors is not None:
            for i, axis in enumerate("xyz"):
                name = f"{prefix}_{axis}"
                found[name] = Column(vectors[:, i], unit=declared.UNITS[name], format=".15g")
    return found


def told(recording: Recording) -> dict[str, Any]:
    """Metadata that its columns do not say."""
    meta: dict[str, Any] = {"time_scale": recording.time.scale}
    if recording.light_time_corrected:
        meta["light_time_corrected"] = True
    if recording.sun is not None and recording.frame:
        meta["frame"] = recording.frame
    return meta


def to_timeseries(recording: Recording) -> TimeSeries:
    """All columns as an astropy TimeSeries: mag or flux, errors, station and what :func:`carried` gives."""
    from astropy.timeseries import TimeSeries

    return TimeSeries(time=recording.time, data=_data(recording), meta=told(recording))


def to_lightkurve(recording: Recording) -> Any:
    """A lightkurve LightCurve; magnitudes become flux over that of their median, and are kept beside it."""
    try:
        import lightkurve  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtraError("a LightCurve needs lightkurve: pip install lightkurve") from error
    data = _data(recording)
    if recording.kind == "mag":
        flux = np.exp((np.median(recording.observed) - recording.observed) / MAG_PER_LN)
        data["flux"] = Column(flux)
        if recording.error is not None:
            data["flux_err"] = Column(flux * recording.error / MAG_PER_LN)
    return lightkurve.LightCurve(time=recording.time, data=data, meta=told(recording))


def from_timeseries(series: Any, scene: Scene | None = None, *, use: str | None = None) -> Recording:
    """The recording that a TimeSeries or LightCurve holds, checked as one from a file.

    Times in TDB or TCB become TDB, all others UTC; barycentric times are taken as they are. Columns and
    units are those of a file; columns of other names are left.
    """
    source = Path(type(series).__name__)
    present = [name for name in COLUMNS if name in series.colnames]
    columns = {name: series[name] for name in present}
    for name, column in columns.items():
        if np.ndim(column) != 1:
            raise InputError(source, f"column {name}", f"{np.ndim(column)} dimensions", "one number a row")
    meta = {key: series.meta[key] for key in ("frame", "light_time_corrected") if key in series.meta}
    header = Header(**described(source, series.time, columns, meta))
    return replace(read_recording(header, scene, use=use), source=None)


def _data(recording: Recording) -> dict[str, Any]:
    unit = "mag" if recording.kind == "mag" else None
    data: dict[str, Any] = {recording.kind: Column(recording.observed, unit=unit)}
    if recording.error is not None:
        data[f"{recording.kind}_err"] = Column(recording.error, unit=unit)
    data["station"] = Column(np.array(recording.station_ids, dtype=str)[recording.station])
    if recording.upper_limit.any():
        data["upper_limit"] = Column(recording.upper_limit)
    return data | carried(recording)
