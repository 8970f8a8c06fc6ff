"""Measurement tables of AstroImageJ, as .tbl (tabs) or .csv (Collins et al. 2017)."""

from __future__ import annotations

from typing import ClassVar

from torchlc.readers.format import Head
from torchlc.readers.formats.delimited import NamedTable, table_header


class AstroImageJ(NamedTable):
    """The target T1: its apparent magnitude where stars with known magnitudes were measured too, else its flux over that
    of all comparison stars. ``JD_UTC`` is taken, the middle of the exposure, as ``JD_MOBS`` is; ``JD_SOBS`` is its start.
    ``BJD_TDB`` and ``HJD_UTC`` are at the Sun.
    """

    name = "AstroImageJ"
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
