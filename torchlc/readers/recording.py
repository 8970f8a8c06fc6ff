"""Recordings: read from files and from what others hold, shown, and given back."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from torchlc.digits import number_of
from torchlc.files.reading import sha256_of, unchanged
from torchlc.files.svg import scatter
from torchlc.readers import exchange
from torchlc.readers.formats import read_header
from torchlc.readers.measurements import Measurements, counted
from torchlc.readers.reader import read_measurements
from torchlc.readers.table import Header
from torchlc.scene.reading import Reading, reading_of

if TYPE_CHECKING:
    import pandas
    from astropy.table import Table
    from astropy.timeseries import TimeSeries

    from torchlc.scene import Scene


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Measurements):
    __doc__ = Measurements.__doc__

    def __repr__(self) -> str:
        first, last = (str(cast(Any, self.time[i]).isot)[:19] for i in (0, -1))
        parts = [f"{number_of(len(self), 'row')} of {self.kind}, {first} to {last} {self.time.scale.upper()}"]
        for names, what in (
            (self.curve_ids, "curve"),
            (self.night_ids, "night"),
            (self.station_ids, "station"),
            *([(self.object_ids, "object")] if self.object is not None else []),
        ):
            parts.append(f"{number_of(len(names), what)}")
        parts.append(
            "errors to be fitted" if self.error is None else f"errors of {np.median(self.error):.2g}"
        )
        parts += [f"left out: {counted(self.dropped)}"] if self.dropped else []
        return "\n".join([f"Recording: {', '.join(parts)}", *(f"  ! {text}" for text in self.warnings)])

    def _repr_html_(self) -> str:
        hours = self.seconds / 3600.0
        up = self.kind == "flux"
        first = str(cast(Any, self.time[0]).isot)[:16].replace("T", " ")
        label = f"{self.kind} against hours from {first} {self.time.scale.upper()}"
        picture = scatter(hours, self.observed, self.curve, label, upwards=up)
        return f"<div>{picture}<pre>{html.escape(repr(self))}</pre></div>"

    @classmethod
    def from_timeseries(
        cls, series: TimeSeries, scene: Scene | None = None, *, use: str | None = None
    ) -> Recording:
        """The recording that an astropy TimeSeries or a lightkurve LightCurve holds, checked as a file is.

        Columns have the names and units of a file, ``time`` first. Times in TDB or TCB become TDB, all others
        UTC; barycentric times are taken as they are.
        """
        return recording_of(series, scene, use=use)

    @classmethod
    def from_table(
        cls,
        rows: Any,
        scene: Scene | None = None,
        *,
        use: str | None = None,
        columns: str | Mapping[str, Any] | None = None,
    ) -> Recording:
        """The recording that an astropy Table, a pandas DataFrame or a mapping of columns holds: arrays, quantities, and
        instants as astropy's Time, checked as a file is.

        ``columns`` says which is what where they have other names: "time=JD_UTC,mag=V", or a mapping.
        """
        return recording_of(rows, scene, use=use, columns=columns)

    def to_table(self) -> Table:
        """An astropy Table with every column and its unit; written as ECSV it is a recording again."""
        return exchange.to_table(self)

    def to_pandas(self) -> pandas.DataFrame:
        """A DataFrame of pandas with every column; ``time`` holds instants."""
        return exchange.to_pandas(self)

    def to_timeseries(self) -> TimeSeries:
        """An astropy TimeSeries with every column and its unit; ``from_timeseries`` gives the same recording."""
        return exchange.to_timeseries(self)

    def to_lightkurve(self) -> Any:
        """A lightkurve LightCurve; magnitudes become flux over that of their median, and are kept beside it."""
        return exchange.to_lightkurve(self)


def load_recording(
    path: str | Path,
    scene: Scene | None = None,
    *,
    use: str | None = None,
    columns: str | Mapping[str, Any] | Reading | None = None,
    min_rows: int = 1,
) -> Recording:
    """Read a recording in any of the formats of :mod:`torchlc.readers.formats` and check it, against the scene's needs
    when one is given.

    ``use`` picks "mag" or "flux" when both are there (default mag). ``columns`` says which column is what, over the
    scene's table [recording]. Without a ``curve`` column each station and band is one curve. A night is a station's
    local noon to noon, named after its evening, or, without stations, what lies between gaps of more than 6 h.
    """
    path, reading = Path(path), _reading(scene, columns)
    with unchanged(path):
        recording = _recording(read_header(path, reading, scene), scene, reading, use, min_rows)
        return replace(recording, sha256=sha256_of(path))


def recording_of(
    rows: Any,
    scene: Scene | None = None,
    *,
    use: str | None = None,
    columns: str | Mapping[str, Any] | Reading | None = None,
    min_rows: int = 1,
) -> Recording:
    """The recording that a path, a Recording or rows in memory hold; see :meth:`Recording.from_table`."""
    if isinstance(rows, Recording):
        return rows
    if isinstance(rows, str | Path):
        return load_recording(rows, scene, use=use, columns=columns, min_rows=min_rows)
    reading = _reading(scene, columns)
    header = exchange.header_of(rows, reading)
    return replace(_recording(header, scene, reading, use, min_rows), source=None)


def _reading(scene: Scene | None, columns: str | Mapping[str, Any] | Reading | None) -> Reading:
    """What scene and caller say of how a file is to be read; the caller's word counts."""
    given = reading_of(columns)
    return given if scene is None else scene.recording.with_given(given)


def _recording(
    header: Header, scene: Scene | None, reading: Reading, use: str | None, min_rows: int
) -> Recording:
    return Recording(**vars(read_measurements(header, scene, reading, use=use, min_rows=min_rows)))
