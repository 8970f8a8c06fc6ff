"""Forced photometry of ATLAS (fallingstar-data.com/forcedphot)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from torchlc.files.decimals import checked_decimal
from torchlc.readers.format import Format, Head
from torchlc.readers.table import Header, Row, check_width, lines_of
from torchlc.scene.reading import Reading

EXPOSURE_S = 30.0
NAMES = ("MJD", "m", "dm", "uJy", "duJy", "F")


class Atlas(Format):
    """Forced photometry: AB magnitudes of difference images, each filter a band.

    A negative magnitude stands for a negative flux there, and is read as an upper limit at the 5-sigma magnitude ``mag5sig`` of its
    row. MJD is the start of the exposure, which takes 30 s (fallingstar-data.com/forcedphot/resultdesc). ``err`` flags a row only
    where ``--columns bad=err`` says so.
    """

    name = "ATLAS"
    files = "text with the columns `MJD`, `m`, `dm`, `F`"

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return bool(_names(head))

    @classmethod
    def read(cls, head: Head) -> Header:
        path, names = head.path, _names(head)
        places = [names.index(name) for name in ("MJD", "m", "dm", "F")]
        faintest = names.index("mag5sig") if "mag5sig" in names else None
        flag = names.index("err") if "err" in names else None
        delimiter = "," if "," in head.first else None

        def rows() -> Iterator[Row]:
            for number, line in enumerate(lines_of(path), 1):
                if line.startswith("#") or not line.strip() or line.lstrip().startswith("MJD"):
                    continue
                cells = [cell.strip() for cell in line.split(delimiter)]
                check_width(path, f"line {number}", cells, names)
                date, mag, error, band = (cells[index] for index in places)
                if checked_decimal(mag, path, f"line {number}, m") < 0:
                    mag, error = "" if faintest is None else f">{cells[faintest]}", ""
                yield number, [date, mag, error, band, *([] if flag is None else [cells[flag]])]

        columns = ("time", "mag", "mag_err", "band", *([] if flag is None else ["err"]))
        header = Header(path, columns, ",", ecsv=False, meta={"time_format": "mjd"}, rows=rows)
        reading = Reading(time_mark="start", exptime=EXPOSURE_S)
        theirs = {"time": "MJD", "mag": "m", "mag_err": "dm", "band": "F"}
        notes = (f"MJD of ATLAS is the start of exposures of {EXPOSURE_S:g} s",)
        return replace(header, format=cls.name, theirs=theirs, told=reading, notes=notes)


def _names(head: Head) -> list[str]:
    """Names of the columns, in a comment or the first other line; none where it is another format."""
    for line in (*head.comments, head.first):
        text = line.lstrip("# ")
        names = [name.strip() for name in (text.split(",") if "," in text else text.split())]
        if set(NAMES) <= set(names):
            return names
    return []
