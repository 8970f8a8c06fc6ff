"""Recording files, ECSV or CSV: every defect is one InputError, every row lost is counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from astropy.time import Time

from torchlc.errors import InputError
from torchlc.files.decimals import advice, decimal
from torchlc.files.reading import sha256_of, unchanged
from torchlc.readers import declared, groups
from torchlc.readers.layouts import LAYOUTS
from torchlc.readers.recording import Recording, counted, no_usable_row, seconds_since
from torchlc.readers.table import (
    BEYOND_MAG,
    Header,
    LabelReader,
    read_columns,
    read_flags,
    read_header,
    read_numbers,
    row_place,
)
from torchlc.scene.timestamps import (
    JULIAN_DATE,
    REDUCED,
    UnreadableTime,
    in_utc,
    julian_dates_of_iso,
    julian_dates_of_numbers,
)
from torchlc.suggest import did_you_mean

if TYPE_CHECKING:
    from torchlc.scene import Scene

NO_STATION = "unknown"
SHORTEST_KM = 1e-6
"""Of a vector to Sun or observer: a millimetre is no distance between bodies."""
ABOVE_0 = 5e-324
LEAST_ERROR, LARGEST_ERROR = 1e-12, 1e12
"""Of an error, of the size of what it belongs to (1 for magnitudes): beyond it, it is no measured error, and
weights of its inverse square lose the other rows.
"""
LIMITS = {
    "mag": (-BEYOND_MAG, BEYOND_MAG),
    "flux": (-1e30, 1e30),
    "mag_err": (LEAST_ERROR, BEYOND_MAG),
    "flux_err": (ABOVE_0, 1e30),
    "exptime": (0.0, 86400.0),
    "alt": (-90.0, 90.0),
    "az": (-360.0, 720.0),
    "height": (ABOVE_0, 1e9),
}
LIMITS |= {f"{prefix}_{axis}": (-1e15, 1e15) for prefix in declared.VECTORS.values() for axis in "xyz"}
"""What a column may hold, in our units: beyond it a cell is a mistake or a marker for a missing value."""


def load_recording(
    path: str | Path, scene: Scene | None = None, *, use: str | None = None, min_rows: int = 1
) -> Recording:
    """Read an ECSV or CSV recording, or one of the other ``LAYOUTS``, and check it, against the scene's needs
    when one is given.

    ``use`` picks "mag" or "flux" when both are there (default mag). Without a ``curve`` column each station
    and band is one curve. A night is a station's local noon to noon, named after its evening, or, without
    stations, what lies between gaps of more than 6 h.
    """
    path = Path(path)
    with unchanged(path):
        recording = read_recording(read_header(path, LAYOUTS), scene, use=use, min_rows=min_rows)
        return replace(recording, sha256=sha256_of(path))


def read_recording(
    header: Header, scene: Scene | None = None, *, use: str | None = None, min_rows: int = 1
) -> Recording:
    """The recording of a table whose header has been read; see :func:`load_recording`."""
    return _Reader(header, scene, use).recording(min_rows)


class _Reader:
    """One recording on its way in: which columns are wanted, what they hold, and which rows survive."""

    def __init__(self, header: Header, scene: Scene | None, use: str | None) -> None:
        self.header, self.scene, self.source = header, scene, header.source
        self.dropped: dict[str, int] = {}
        self.kind = declared.brightness(header, use)
        self.timing = declared.timing(header)
        self.scale = "tdb" if self.timing.scale == "tdb" else "utc"
        self.time_format = self.timing.format
        self.warnings = [*self.timing.notes, *declared.units_told(header, self.kind)]
        self.frame = declared.frame(header, scene)
        self.labels = {name: LabelReader() for name in ("station", "band", "curve") if name in header.names}
        self.columns = self._read()
        self.rows = np.arange(len(self.columns["time"]))

    def _read(self) -> dict[str, np.ndarray]:
        needed, optional = declared.numeric_columns(self.header, self.scene, self.kind)
        readers: dict[str, Any] = {"time": self._read_times, **self.labels}
        readers |= dict.fromkeys([*needed, *(name for group in optional for name in group)], read_numbers)
        if "upper_limit" in self.header.names:
            readers["upper_limit"] = read_flags
        columns = read_columns(self.header, readers)
        for group in optional:
            if not all(np.isfinite(columns[name]).any() for name in group):
                self.warnings.append(f"no number in {', '.join(group)}, taken as absent")
                columns = {name: column for name, column in columns.items() if name not in group}
        return {
            name: declared.converted(self.header, name, column) if readers[name] is read_numbers else column
            for name, column in columns.items()
        }

    def _read_times(self, header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
        """Two-part Julian dates (T, 2); the first cell of the file decides between ISO and JD."""
        if not self.time_format:
            self.time_format = "jd" if JULIAN_DATE.fullmatch(cells[0]) else "iso"
        try:
            if self.time_format == "iso":
                days = julian_dates_of_iso(cells, self.timing.scale)
            else:
                if not all(map(str.strip, cells)):
                    blank = next(index for index, cell in enumerate(cells) if not cell.strip())
                    raise UnreadableTime(blank, "", "a time")
                numbers = read_numbers(header, name, cells, start)
                zero = declared.ZEROS[self.time_format]
                days = julian_dates_of_numbers(numbers, self.timing.scale, zero=zero)
        except UnreadableTime as error:
            place = row_place(start + error.index, name)
            hint = self._time_hint(error.found)
            raise InputError(self.source, place, repr(error.found[:40]), error.expected, hint) from None
        if self.timing.scale != self.scale:
            days = in_utc(*days, self.timing.scale)
        return np.stack(days, axis=-1)

    def _time_hint(self, found: str) -> str | None:
        """What to do about a time that is no Julian date but may be one of a known kind."""
        try:
            number = decimal(found)
        except ValueError:
            return advice(found)
        if self.time_format != "jd" or not REDUCED[0] < number < REDUCED[1]:
            return None
        return f"Or say time_format: mjd, or time_format: jd-2400000, {declared.metadata_hint(self.header)}"

    def recording(self, min_rows: int) -> Recording:
        self._move_to_middle()
        self._drop_markers()
        self._drop_non_finite()
        self._check_limits()
        self._check_errors()
        self._sort()
        first_time = cast(Time, self._time()[:1])
        self._keep(~groups.repeats(self.columns), "duplicate")
        if "alt" in self.columns:
            self._keep(self.columns["alt"] >= 0, "below the horizon")
        rows = len(self.rows)
        if rows < min_rows:
            found = f"{rows} usable row{'s' * (rows > 1)}{_because(self.dropped)}"
            raise InputError(self.source, None, found, f"at least {min_rows}")
        return self._assembled(first_time)

    def _assembled(self, first_time: Time) -> Recording:
        columns, time = self.columns, self._time()
        days = columns["time"].sum(-1)
        station, station_ids = self._stations()
        curve, curve_ids = self._curves(station, station_ids)
        if self.scene is not None and self.scene.stations:
            longitude = np.array([place.longitude for place in self.scene.stations])
            night, night_ids = groups.local_nights(days, longitude, station, station_ids)
        else:
            night, night_ids = groups.nights_between_gaps(days)
        vectors = {
            name: np.stack([columns[f"{prefix}_{axis}"] for axis in "xyz"], axis=-1)
            for name, prefix in declared.VECTORS.items()
            if f"{prefix}_x" in columns
        }
        for name, vector in vectors.items():
            if name != "velocity" and not (np.abs(vector).max(-1) > SHORTEST_KM).all():
                place = f"columns {declared.VECTORS[name]}_x, _y, _z"
                raise InputError(self.source, place, "a vector of length 0", "a direction")
        return Recording(
            time=time,
            seconds=seconds_since(time, cast(Time, time[:1])),
            first_time=cast(Time, first_time[0]),
            kind=self.kind,
            observed=columns[self.kind],
            error=columns.get(f"{self.kind}_err"),
            station=station,
            station_ids=station_ids,
            curve=curve,
            curve_ids=curve_ids,
            night=night,
            night_ids=night_ids,
            upper_limit=columns.get("upper_limit", np.zeros(len(days), dtype=bool)),
            exptime=columns.get("exptime"),
            band=self._band(),
            sun=vectors.get("sun"),
            obs=vectors.get("obs"),
            position=vectors.get("position"),
            velocity=vectors.get("velocity"),
            alt=columns.get("alt"),
            az=columns.get("az"),
            height=columns.get("height"),
            frame=self.frame,
            light_time_corrected=declared.light_time_corrected(self.header),
            meta=self.header.meta,
            dropped=self.dropped,
            warnings=tuple(self.warnings),
            source=self.source,
        )

    def _keep(self, mask: np.ndarray, reason: str) -> None:
        lost = int(np.size(mask) - np.count_nonzero(mask))
        if lost:
            self.dropped[reason] = lost
            self.columns = {name: column[mask] for name, column in self.columns.items()}
            self.rows = self.rows[mask]
        if not len(self.rows):
            raise no_usable_row(self.source, self.dropped)

    def _move_to_middle(self) -> None:
        """Times of the start or end of exposures become those of their middle."""
        if self.timing.mark == "mid":
            return
        exptime = self.columns.get("exptime")
        if exptime is None:
            raise InputError(
                self.source, "column exptime", "no number", "s, for times are of the " + self.timing.mark
            )
        half_day = exptime / 2 / 86400.0
        self.columns["time"][:, 1] += half_day if self.timing.mark == "start" else -half_day

    def _drop_markers(self) -> None:
        """Rows whose magnitude or error is a number that stands for a missing one; an error of a limit is
        left open instead.
        """
        mag, error = self.columns.get("mag"), self.columns.get("mag_err")
        limit = self.columns.get("upper_limit", np.zeros(len(self.rows), dtype=bool))
        if error is not None:
            error[limit & (np.abs(error) > BEYOND_MAG)] = np.nan
        beyond = np.zeros(len(self.rows), dtype=bool)
        for column in (mag, error):
            if column is not None:
                beyond |= np.isfinite(column) & (np.abs(column) > BEYOND_MAG)
        self._keep(~beyond, f"beyond {BEYOND_MAG:g} mag")

    def _drop_non_finite(self) -> None:
        """Rows with a blank or infinite number go; an upper limit without an error takes the median."""
        error, limit = self.columns.get(f"{self.kind}_err"), self.columns.get("upper_limit")
        if error is not None and limit is not None:
            self.columns[f"{self.kind}_err"] = np.where(limit & np.isnan(error), np.nanmedian(error), error)
        finite = np.ones(len(self.rows), dtype=bool)
        for column in self.columns.values():
            if column.dtype.kind == "f":
                finite &= np.isfinite(column).reshape(len(finite), -1).all(-1)
        self._keep(finite, "non-finite")

    def _check_limits(self) -> None:
        for name, (low, high) in LIMITS.items():
            column = self.columns.get(name)
            if column is None:
                continue
            bad = np.flatnonzero(
                (column < low) | (column > high) | (column <= 0 if low == ABOVE_0 else False)
            )
            if bad.size:
                expected = f"> 0 and at most {high:g}" if low == ABOVE_0 else f"{low:g} to {high:g}"
                if name == "mag_err":
                    expected = f"> 0: {low:g} to {high:g} mag"
                place = row_place(int(self.rows[bad[0]]), name)
                hint = "Leave a missing value blank." if name == self.kind else None
                raise InputError(self.source, place, f"{column[bad[0]]:g}", expected, hint)

    def _check_errors(self) -> None:
        """Errors of a flux that are nothing, or everything, beside the fluxes of the file."""
        error = self.columns.get("flux_err")
        if error is None or self.kind != "flux":
            return
        size = float(np.median(np.abs(self.columns["flux"]))) or 1.0
        bad = np.flatnonzero((error < LEAST_ERROR * size) | (error > LARGEST_ERROR * size))
        if bad.size:
            expected = f"{LEAST_ERROR * size:.1g} to {LARGEST_ERROR * size:.1g}, for fluxes of {size:.3g}"
            place = row_place(int(self.rows[bad[0]]), "flux_err")
            raise InputError(self.source, place, f"{error[bad[0]]:g}", expected)

    def _sort(self) -> None:
        order = groups.time_order(self.columns["time"])
        if order is not None:
            self.columns = {name: column[order] for name, column in self.columns.items()}
            self.rows = self.rows[order]
            self.warnings.append("the rows were not in order of time and have been sorted")

    def _time(self) -> Time:
        days = self.columns["time"]
        return cast(Time, Time(days[:, 0], days[:, 1], format="jd", scale=self.scale))

    def _stations(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """Station of each row as an index into the scene's stations, else into those that the file names."""
        codes = self.columns.get("station")
        known = () if self.scene is None else tuple(station.id for station in self.scene.stations)
        if codes is None:
            if len(known) > 1:
                raise declared.missing(
                    self.header, "station", f"a column station: the scene has {len(known)}"
                )
            return np.zeros(len(self.rows), dtype=np.int64), known or (NO_STATION,)
        named = self.labels["station"].ids
        if not known:
            return codes, named
        numbers = np.zeros(len(named), dtype=np.int64)
        for code in np.unique(codes):
            name = named[code]
            if name in known:
                numbers[code] = known.index(name)
            elif name or len(known) > 1:
                place = row_place(int(self.rows[np.flatnonzero(codes == code)[0]]), "station")
                expected = f"a station of the scene: {', '.join(known)}"[:200]
                raise InputError(self.source, place, repr(name[:40]), expected, did_you_mean(name, known))
        return numbers[codes], known

    def _curves(self, station: np.ndarray, station_ids: Sequence[str]) -> tuple[np.ndarray, tuple[str, ...]]:
        """The ``curve`` column, else one curve for each station and band."""
        if "curve" in self.columns:
            return groups.compact(
                self.columns["curve"], [name or "unnamed" for name in self.labels["curve"].ids]
            )
        bands = self.labels["band"].ids if "band" in self.columns else ("",)
        band = self.columns.get("band", np.zeros(len(self.rows), dtype=np.int64))
        pairs = [f"{place} {name}".strip() for place in station_ids for name in bands]
        return groups.compact(station * len(bands) + band, pairs)

    def _band(self) -> np.ndarray | None:
        """Band names (T,)."""
        if "band" not in self.columns:
            return None
        return np.array(self.labels["band"].ids, dtype=object)[self.columns["band"]]


def _because(dropped: Mapping[str, int]) -> str:
    return f" ({counted(dropped)})" if dropped else ""
