"""The search over missing effects: probes of every candidate, refits, a beam over sets of up to three."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import zip_longest

import torch
from torch import Tensor

from torchlc.diagnosis.evidence import Score, Scorer
from torchlc.diagnosis.probes import SWING, Probe, apart, probe, scanned_column, scanned_hours
from torchlc.diagnosis.refit import (
    Hypothesis,
    Refit,
    Workbench,
    effect_columns,
    effect_starts,
    is_dear,
    is_heavy,
    is_slow,
    leading,
    linearised,
    refit,
)
from torchlc.diagnosis.starts import objective, screened
from torchlc.effects import effect_class, registry
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import polish
from torchlc.parameters import SHARE
from torchlc.stages.effect import Entry, Quantity

MOST_RESCANS = 3
"""Times that an effect that was tried at every row is tried there again from its refit."""
STARTS = 12
SLOW_STARTS = 3
LEADERS = 2
REWEIGHTED = 4
REWEIGHTED_STEPS = 15
FEW_STARTS = 3
PLACES = 12
SLOW_PLACES = 4
"""Values of an effect's own parameters, half of them the best of its probe, that are tried with ..."""
MATERIALS = 24
"""... so many draws of the materials from their priors, ..."""
HEAVY_MATERIALS = 4
TRIAL_VALUES = 1e7
"""... or, down to HEAVY_MATERIALS, as many as let all trials together need so many numbers."""
WIDE = 192
"""Draws of the materials among which further minima of the final refit are looked for."""
EVIDENCE_GAIN = 3.5
HELDOUT_GAIN = 1.0
EXCESS_SHARE = 0.1
LEFT_SHARE = 0.5
"""What is named has to take the first share of the whole excess of chi-square; beside another effect the second share, of
what that one leaves, will do."""
CONSISTENT = 2.0
"""Standard deviations of chi-square within which what is left counts as nothing."""
GROSS = 6.0
"""Standard deviations of chi-square beyond which a mismatch is gross."""
STEP_BACK = 0.2
HARMLESS = 1.0
"""What a step back from a bound, by that share of the way to no effect, may cost in chi-square."""
MOST_WEIGHT = 0.6
"""The share of a second material beyond which it is the first."""
TIED = 2.0
"""Difference of log evidence within which refits count as equally good."""
BEAM = 3
MOST_EFFECTS = 3
LEAST_SCORE = 9.0
SPREADS = 4.0
"""Of the values of a divided offset, that must find room on either side of none."""
PREVIEW_STEPS = 6
MOST_GROWN = 10
MOST_GROWN_BESIDE = 4
WEAK_SHARE = 0.05
"""In later rounds at most MOST_GROWN effects are refitted on the best set, MOST_GROWN_BESIDE on the others of
the beam, those whose score is at least LEAST_SCORE and WEAK_SHARE of the strongest."""


@dataclass(frozen=True)
class Found:
    """A hypothesis, refitted and scored."""

    refit: Refit
    score: Score

    @property
    def hypothesis(self) -> Hypothesis:
        return self.refit.hypothesis

    @property
    def log_evidence(self) -> float:
        return self.score.log_evidence


def judged(fitted: Refit, scorer: Scorer) -> Found:
    """A refit with its score; where a law of errors that is not normal describes its residuals best, refitted with its bad
    rows given less weight, for least squares follow them."""
    found = Found(fitted, scorer.score(fitted))
    fitted.model.forget()
    for _ in range(REWEIGHTED):
        likelihood = found.refit.likelihood
        if found.score.noise.noise.normal or likelihood.fitted_errors or not likelihood.model.names:
            break
        lighter = copy(likelihood)
        lighter.error = scorer.weights(found.refit, found.score.noise)
        with torch.no_grad():
            reached = polish(lighter, found.refit.theta[None], None, iterations=REWEIGHTED_STEPS)
            theta = likelihood.model.parameter_set.from_flat(reached.y[0])
        again = linearised(likelihood, found.refit.hypothesis, theta)
        new = Found(again, scorer.score(again))
        if new.log_evidence < found.log_evidence + 0.1:
            break
        found = new
    return found


