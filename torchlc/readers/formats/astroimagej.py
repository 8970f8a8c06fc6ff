"""Measurement tables of AstroImageJ, as .tbl (tabs) or .csv (Collins et al. 2017)."""

from __future__ import annotations

from typing import ClassVar

from torchlc.readers.format import Head
from torchlc.readers.formats.delimited import NamedTable, table_header


class AstroImageJ(NamedTable):
    """The target T1: its magnitude ``Source_AMag_T1``, or without one its relative flux ``rel_flux_T1``.

    The magnitude is apparent, and there where stars with known magnitudes were measured too; the flux is over that of all
    comparison stars. ``JD_UTC`` is taken, else ``JD-2400000`` or ``JD_MOBS``, the middle of the exposure, else ``JD_SOBS``, its
    start. ``BJD_TDB`` and ``HJD_UTC`` are at the Sun.
    """

    name = "AstroImageJ"
    files = "`.tbl` (tabs) or `.csv`"
    columns: ClassVar = {
        "time": ("JD_UTC", "JD-2400000", "J.D.-2400000", "JD_MOBS", "JD_SOBS", "BJD_TDB", "HJD_UTC"),
        "mag": ("Source_AMag_T1",),
        "mag_err": ("Source_AMag_Err_T1",),
        "flux": ("rel_flux_T1",),
        "flux_err": ("rel_flux_err_T1",),
        "exptime": ("EXPTIME", "EXPOSURE"),
    }

    @classmethod
    def recognises(cls, head: Head) -> bool:
        if not any("_T1" in text for _, text in head.lines):
            return False
        return bool({"Source_AMag_T1", "rel_flux_T1"} & set(table_header(head).names))
