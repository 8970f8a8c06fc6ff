"""torchlc's own diagnosis: odds of sets of effects by their evidence, within a budget of CPU seconds."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from benchmarks.concealed.answer import Answer
from benchmarks.concealed.case import Case
from torchlc.diagnosis.run import diagnose
from torchlc.effects import registry
from torchlc.stages.entry import Entry
from torchlc.terminal import quiet_libraries

TITLE = "torchlc diagnose"
NEEDS: Sequence[str] = ()
NAMES = True
SHARES: Sequence[str] = ()
BUDGET_S = 40.0
"""CPU seconds of a case, so that three hundred take less than three hours on two cores."""


def examine(case: Case, without: Collection[str], seed: int) -> Answer:
    menu = [name for name, cls in registry().items() if cls.stage != "noise" and name not in without]
    with quiet_libraries():
        found = diagnose(
            case.scene, case.recording, effects=menu if without else None, seed=seed, budget=BUDGET_S
        )
    content, odds = found.to_json(), found.odds
    names: dict[tuple[str, ...], float] = {}
    for entries, share in odds.sets:
        key = tuple(sorted({Entry.parse(entry).name for entry in entries}))
        names[key] = names.get(key, 0.0) + share
    ranked = sorted((one for one in names if one), key=lambda one: -names[one])
    missing = odds.verdict == "missing_physics"
    verdict = {"adequate": "none", "missing_physics": "named"}.get(odds.verdict, "unlisted")
    proof = content["proof"]["models"]
    gain = None
    if "final" in proof and "as quoted" in proof:
        gain = proof["final"]["log_density"] - proof["as quoted"]["log_density"]
    return Answer(
        content["global_p"],
        verdict,
        ranked,
        odds.families if missing else (),
        min(odds.told, 1.0),
        None if found.where is None else found.where.rows.numpy(),
        gain if gain is not None and math.isfinite(gain) else None,
    )