def candidate_entries(bench: Workbench, only: Sequence[str] | None) -> list[str]:
    """Every physical effect that the scene's list leaves out and these data could carry, as ``name`` or
    ``name[target]``; of those in ``only`` if given, where a name stands for all its targets and divisions."""
    entries = _carried(bench)
    if only is None:
        return entries
    return [
        entry
        for entry in entries
        if {entry, (parsed := Entry.parse(entry)).name, Entry(parsed.name, parsed.target).plain} & set(only)
    ]


def _carried(bench: Workbench) -> list[str]:
    present = {effect.name for effect in bench.base.effects}
    entries = []
    for name, cls in registry().items():
        if cls.stage == "noise" or name in present:
            continue
        for target in cls.targets(bench.base.context):
            if cls(target).missing(bench.base.context) is None:
                entries.append(str(Entry(name, target)))
                entries += [
                    str(Entry(name, target, per)) for per in (divisions(bench) if cls.divisible else ())
                ]
    return entries


def not_carried(bench: Workbench, only: Sequence[str] | None) -> dict[str, str]:
    """Why, by entry, what ``only`` asks for is no candidate: each that :func:`candidate_entries` drops, and noise
    not."""
    context, known = bench.base.context, registry()
    present = {effect.name for effect in bench.base.effects}
    reasons = {}
    for text in only or ():
        entry = Entry.parse(text)
        cls = known[entry.name]
        if cls.stage == "noise" or candidate_entries(bench, [text]):
            continue
        if entry.name in present:
            reasons[text] = "it is in the scene's model already"
            continue
        targets = [entry.target] if entry.target is not None else cls.targets(context)
        missing = [reason for one in targets or [None] if (reason := cls(one).missing(context)) is not None]
        reasons[text] = missing[0] if missing else "the scene has nothing that it could be applied to"
    return reasons


def affordable(bench: Workbench, entries: Sequence[str]) -> list[str]:
    """The entries whose refits can be paid: on a large mesh a parameter that turns or lights it anew costs a
    pass over every facet and row, hundreds of which a fit would need; a clock's offset is interpolated."""
    return [
        entry for entry in entries if not bench.likelihood(Hypothesis().with_effect(entry)).model.unaffordable
    ]


def divisions(bench: Workbench) -> list[str]:
    """What an offset may be divided by in this recording: curves, and nights where they are not the
    curves."""
    recording = bench.base.recording
    curves, nights = len(recording.curve_ids), len(recording.night_ids)
    pairs = len(set(zip(recording.curve.tolist(), recording.night.tolist(), strict=True)))
    found = ["curve"] if curves > 1 else []
    if nights > 1 and not (pairs == curves == nights):
        found.append("night")
    return found


