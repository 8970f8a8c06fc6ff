"""What a column of a recording may hold, in our units."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from torchlc.errors import InputError
from torchlc.readers import groups
from torchlc.readers.roles import VECTORS
from torchlc.readers.table import BEYOND_MAG, row_place

ABOVE_0 = 5e-324
LEAST_FLUX_ERROR = 1e-60
"""In whatever unit: the square of a weight, 1 / error^2, is then still a number. A source of 30 mag is 4e-35 W / m2 / Hz."""
LEAST_ERROR, LARGEST_ERROR = 1e-12, 1e12
"""Of an error, of the size of what it belongs to (1 for magnitudes): beyond it, it is no measured error, and
weights of its inverse square lose the other rows.
"""
LIMITS = {
    "mag": (-BEYOND_MAG, BEYOND_MAG),
    "flux": (-1e30, 1e30),
    "mag_err": (LEAST_ERROR, BEYOND_MAG),
    "flux_err": (LEAST_FLUX_ERROR, 1e30),
    "exptime": (0.0, 86400.0),
    "alt": (-90.0, 90.0),
    "az": (-360.0, 720.0),
    "height": (ABOVE_0, 1e9),
}
LIMITS |= {f"{prefix}_{axis}": (-1e15, 1e15) for prefix in VECTORS.values() for axis in "xyz"}
"""What a column may hold, in our units: beyond it a cell is a mistake or a marker for a missing value."""


def check_limits(source: Path, kind: str, columns: Mapping[str, np.ndarray], rows: np.ndarray) -> None:
    """InputError at the first of the ``rows`` (T,) of a file that holds what its column may not."""
    for name, (low, high) in LIMITS.items():
        column = columns.get(name)
        if column is None:
            continue
        bad = np.flatnonzero((column < low) | (column > high) | (column <= 0 if low == ABOVE_0 else False))
        if bad.size:
            expected = f"> 0 and at most {high:g}" if low == ABOVE_0 else f"{low:g} to {high:g}"
            if name in ("mag_err", "flux_err"):
                expected = f"> 0: {low:g} to {high:g}{' mag' if name == 'mag_err' else ''}"
            place = row_place(int(rows[bad[0]]), name)
            hint = "Leave a missing value blank." if name == kind else None
            if name == f"{kind}_err":
                hint = "Leave an error blank that is not known: its row is left out, and without any errors they are fitted"
            raise InputError(source, place, f"{column[bad[0]]:g}", expected, hint)


def check_flux_errors(
    source: Path, columns: Mapping[str, np.ndarray], rows: np.ndarray, curve: np.ndarray
) -> None:
    """InputError where errors of a flux are nothing, or everything, beside the fluxes of its ``curve`` (T,), which has a unit of its
    own."""
    error = columns.get("flux_err")
    if error is None:
        return
    sizes = groups.medians(np.abs(columns["flux"]), curve)
    sizes[sizes == 0] = 1.0
    bad = np.flatnonzero((error < LEAST_ERROR * sizes) | (error > LARGEST_ERROR * sizes))
    if bad.size:
        size = sizes[bad[0]]
        expected = f"{LEAST_ERROR * size:.1g} to {LARGEST_ERROR * size:.1g}, for fluxes of {size:.3g}"
        place = row_place(int(rows[bad[0]]), "flux_err")
        raise InputError(source, place, f"{error[bad[0]]:g}", expected)
