"""Photometry of Tycho Tracker, exported as a table."""

from __future__ import annotations

from typing import ClassVar

from torchlc.readers.formats.delimited import NamedTable


class TychoTracker(NamedTable):
    """Julian dates of mid-exposure with the magnitude ``Target Mag`` and its uncertainty.

    The columns of a text export are its user's choice: ``--columns`` names others. Tycho Tracker writes ALCDEF too, which is read
    as such.
    """

    name = "Tycho Tracker"
    columns: ClassVar = {
        "time": ("JD", "Julian Date", "JD (mid)", "Mid JD"),
        "mag": ("Target Mag", "Mag"),
        "mag_err": ("Target Mag Err", "Mag Unc", "Mag Uncertainty", "Mag Err"),
    }
    marks_of_it = frozenset({"Target Mag"})
