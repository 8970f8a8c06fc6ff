"""Numbers in a recording that stand for a measurement that is missing."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from torchlc.digits import number_of
from torchlc.readers.table import BEYOND_MAG, row_place

MARKERS = np.array(
    [
        float(f"-{whole}.{share}")
        for whole in ("99", "999", "9999")
        for share in ("0", "9", "99", "999", "9999")
    ]
)
"""-99, -99.9 ... -9999.9999: what stands for a missing value where nothing negative can be."""
CHOSEN = re.compile(r"0|-?(\d)\1+(\.\1+)?|-?(\d)\.\3+|-?[3-9]\d")
"""0, 88, 88.8, 9.99, 50: what people and programs choose because no measurement gives it."""
FAR_MAG = 5.0
"""From all others: less is a glint, a sunset or a cloud."""
LARGEST_MAG = 1.0
"""Of a usual error: a signal to noise of 1. Nobody measures so a whole night."""
OFTEN = 5
"""Rows of exactly one magnitude, which noise does not repeat."""
APART_MAG = 1.0
"""From all others, of such rows: more than a step of estimates by eye, or of magnitudes that are rounded."""
ASIDE = 100
"""Of so many rows one may be as far out, at either end, without being like those that somebody chose."""


def brightness_markers(kind: str, columns: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Rows (T,) whose flux is a marker for a missing value, and rows whose magnitude is beyond all that shine."""
    value = columns[kind]
    none = np.zeros(len(value), dtype=bool)
    if kind == "mag":
        return none, np.isfinite(value) & (np.abs(value) > BEYOND_MAG)
    missing = np.isin(value, MARKERS)
    # in a file of fluxes about 0, -99 may be one
    return (none if ((value < 0) & ~missing).any() else missing), none.copy()


def error_markers(kind: str, columns: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, str]:
    """Rows (T,) whose error, which is never negative, is a marker for a missing value, and rows whose error in mag is beyond all
    sense. A column of which all says as little as one that is blank, and is to be taken away: why, in words, else nothing."""
    name = f"{kind}_err"
    none = np.zeros(len(columns[kind]), dtype=bool)
    error = columns.get(name)
    if error is None:
        return none, none, ""
    missing = np.isin(error, MARKERS)
    far = np.abs(error) > BEYOND_MAG if kind == "mag" else none
    given = np.isfinite(error)
    if not given.any() or not (missing | far)[given].all():
        return missing, far, ""
    absent = f"{name} is {error[given][0]:g} in all rows, a marker for a missing value: taken as absent"
    return missing, far, absent


def suspected_marker(mag: np.ndarray, rows: np.ndarray) -> str:
    """A warning of magnitudes (T,) of the ``rows`` (T,) of a file that may stand for no measurement: a number that somebody chose,
    far from nearly all others; else nothing.

    One in a hundred of the others is left aside at either end: a wild row beside the markers must not hide them.
    """
    different, counts = np.unique(mag, return_counts=True)
    chosen = [value for value in different.tolist() if CHOSEN.fullmatch(f"{value:.10g}")]
    likely = np.isin(mag, chosen)
    others = mag[~likely]
    if not chosen or not len(others):
        return _repeated(mag, rows, different, counts)
    others.sort()
    aside = len(others) // ASIDE
    apart = np.maximum(others[aside] - mag, mag - others[-1 - aside])
    far = likely & (apart > FAR_MAG)
    if not far.any():
        return _repeated(mag, rows, different, counts)
    first = row_place(int(rows[far][0]), "mag")
    more = np.count_nonzero(far) - 1
    also = f", and so {'is' if more == 1 else 'are'} {number_of(more, 'more row')}" if more else ""
    return (
        f"{first}: {mag[far][0]:g} mag is {apart[far][0]:.1f} mag from {'nearly ' if aside else ''}all others"
        f"{also}: if it stands for a "
        "missing measurement, leave it blank or out. It is taken as measured"
    )


def _repeated(mag: np.ndarray, rows: np.ndarray, different: np.ndarray, counts: np.ndarray) -> str:
    """A warning of the brightest or faintest of the ``different`` (sorted) magnitudes where many rows hold exactly that
    and all others are far; else nothing."""
    if len(different) < 3:
        return ""
    for end, beside in ((0, 1), (-1, -2)):
        apart = abs(different[end] - different[beside])
        if counts[end] >= OFTEN and apart > APART_MAG:
            first = row_place(int(rows[mag == different[end]][0]), "mag")
            return (
                f"{first}: {different[end]:g} mag stands in {counts[end]} rows, {apart:.1f} mag from all others: if it stands "
                "for a missing measurement, leave it blank or out. It is taken as measured"
            )
    return ""


def suspected_errors(error: np.ndarray | None) -> str:
    """A warning of errors (T,) of magnitudes that are larger than most measurements bear; else nothing."""
    if error is None or not (usual := float(np.median(error))) > LARGEST_MAG:
        return ""
    return (
        f"half of the errors in mag_err are above {usual:.3g} mag: if they are in another unit, name it in the header, as in "
        'mag_err (mmag), or in the scene: units = { mag_err = "mmag" } below [recording]. They are taken as magnitudes'
    )
