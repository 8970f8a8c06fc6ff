"""Numbers as people read them: with as many digits as their uncertainty bears."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, SupportsFloat

HISSING = re.compile("(s|x|ch|sh)$")
"""Ends of nouns whose plural takes another syllable."""


def stated(row: Mapping[str, Any]) -> str:
    """``median +- sd unit`` with as many digits as the uncertainty bears; an interval where it is skewed."""
    median, sd, low, high = row["median"], row["sd"], row["q05"], row["q95"]
    unit = f" {row['unit']}" if row["unit"] else ""
    skew = (high - median) / max(median - low, 1e-300)
    if not math.isfinite(sd) or sd <= 0:
        return f"{median:.5g}{unit}"
    digits = decimals(sd)
    if sd > 0.3 * abs(median) and not 0.5 < skew < 2:
        return f"{rounded(median, 2)} ({rounded(low, 2)} to {rounded(high, 2)}){unit}"
    if abs(median) >= 1e5 or digits > 8:
        return f"{median:.4g} ± {sd:.2g}{unit}"
    if sd >= 10:
        place = 10 ** (math.floor(math.log10(sd)) - 1)
        if abs(median) < place:  # of which no digit is certain
            return f"{rounded(median, 2)} ± {rounded(sd, 2)}{unit}"
        return f"{round(median / place) * place:.0f} ± {round(sd / place) * place:.0f}{unit}"
    return f"{median:.{digits}f} ± {sd:.{digits}f}{unit}"


def decimals(sd: float) -> int:
    """Decimals that a number with this uncertainty bears: two digits of it."""
    return max(0, min(12, 1 - math.floor(math.log10(sd)))) if math.isfinite(sd) and sd > 0 else 6


def rounded(value: float, digits: int) -> str:
    """``value`` to that many significant digits, without an exponent where it can be read without."""
    text = f"{value:.{digits}g}"
    return f"{float(text):g}" if abs(float(text)) < 1e6 else text


def against_freedom(chi2: float, dof: SupportsFloat, decimals: int = 1) -> str:
    """The value of chi-square beside its degrees of freedom, or why there are none."""
    if float(dof) > 0:
        return f"{chi2:.{decimals}f} for {number_of(dof, 'degree')} of freedom"
    rows = "fewer" if float(dof) < 0 else "no more"
    return f"{chi2:.{decimals}f}, with {rows} measured rows than free numbers"


def number_of(count: SupportsFloat, what: str) -> str:
    """So many of what is named in the singular: "1 row", "3 rows", "2 passes". Without decimals."""
    said = f"{float(count):.0f}"
    plural = "es" if HISSING.search(what) else "s"
    return f"{said} {what}{'' if said == '1' else plural}"
