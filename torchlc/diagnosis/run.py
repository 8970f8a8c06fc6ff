"""Diagnosis from scene and recording to verdict: is anything missing, what is it, where, and what does it change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchlc.diagnosis.candidates import check_candidates
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.coordinates import coordinates
from torchlc.diagnosis.engine import DRAWS, Search
from torchlc.diagnosis.gate import Battery, Gate, gate
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench, carried
from torchlc.diagnosis.plan import LEAST_P, MOST_SETS, TOLD, next_nights, sentence
from torchlc.diagnosis.probabilities import Probabilities, probabilities
from torchlc.diagnosis.probes import Probe
from torchlc.diagnosis.proof import Unseen, make_blocks, unseen
from torchlc.diagnosis.result import Diagnosis
from torchlc.diagnosis.standing import CLEAN_P, near_quoted
from torchlc.diagnosis.where import Where, best_coordinate, intervals, locate, rows_of_unknown
from torchlc.errors import option
from torchlc.files.steps import Steps
from torchlc.inference.density import Fitted
from torchlc.inference.posterior import fitted_at
from torchlc.readers import Recording
from torchlc.scene import Scene

QUICK_S = 20.0
MOST_ALONE_S = 25.0
"""CPU seconds of an effect's probe or refit beyond which it waits for a budget: a search makes some tens of either."""
NONE_TO_SPARE = "want of rows: there are no more of them than free numbers"


def diagnose(
    scene: Scene,
    recording: Recording,
    *,
    quick: bool = False,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    budget: float | None = None,
    progress: Callable[[str, float], None] | None = None,
    steps: Steps | None = None,
) -> Diagnosis:
    """What the scene's model leaves out of a recording.

    ``effects`` restricts the candidates (noise is always considered), each as :func:`check_candidates` takes it;
    ``budget`` is in CPU seconds, MOST_S if none is given, after which the verdict says what was not examined; ``quick`` is one of QUICK_S. An
    interruption ends the search as a budget does, once the scene's own model is fitted. Upper limits are left out, and
    counted as dropped. ``steps`` keeps what is finished, and knows what an earlier run had. Raises InputError for an unknown
    effect name.
    """
    recording = recording.keep(~recording.upper_limit, "upper limit, which a diagnosis does not use")
    clock = Clock(QUICK_S if quick and budget is None else budget, progress)
    bench = Workbench(scene, recording)
    if effects is not None:
        check_candidates(effects, bench.base)
    possible = bench.candidates(effects)
    # somebody who names an effect, or says how long it may take, waits for it
    bounded = clock.gave or effects is not None
    search = Search(bench, clock, seed, steps=Steps() if steps is None else steps)
    bench.entries = [entry for entry in possible if bounded or search.seconds_of(entry) < MOST_ALONE_S]
    dear = f"each of its geometries costs a pass over the whole mesh; {option('budget')} SECONDS has it asked as far as there is time"
    untried = bench.not_carried(effects) | {entry: dear for entry in possible if entry not in bench.entries}
    clock.tell("goes on from a run that was ended" if search.steps.resumed else "baseline", 0.02)
    search.null()
    coordinate_values = coordinates(search.best().model, search.best().theta)
    try:
        if search.best().likelihood.degrees_of_freedom > 0:
            _explore(search, coordinate_values)
        else:  # nothing can be told, whatever is tried
            search.unexamined.update(dict.fromkeys(bench.entries, NONE_TO_SPARE))
    except KeyboardInterrupt:
        clock.stopped = True
    search.tell_unexamined()
    first_gate = _gate(_at_quoted_errors(search), coordinate_values, search.probes, seed)
    leader = search.visited[search.leader]
    final_gate = _gate(leader, coordinate_values, {}, seed, level=False)
    odds = probabilities(search, final_gate.global_p)
    null, final = search.best(), _final(search, odds)
    if final is not leader:
        final_gate = _gate(final, coordinate_values, {}, seed, level=False)
    if clock.left():
        final = search.charted(final)
    unweighed = final.evidence is None or final.evidence.linear
    if (unweighed or final.missed) and not final.posterior.dear and clock.left():
        # the table of the materials is neither that of a linear form nor of Laplace's method
        final = search.weighed(final, DRAWS)
    proof = _proof(search, odds, null, final)
    nights, advice = _next(search, odds, clock)
    return Diagnosis(
        search=search,
        odds=odds,
        gate=first_gate,
        final_gate=final_gate,
        baseline=null,
        final=final,
        where=_where(search, odds, null, final, first_gate, coordinate_values),
        coordinates=coordinate_values,
        proof=proof,
        quick=quick,
        untried=untried,
        nights=nights,
        next_observation=advice,
        seconds=clock.spent,
    )


