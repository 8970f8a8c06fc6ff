"""Which effects the data cannot tell apart from a named one."""

from __future__ import annotations

import math
from collections.abc import Sequence

from torchlc.diagnosis.search import Found, nameable
from torchlc.stages.effect import Entry

TIED_EVIDENCE = 4.0
"""Margin of log evidence within which another effect in the same place is a member of the family."""
TIED_DISTANCE = 6.0
"""Sum over rows of ((difference of two refits) / sigma)^2 below which only priors could tell them apart."""

LEAST_SHARE = 0.5
"""A member gives at least this share of what the named effect gives to the set without either."""


def families(final: Found, made: Sequence[Found], named: Sequence[str]) -> list[list[str]]:
    """For each named effect, itself and those that do as well in its place beside the other named effects,
    best first."""
    entries = list(final.hypothesis.plain)
    groups = []
    for name in named:
        own = next(entry for entry in entries if Entry.parse(entry).name == name)
        others = frozenset(entries) - {own}
        rivals = []
        without = max(
            (found.log_evidence for found in made if frozenset(found.hypothesis.plain) == others),
            default=-math.inf,
        )
        for found in made:
            members = frozenset(found.hypothesis.plain)
            if len(members) != len(entries) or not others <= members:
                continue
            (rival,) = members - others
            short = Entry.parse(rival).name
            if short == name or short in named or not nameable(found):
                continue
            margin = final.log_evidence - found.log_evidence
            if found.log_evidence - without < LEAST_SHARE * (final.log_evidence - without):
                continue
            distance = float((((found.refit.delta - final.refit.delta) / final.refit.sigma) ** 2).sum())
            if margin < TIED_EVIDENCE or (distance < TIED_DISTANCE and margin < 3 * TIED_EVIDENCE):
                rivals.append((margin, short))
        groups.append(list(dict.fromkeys([name, *(short for _, short in sorted(rivals))])))
    return groups
