"""Tables of aperture photometry of photutils, and those of LCOGT's pipelines, written as text."""

from __future__ import annotations

from typing import ClassVar

from torchlc.errors import InputError
from torchlc.readers.format import Head
from torchlc.readers.formats.delimited import NamedTable, cells_of
from torchlc.readers.table import Header, is_as_wide


class Photutils(NamedTable):
    """A table of photutils or LCOGT: the sum of an aperture, ``aperture_sum``, as relative flux, a row an image.

    A table with several sources is refused.
    """

    name = "photutils"
    columns: ClassVar = {
        "flux": ("residual_aperture_sum", "aperture_sum_bkgsub", "aperture_sum"),
        "flux_err": ("residual_aperture_sum_err", "aperture_sum_bkgsub_err", "aperture_sum_err"),
    }
    marks_of_it = frozenset({"aperture_sum"})

    @classmethod
    def read(cls, head: Head) -> Header:
        header = super().read(head)
        if "id" in header.names:
            index = header.names.index("id")
            rows = [cells_of(text, header.delimiter) for number, text in head.lines if number > header.skip]
            sources = [cells[index] for cells in rows if is_as_wide(cells, header.names)]
            if len(set(sources)) > 1 and len(set(sources)) < len(sources):
                listed = ", ".join(sorted(set(sources))[:8])
                hint = "Write the rows of the object alone into a file"
                raise InputError(head.path, "column id", f"several sources ({listed})", "one", hint)
        return header
