"""Measurements to and from what others hold: tables and time series of astropy, lightkurve, pandas."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.table import Column, MaskedColumn, Table
from astropy.time import Time, TimeDelta

from torchlc.errors import InputError, MissingExtraError
from torchlc.readers import declared
from torchlc.readers.astropy_tables import PLAIN_KINDS, described
from torchlc.readers.column_limits import LIMITS
from torchlc.readers.roles import LABELS, VECTORS, assigned
from torchlc.readers.table import METADATA, Header

if TYPE_CHECKING:
    import pandas
    from astropy.timeseries import TimeSeries

    from torchlc.readers.measurements import Measurements
    from torchlc.scene.reading import Reading

COLUMNS = (*LIMITS, *LABELS, "upper_limit")
"""What is read of a time series, beside its times; the rest is left."""
MAG_PER_LN = 2.5 / np.log(10)


def carried(measurements: Measurements) -> dict[str, Any]:
    """Columns (T,) that a model needs to see the same geometry again: curve, band, exptime, places."""
    columns: dict[str, Any] = {
        "curve": Column(np.array(measurements.curve_ids, dtype=str)[measurements.curve])
    }
    if measurements.band is not None:
        columns["band"] = Column(measurements.band.astype(str))
    if measurements.object is not None:
        columns["object"] = Column(np.array(measurements.object_ids, dtype=str)[measurements.object])
    for name in ("exptime", "alt", "az", "height"):
        values = getattr(measurements, name)
        if values is not None:
            columns[name] = Column(values, unit=declared.UNITS[name], format=".12g")
    for attribute, prefix in VECTORS.items():
        vectors = getattr(measurements, attribute)
        if vectors is not None:
            for i, axis in enumerate("xyz"):
                name = f"{prefix}_{axis}"
                columns[name] = Column(vectors[:, i], unit=declared.UNITS[name], format=".15g")
    return columns


def told(measurements: Measurements) -> dict[str, Any]:
    """Metadata that its columns do not say."""
    meta: dict[str, Any] = {"time_scale": measurements.time.scale}
    if measurements.light_time_corrected:
        meta["light_time_corrected"] = True
    if measurements.sun is not None and measurements.frame:
        meta["frame"] = measurements.frame
    return meta


def to_timeseries(measurements: Measurements) -> TimeSeries:
    """All columns as an astropy TimeSeries: mag or flux, errors, station and what :func:`carried` gives."""
    from astropy.timeseries import TimeSeries

    return TimeSeries(time=measurements.time, data=_data(measurements), meta=told(measurements))


def to_lightkurve(measurements: Measurements) -> Any:
    """A lightkurve LightCurve; magnitudes become flux over that of their median, and are kept beside it."""
    try:
        import lightkurve  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtraError("a LightCurve needs lightkurve: pip install lightkurve") from error
    data = _data(measurements)
    if measurements.kind == "mag":
        flux = np.exp((np.median(measurements.observed) - measurements.observed) / MAG_PER_LN)
        data["flux"] = Column(flux)
        if measurements.error is not None:
            data["flux_err"] = Column(flux * measurements.error / MAG_PER_LN)
    return lightkurve.LightCurve(time=measurements.time, data=data, meta=told(measurements))


def to_table(measurements: Measurements) -> Table:
    """All columns as an astropy Table, ``time`` among them; written as ECSV it is a recording again."""
    return Table({"time": measurements.time, **_data(measurements)}, meta=told(measurements))


def to_pandas(measurements: Measurements) -> pandas.DataFrame:
    """All columns as a DataFrame of pandas, ``time`` as instants of UTC to the nanosecond, or of TDB without a zone."""
    import pandas

    time: Any = measurements.time.copy(format="isot")
    time.precision = 9
    instants = pandas.to_datetime(np.asarray(time.value, dtype=str), utc=measurements.time.scale == "utc")
    return pandas.DataFrame(
        {"time": instants, **{name: np.asarray(column) for name, column in _data(measurements).items()}}
    )


def header_of(rows: Any, reading: Reading) -> Header:
    """What rows in memory say: a table of astropy, a time series, a light curve of lightkurve, a DataFrame of pandas, or
    a mapping of columns, arrays, quantities and instants among them. Columns may have the names that they have in files.

    Times in TDB or TCB become TDB, all others UTC; barycentric times of a time series are taken as they are. An index
    of times of a DataFrame counts as its column time where it has none.
    """
    source = Path(type(rows).__name__)
    if hasattr(rows, "to_table") and not hasattr(rows, "colnames"):
        rows = rows.to_table()
    table, meta = _columns_of(rows, source)
    lengths = {name: np.shape(column)[0] if np.ndim(column) else 0 for name, column in table.items()}
    if not table or 0 in lengths.values():
        found = next((f"column {name} is one number" for name, n in lengths.items() if n == 0), "no columns")
        raise InputError(source, None, found, "columns of one number a row, all of one length")
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {n}" for name, n in lengths.items())[:200]
        raise InputError(source, None, f"columns of different lengths: {listed}", "one length")
    times = {name: column for name, column in table.items() if isinstance(column, Time)}
    name = next((name for name in (reading.columns.get("time"), "time", *times) if name in times), None)
    columns = {}
    for other, column in table.items():
        if other == name or isinstance(column, Time | TimeDelta):
            continue
        if other in COLUMNS and np.ndim(column) != 1:
            raise InputError(source, f"column {other}", f"{np.ndim(column)} dimensions", "one number a row")
        columns[other] = column
    if name is not None:
        reading = reading.model_copy(
            update={"columns": {role: text for role, text in reading.columns.items() if role != "time"}}
        )
        columns.pop("time", None)
    fields = described(source, None if name is None else times[name], plain(columns), meta)
    return assigned(Header(**fields), reading, {})


def _columns_of(rows: Any, source: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Columns by name, and metadata."""
    if hasattr(rows, "colnames"):
        meta = {key: rows.meta[key] for key in METADATA if key in (rows.meta or {})}
        table = {str(name): rows[name] for name in rows.colnames}
        if isinstance(getattr(rows, "time", None), Time):
            table["time"] = rows.time
            meta = {key: value for key, value in meta.items() if not key.startswith("time_")}
        return table, meta
    if hasattr(rows, "columns") and hasattr(rows, "index"):
        table = {str(name): _series(rows[name]) for name in rows.columns}
        index = rows.index
        if "time" not in table and getattr(index, "dtype", None) is not None and index.dtype.kind in "M":
            table["time"] = _series(index)
        elif "time" not in table and index.name is not None:
            table[str(index.name)] = _series(index)
        return table, {}
    if isinstance(rows, Mapping):
        return {str(name): _array(column) for name, column in rows.items()}, {}
    raise InputError(
        None,
        "recording",
        type(rows).__name__,
        "a path, a Recording, a Table, TimeSeries, LightCurve or DataFrame, or a mapping of columns",
    )


