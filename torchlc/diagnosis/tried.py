"""Effects and sets of effects that a search tried, as diagnosis.json lists them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from torchlc.diagnosis.counts import Counted
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.gate import Gate
from torchlc.diagnosis.hypotheses import SCALE, Hypothesis
from torchlc.diagnosis.probabilities import Probabilities
from torchlc.diagnosis.values import effect_parameters
from torchlc.effects import registry
from torchlc.inference.density import Fitted
from torchlc.stages.entry import Entry

MOST_SETS = 12
"""Rows of the table of what was tried, which then fits on a screen."""


def candidates(
    search: Search,
    odds: Probabilities,
    gate: Gate,
    foreseen: Callable[[Fitted | None], float | None],
    turns: Callable[[Fitted], Counted],
) -> list[dict[str, Any]]:
    """Every effect tried, best first: refitted ones by evidence, kinds of noise among them, the rest by score.

    Gains are over the scene's own model with the errors as quoted; ``foreseen`` is that of a fit in rows that it had not seen,
    ``turns`` what counts of turns leave open beside it.
    """
    rows = []
    plain = search.visited[Hypothesis()].log_z

    def best(added: tuple[str, ...]) -> Fitted | None:
        chosen = [
            visited
            for visited in search.visited
            if visited.plain == added and (visited.noise or not visited.added)
        ]
        chosen += [
            visited
            for visited in search.visited
            if visited.plain == added and not visited.noise and visited.added
        ]
        return search.visited[search.ranked(chosen)[0]] if chosen else None

    listed = {entry: probe for entry, probe in search.probes.items() if Entry.parse(entry).name in registry()}
    for entry, probe in listed.items():
        at = best((entry,))
        rows.append(
            {
                **_names(entry if at is None else at.hypothesis.added[0]),
                "score": probe.score,
                "p": gate.marginal.get(f"signature {entry}"),
                "probability": odds.effects.get(Entry.parse(entry).name, 0.0),
                "delta_log_evidence": None if at is None else at.log_z - plain,
                "heldout_delta_log_likelihood": foreseen(at),
                "parameters": {} if at is None else effect_parameters(at, entry, turns(at)),
                "chi2_after": None if at is None else at.chi2,
            }
        )
    for hypothesis in search.visited:
        if hypothesis.added or hypothesis.law or len(hypothesis.noise) != 1 or hypothesis.noise == (SCALE,):
            continue
        at = search.visited[hypothesis]
        rows.append(
            {
                **_names(hypothesis.noise[0]),
                "score": None,
                "p": None,
                "probability": odds.kinds.get(hypothesis.noise[0], 0.0),
                "delta_log_evidence": at.log_z - plain,
                "heldout_delta_log_likelihood": foreseen(at),
                "parameters": {},
                "chi2_after": at.chi2,
            }
        )
    untried = [row for row in rows if row["delta_log_evidence"] is None]
    tried = [row for row in rows if row["delta_log_evidence"] is not None]
    tried.sort(key=lambda row: -row["delta_log_evidence"])
    return [*tried, *sorted(untried, key=lambda row: -row["score"])]


def sets(search: Search, final: Fitted) -> list[dict[str, Any]]:
    """The sets beside the ``final`` one, best first, with the odds against each; of sets of the same names the best."""
    known = {frozenset(final.hypothesis.names)}
    rows = []
    for hypothesis in search.ranked():
        members = frozenset(hypothesis.names)
        if members in known or len(hypothesis.added) < 2:
            continue
        known.add(members)
        at = search.visited[hypothesis]
        behind = search.log_odds(final.hypothesis) - search.log_odds(hypothesis)
        rows.append(
            {
                "effects": list(hypothesis.plain),
                "delta_log_evidence": at.log_z - final.log_z,
                "heldout_delta_log_likelihood": None,
                "chi2_after": at.chi2,
                "why_not": f"odds of {math.exp(min(behind, 30.0)):.2g} to 1 against it"
                if behind > 0
                else "no more probable than the answer, noise and targets taken together",
            }
        )
    return rows[:MOST_SETS]


def _names(entry: str) -> dict[str, str | None]:
    parsed = Entry.parse(entry)
    return {"effect": parsed.name, "target": parsed.target, "per": parsed.per}
