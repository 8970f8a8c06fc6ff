"""Isolation baseline: chi-square of the nominal model's refit against its distribution. It cannot name or predict."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from scipy import stats

from benchmarks.concealed.answer import SURE, Answer
from benchmarks.concealed.case import Case

TITLE = "chi-square only"
NEEDS: Sequence[str] = ()
NAMES = False
SHARES: Sequence[str] = ("nominal",)


def examine(case: Case, without: Collection[str], seed: int) -> Answer:
    """Rows and priors are T + P numbers, of which the refit takes P."""
    p = float(stats.chi2.sf(case.residual @ case.residual, case.rows))
    return Answer(p, "missing" if p < SURE else "none")