def _series(column: Any) -> Any:
    """The values of a column of pandas; instants with a zone in UTC, missing values as not-a-number or blank."""
    dtype = column.dtype
    if dtype.kind == "M":
        if getattr(dtype, "tz", None) is not None:
            column = column.dt.tz_convert("UTC") if hasattr(column, "dt") else column.tz_convert("UTC")
            column = column.dt.tz_localize(None) if hasattr(column, "dt") else column.tz_localize(None)
        return _array(column.to_numpy())
    if dtype.kind in "fiub":
        return np.asarray(column.to_numpy())
    if hasattr(dtype, "numpy_dtype") and dtype.kind in "fiu":
        return np.asarray(column.to_numpy(dtype=float, na_value=np.nan))
    missing = np.asarray(column.isna())
    return np.array(
        ["" if lost else str(value) for value, lost in zip(column, missing, strict=True)], dtype=object
    )


def _array(column: Any) -> Any:
    if isinstance(column, Time | TimeDelta | u.Quantity) or hasattr(column, "mask"):
        return column
    if hasattr(column, "detach"):
        column = column.detach().cpu().numpy()
    values = np.asarray(column)
    if values.dtype.kind == "M":
        return np.datetime_as_string(values.astype("datetime64[ns]"))
    if values.dtype.kind == "O" and values.size and isinstance(values.flat[0], datetime.datetime):
        return np.array([value.isoformat() for value in values], dtype=object)
    return values


def plain(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of one number, flag or text a row, as astropy's columns."""
    table = {
        name: column
        if hasattr(column, "info")
        else (MaskedColumn if hasattr(column, "mask") else Column)(column)
        for name, column in columns.items()
    }
    return {
        name: column
        for name, column in table.items()
        if np.ndim(column) == 1 and getattr(getattr(column, "dtype", None), "kind", "") in PLAIN_KINDS
    }


def _data(measurements: Measurements) -> dict[str, Any]:
    unit = "mag" if measurements.kind == "mag" else None
    data: dict[str, Any] = {measurements.kind: Column(measurements.observed, unit=unit)}
    if measurements.error is not None:
        data[f"{measurements.kind}_err"] = Column(measurements.error, unit=unit)
    data["station"] = Column(np.array(measurements.station_ids, dtype=str)[measurements.station])
    if measurements.upper_limit.any():
        data["upper_limit"] = Column(measurements.upper_limit)
    return data | carried(measurements)
