"""The AAVSO extended file format (aavso.org/aavso-extended-file-format)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.files.decimals import checked_decimal
from torchlc.readers.format import Format, Head
from torchlc.readers.formats.delimited import NamedTable, cells_of
from torchlc.readers.objects import chosen_object
from torchlc.readers.table import BEYOND_MAG, Header, Row, lines_as_cells, lines_of

COLUMNS = ("NAME", "DATE", "MAG", "MERR", "FILT", "TRANS", "MTYPE")
DOWNLOADED = frozenset({"JD", "Magnitude", "Uncertainty", "Band", "Observer Code"})
"""Names in the tables that the data base of the AAVSO sends."""
DELIMITERS = {"comma": ",", "tab": "\t", "semicolon": ";", "space": " ", "pipe": "|"}
STANDARD = ("STD", "ABS")


class Aavso(Format):
    """Magnitudes of one star or asteroid at mid-exposure, each filter a band.

    ``<15.0`` is an upper limit, ``na`` is missing. Standardised magnitudes (``MTYPE`` STD, once ABS) are taken as they are.
    Differential ones (DIF) are refused: they are relative to a comparison star, whose magnitude has to be added. HJD needs a direction.
    ``#DELIM`` is a sign, its name, its code (32 to 126) or ``excel``. The visual format, of estimates by eye, has no errors.
    """

    name = "AAVSO extended"
    files = "text that begins with `#TYPE=Extended` or `#TYPE=Visual`"

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return any(re.match(r"type\s*=\s*(extended|visual)", line, re.IGNORECASE) for line in head.comments)

    @classmethod
    def read(cls, head: Head) -> Header:
        path = head.path
        pairs = (line.partition("=") for line in head.comments)
        said: dict[str, str] = {key.strip().lower(): value.strip().lower() for key, _, value in pairs}
        delimiter = _delimiter(head, said.get("delim", ","))
        said = {key: value.rstrip(f"{delimiter} ") for key, value in said.items()}
        by_eye = said["type"] == "visual"
        wanted_cells = COLUMNS[:3] if by_eye else COLUMNS
        dates = {"jd": ("jd", ""), "hjd": ("jd", "HJD")}.get(said.get("date", "jd"))
        if dates is None:
            raise InputError(path, "#DATE", repr(said["date"][:40]), "JD or HJD", "Convert the dates to JD")

        def all_rows() -> Iterator[tuple[str, Row]]:
            for number, line in enumerate(lines_of(path), 1):
                if line.startswith("#") or not line.strip():
                    continue
                cells = cells_of(line.rstrip("\r\n"), delimiter)
                place = f"line {number}"
                if len(cells) < len(wanted_cells):
                    expected = f"{', '.join(wanted_cells)} and more"
                    raise InputError(path, place, number_of(len(cells), "value"), expected)
                if cells[:2] == ["NAME", "DATE"]:
                    continue
                if by_eye:
                    cells = [*cells[:3], "", "Vis.", "", "STD"]
                kind = cells[6].upper()
                if kind not in (*STANDARD, "NA", ""):
                    hint = "Add the comparison star's magnitude (CMAG), and write STD"
                    raise InputError(
                        path, f"{place}, MTYPE", repr(kind[:40]), "STD: magnitudes on a standard scale", hint
                    )
                name, date, mag, error, band = cells[:5]
                if mag.startswith("<"):
                    mag, error = f">{mag[1:].strip()}", ""
                checked = (
                    checked_decimal(mag.lstrip("> "), path, f"{place}, MAG") if mag.lower() != "na" else 0.0
                )
                if error and error.lower() != "na" and abs(checked) <= BEYOND_MAG:
                    checked_decimal(error, path, f"{place}, MERR")
                yield name, (number, [date, mag, error, band, name])

        wanted = chosen_object(path, [{name} for name, _ in all_rows()], head.reading.object)

        def rows() -> Iterator[Row]:
            return (row for name, row in all_rows() if wanted is None or name == wanted)

        return Header(
            path,
            ("time", "mag", "mag_err", "band", "object"),
            delimiter,
            ecsv=False,
            descriptions={"time": dates[1]},
            meta={"time_format": dates[0]},
            rows=rows,
            format=cls.name,
            theirs={
                "time": "DATE",
                "mag": "MAG",
                "mag_err": "none" if by_eye else "MERR",
                "band": "Vis." if by_eye else "FILT",
                "object": "NAME",
            },
        )


def _delimiter(head: Head, mark: str) -> str:
    """What stands between values: a sign, its name, its code (32 to 126), or "excel" for what a spreadsheet put there."""
    if mark.isdecimal() and mark.isascii() and len(mark) <= 3 and 32 <= int(mark) <= 126:
        return chr(int(mark))
    if mark.rstrip(",;\t ") == "excel":
        # the comma, or the semicolon or tab where the comma is that of decimals
        first = next((line for line in lines_of(head.path) if line.strip() and not line.startswith("#")), "")
        return max(",;\t", key=first.count)
    if len(set(mark)) == 1:  # a spreadsheet fills every line up with delimiters
        mark = mark[0]
    delimiter = DELIMITERS.get(mark, mark)
    if len(delimiter) != 1:
        expected = f"one sign, its code of 32 to 126, excel, or {', '.join(DELIMITERS)}"
        raise InputError(head.path, "#DELIM", repr(mark[:40]), expected)
    return delimiter


class AavsoDownload(NamedTable):
    """A table of observations from the data base of the AAVSO.

    ``<15.0`` is an upper limit.
    """

    name = "AAVSO download"
    files = "CSV"
    marks_of_it = DOWNLOADED

    @classmethod
    def read(cls, head: Head) -> Header:
        header = super().read(head)
        index = header.names.index("Magnitude")

        def rows() -> Iterator[Row]:
            for number, cells in lines_as_cells(header):
                if index < len(cells) and cells[index].lstrip().startswith("<"):
                    cells[index] = f">{cells[index].lstrip()[1:]}"
                yield number, cells

        return replace(header, rows=rows)
