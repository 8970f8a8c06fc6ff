"""Light curves exported as text by MPO Canopus, where they are not written as ALCDEF."""

from __future__ import annotations

from typing import ClassVar

from torchlc.readers.formats.delimited import NamedTable


class MpoCanopus(NamedTable):
    """Julian dates with the magnitude ``ObjMag`` of the object.

    ``O-C`` and the comparison stars are left. The columns of a text export are its user's choice: ``--columns`` names others. MPO
    Canopus writes ALCDEF too, which is read as such.
    """

    name = "MPO Canopus"
    columns: ClassVar = {
        "time": ("JD", "J.D.", "JD (UTC)"),
        "mag": ("ObjMag", "Obj Mag", "O Mag", "TMag"),
        "mag_err": ("ObjErr", "Obj Err", "O Err", "TErr", "Mag Err"),
    }
    marks_of_it = frozenset({"ObjMag"})
