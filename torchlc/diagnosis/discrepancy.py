"""Physics without a name in the library: what describes a recording better than all that could be named."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence

from torchlc.diagnosis.evidence import Scorer
from torchlc.diagnosis.probes import probe
from torchlc.diagnosis.refit import Refit, Workbench, effect_columns, is_heavy
from torchlc.diagnosis.search import EVIDENCE_GAIN, Found, affordable, extended, nameable, unlisted_entries
from torchlc.effects import effect_class


def stranger(
    bench: Workbench, scorer: Scorer, baseline: Sequence[Refit], final: Found, seed: int
) -> Found | None:
    """The best refit with an effect that is never named, if it describes the recording better than ``final`` does, with
    no more parameters than the effects of that; those whose light fills the buffers are not asked."""
    most = len(effects_of(final)) or math.inf
    entries = [
        entry
        for entry in affordable(bench, unlisted_entries(bench))
        if len(effect_class(entry).quantities) <= most
        and not is_heavy(bench.likelihood(baseline[0].hypothesis.with_effect(entry)).model)
    ]
    made = [
        extended(
            bench, scorer, baseline, entry, probe(bench, baseline[0], entry, seed + number), seed + number
        )
        for number, entry in enumerate(entries)
    ]
    ahead = [
        found
        for found in made
        if nameable(found)
        and found.log_evidence > final.log_evidence + EVIDENCE_GAIN
        and found.log_evidence + found.score.heldout_total > final.log_evidence + final.score.heldout_total
    ]
    return max(ahead, key=lambda found: found.log_evidence, default=None)


def effects_of(found: Found) -> list[int]:
    """Columns of theta that belong to a refit's added effects."""
    parameters = found.refit.model.parameter_set
    return [column for entry in found.hypothesis.added for column in effect_columns(parameters, entry)]


def told_of(found: Found) -> str:
    """In words, what such a refit says."""
    (entry,) = found.hypothesis.plain
    cls = effect_class(entry)
    what = inspect.getdoc(inspect.getmodule(cls)) or cls.name
    units = {quantity.name: quantity.unit for quantity in cls.quantities}
    parameters = found.refit.model.parameter_set
    numbers = ", ".join(
        f"{parameters.quantities[column]} = {float(found.refit.theta[column]):.3g} "
        f"{units[parameters.quantities[column]]}"
        for column in effect_columns(parameters, entry)
    )
    return f"what describes it has no name there: {what[0].lower()}{what[1:].rstrip('.')} ({numbers})"
