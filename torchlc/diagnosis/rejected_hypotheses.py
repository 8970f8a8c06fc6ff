"""Why the sets of effects that were refitted beside the named one lose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torchlc.diagnosis.search import EVIDENCE_GAIN, EXCESS_SHARE, Found, foreseen, nameable

MOST_TOLD = 12


def told(found: Sequence[Found], final: Found, null: Found) -> list[dict[str, Any]]:
    """The sets beside the final one, best first, each with its effects, what it gains over the final one, and in
    words why it is not named; of sets of the same names, divided otherwise or of other targets, the best alone."""
    rows = []
    known = {frozenset(final.hypothesis.names)}
    for one in sorted(found, key=lambda one: -one.log_evidence):
        members = frozenset(one.hypothesis.names)
        if members in known:
            continue
        known.add(members)
        rows.append(
            {
                "effects": list(one.hypothesis.plain),
                "delta_log_evidence": one.log_evidence - final.log_evidence,
                "heldout_delta_log_likelihood": one.score.heldout_total - final.score.heldout_total,
                "chi2_after": one.refit.chi2,
                "why_not": why_not(one, final, null),
            }
        )
    return rows[:MOST_TOLD]


def why_not(found: Found, final: Found, null: Found) -> str:
    """Why a set of effects is not the one that is named, in a few words."""
    behind = final.log_evidence - found.log_evidence
    if not nameable(found):
        return "a parameter stands at its bound, or its parts scatter over all that is possible"
    if behind > 0:
        return f"log evidence {behind:.1f} lower"
    taken = foreseen(found, final, null)
    if taken < EXCESS_SHARE:
        return (
            f"takes {max(100 * taken, 0):.0f} % only of the variance that the scene's own model leaves unseen"
        )
    if found.score.heldout_total <= final.score.heldout_total:
        return "predicts unseen rows no better"
    if -behind < EVIDENCE_GAIN:
        return f"log evidence {-behind:.1f} higher only"
    return "not every effect of it is needed"
