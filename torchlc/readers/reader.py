"""Rows of a recording, checked: every defect is one InputError, every row lost is counted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from astropy.time import Time

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.readers import declared, groups
from torchlc.readers.catalogue_numbers import told_of_another
from torchlc.readers.column_limits import check_flux_errors, check_limits
from torchlc.readers.copies import copies
from torchlc.readers.empty_slots import empty_slots, rows_of_slots
from torchlc.readers.light_path import days_by_direction, days_by_vectors
from torchlc.readers.markers import (
    MARKERS,
    brightness_markers,
    error_markers,
    suspected_errors,
    suspected_marker,
)
from torchlc.readers.measurements import Measurements, no_usable_row, seconds_since, too_few_rows
from torchlc.readers.objects import ALL, chosen_object
from torchlc.readers.roles import LABELS, VECTORS
from torchlc.readers.stations import (
    SiteReader,
    left_of_sites,
    sites_read,
    station_numbers,
    stations_by_place,
)
from torchlc.readers.table import (
    BEYOND_MAG,
    MAX_ROWS,
    BrightnessReader,
    Header,
    LabelReader,
    read_bad,
    read_columns,
    read_flags,
    read_numbers,
    too_long,
)
from torchlc.readers.time_cells import TimeReader
from torchlc.readers.timing import timing
from torchlc.scene.reading import Reading
from torchlc.scene.timestamps import UTC_BEGINS, ut_in_tdb

if TYPE_CHECKING:
    from torchlc.scene import Scene

SHORTEST_KM = 1e-6
"""Of a vector to Sun or observer: a millimetre is no distance between bodies."""


def read_measurements(
    header: Header,
    scene: Scene | None = None,
    reading: Reading | None = None,
    *,
    use: str | None = None,
    min_rows: int = 1,
) -> Measurements:
    """The measurements of a table whose header has been read, checked against the scene's needs when one is given.

    ``use`` picks "mag" or "flux" when both are there (default mag). Without a ``curve`` column each station
    and band is one curve. A night is a station's local noon to noon, named after its evening, or, without
    stations, what lies between gaps of more than 6 h.
    """
    reading = header.told if reading is None else header.told.with_given(reading)
    return _Reader(header, scene, reading, use).measurements(min_rows)


class _Reader:
    """One recording on its way in: which columns are wanted, what they hold, and which rows survive."""

    def __init__(self, header: Header, scene: Scene | None, reading: Reading, use: str | None) -> None:
        self.header, self.scene, self.reading, self.source = header, scene, reading, header.source
        self.dropped: dict[str, int] = {}
        self.dropped_at: dict[str, np.ndarray] = {}
        self.kind = declared.brightness(header, use)
        self.timing = timing(header, reading, located=self._is_located())
        bound = scene is not None and scene.orbit.vectors is None
        self.times = TimeReader(header, self.timing, reading.date_order, before_utc=not bound)
        self.frame = declared.frame(header, scene)
        self.labels = {name: LabelReader() for name in LABELS if name in header.names}
        self.limits = BrightnessReader(self.kind)
        self.units_told: list[str] = []
        self.columns = self._read()
        self.rows = np.arange(len(self.columns["time"]))
        old_times = self._to_tdb_where_old()
        self._choose_object()
        names = list(self.columns)
        not_used = self._stations_by_place()
        names = [name for name in names if name in self.columns or name in self.sites_used]
        taken = declared.taken(header, reading, names, self.timing, self.times.format, not_used)
        self.warnings = [
            *taken,
            *declared.errors_told(header, self.kind),
            *self.timing.notes,
            *old_times,
            *declared.units_told(header, self.kind),
            *declared.magnitudes_told(header, self.kind),
            *self.units_told,
        ]
        if reading.date_order:
            self.warnings.append(f"dates are read {reading.date_order}, as told")
        elif self.times.calendar.because:
            calendar = self.times.calendar
            self.warnings.append(f"dates are read {calendar.order}: {calendar.because} can be nothing else")

    def _is_located(self) -> bool:
        """Is the direction to the object known without its orbit about the Earth?"""
        if self.scene is not None and self.scene.orbit.vectors is None:
            return False
        vectors = all(f"{prefix}_{axis}" in self.header.names for prefix in ("sun", "obs") for axis in "xyz")
        return vectors or self.reading.direction is not None

    def _read(self) -> dict[str, np.ndarray]:
        needed, optional = declared.numeric_columns(self.header, self.scene, self.kind)
        readers: dict[str, Any] = {"time": self.times, **self.labels}
        readers |= dict.fromkeys([*needed, *(name for group in optional for name in group)], read_numbers)
        readers[self.kind] = self.limits
        self.site_readers = {name: SiteReader() for name in sites_read(self.header)}
        readers |= self.site_readers
        if "upper_limit" in self.header.names:
            readers["upper_limit"] = read_flags
        if "bad" in self.header.names:
            readers["bad"] = read_bad
        self.places, columns = read_columns(self.header, readers)
        for group in optional:
            if not all(np.isfinite(columns[name]).any() for name in group):
                self.units_told.append(f"no number in {', '.join(group)}, taken as absent")
                columns = {name: column for name, column in columns.items() if name not in group}
        if self.limits.limits.any():
            flagged = columns.get("upper_limit", np.zeros(len(self.limits.limits), dtype=bool))
            columns["upper_limit"] = flagged | self.limits.limits
        if self.reading.exptime is not None and "exptime" not in columns:
            columns["exptime"] = np.full(len(columns["time"]), self.reading.exptime)
        numbers = {*needed, *(name for group in optional for name in group)}
        return {
            name: declared.converted(self.header, name, column)
            if name in numbers and name in readers
            else column
            for name, column in columns.items()
        }

    def measurements(self, min_rows: int) -> Measurements:
        if "bad" in self.columns:
            self._keep(~self.columns.pop("bad"), "flagged as bad")
        self._take_limits()
        self._move_to_middle()
        self.times_of_file = self.columns["time"]
        self._drop_markers()
        self._drop_non_finite()
        self._to_observer()
        if self.kind == "mag" and (suspect := suspected_marker(self.columns["mag"], self.rows)):
            self.warnings.append(suspect)
        if self.kind == "mag" and (suspect := suspected_errors(self.columns.get("mag_err"))):
            self.warnings.append(suspect)
        check_limits(self.source, self.kind, self.columns, self.rows)
        if self.kind == "flux":
            check_flux_errors(self.source, self.columns, self.rows, self._curve_codes())
        self._sort()
        first_time = cast(Time, self._time()[:1])
        self._keep(~groups.repeats(self.columns), "duplicate")
        self._add_non_detections()
        if "alt" in self.columns:
            above = self.columns["alt"] >= 0
            if not above.any():
                found = f"below 0 in {number_of(len(above), 'row')}, which is all that is left"
                hint = "alt is the elevation of the object, degrees, not its zenith distance nor a latitude"
                raise InputError(self.source, "column alt", found, "0 to 90 deg", hint)
            self._keep(above, "below the horizon")
        rows = len(self.rows)
        if rows < min_rows:
            raise too_few_rows(self.source, rows, self.dropped, min_rows)
        return self._assembled(first_time)

    def _assembled(self, first_time: Time) -> Measurements:
        columns, time = self.columns, self._time()
        days = columns["time"].sum(-1)
        station, station_ids = station_numbers(self.header, self.scene, self.columns, self.labels, self.rows)
        curve, curve_ids = self._curves(station, station_ids)
        if self.scene is not None and self.scene.stations:
            longitude = np.array([site.longitude for site in self.scene.stations])
            night, night_ids = groups.local_nights(days, longitude, station, station_ids)
        else:
            night, night_ids = groups.nights_between_gaps(days)
        vectors = self._vectors()
        for name, vector in vectors.items():
            if name != "velocity" and not (np.abs(vector).max(-1) > SHORTEST_KM).all():
                place = f"columns {VECTORS[name]}_x, _y, _z"
                raise InputError(self.source, place, "a vector of length 0", "a direction")
        limit = columns.get("upper_limit", np.zeros(len(days), dtype=bool))
        seconds = seconds_since(time, cast(Time, time[:1]))
        objects, object_ids = self._objects()
        self.warnings += told_of_another(self.header, self.scene, self._numbers_or_names())
        self.warnings += copies(seconds[~limit], columns[self.kind][~limit], curve[~limit], curve_ids)
        return Measurements(
            time=time,
            seconds=seconds,
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
            upper_limit=limit,
            exptime=columns.get("exptime"),
            band=self._band(),
            object=objects,
            object_ids=object_ids,
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
            place=self.places[self.rows],
            dropped_at=self.dropped_at,
            placed_by=self.header.placed_by,
            warnings=tuple(self.warnings),
            source=self.source,
        )

    def _vectors(self) -> dict[str, np.ndarray]:
        """Vectors (T, 3) by their field."""
        return {
            name: np.stack([self.columns[f"{prefix}_{axis}"] for axis in "xyz"], axis=-1)
            for name, prefix in VECTORS.items()
            if f"{prefix}_x" in self.columns
        }

    def _to_observer(self) -> None:
        """Times that were reduced to the Sun or the barycentre become those of the observer."""
        path, time = self.timing.light_path, self._time()
        if not path:
            return
        if self.reading.direction is not None:
            site = (
                self.scene.stations[0] if self.scene is not None and len(self.scene.stations) == 1 else None
            )
            station = None if site is None else (site.latitude, site.longitude, site.height)
            added = days_by_direction(time, path, self.reading.direction, station)
        else:
            vectors = self._vectors()
            added = days_by_vectors(time, path, vectors["sun"], vectors["obs"], self.frame)
        self.columns["time"][:, 1] -= added
        low, high = added.min() * 1440.0, added.max() * 1440.0
        self.warnings.append(
            f"{path} times are brought back to the observer: {low:+.2f} to {high:+.2f} minutes of the way of light "
            "are taken off"
        )

    def _keep(self, mask: np.ndarray, reason: str) -> None:
        lost = int(np.size(mask) - np.count_nonzero(mask))
        if lost:
            self.dropped[reason] = lost
            self.dropped_at[reason] = np.sort(self.places[self.rows[~mask]])
            self.columns = {name: column[mask] for name, column in self.columns.items()}
            self.rows = self.rows[mask]
        if not len(self.rows):
            raise no_usable_row(self.source, self.dropped)

    def _choose_object(self) -> None:
        """The rows of the object wanted, of a table that names several."""
        wanted = self.reading.object
        if wanted is None or wanted.strip() == ALL or "object" not in self.columns:
            return
        ids = self.labels["object"].ids
        if len(ids) > 1:
            name = chosen_object(self.source, [{label or "unnamed"} for label in ids], wanted)
            codes = [code for code, label in enumerate(ids) if (label or "unnamed") == name]
            self._keep(np.isin(self.columns["object"], codes), "of another object")

    def _stations_by_place(self) -> str:
        """The column ``station`` from latitude and longitude where none names it; and which columns like these are not used."""
        sites = {name: self.columns.pop(name) for name in self.site_readers}
        labels, because, bad = [], "", [reader.unreadable for reader in self.site_readers.values()]
        if sites and not any(bad[:2]):
            by_user = not {*sites}.isdisjoint(self.reading.columns)
            labels, because = stations_by_place(self.header, self.scene, sites, self.rows, by_user=by_user)
        elif sites:
            because = f"{next(filter(None, bad))[:20]!r} is no number of degrees"
        elif "station" in self.header.names:
            because = "the station is named"
        if labels:
            self.labels["station"] = LabelReader()
            self.columns["station"] = self.labels["station"](self.header, "station", labels, 0)
        self.sites_used = tuple(sites) if labels else ()
        return left_of_sites(self.header, self.sites_used, because)

    def _to_tdb_where_old(self) -> list[str]:
        """All times in TDB, which has no beginning, where some are older than UTC; and what has to be said of it."""
        days = self.columns["time"]
        if self.times.first_year is None or not (days.sum(-1) < UTC_BEGINS).any():
            return []
        self.columns["time"] = np.stack(ut_in_tdb(days[:, 0], days[:, 1]), axis=-1)
        self.times.scale = "tdb"
        return [
            "UTC begins in 1960: times before it are taken as UT (3 s off in 1950, 35 s in 1900), and all are brought to TDB"
        ]

    def _take_limits(self) -> None:
        """Rows without a magnitude, but with the limiting one of their image, are upper limits there."""
        faintest = self.columns.pop("limiting_mag", None)
        if faintest is None:
            return
        columns, value = self.columns, self.columns["mag"]
        empty = ~(np.abs(value) <= BEYOND_MAG) & (np.abs(faintest) <= BEYOND_MAG)
        if not empty.any():
            return
        columns["mag"] = np.where(empty, faintest, value)
        columns["upper_limit"] = columns.get("upper_limit", np.zeros(len(value), dtype=bool)) | empty
        if "mag_err" in columns:
            columns["mag_err"] = np.where(empty, np.nan, columns["mag_err"])
        count = np.count_nonzero(empty)
        self.warnings.append(
            f"{number_of(count, 'row')} without a magnitude {'are' if count > 1 else 'is'} taken as fainter than "
            f"{self.header.theirs.get('limiting_mag', 'limiting_mag')}"
        )

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
        """Rows whose brightness, error or exposure is a number that stands for a missing one; an error of a limit is
        left open instead.
        """
        limit = self.columns.get("upper_limit", np.zeros(len(self.rows), dtype=bool))
        marked, beyond = brightness_markers(self.kind, self.columns)
        missing, far, absent = error_markers(self.kind, self.columns)
        if absent:
            self.warnings.append(absent)
            del self.columns[f"{self.kind}_err"]
        error, exptime = self.columns.get(f"{self.kind}_err"), self.columns.get("exptime")
        if error is not None:
            error[limit & (missing | far)] = np.nan
            marked |= missing & ~limit
            beyond |= far & np.isfinite(error)
        if exptime is not None:  # never negative
            missing = np.isin(exptime, MARKERS)
            exptime[limit & missing] = np.nan
            marked |= missing & ~limit
        self._keep(~beyond, f"beyond {BEYOND_MAG:g} mag")
        self._keep(~marked[~beyond], "marked as missing")

    def _drop_non_finite(self) -> None:
        """Rows with a blank or infinite number go; an upper limit without an error takes the median of its curve."""
        error, limit = self.columns.get(f"{self.kind}_err"), self.columns.get("upper_limit")
        if error is not None and limit is not None and (blank := limit & np.isnan(error)).any():
            usual = groups.medians(error, self._curve_codes())
            self.columns[f"{self.kind}_err"] = np.where(blank, usual, error)
        finite = np.ones(len(self.rows), dtype=bool)
        for column in self.columns.values():
            if column.dtype.kind == "f":
                finite &= np.isfinite(column).reshape(len(finite), -1).all(-1)
        self._keep(finite, "non-finite")

    def _sort(self) -> None:
        order = groups.time_order(self.columns["time"])
        if order is not None:
            self.columns = {name: column[order] for name, column in self.columns.items()}
            self.rows = self.rows[order]
            self.warnings.append("the rows were not in order of time and have been sorted")

    def _add_non_detections(self) -> None:
        """Upper limits of slots in which the object was in the frame and not found, where the recording leaves them out."""
        wanted = self.reading.non_detections
        if not (self.header.skips_non_detections if wanted is None else wanted):
            return
        days, columns = self.columns["time"], self.columns
        station, station_ids = station_numbers(self.header, self.scene, self.columns, self.labels, self.rows)
        curve, curve_ids = self._curves(station, station_ids)
        limit = columns.get("upper_limit", np.zeros(len(self.rows), dtype=bool))
        slots = empty_slots(
            _seconds(days, days[0]),
            columns[self.kind],
            curve,
            curve_ids,
            " mag" if self.kind == "mag" else "",
            fainter=1 if self.kind == "mag" else -1,
            measured=~limit,
            view=np.unique(
                np.stack([station, columns.get("band", 0 * station)]), axis=1, return_inverse=True
            )[1],
            unusable=_seconds(self.times_of_file, days[0]),
            **({} if self.reading.longest_gap is None else {"longest_gap": self.reading.longest_gap}),
        )
        self.warnings += slots.notes
        if not len(slots.limit):
            return
        if len(self.rows) + len(slots.before) > MAX_ROWS:
            raise too_long(self.source)
        columns.setdefault("upper_limit", limit)
        added = rows_of_slots(slots, columns, self.kind, curve)
        self.columns = {name: np.concatenate([column, added[name]]) for name, column in columns.items()}
        self.rows = np.concatenate([self.rows, self.rows[slots.before]])
        order = groups.time_order(self.columns["time"])
        if order is not None:
            self.columns = {name: column[order] for name, column in self.columns.items()}
            self.rows = self.rows[order]

    def _time(self) -> Time:
        days = self.columns["time"]
        return cast(Time, Time(days[:, 0], days[:, 1], format="jd", scale=self.times.scale))

    def _curves(self, station: np.ndarray, station_ids: Sequence[str]) -> tuple[np.ndarray, tuple[str, ...]]:
        """The ``curve`` column, else one curve for each station and band."""
        if "curve" in self.columns:
            return groups.compact(
                self.columns["curve"], [name or "unnamed" for name in self.labels["curve"].ids]
            )
        bands = self.labels["band"].ids if "band" in self.columns else ("",)
        band = self.columns.get("band", np.zeros(len(self.rows), dtype=np.int64))
        pairs = [f"{station_id} {name}".strip() for station_id in station_ids for name in bands]
        return groups.compact(station * len(bands) + band, pairs)

    def _curve_codes(self) -> np.ndarray:
        """Numbers (T,), equal for rows of one curve, also before stations are known by name."""
        if "curve" in self.columns:
            return self.columns["curve"]
        codes = np.zeros(len(self.rows), dtype=np.int64)
        for name in ("station", "band"):
            if name in self.columns:
                codes = codes * len(self.labels[name].ids) + self.columns[name]
        return codes

    def _objects(self) -> tuple[np.ndarray | None, tuple[str, ...]]:
        """The ``object`` column, as an index into its names; None without one."""
        if "object" not in self.columns:
            return None, ()
        names = [name or "unnamed" for name in self.labels["object"].ids]
        return groups.compact(self.columns["object"], names)

    def _numbers_or_names(self) -> list[str]:
        """What the column of catalogue numbers holds, or without one that of objects, in the rows that are used."""
        name = next((name for name in ("object_number", "object") if name in self.columns), None)
        return [] if name is None else [self.labels[name].ids[code] for code in np.unique(self.columns[name])]

    def _band(self) -> np.ndarray | None:
        """Band names (T,)."""
        if "band" not in self.columns:
            return None
        return np.array(self.labels["band"].ids, dtype=object)[self.columns["band"]]


def _seconds(days: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Seconds (T,) of two-part Julian dates (T, 2) after one of them (2,)."""
    return 86400.0 * ((days[:, 0] - origin[0]) + (days[:, 1] - origin[1]))
