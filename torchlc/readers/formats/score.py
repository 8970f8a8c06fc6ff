"""Observations of satellites in the repository SCORE of the IAU CPS (score.cps.iau.org/data-format)."""

from __future__ import annotations

import csv
from collections.abc import Iterator

from torchlc.errors import InputError
from torchlc.files.decimals import checked_decimal
from torchlc.readers.format import Format, Head
from torchlc.readers.objects import chosen_object
from torchlc.readers.stations import to_add
from torchlc.readers.table import BLANK, Header, Row, cells_of_lines, check_names, check_width, lines_of

SATELLITE = ("satellite_name", "norad_cat_id")
OF_SCORE = {"observation_time_utc", "apparent_magnitude"}
PLACE = ("observer_latitude_deg", "observer_longitude_deg", "observer_altitude_m")
ERRORS = ("apparent_magnitude_uncertainty", "apparent_magnitude_uncert")
NEAR_DEG = 0.05
"""Of a station of the scene, in latitude and longitude: 5 km. Observers round their places, some for privacy."""


class Score(Format):
    """Observations of satellites (IAU CPS): apparent magnitudes at mid-exposure in UTC.

    A row without a magnitude but with a limiting one is an upper limit. Of a file of many satellites one is chosen, or all, each by
    its first name. An observer's place has to be within 0.05 deg of a station of the scene.
    """

    name = "SCORE"
    files = "CSV"

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return {name.strip() for name in head.first.split(",")} >= OF_SCORE

    @classmethod
    def read(cls, head: Head) -> Header:
        path = head.path
        names = [name.strip() for name in next(csv.reader([head.first]))]
        check_names(path, names)
        error_name = next((name for name in ERRORS if name in names), "")

        def all_rows() -> Iterator[tuple[int, dict[str, str]]]:
            numbered = enumerate(lines_of(path), 1)
            lines = ((number, line) for number, line in numbered if not line.startswith("#") and line.strip())
            rows = cells_of_lines(path, lines)
            next(rows)
            for number, cells in rows:
                check_width(path, f"line {number}", cells, names)
                yield number, dict(zip(names, map(str.strip, cells), strict=False))

        def called(cells: dict[str, str]) -> set[str]:
            return {cells.get(name, "") for name in SATELLITE} - {""}

        wanted = chosen_object(path, (called(cells) for _, cells in all_rows()), head.reading.object)
        stations: dict[tuple[str, ...], str] = {}

        def rows() -> Iterator[Row]:
            for number, cells in all_rows():
                if wanted is not None and wanted not in called(cells):
                    continue
                mag, error = cells["apparent_magnitude"], cells.get(error_name, "")
                limit = cells.get("limiting_magnitude", "")
                if mag.lower() in BLANK and limit.lower() not in BLANK:
                    mag, error = f">{limit}", ""
                place = tuple(cells.get(name, "") for name in PLACE)
                if place not in stations:
                    stations[place] = _station(head, number, place)
                yield (
                    number,
                    [
                        cells["observation_time_utc"],
                        mag,
                        error,
                        cells.get("observing_filter", ""),
                        stations[place],
                        next((cells[name] for name in SATELLITE if cells.get(name)), ""),
                        cells.get(SATELLITE[1], ""),
                    ],
                )

        columns = ("time", "mag", "mag_err", "band", "station", "object", "object_number")
        theirs = {
            "time": "observation_time_utc",
            "mag": "apparent_magnitude",
            "mag_err": error_name or "none",
            "band": "observing_filter",
            "station": "place of the observer",
            "object": " or ".join(name for name in SATELLITE if name in names) or "none",
            "object_number": SATELLITE[1] if SATELLITE[1] in names else "none",
        }
        return Header(
            path,
            columns,
            ",",
            ecsv=False,
            meta={"time_format": "iso"},
            rows=rows,
            format=cls.name,
            theirs=theirs,
        )


def _station(head: Head, line: int, place: tuple[str, ...]) -> str:
    """The station of the scene at a place; the place itself as a name where there is no scene."""
    if head.scene is None or not head.scene.stations or not all(place[:2]):
        return ", ".join(filter(None, place)) if head.scene is None else ""
    latitude, longitude = (
        checked_decimal(place[k], head.path, f"line {line}, column {PLACE[k]}") for k in range(2)
    )
    for station in head.scene.stations:
        east = (station.longitude - longitude + 180.0) % 360.0 - 180.0
        if abs(station.latitude - latitude) < NEAR_DEG and abs(east) < NEAR_DEG:
            return station.id
    known = ", ".join(
        f"{site.id} at {site.latitude:g}, {site.longitude:g}" for site in head.scene.stations[:5]
    )
    raise InputError(
        head.path,
        f"line {line}",
        f"an observer at {latitude:g}, {longitude:g}",
        f"a station of the scene: {known}",
        to_add(f"{latitude:g} {longitude:g}", f"{latitude:g}", f"{longitude:g}", place[2] or "0"),
    )
