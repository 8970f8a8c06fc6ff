"""Tracks of the satellite photometry of Mini-MegaTORTORA (mmt.favor2.info; Karpov et al. 2016).

:mod:`torchlc.readers.empty_slots` makes upper limits of the slots without a row.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator

from torchlc.readers.format import Format, Head
from torchlc.readers.table import Header, Row, check_width, lines_of

MMT = {"StdMag", "Mag", "Filter", "Channel"}


class MiniMegaTortora(Format):
    """A track, or all tracks of a satellite: apparent magnitudes ``Mag`` at times in UTC, ``Filter`` the band.

    ``StdMag`` is not taken. Each track and camera channel is a curve, for steps of some hundredths of a magnitude may lie between
    channels. Of the slots, ten a second, a row is there only where the camera found the object: the others become upper limits.
    """

    name = "Mini-MegaTORTORA"
    files = "`.txt` of mmt.favor2.info, or the same as CSV"

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return bool(_names(head))

    @classmethod
    def read(cls, head: Head) -> Header:
        path, names = head.path, _names(head)
        split = "Time" in names
        index = {name: names.index(name) for name in (*MMT, "Date", "Track") if name in names}

        def rows() -> Iterator[Row]:
            for number, line in enumerate(lines_of(path), 1):
                if line.startswith(("#", "Date,")) or not line.strip():
                    continue
                cells = line.split() if split else next(csv.reader([line.strip()]))
                check_width(path, f"line {number}", cells, names)
                date = "T".join(cells[:2]) if split else cells[index["Date"]]
                track = f"track {cells[index['Track']]} " if "Track" in index else ""
                band = cells[index["Filter"]]
                curve = f"{track}channel {cells[index['Channel']]}"
                yield number, [date, cells[index["Mag"]], "clear" if band == "Clear" else band, curve]

        about = dict(line.split(": ", 1) for line in head.comments if ": " in line)
        meta = {"object": about["satellite"]} if "satellite" in about else {}
        return Header(
            path,
            ("time", "mag", "band", "curve"),
            ",",
            ecsv=False,
            meta=meta,
            rows=rows,
            format=cls.name,
            theirs={
                "time": "Date and Time" if split else "Date",
                "mag": "Mag",
                "band": "Filter",
                "curve": "Track and Channel" if "Track" in index else "Channel",
            },
            skips_non_detections=True,
        )


def _names(head: Head) -> list[str]:
    """Names of the columns; none where it is another format."""
    names = head.first.split(",")
    if set(names) >= MMT | {"Date"}:
        return names
    titles = (line.split() for line in head.comments if line.startswith("Date Time"))
    return next((title for title in titles if set(title) >= MMT), [])
