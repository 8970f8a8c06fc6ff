"""The station of each row, and what to write for one that a recording has and its scene has not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from torchlc.errors import InputError
from torchlc.readers import declared
from torchlc.readers.table import Header, LabelReader, row_place
from torchlc.scene.writer import toml_value
from torchlc.suggest import did_you_mean

if TYPE_CHECKING:
    from torchlc.scene import Scene

NO_STATION = "unknown"


def station_numbers(
    header: Header,
    scene: Scene | None,
    columns: Mapping[str, np.ndarray],
    labels: Mapping[str, LabelReader],
    rows: np.ndarray,
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Station of each of the ``rows`` (T,) of a file as an index into the scene's stations, else into those that the file names."""
    codes = columns.get("station")
    known = () if scene is None else tuple(station.id for station in scene.stations)
    if codes is None:
        if len(known) > 1:
            raise declared.missing(header, "station", f"a column station: the scene has {len(known)}")
        return np.zeros(len(rows), dtype=np.int64), known or (NO_STATION,)
    named = labels["station"].ids
    if not known:
        return codes, named
    numbers = np.zeros(len(named), dtype=np.int64)
    for code in np.unique(codes):
        name = named[code]
        if name in known:
            numbers[code] = known.index(name)
        elif name or len(known) > 1:
            place = row_place(int(rows[np.flatnonzero(codes == code)[0]]), "station")
            expected = f"a station of the scene: {', '.join(known)}"[:200]
            raise InputError(header.source, place, repr(name[:40]), expected, remedy(name, known))
    return numbers[codes], known


def to_add(
    name: str, latitude: str = "(deg north)", longitude: str = "(deg east)", height: str = "(m)"
) -> str:
    """The lines of a scene that make a station of this name; words in brackets stand for numbers that are not known."""
    return (
        f"Add to the scene, each on a line of its own: [[stations]], id = {toml_value(name)}, latitude = {latitude}, "
        f"longitude = {longitude}, height = {height}"
    )


def remedy(name: str, known: Sequence[str]) -> str:
    """What to do about a name of a row's station, blank or not, that is none of those that the scene has."""
    if not name:
        return "Write into every row which of them it is from"
    near = did_you_mean(name, known)
    only = f"If {known[0]} has been meant, that may be its id in the scene. " if len(known) == 1 else ""
    return f"{f'{near} ' if near else only}{to_add(name)}"
