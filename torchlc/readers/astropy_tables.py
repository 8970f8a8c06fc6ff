"""Tables that astropy holds, as the names, units and text of cells that a Header is made of."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table
from astropy.time import Time, TimeBase
from astropy.utils import iers
from astropy.utils.exceptions import AstropyWarning
from erfa import ErfaWarning

from torchlc.errors import InputError
from torchlc.readers.table import Row

KEPT = {"utc": "utc", "tai": "tai", "tt": "tt", "tdb": "tdb", "tcb": "tdb", "tcg": "tt", "ut1": "utc"}
"""Time scales of astropy and those that their instants are told in."""
PLAIN_KINDS = "biufUSO"
"""Kinds of array whose values have a text that tells the same value again."""


def read_table(path: Path, lines: Sequence[str]) -> Table:
    """The table of ECSV ``lines``, its masks, quantities and times put together again by astropy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AstropyWarning)
        warnings.simplefilter("ignore", ErfaWarning)
        try:
            return Table.read([line.rstrip("\r\n") for line in lines], format="ascii.ecsv")
        except Exception as error:  # astropy builds what the header names, and can raise anything
            found = f"astropy cannot read it: {error}"[:300]
            raise InputError(path, None, found, "ECSV as astropy writes it") from None


def plain_columns(table: Any) -> dict[str, Any]:
    """Columns of one number, flag or text a row; others, such as coordinates, are left."""
    columns: dict[str, Any] = {}
    for name in table.colnames:
        values = getattr(table[name], "value", table[name])
        if isinstance(table[name], TimeBase):
            continue
        if np.ndim(values) == 1 and getattr(getattr(values, "dtype", None), "kind", "") in PLAIN_KINDS:
            columns[name] = table[name]
    return columns


def described(
    source: Path, time: Time | None, columns: dict[str, Any], meta: dict[str, Any]
) -> dict[str, Any]:
    """Fields of a Header: ``time`` (T,), where there is one, as ISO text of a scale of ``KEPT``, and
    ``columns``.
    """
    names = list(columns)
    cells: list[Callable[[], list[str]]] = [
        lambda column=column: _cells(column) for column in columns.values()
    ]
    if time is not None:
        scale = KEPT.get(time.scale, "utc")
        texts = _iso(source, time, scale)
        names, cells = ["time", *names], [lambda: texts, *cells]
        meta = {**meta, "time_scale": scale, "time_format": "iso"}

    def rows() -> Iterator[Row]:
        yield from enumerate(map(list, zip(*(texts() for texts in cells), strict=True)), 1)

    return {
        "source": source,
        "names": tuple(names),
        "delimiter": ",",
        "ecsv": False,
        "units": {
            name: str(column.unit) for name, column in columns.items() if getattr(column, "unit", None)
        },
        "descriptions": {
            name: str(getattr(column.info, "description", "") or "") for name, column in columns.items()
        },
        "meta": meta,
        "rows": rows,
        "placed_by": "row",
    }


def described_table(path: Path, table: Table) -> dict[str, Any]:
    """Fields of a Header for a table of a file, in which ``time`` may be instants or plain numbers or text."""
    columns, time = plain_columns(table), None
    if "time" in table.colnames and "time" not in columns:
        time = table["time"]
        if not isinstance(time, Time):
            kind = "durations" if isinstance(time, TimeBase) else type(time).__name__
            raise InputError(path, "column time", kind, "instants: ISO text, Julian dates or astropy's Time")
    said = {key: value for key, value in (table.meta or {}).items() if key != "__serialized_columns__"}
    fields = described(path, time, columns, said)
    if time is not None:
        fields["descriptions"]["time"] = str(getattr(time.info, "description", "") or "")
    return fields


def _iso(source: Path, time: Time, scale: str) -> list[str]:
    """ISO text (T,) to the nanosecond; blank where masked."""
    with warnings.catch_warnings(), iers.conf.set_temp("auto_download", False):
        warnings.simplefilter("ignore", AstropyWarning)
        warnings.simplefilter("ignore", ErfaWarning)
        try:
            moments: Any = getattr(time, scale).copy(format="isot")
            moments.precision = 9
            return np.ma.filled(moments.value, "").tolist()
        except Exception as error:  # a local time, or UT1 beyond the tables
            found = f"times of scale {time.scale} that astropy cannot convert: {error}"[:300]
            raise InputError(source, "column time", found, f"{scale.upper()}") from None


def _cells(column: Any) -> list[str]:
    """Text of every value, blank where masked; a number's text gives the same number again."""
    values = getattr(column, "value", column)
    hidden = np.broadcast_to(getattr(values, "mask", False), np.shape(values))
    data = np.asarray(getattr(values, "unmasked", getattr(values, "data", values)))
    text = [value if isinstance(value, str) else repr(value) for value in data.tolist()]
    return ["" if out else cell for cell, out in zip(text, hidden, strict=True)]