def extended(
    bench: Workbench,
    scorer: Scorer,
    at: Sequence[Refit],
    entry: str,
    found: Probe,
    seed: int,
    *,
    starts: int = STARTS,
    seeds: Sequence[Refit] = (),
) -> Found:
    """Refit of one hypothesis with ``entry`` added: from its minima ``at``, from other materials, and from
    the best probed values; or, where other refits are given as ``seeds``, from their materials alone."""
    if Entry.parse(entry).per is not None and Entry.parse(entry).width is None:
        return _divided(bench, scorer, at, entry, found, seed)
    hypothesis = at[0].hypothesis.with_effect(entry)
    likelihood = bench.likelihood(hypothesis)
    parameters = likelihood.model.parameter_set
    generator = torch.Generator().manual_seed(seed)
    dear = is_dear(likelihood.model)
    starts = SLOW_STARTS if dear else starts
    columns = effect_columns(parameters, entry)
    places = 1 if not columns else SLOW_PLACES if dear else PLACES
    psi = effect_starts(likelihood, entry, places, generator)
    ranked = found.psi[torch.argsort(found.scores, descending=True)]
    likely = apart(bench, entry, ranked)[: -(-places // 2)]
    if columns:
        psi[: len(likely)] = likely
    materials = max(paid(likelihood, places * MATERIALS) // places, HEAVY_MATERIALS)
    if seeds:
        pool = torch.cat([bench.start(hypothesis, one.theta[None], one.names) for one in seeds])
    else:
        pool = torch.cat(
            [
                torch.stack([one.theta for one in at]),
                other_materials(at[0], materials, generator),
            ]
        )
        pool = bench.start(hypothesis, pool, at[0].names)
    theta = pool.repeat(places, 1)
    group = torch.arange(places).repeat_interleave(len(pool))
    theta[:, columns] = psi[group]
    fitted = refit(likelihood, hypothesis, screened(likelihood, theta, starts, group, generator))
    return judged(released(wrapped(entry, rescanned(bench, entry, fitted))), scorer)


def wrapped(entry: str, fitted: Refit) -> Refit:
    """A refit of a swing whose phase, or the longitude of whose axis, came to the end of its range, fitted on from the
    other end: the two are the same swing."""
    columns = effect_columns(fitted.model.parameter_set, entry)
    if effect_class(entry).turning != "swing" or len(columns) != SWING or fitted.likelihood.fitted_errors:
        return fitted
    _, _, phase, lon, lat = columns
    free = fitted.model.parameter_set.free
    theta = fitted.theta.clone()
    if bool(fitted.held[lon]):
        limits = free[lon].prior
        theta[lon] = limits.low + limits.high - theta[lon]
        theta[lat] = -theta[lat]
        theta[phase] = (theta[phase] + 180.0) % 360.0
    elif bool(fitted.held[phase]):
        theta[phase] = free[phase].prior.low + free[phase].prior.high - theta[phase]
    else:
        return fitted
    again = refit(fitted.likelihood, fitted.hypothesis, theta[None])
    return again if again.objective < fitted.objective else fitted


def rescanned(bench: Workbench, entry: str, fitted: Refit) -> Refit:
    """A refit whose effect has to be tried at every row, tried again at every row from what was found, until that
    helps no more."""
    column = scanned_column(entry)
    if column is None or fitted.likelihood.fitted_errors:
        return fitted
    place = effect_columns(fitted.model.parameter_set, entry)[column]
    for _ in range(MOST_RESCANS):
        hours = scanned_hours(bench)
        theta = fitted.theta.repeat(len(hours), 1)
        theta[:, place] = hours
        with torch.no_grad():
            cost = objective(fitted.likelihood, theta)
        best = theta[torch.argsort(cost)[:1]]
        if float(cost.min()) > fitted.objective - 1.0:
            break
        again = refit(fitted.likelihood, fitted.hypothesis, best)
        if again.objective > fitted.objective - 1.0:
            break
        fitted = again
    return fitted


def paid(likelihood: Likelihood, most: int) -> int:
    """``most`` trials, or as many as TRIAL_VALUES allow where each fills the buffers."""
    if not is_heavy(likelihood.model):
        return most
    return max(1, min(most, int(TRIAL_VALUES / likelihood.model.values_a_call())))


def other_materials(at: Refit, count: int, generator: torch.Generator) -> Tensor:
    """Draws (count, P) of a refit's parameters from the prior, those of its effects and of the geometry
    kept."""
    draws = at.model.parameter_set.sample_prior(count, generator)
    columns = settled(at)
    draws[:, columns] = at.theta[columns]
    return draws


def settled(at: Refit) -> list[int]:
    """Columns of a refit's theta that belong to its effects or to the geometry."""
    parameters = at.model.parameter_set
    kept = {column for added in at.hypothesis.added for column in effect_columns(parameters, added)}
    return sorted(kept | set(at.model.assembly.geometry_columns))


def second_look(
    bench: Workbench,
    scorer: Scorer,
    baseline: Sequence[Refit],
    first: Sequence[Found],
    probes: dict[str, Probe],
    null: Found,
    seed: int,
) -> list[Found]:
    """The first round, best first, with every effect refitted once more from the materials of the leaders.

    What an effect is blamed for may sit in the materials: a rival whose refit stayed at the biased ones of the
    baseline would lose for that alone.
    """
    ranked = sorted(first, key=lambda found: -found.log_evidence)
    leaders = [found for found in ranked[:LEADERS] if better(found, null, None)]
    again = []
    for number, found in enumerate(ranked):
        seeds = [one.refit for one in leaders if one is not found]
        (entry,) = found.hypothesis.plain
        if seeds and Entry.parse(entry).per is None:
            new = extended(
                bench, scorer, baseline, entry, probes[entry], seed + number, starts=FEW_STARTS, seeds=seeds
            )
            found = max(found, new, key=lambda one: one.log_evidence)
        again.append(found)
    return sorted(again, key=lambda found: -found.log_evidence)


def preview(bench: Workbench, at: Refit, entry: str, found: Probe, seed: int) -> float:
    """What a few steps from the best probed values already reach: the objective, plus 4 for each parameter
    that the effect brings, as Occam would have it."""
    hypothesis = at.hypothesis.with_effect(entry)
    likelihood = bench.likelihood(hypothesis)
    columns = effect_columns(likelihood.model.parameter_set, entry)
    starts = 1 if is_slow(likelihood.model) or not columns else 3
    theta = bench.start(hypothesis, at.theta[None].expand(starts, -1), at.names)
    if columns:
        generator = torch.Generator().manual_seed(seed)
        tried = effect_starts(likelihood, entry, starts, generator)
        best = found.psi[torch.argsort(found.scores, descending=True)][:starts]
        tried[: len(best)] = best
        theta[:, columns] = tried
    level = theta[0] if likelihood.fitted_errors else None
    with torch.no_grad():
        reached = polish(likelihood, theta, None, iterations=PREVIEW_STEPS, level_at=level)
    return float(reached.cost.min()) + 4.0 * len(columns)


def _divided(
    bench: Workbench, scorer: Scorer, at: Sequence[Refit], entry: str, found: Probe, seed: int
) -> Found:
    """An offset that every curve (or night) has for itself, the spread of its values learnt from them: begun
    wide, narrowed to their root mean square."""
    parsed = Entry.parse(entry)
    (quantity,) = effect_class(entry).quantities
    width = min(10 * (quantity.sigma or 1.0), quantity.high / 3)
    hypothesis, theta, names = at[0].hypothesis, at[0].theta, at[0].names
    for _ in range(3):
        wide = hypothesis.with_effect(str(replace(parsed, width=width)))
        likelihood = bench.likelihood(wide)
        fitted = refit(likelihood, wide, bench.start(wide, theta[None], names))
        columns = effect_columns(likelihood.model.parameter_set, wide.added[-1])
        values = fitted.theta[columns] - (quantity.off or 0.0)
        variance = torch.diagonal(fitted.covariance())[columns]
        theta, names = fitted.theta, fitted.names
        new = float(
            f"{max(float(torch.sqrt((values**2 + variance).mean())), 1e-3 * (quantity.sigma or 1.0)):.3g}"
        )
        if abs(new - width) < 0.05 * width:
            break
        width = new
    return judged(fitted, scorer)


def nameable(found: Found) -> bool:
    """The parameters of every added effect are inside their bounds, which hold SPREADS of a divided offset's: one
    that scatters more is no error of calibration, whatever it mends. An effect with an onset that comes to the first or
    the last row is none: it is there all the time, or never."""
    for entry in found.hypothesis.added:
        onset = scanned_column(entry)
        if onset is not None:
            columns = effect_columns(found.refit.model.parameter_set, entry)
            if len(columns) > onset and bool(found.refit.held[columns[onset]]):
                return False
        parsed = Entry.parse(entry)
        if parsed.width is not None:
            (one,) = effect_class(entry).quantities
            off = one.off or 0.0
            if SPREADS * parsed.width > min(off - one.low, one.high - off):
                return False
    sizes = sizes_of(found.refit)
    too_much = any(size.quantity.role == SHARE and size.value > MOST_WEIGHT for size in sizes)
    return not too_much and not stuck(found.refit)


@dataclass(frozen=True)
class Size:
    """What makes an added effect large or small: its column in theta, its value, and the value without effect."""

    column: int
    quantity: Quantity
    value: float
    off: float


def sizes_of(at: Refit) -> list[Size]:
    """The sizes of all added effects."""
    found = []
    for entry in at.hypothesis.added:
        quantities = {quantity.name: quantity for quantity in effect_class(entry).quantities}
        for column in effect_columns(at.model.parameter_set, entry):
            quantity = quantities[at.model.parameter_set.quantities[column]]
            if quantity.off is not None:
                found.append(Size(column, quantity, float(at.theta[column]), quantity.off))
    return found


def stuck(at: Refit) -> list[Size]:
    """Sizes at a bound. One towards a value without effect that lies at infinity does not count: it is as little as
    there can be, rather than as much."""

    def least(size: Size) -> bool:
        return size.off == math.inf and size.value > 0.5 * (size.quantity.low + size.quantity.high)

    return [size for size in sizes_of(at) if bool(at.held[size.column]) and not least(size)]


def released(at: Refit) -> Refit:
    """A refit whose sizes came to their bounds with them a step back, where that costs less than HARMLESS: a product
    (of an area and its reflectance) may wander to the bound of one for nothing."""
    held = stuck(at)
    if not held or at.likelihood.fitted_errors or any(math.isinf(size.off) for size in held):
        return at
    theta = at.theta.clone()
    for size in held:
        theta[size.column] -= STEP_BACK * (size.value - size.off)
    with torch.no_grad():
        reached = polish(at.likelihood, theta[None], None, held=[size.column for size in held])
    again = linearised(at.likelihood, at.hypothesis, at.model.parameter_set.from_flat(reached.y[0]))
    return again if again.objective < at.objective + HARMLESS else at


def better(
    new: Found,
    old: Found,
    excess: float | None,
    gain: float = HELDOUT_GAIN,
    evidence: float = EVIDENCE_GAIN,
) -> bool:
    """Whether ``new`` earns its place over ``old``: evidence, held-out density and a share of the chi-square
    excess."""
    if new.log_evidence - old.log_evidence < evidence:
        return False
    if new.score.heldout_total - old.score.heldout_total < gain:
        return False
    return not (excess is not None and old.refit.chi2 - new.refit.chi2 < EXCESS_SHARE * excess)


def foreseen(new: Found, old: Found, null: Found) -> float:
    """How much of the variance that the baseline leaves in unseen parts of curves ``new`` takes from what ``old``
    leaves; nan where errors are quoted.

    EXCESS_SHARE of it is asked of what is named where errors are fitted: their scale makes up for whatever a
    model misses, in the density of unseen rows as well, and with many rows evidence grows for whatever bends a
    wrong model a little.
    """
    return (old.score.unseen**2 - new.score.unseen**2) / max(null.score.unseen**2, 1e-300)


def search(
    bench: Workbench,
    scorer: Scorer,
    null: Found,
    baseline: Sequence[Refit],
    probes: dict[str, Probe],
    is_clean: Callable[[Found, Mapping[str, Probe]], bool],
    *,
    seed: int = 0,
    most_refits: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[Found, Found, list[Found], list[Found]]:
    """The scene's own model at its best, the best set of effects, all first-round refits (best first), and every
    other refit that was made."""
    dof = baseline[0].likelihood.degrees_of_freedom
    excess = None if baseline[0].likelihood.fitted_errors else max(null.refit.chi2 - dof, 1.0)
    entries = sorted(probes, key=lambda entry: -probes[entry].score)
    if most_refits is not None:
        previews = {entry: preview(bench, baseline[0], entry, probes[entry], seed) for entry in entries}
        entries = sorted(entries, key=lambda entry: previews[entry])[:most_refits]
    least = least_score(probes)  # of effects whose light takes long to work out; every other one is refitted
    entries = [
        entry
        for entry in entries
        if probes[entry].score >= least or not is_heavy(bench.likelihood(Hypothesis((entry,))).model)
    ]
    first: list[Found] = []
    for number, entry in enumerate(entries):
        first.append(extended(bench, scorer, baseline, entry, probes[entry], seed + number))
        if progress is not None:
            progress("refits", 0.1 + 0.5 * (number + 1) / len(entries))
    first = second_look(bench, scorer, baseline, first, probes, null, seed)
    null = unaided(bench, scorer, null, first)
    others: list[Found] = []
    sound = [found for found in first if nameable(found)]
    good = leader_first(
        [
            found
            for found in sound
            if better(found, null, excess) and not foreseen(found, null, null) < EXCESS_SHARE
        ]
    )
    best = good[0] if good else null
    beam = stems(good, promising(sound, null, excess))
    for _ in range(MOST_EFFECTS - 1):
        if not beam:
            break
        probed: dict[str, Probe] = {}
        if is_clean(best, {}):
            # A faint effect beside a strong one is seen by what it would do, not by the residuals' look alone.
            if not best.hypothesis.added or most_refits is not None:
                break
            probed = beside(bench, best, entries, seed)
            if is_clean(best, probed):
                break
            beam = [best]
        grown: list[Found] = []
        for place, stem in enumerate(beam):
            again = {
                entry: found
                for entry, found in (probed or beside(bench, stem, entries, seed)).items()
                if not any(set(one.hypothesis.plain) == {*stem.hypothesis.plain, entry} for one in grown)
            }
            least = least_score(again)
            for number, entry in enumerate(sorted(again, key=lambda one: -again[one].score)):
                late = number >= (MOST_GROWN if place == 0 else MOST_GROWN_BESIDE)
                weak = late or again[entry].score < least
                if weak and not (again[entry].psi.shape[-1] == 0 and again[entry].score > 1.0):
                    continue
                grown.append(
                    extended(bench, scorer, [stem.refit], entry, again[entry], seed + number, starts=8)
                )
            if progress is not None:
                progress("sets of effects", 0.6 + 0.3 * (place + 1) / len(beam))
        others += grown
        grown = [found for found in grown if nameable(found)]
        grown.sort(key=lambda found: -found.log_evidence)
        known = {frozenset(found.hypothesis.plain): found for found in [null, *first, *others]}
        accepted = [found for found in grown if _all_needed(found, known, best, excess)]
        if not accepted:
            break
        accepted = leader_first(accepted)
        best, tried = trimmed(bench, scorer, accepted[0])
        others += tried
        beam = [best, *accepted[1:BEAM]]
    return null, best, first, others


def unaided(bench: Workbench, scorer: Scorer, null: Found, first: Sequence[Found]) -> Found:
    """The scene's own model from the materials at which effects left it too: what an effect that does nothing has
    over it is but a minimum that was not looked into."""
    likelihood = null.refit.likelihood
    if is_dear(likelihood.model) or not null.refit.names or likelihood.fitted_errors:
        return null
    starts = [bench.start(null.hypothesis, one.refit.theta[None], one.refit.names) for one in first]
    if not starts:
        return null
    with torch.no_grad():
        reached = polish(likelihood, torch.cat(starts), None)
    order = torch.argsort(reached.cost)
    theta = likelihood.model.parameter_set.from_flat(reached.y[order])
    again = leading(likelihood, null.hypothesis, theta, reached.cost[order])
    return max([null, *minima(again, scorer)], key=lambda one: one.log_evidence)


def minima(at: Refit, scorer: Scorer) -> list[Found]:
    """A refit at each of its minima, with the others beside it: what noise describes best need not be the one that is
    deepest, or the widest, at the quoted errors."""
    each = [at, *at.others]
    return [
        judged(replace(one, others=tuple(other for other in each if other is not one)), scorer)
        for one in each
    ]


def beside(bench: Workbench, stem: Found, entries: Sequence[str], seed: int) -> dict[str, Probe]:
    """Probes at a refit of every effect that may join its set."""
    return {
        entry: probe(bench, stem.refit, entry, seed + number)
        for number, entry in enumerate(entries)
        if compatible(stem, entry) and payable(bench, stem, entry)
    }


def least_score(probes: Mapping[str, Probe]) -> float:
    """What an effect that is not refitted for its own sake has to score beside others."""
    return max(LEAST_SCORE, WEAK_SHARE * max((one.score for one in probes.values()), default=0.0))


def trimmed(bench: Workbench, scorer: Scorer, found: Found) -> tuple[Found, list[Found]]:
    """A set without the members that it does not need once their like is refitted from its own values, and all
    refits made: the smaller sets that it grew from may have stayed in minima that it left."""
    tried: list[Found] = []
    for entry in found.hypothesis.added:
        if len(found.hypothesis.added) == 1:
            break
        fewer = Hypothesis(tuple(one for one in found.hypothesis.added if one != entry))
        theta = bench.start(fewer, found.refit.theta[None], found.refit.names)
        without = judged(refit(bench.likelihood(fewer), fewer, theta), scorer)
        tried.append(without)
        if nameable(without) and not better(found, without, None, gain=0.0):
            found = without
    return found, tried


def explored(found: Found, scorer: Scorer, seed: int) -> Found:
    """The refit with all the minima that a wide search of the materials finds while its effects and the geometry
    stay, so that what is said of materials spans them."""
    at, likelihood = found.refit, found.refit.likelihood
    if likelihood.fitted_errors or not found.score.noise.noise.normal or not at.names:
        return found
    generator = torch.Generator().manual_seed(seed)
    draws = other_materials(at, paid(likelihood, WIDE), generator)
    count = SLOW_STARTS if is_heavy(likelihood.model) else STARTS
    starts = screened(likelihood, draws, count, torch.arange(len(draws)), generator)
    with torch.no_grad():
        reached = polish(likelihood, torch.cat([at.theta[None], starts]), None, held=settled(at))
    order = torch.argsort(reached.cost)
    theta = likelihood.model.parameter_set.from_flat(reached.y[order])
    wide = leading(likelihood, at.hypothesis, theta, reached.cost[order])
    return Found(wide, scorer.score(wide))


def compatible(stem: Found, entry: str) -> bool:
    """Whether an effect may join a set: one that is not there, or the same in another material."""
    new = Entry.parse(entry)
    if new.plain in stem.hypothesis.plain:
        return False
    return effect_class(entry).stage == "material" or new.name not in stem.hypothesis.names


def stems(good: Sequence[Found], promising: Sequence[Found]) -> list[Found]:
    """Refits to extend: of the good and the promising in turn, each once."""
    turns = [one for pair in zip_longest(good, promising) for one in pair if one is not None]
    chosen = {one.hypothesis.plain: one for one in turns}
    return list(chosen.values())[: BEAM + 1 if good and promising else BEAM]


def payable(bench: Workbench, stem: Found, entry: str) -> bool:
    """Whether a set's refits can be paid: light between parts, up to 2 % of the whole, is not worked out anew for
    every step of an effect that moves them, unless the scene itself asks for it."""
    model = bench.likelihood(stem.hypothesis.with_effect(entry)).model
    asked = any(effect.stage == "scatter" for effect in bench.base.effects)
    return asked or not (model.geometry_free and any(effect.stage == "scatter" for effect in model.effects))


def promising(sound: Sequence[Found], null: Found, excess: float | None) -> list[Found]:
    """Refits to extend whether or not they are good enough alone: those that gain most over the baseline at the
    quoted errors.

    Of two missing effects either alone may leave so much that noise describes the rest as well as all. That is
    so of a gross mismatch; a faint one that no effect explains is left at that.
    """
    if excess is None or excess < GROSS * null.refit.likelihood.chi2_sd:
        return []
    white = null.score.white[0]
    gains = {id(found): found.score.white[0] - white for found in sound}
    kept = [
        found
        for found in sound
        if gains[id(found)] > EVIDENCE_GAIN and null.refit.chi2 - found.refit.chi2 > EXCESS_SHARE * excess
    ]
    return sorted(kept, key=lambda found: -gains[id(found)])[:BEAM]


def leader_first(ranked: Sequence[Found]) -> list[Found]:
    """Refits in order of evidence, led, among those whose evidence is as good as the first's, by that of the largest
    evidence and held-out density together, less one for each parameter: the point about which blocks are predicted
    had them in sight (Akaike 1974, IEEE Trans. Autom. Control 19, 716)."""
    tied = [found for found in ranked if found.log_evidence > ranked[0].log_evidence - TIED]
    leader = max(
        tied,
        key=lambda found: found.log_evidence + found.score.heldout_total - len(found.refit.names),
        default=None,
    )
    return sorted(ranked, key=lambda found: found is not leader)


def consistent(at: Refit) -> bool:
    """Whether chi-square at the quoted errors leaves nothing to be explained."""
    return at.chi2 <= at.likelihood.degrees_of_freedom + CONSISTENT * at.likelihood.chi2_sd


def _all_needed(found: Found, known: dict[frozenset[str], Found], best: Found, excess: float | None) -> bool:
    """A set is named only if it beats the best smaller set and each member improves held-out prediction given
    the others, where errors are fitted by enough."""
    left = best.refit.chi2 - best.refit.likelihood.degrees_of_freedom
    asked = None if excess is None else min(excess, left * LEFT_SHARE / EXCESS_SHARE)
    if not better(found, best, asked, gain=0.0):
        return False
    if not best.hypothesis.added and not better(found, best, excess, 2 * HELDOUT_GAIN, 2 * EVIDENCE_GAIN):
        return False
    members = frozenset(found.hypothesis.plain)
    for entry in members:
        without = known.get(members - {entry})
        if without is not None and (
            found.score.heldout_total <= without.score.heldout_total
            or found.log_evidence - without.log_evidence < EVIDENCE_GAIN
            or foreseen(found, without, known[frozenset()]) < EXCESS_SHARE
        ):
            return False
    return True