def _explore(search: Search, coordinate_values: dict[str, Tensor]) -> None:
    """Everything that is searched, the most telling first."""
    entries = search.bench.entries

    def left(at: Fitted) -> float:
        return _gate(at, coordinate_values, {}, search.seed, level=False).global_p

    search.singles(entries, left)
    search.afresh()
    search.strangers(coordinate_values)
    if _gate(_at_quoted_errors(search), coordinate_values, search.probes, search.seed).global_p < CLEAN_P:
        search.jointly(bool(search.foremost.added) and search.clean(left))
        if search.bench.recording.error is not None:
            search.laws(entries, bool(search.foremost.added) and search.clean(left))
    search.sets(entries, left)
    search.afresh()
    search.nominal_sizes()
    search.noise_of_leaders()
    search.strangers(coordinate_values)
    search.clock.tell(search.state(), 0.9)


def _at_quoted_errors(search: Search) -> Fitted:
    """The scene's own model at the quoted errors, or where there are some bad rows with these among the noise: larger errors, or a third of the
    rows bad, leave nothing of another lobe to be seen."""
    laws = [name for name, kind in search.bench.kinds.items() if kind.reshapes]
    noises = [(), *((name,) for name in laws)]
    chosen = [Hypothesis(noise=noise) for noise in noises]
    best = search.visited[
        search.ranked(hypothesis for hypothesis in chosen if hypothesis in search.visited)[0]
    ]
    return best if near_quoted(best) else search.visited[Hypothesis()]


def _final(search: Search, odds: Probabilities) -> Fitted:
    """The model of the answer: the named set, the noise, or the scene's own, each at its best."""
    entries = odds.best if odds.verdict == "missing_physics" else ()
    return search.best(*entries)


def _gate(
    at: Fitted,
    coordinate_values: Mapping[str, Tensor],
    probes: Mapping[str, Probe],
    seed: int,
    level: bool = True,
) -> Gate:
    """The battery on a fit's residuals under its noise; with their ``level``, or, where it was fitted, their structure alone."""
    signatures = {
        entry: probe.signatures[~probe.aimed] for entry, probe in probes.items() if not probe.aimed.all()
    }
    context = at.model.assembly.context
    with_chi2 = level and not at.likelihood.fitted_errors
    return gate(
        at, Battery(context.seconds, at.likelihood.curve, coordinate_values, signatures, with_chi2), seed
    )


def _proof(search: Search, odds: Probabilities, null: Fitted, final: Fitted) -> dict[str, Unseen]:
    """Unseen rows by the scene's own model, as quoted and under its best noise, the answer's, and the best rival's, as far as
    there is time."""
    context = search.bench.base.context
    group = context.curve if len(search.bench.recording.curve_ids) >= 4 else context.night
    if context.object is not None and len(search.bench.recording.object_ids) >= 4:
        group = context.object
    blocks = make_blocks(context.seconds, group)
    shown = {"null": null, "final": final, "as quoted": search.visited[Hypothesis()]}
    runner = _runner_up(search, odds)
    if runner is not None:
        shown["runner-up"] = runner
    made: dict[str, Unseen] = {}
    for name, at in shown.items():
        if at.posterior.dear and not search.clock.left(0.5):
            continue
        same = next((other for other in made if shown[other] is at), None)
        made[name] = made[same] if same is not None else unseen(at, blocks)
    return made


