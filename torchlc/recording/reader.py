"""Recording files, ECSV or CSV: every defect is one InputError, every row lost is counted."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.time import Time

from torchlc.errors import InputError
from torchlc.recording.recording import Recording, compact, no_usable_row, seconds_since
from torchlc.recording.table import (
    Header,
    LabelReader,
    read_columns,
    read_flags,
    read_header,
    read_numbers,
    row_place,
)
from torchlc.timestamps import UnreadableTime, julian_dates_of_iso, julian_dates_of_numbers

if TYPE_CHECKING:
    from torchlc.scene import Scene

VECTORS = {"sun": "sun", "obs": "obs", "position": "r", "velocity": "v"}
"""Field of a Recording and the prefix of its three columns."""
UNITS = {"mag": u.mag, "mag_err": u.mag, "exptime": u.s, "alt": u.deg, "az": u.deg, "height": u.km}
UNITS |= {f"{prefix}_{axis}": u.km for prefix in ("sun", "obs", "r") for axis in "xyz"}
UNITS |= {f"v_{axis}": u.km / u.s for axis in "xyz"}
EQUATORIAL = re.compile(r"(icrs|icrf|gcrs|gcrf|eme ?2000|j2000|fk5|equatorial)\b")
NIGHT_GAP_DAYS = 6 / 24
NO_STATION = "unknown"


def load_recording(
    path: str | Path, scene: Scene | None = None, *, use: str | None = None, min_rows: int = 1
) -> Recording:
    """Read an ECSV or CSV recording and check it, against the scene's needs when one is given.

    ``use`` picks "mag" or "flux" when both are there (default mag). Without a ``curve`` column each station
    and band is one curve. A night is a station's local noon to noon, named after its evening, or, without
    stations, what lies between gaps of more than 6 h.
    """
    header = read_header(Path(path))
    return _Reader(header, scene, use).recording(min_rows)


class _Reader:
    """One recording on its way in: which columns are wanted, what they hold, and which rows survive."""

    def __init__(self, header: Header, scene: Scene | None, use: str | None) -> None:
        self.header, self.scene, self.source = header, scene, header.source
        self.warnings: list[str] = []
        self.dropped: dict[str, int] = {}
        self.kind = self._kind(use)
        self.scale = self._scale()
        self.frame = self._frame()
        self.labels = {name: LabelReader() for name in ("station", "band", "curve") if name in header.names}
        self.columns = self._read()
        self.rows = np.arange(len(self.columns["time"]))

    # --- what the file says about itself

    def _kind(self, use: str | None) -> str:
        names = self.header.names
        self._require("time")
        if use not in (None, "mag", "flux"):
            raise InputError(None, "--use", repr(use), "mag or flux")
        if use is not None:
            self._require(use)
            return use
        if "mag" not in names and "flux" not in names:
            raise self._missing("mag", "a column mag or flux")
        return "mag" if "mag" in names else "flux"

    def _scale(self) -> str:
        scale = str(self.header.meta.get("time_scale", "utc")).strip().lower()
        if scale not in ("utc", "tdb"):
            hint = "A local time cannot be converted safely." if "local" in scale else None
            raise InputError(self.source, "metadata time_scale", repr(scale[:40]), "utc or tdb", hint)
        if re.search(r"\blocal\b", self.header.descriptions.get("time", ""), re.IGNORECASE):
            raise InputError(
                self.source, "column time", "described as local time", "UTC", "Convert it first."
            )
        return scale

    def _time_format(self) -> str:
        """ "iso", "jd", "mjd", or "" when the cells decide."""
        text = str(self.header.meta.get("time_format", "")).strip().lower()
        known = {"": "", "jd": "jd", "mjd": "mjd", "iso": "iso", "isot": "iso"}
        if text not in known:
            raise InputError(self.source, "metadata time_format", repr(text[:40]), "jd, mjd or iso")
        unit = self.header.units.get("time", "d")
        if unit.lower() not in ("d", "day", "days", "jd", "mjd", "utc"):
            raise InputError(self.source, "column time", f"unit {unit[:40]}", "d, for Julian dates")
        return known[text]

    def _frame(self) -> str | None:
        if self.scene is not None and self.scene.orbit.vectors is None:
            return None
        if not any(name in self.header.names for name in ("sun_x", "obs_x", "r_x")):
            return None if self.scene is None else self.scene.orbit.vectors
        expected = None if self.scene is None else self.scene.orbit.vectors
        said = str(self.header.meta.get("frame", "")).strip().lower()
        if not said:
            return expected or "icrs"
        frame = "ecliptic" if said.startswith("ecliptic") else "icrs" if EQUATORIAL.match(said) else None
        if frame is None:
            raise InputError(self.source, "metadata frame", repr(said[:40]), "icrs or ecliptic")
        if expected and frame != expected:
            raise InputError(
                self.source,
                "metadata frame",
                f"{frame}, but the scene says vectors = {expected!r}",
                "the same frame in both",
            )
        return frame

    # --- reading

    def _require(self, name: str) -> None:
        if name not in self.header.names:
            raise self._missing(name, f"a column {name}")

    def _missing(self, name: str, expected: str) -> InputError:
        names = {column.lower(): column for column in self.header.names}
        near = difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.6)
        hint = f"Did you mean the column {names[near[0]]!r}?" if near else None
        if hint is None and len(self.header.names) == 1:
            hint = "The header holds one name only: is the delimiter a comma?"
        found = f"no column {name} among {', '.join(self.header.names)}"
        return InputError(self.source, "header", found[:200], expected, hint)

    def _wanted_vectors(self) -> list[str]:
        """Fields of VECTORS to read: those present, all three columns each, and those the scene needs."""
        orbit = None if self.scene is None else self.scene.orbit
        if orbit is not None and orbit.vectors is None:
            return []
        needed: dict[str, str] = {}
        if orbit is not None and self.scene is not None:
            mode = self.scene.attitude.mode
            needed = {"sun": 'vectors = "..."', "obs": 'vectors = "..."'}
            if mode in ("nadir", "yaw-steering"):
                needed["position"] = f'attitude mode = "{mode}"'
            if mode == "nadir":
                needed["velocity"] = f'attitude mode = "{mode}"'
        wanted = []
        for name, prefix in VECTORS.items():
            columns = [f"{prefix}_{axis}" for axis in "xyz"]
            present = [column for column in columns if column in self.header.names]
            if present or name in needed:
                for column in columns:
                    if column not in self.header.names:
                        why = f"; the scene's {needed[name]} needs it" if name in needed else ""
                        raise self._missing(column, f"columns {', '.join(columns)}{why}")
                wanted.append(name)
        return wanted

    def _read(self) -> dict[str, np.ndarray]:
        names = self.header.names
        self.vectors = self._wanted_vectors()
        numbers = [self.kind, f"{self.kind}_err", "exptime"]
        numbers += [f"{VECTORS[name]}_{axis}" for name in self.vectors for axis in "xyz"]
        if self.scene is not None and self.scene.orbit.altaz:
            for name in ("alt", "az", "height"):
                self._require(name)
            if self.scene.attitude.mode == "nadir":
                expected = 'a mode without it, such as "yaw-steering"'
                raise InputError(
                    self.scene.source,
                    "attitude.mode",
                    "nadir needs a velocity, which alt-az rows lack",
                    expected,
                )
        if self.scene is None or self.scene.orbit.altaz:
            numbers += ["alt", "az", "height"]
        readers: dict[str, Any] = {name: read_numbers for name in numbers if name in names}
        readers |= self.labels
        if "upper_limit" in names:
            readers["upper_limit"] = read_flags
        self.time_format = self._time_format()
        readers["time"] = self._read_times
        columns = read_columns(self.header, readers)
        for name in numbers:
            if name in columns:
                columns[name] = self._converted(name, columns[name])
        for name in ("exptime", f"{self.kind}_err"):
            if name in columns and not np.isfinite(columns[name]).any():
                del columns[name]
                self.warnings.append(f"column {name} holds no number and counts as absent")
        return columns

    def _read_times(self, header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
        """Two-part Julian dates (T, 2); the first cell of the file decides between ISO and JD."""
        if not self.time_format:
            self.time_format = "jd" if re.fullmatch(r"\s*[+-]?[\d.]+([eE][+-]?\d+)?\s*", cells[0]) else "iso"
        try:
            if self.time_format == "iso":
                return np.stack(julian_dates_of_iso(cells, self.scale), axis=-1)
            for index, cell in enumerate(cells):
                if not cell.strip():
                    raise UnreadableTime(index, "", "a Julian date, found a blank cell")
            numbers = read_numbers(header, name, cells, start)
            return np.stack(
                julian_dates_of_numbers(numbers, self.scale, modified=self.time_format == "mjd"), axis=-1
            )
        except UnreadableTime as error:
            place = row_place(start + error.index, name)
            raise InputError(self.source, place, repr(error.found[:40]), error.expected) from None

    def _converted(self, name: str, values: np.ndarray) -> np.ndarray:
        text = self.header.units.get(name)
        target = UNITS.get(name)
        if name == "flux_err":
            target = self.header.units.get("flux")
        if not text or target is None:
            return values
        try:
            unit, target = u.Unit(text[:60]), u.Unit(target)
            if getattr(unit, "function_unit", None) == u.mag:
                return values
            factor = unit.to(target)
        except (ValueError, TypeError, OverflowError, u.UnitsError):
            raise InputError(
                self.source, f"column {name}", f"unit {text[:60]}", f"a unit like {target}"
            ) from None
        return values if factor == 1.0 else values * factor

    # --- judging rows

    def recording(self, min_rows: int) -> Recording:
        self._drop_non_finite()
        self._check_values()
        self._sort()
        first = self._time()[0]
        self._keep(~_repeats(self.columns), "duplicate")
        if "alt" in self.columns:
            self._keep(self.columns["alt"] >= 0, "below the horizon")
        columns, rows = self.columns, len(self.columns["time"])
        if rows < min_rows:
            counts = "".join(f", {count} {reason}" for reason, count in self.dropped.items())
            raise InputError(
                self.source, None, f"{rows} usable row{'s' * (rows > 1)}{counts}", f"at least {min_rows}"
            )
        station, station_ids = self._stations()
        curve, curve_ids = self._curves(station, station_ids)
        night, night_ids = self._nights(station, station_ids)
        band = self._band()
        time = self._time()
        vectors = {
            name: np.stack([columns[f"{VECTORS[name]}_{axis}"] for axis in "xyz"], axis=-1)
            for name in self.vectors
        }
        for name, vector in vectors.items():
            if not (np.abs(vector).max(-1) > 0).all():
                raise InputError(
                    self.source, f"columns {VECTORS[name]}_*", "a vector of length 0", "a direction"
                )
        return Recording(
            time=time,
            seconds=seconds_since(time, time[0]),
            first_time=first,
            kind=self.kind,
            observed=columns[self.kind],
            error=columns.get(f"{self.kind}_err"),
            station=station,
            station_ids=station_ids,
            curve=curve,
            curve_ids=curve_ids,
            night=night,
            night_ids=night_ids,
            upper_limit=columns.get("upper_limit", np.zeros(rows, dtype=bool)),
            exptime=columns.get("exptime"),
            band=band,
            sun=vectors.get("sun"),
            obs=vectors.get("obs"),
            position=vectors.get("position"),
            velocity=vectors.get("velocity"),
            alt=columns.get("alt"),
            az=columns.get("az"),
            height=columns.get("height"),
            frame=self.frame,
            light_time_corrected=self._light_time_corrected(),
            meta=self.header.meta,
            dropped=self.dropped,
            warnings=tuple(self.warnings),
            source=self.source,
        )

    def _keep(self, mask: np.ndarray, reason: str) -> None:
        lost = int(np.size(mask) - np.count_nonzero(mask))
        if lost:
            self.dropped[reason] = self.dropped.get(reason, 0) + lost
            self.columns = {name: column[mask] for name, column in self.columns.items()}
            self.rows = self.rows[mask]
        if not mask.any():
            raise no_usable_row(self.source, self.dropped)

    def _drop_non_finite(self) -> None:
        """Rows with a blank or infinite number go; an upper limit without an error takes the median."""
        error = self.columns.get(f"{self.kind}_err")
        limit = self.columns.get("upper_limit")
        if error is not None and limit is not None:
            self.columns[f"{self.kind}_err"] = np.where(limit & np.isnan(error), np.nanmedian(error), error)
        mask = np.ones(len(self.rows), dtype=bool)
        for column in self.columns.values():
            if column.dtype.kind == "f":
                mask &= np.isfinite(column).reshape(len(mask), -1).all(-1)
        self._keep(mask, "non-finite")

    def _check_values(self) -> None:
        limits = {f"{self.kind}_err": "> 0", "exptime": ">= 0", "alt": "-90 to 90", "height": "> 0"}
        for name, expected in limits.items():
            column = self.columns.get(name)
            if column is None:
                continue
            if expected == "-90 to 90":
                bad = np.abs(column) > 90
            else:
                bad = column <= 0 if expected == "> 0" else column < 0
            if bad.any():
                index = int(np.flatnonzero(bad)[0])
                place = row_place(int(self.rows[index]), name)
                raise InputError(self.source, place, f"{column[index]:g}", expected)

    def _sort(self) -> None:
        days = self.columns["time"]
        whole = np.floor(days.sum(-1))
        rest = (days[:, 0] - whole) + days[:, 1]
        step, part = np.diff(whole), np.diff(rest)
        if ((step < 0) | ((step == 0) & (part < 0))).any():
            order = np.lexsort((rest, whole))
            self.columns = {name: column[order] for name, column in self.columns.items()}
            self.rows = self.rows[order]
            self.warnings.append("the rows were not in order of time and have been sorted")

    def _time(self) -> Time:
        days = self.columns["time"]
        return Time(days[:, 0], days[:, 1], format="jd", scale=self.scale)

    def _stations(self) -> tuple[np.ndarray, tuple[str, ...]]:
        codes = self.columns.get("station")
        named = self.labels["station"].ids if codes is not None else ()
        known = () if self.scene is None else tuple(station.id for station in self.scene.stations)
        if not known:
            return (
                (codes, named)
                if codes is not None
                else (np.zeros(len(self.rows), dtype=np.int64), (NO_STATION,))
            )
        if codes is None:
            if len(known) > 1:
                raise self._missing("station", f"a column station: the scene has {len(known)}")
            return np.zeros(len(self.rows), dtype=np.int64), known
        numbers = np.zeros(len(named), dtype=np.int64)
        for code in np.unique(codes):
            name = named[code]
            if name in known:
                numbers[code] = known.index(name)
            elif name or len(known) > 1:
                row = int(self.rows[np.flatnonzero(codes == code)[0]])
                near = difflib.get_close_matches(name, known, n=1)
                hint = f"Did you mean {near[0]!r}?" if near else None
                expected = f"a station of the scene: {', '.join(known)}"
                raise InputError(
                    self.source, row_place(row, "station"), repr(name[:40]), expected[:200], hint
                )
        return numbers[codes], known

    def _band(self) -> np.ndarray | None:
        """Band names (T,), and the check that the scene knows the Sun's magnitude in each."""
        codes = self.columns.get("band")
        names = self.labels["band"].ids if codes is not None else ()
        sun = None if self.scene is None else self.scene.model.band_sun_magnitude
        if isinstance(sun, dict) and self.kind == "mag":
            present = [names[code] for code in np.unique(codes)] if codes is not None else []
            unknown = [name for name in present if name not in sun]
            if unknown:
                place, expected = (
                    "model.parameters.band_sun_magnitude",
                    f"the bands {', '.join(sorted(set(present)))}",
                )
                raise InputError(
                    self.scene.source if self.scene else None, place, f"no band {unknown[0]!r}", expected
                )
            if codes is None and len(sun) > 1:
                raise self._missing("band", "a column band: the scene gives the Sun's magnitude in several")
        if self.scene is not None and sun is None and self.kind == "mag":
            self.warnings.append("the scene has no band_sun_magnitude; -26.7 is taken")
        return None if codes is None else np.array(names, dtype=object)[codes]

    def _curves(
        self, station: np.ndarray, station_ids: tuple[str, ...]
    ) -> tuple[np.ndarray, tuple[str, ...]]:
        """The ``curve`` column, else one curve for each station and band."""
        if "curve" in self.columns:
            return compact(self.columns["curve"], [name or "unnamed" for name in self.labels["curve"].ids])
        bands = self.labels["band"].ids if "band" in self.columns else ("",)
        band = self.columns.get("band", np.zeros(len(self.rows), dtype=np.int64))
        pairs = [f"{place} {name}".strip() for place in station_ids for name in bands]
        return compact(station * len(bands) + band, pairs)

    def _nights(
        self, station: np.ndarray, station_ids: tuple[str, ...]
    ) -> tuple[np.ndarray, tuple[str, ...]]:
        """A station's local noon to noon, named after the evening; without stations, rows between gaps."""
        jd = self.columns["time"].sum(-1)
        if self.scene is None or not self.scene.stations:
            night = np.concatenate([[0], np.cumsum(np.diff(jd) > NIGHT_GAP_DAYS)])
            starts = np.flatnonzero(np.diff(night, prepend=-1))
            dates = Time(jd[starts], format="jd", scale=self.scale).datetime64.astype("datetime64[m]")
            return night.astype(np.int64), tuple(str(date) for date in dates)
        longitude = np.array([place.longitude for place in self.scene.stations])
        noon = np.floor(jd + longitude[station] / 360).astype(np.int64)
        keys, night = np.unique(np.stack([noon, station], axis=-1), axis=0, return_inverse=True)
        several = len(np.unique(station)) > 1
        ids = []
        for day, place in keys:
            date = str(np.datetime64("2000-01-01") + np.timedelta64(int(day) - 2451545, "D"))
            ids.append(f"{station_ids[place]} {date}" if several else date)
        return night.reshape(-1).astype(np.int64), tuple(ids)

    def _light_time_corrected(self) -> bool:
        said = str(self.header.meta.get("light_time_corrected", False)).strip().lower()
        if said not in ("true", "false"):
            raise InputError(self.source, "metadata light_time_corrected", repr(said[:40]), "true or false")
        return said == "true"


def _repeats(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """(T,) true for rows, in order of time, that equal an earlier row in every column read."""
    time = columns["time"].sum(-1)
    tied = np.zeros(len(time), dtype=bool)
    equal = time[1:] == time[:-1]
    tied[1:] |= equal
    tied[:-1] |= equal
    index = np.flatnonzero(tied)
    repeats = np.zeros(len(time), dtype=bool)
    if index.size:
        table = np.concatenate(
            [c[index].reshape(len(index), -1).astype(np.float64) for c in columns.values()], axis=-1
        )
        _, first = np.unique(table, axis=0, return_index=True)
        repeats[index] = True
        repeats[index[first]] = False
    return repeats
