"""Observations of satellites in the repository SCORE of the IAU CPS (score.cps.iau.org/data-format)."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence

from torchlc.files.decimals import checked_decimal
from torchlc.readers.format import Format, Head
from torchlc.readers.objects import chosen_object
from torchlc.readers.roles import SITE, looks_like_site, named_as_site
from torchlc.readers.stations import no_station_there, station_near
from torchlc.readers.table import BLANK, Header, Row, cells_of_lines, check_names, check_width, lines_of

SATELLITE = ("satellite_name", "norad_cat_id")
OF_SCORE = {"observation_time_utc", "apparent_magnitude"}
PLACE = ("observer_latitude_deg", "observer_longitude_deg", "observer_altitude_m")
ERRORS = ("apparent_magnitude_uncertainty", "apparent_magnitude_uncert")


class Score(Format):
    """Observations of satellites (IAU CPS): apparent magnitudes at mid-exposure in UTC.

    A row without a magnitude but with a limiting one is an upper limit. Of a file of many satellites one is chosen, or all, each by
    its first name. An observer's place, also under usual names such as ``site_lat``, has to be within 0.05 deg of
    a station of the scene.
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
        places = _places(names)
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
                place = tuple(cells.get(name, "") for name in places)
                if place not in stations:
                    stations[place] = _station(head, number, places, place)
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
            "station": _named_place(names, places),
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


def _places(names: Sequence[str]) -> tuple[str, ...]:
    """Columns of latitude, longitude and height of the observer, by SCORE's names or usual ones; blank where there is none."""
    others = {role: name for name in reversed(names) if (role := named_as_site(name)) is not None}
    return tuple(
        ours if ours in names else others.get(role, "") for ours, role in zip(PLACE, SITE, strict=True)
    )


def _named_place(names: Sequence[str], places: Sequence[str]) -> str:
    """What is taken for the station, and what looks like it and is not."""
    taken = "place of the observer" if all(places[:2]) else "none"
    others = [name for name in places if name and name not in PLACE]
    left = [name for name in names if looks_like_site(name) and name not in places]
    said = [", ".join(others)] if others else []
    said += [f"not used: {', '.join(left)}"] if left else []
    return f"{taken} ({'; '.join(said)})" if said else taken


def _station(head: Head, line: int, columns: Sequence[str], place: tuple[str, ...]) -> str:
    """The station of the scene at a place; the place itself as a name where there is no scene."""
    if head.scene is None or not head.scene.stations or not all(place[:2]):
        return ", ".join(filter(None, place)) if head.scene is None else ""
    latitude, longitude = (
        checked_decimal(place[k], head.path, f"line {line}, column {columns[k]}") for k in range(2)
    )
    near = station_near(head.scene, latitude, longitude)
    if near is None:
        raise no_station_there(head.path, f"line {line}", head.scene, latitude, longitude, place[2])
    return near