def _runner_up(search: Search, odds: Probabilities) -> Fitted | None:
    """The best set of effects beside the named one that is not that with more in it, of those that were refitted: others were
    judged by their linear form alone."""
    named = set(odds.best) if odds.verdict == "missing_physics" else set()
    fitted = {frozenset(hypothesis.plain) for hypothesis in search.visited}
    rivals = [
        entries
        for entries, _ in odds.sets
        if entries and not named <= set(entries) and frozenset(entries) in fitted
    ]
    if not rivals:
        return None
    return search.best(*rivals[0])


def _where(
    search: Search,
    odds: Probabilities,
    null: Fitted,
    final: Fitted,
    first: Gate,
    coordinate_values: Mapping[str, Tensor],
) -> Where | None:
    if odds.verdict == "adequate":
        return None
    if odds.verdict == "missing_physics":
        return _located(search, final, null, coordinate_values)
    odd = search.strongest()
    by_shape = odds.shapeless >= sum(odds.laws.values())
    if odd is not None and odd.like is not None and odds.verdict == "unexplained" and by_shape:
        return _located(search, odd.like, null, coordinate_values)
    rows = torch.zeros(len(null.delta), dtype=torch.bool)
    if odd is not None and odds.verdict == "unexplained":
        alike = search.visited.get(replace(odd.beside, added=()), null)
        rows = rows_of_unknown(odd, search.visited[odd.beside], alike, null)
    order = torch.argsort(null.model.assembly.context.seconds)
    rank = torch.empty_like(order)
    rank[order] = torch.arange(len(order))
    for a, b, _ in first.windows if not bool(rows.any()) else ():
        rows[order[int(rank[a]) : int(rank[b]) + 1]] = True
    strength = null.delta / null.wide
    return Where(
        rows, intervals(rows, strength, null), [], *best_coordinate(strength, coordinate_values, rows)
    )


def _located(search: Search, final: Fitted, null: Fitted, coordinate_values: Mapping[str, Tensor]) -> Where:
    """Where a fit with effects differs from the scene's own model under rows that err as in it: a law with bad rows would call what is missing
    bad, and leave the materials alone."""
    alike = search.visited.get(replace(final.hypothesis, added=()), null)
    bares = [
        at
        for hypothesis, at in search.visited.items()
        if not hypothesis.added and hypothesis.law == final.hypothesis.law
    ]
    return locate(alike, final, fitted_bare(search, final), coordinate_values, bares)


def fitted_bare(search: Search, final: Fitted) -> Fitted:
    """The final model with its effects switched off, and everything else as it is."""
    hypothesis = replace(final.hypothesis, added=())
    bare = search.posterior(hypothesis)
    theta = carried(bare.model.parameter_set, final.theta[None], final.names)[0]
    return fitted_at(hypothesis, bare, bare.coordinates(theta))


def _next(search: Search, odds: Probabilities, clock: Clock):
    """Candidate nights for the sets that the data leave possible, and the advice in a sentence."""
    every = sorted([((), odds.nothing + odds.noise), *odds.sets], key=lambda pair: -pair[1])
    possible = [(entries, p) for entries, p in every if p >= LEAST_P and search.exactly(*entries)][:MOST_SETS]
    if len(possible) < 2 or possible[0][1] >= TOLD or odds.spare <= 0 or not clock.left():
        return [], ""
    options = next_nights(search.likely(possible), search.seed)
    names = [" with ".join(entries) or "nothing missing" for entries, _ in possible]
    return options, sentence(options, names, search.bench.scene.orbit.known)
