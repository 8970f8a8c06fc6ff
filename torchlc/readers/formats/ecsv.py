"""ECSV, the tables that astropy writes."""

from __future__ import annotations

import csv

from astropy.table.meta import get_header_from_yaml

from torchlc.errors import InputError
from torchlc.readers.astropy_tables import described_table, read_table
from torchlc.readers.format import Format, Head
from torchlc.readers.table import Header, check_names, lines_of


class Ecsv(Format):
    """Columns with units, descriptions and metadata, as astropy writes them.

    What astropy took apart to write, it puts together again.
    """

    name = "ECSV"
    files = "text that begins with `# %ECSV`"
    order = -1

    @classmethod
    def recognises(cls, head: Head) -> bool:
        return bool(head.comments) and head.comments[0].startswith("%ECSV")

    @classmethod
    def read(cls, head: Head) -> Header:
        path, first = head.path, head.first
        try:
            header = get_header_from_yaml([line for line in head.comments[1:] if line.strip()])
            declared = {str(column["name"]): column for column in header["datatype"]}
            meta = dict(header.get("meta") or {})
            delimiter = header.get("delimiter", " ")
        except Exception as error:  # the YAML loader builds astropy objects on request and can raise anything
            raise InputError(
                path, "header", f"unreadable ECSV header: {error}"[:300], "ECSV as astropy writes it"
            ) from None
        if delimiter not in (" ", ","):
            raise InputError(path, "header", f"delimiter {delimiter!r}", "a space or a comma")
        names = tuple(next(csv.reader([first.strip()], delimiter=delimiter, skipinitialspace=True)))
        check_names(path, names)
        if list(names) != list(declared):
            raise InputError(
                path,
                "header",
                f"columns {', '.join(names)}"[:200],
                f"as declared: {', '.join(declared)}"[:200],
            )
        if meta.get("__serialized_columns__"):
            return Header(**described_table(path, read_table(path, list(lines_of(path)))))
        return Header(
            source=path,
            names=names,
            delimiter=delimiter,
            ecsv=True,
            units={name: str(column["unit"]) for name, column in declared.items() if column.get("unit")},
            descriptions={name: str(column.get("description") or "") for name, column in declared.items()},
            meta=meta,
            skip=next(number for number, text in head.lines if text.strip() and not text.startswith("#")),
        )
