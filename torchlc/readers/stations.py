"""The station of each row, and what to write for one that a recording has and its scene has not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torchlc.errors import InputError
from torchlc.files.decimals import decimal
from torchlc.readers import declared
from torchlc.readers.roles import SAYS_WHOSE, SITE, looks_like_site, plain
from torchlc.readers.table import BLANK, Header, LabelReader, row_place, with_point
from torchlc.scene.writer import toml_value
from torchlc.suggest import did_you_mean

if TYPE_CHECKING:
    from torchlc.scene import Scene

NO_STATION = "unknown"
NEAR_DEG = 0.05
"""Of a station of the scene, in latitude and longitude: 5 km. Observers round their places, some for privacy."""
DECIMALS = 5
"""Of degrees in the name of a place: a metre."""


class SiteReader:
    """Reads latitudes, longitudes or heights (T,), degrees or metres; what is no number is noted as ``unreadable``, for
    nothing else in the row depends on it."""

    def __init__(self) -> None:
        self.unreadable = ""

    def __call__(self, header: Header, name: str, cells: list[str], start: int) -> np.ndarray:
        numbers = np.full(len(cells), np.nan)
        for index, cell in enumerate(cells):
            if cell.strip().lower() in BLANK:
                continue
            try:
                numbers[index] = decimal(with_point(cell, header.decimal) if header.decimal != "." else cell)
            except ValueError:
                self.unreadable = self.unreadable or cell.strip()
        return numbers


def station_near(scene: Scene, latitude: float, longitude: float) -> str | None:
    """The id of the station of the scene at this place."""
    for station in scene.stations:
        east = (station.longitude - longitude + 180.0) % 360.0 - 180.0
        if abs(station.latitude - latitude) < NEAR_DEG and abs(east) < NEAR_DEG:
            return station.id
    return None


def no_station_there(
    header_source: Path, where: str, scene: Scene, latitude: float, longitude: float, height: str
) -> InputError:
    """The error of an observer who is at no station of the scene, with the lines that add one."""
    known = ", ".join(f"{site.id} at {site.latitude:g}, {site.longitude:g}" for site in scene.stations[:5])
    return InputError(
        header_source,
        where,
        f"an observer at {latitude:g}, {longitude:g}",
        f"a station of the scene: {known}",
        to_add(f"{latitude:g} {longitude:g}", f"{latitude:g}", f"{longitude:g}", height or "0"),
    )


def sites_read(header: Header) -> tuple[str, ...]:
    """Columns of the observer's place by which the station of a row can be known; none where a column names it."""
    if "station" in header.names or not all(name in header.names for name in SITE[:2]):
        return ()
    return tuple(name for name in SITE if name in header.names)


def stations_by_place(
    header: Header, scene: Scene | None, sites: Mapping[str, np.ndarray], rows: np.ndarray, *, by_user: bool
) -> tuple[list[str], str]:
    """The id of the station (T,) at the latitude and longitude of each of the ``rows`` (T,), blank where these are; else none, and why not.

    ``by_user``: the user says that these columns are the observer's. InputError where they are, or say so by name, and a row is
    at no station of the scene. Columns called latitude alone may be of anything, and are left.
    """
    certain = by_user or any(SAYS_WHOSE.search(plain(header.theirs[name])) for name in SITE[:2])
    degrees = [declared.converted(header, name, sites[name]) for name in SITE[:2]]
    metres = (
        declared.converted(header, SITE[2], sites[SITE[2]])
        if SITE[2] in sites
        else np.full(len(rows), np.nan)
    )
    if scene is not None and not scene.stations:
        return [], "the scene has no station"
    if scene is None and not certain:
        return [], "no scene"
    if not np.isfinite(degrees[0] + degrees[1]).any():
        return [], "no degrees in them"
    names: dict[tuple[float, float], str] = {}
    labels = []
    for row, latitude, longitude, height in zip(
        rows, *(column.tolist() for column in (*degrees, metres)), strict=True
    ):
        if not np.isfinite(latitude + longitude):
            labels.append("")
            continue
        at = (latitude, longitude)
        if at not in names and scene is None:
            names[at] = ", ".join(
                str(round(number, DECIMALS)) for number in (*at, height) if np.isfinite(number)
            )
        elif at not in names and scene is not None:
            near = station_near(scene, *at)
            if near is None and certain:
                text = f"{height:g}" if np.isfinite(height) else ""
                raise no_station_there(header.source, f"row {row + 1}", scene, *at, text)
            if near is None:
                return [], "at no station of the scene"
            names[at] = near
        labels.append(names[at])
    return labels, ""


def left_of_sites(header: Header, used: Sequence[str], because: str) -> str:
    """Columns that look like the observer's place and are not ``used``, with the reason if there is one; empty for none."""
    places = {column for name in used for column in header.places(name)}
    left = [
        header.theirs.get(name, name)
        for column, name in enumerate(header.names)
        if column not in places and (name in SITE or looks_like_site(name))
    ]
    return f"{', '.join(left)}{f' ({because})' if because else ''}" if left else ""


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
