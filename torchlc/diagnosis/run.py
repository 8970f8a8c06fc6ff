"""Diagnosis from scene and recording to verdict: is anything missing, what is it, where, and what does it
change."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import torch

from torchlc.diagnosis.brdf_alternatives import under_other_laws
from torchlc.diagnosis.candidates import check_candidates
from torchlc.diagnosis.coordinates import coordinates
from torchlc.diagnosis.evidence import NoiseModel, Scorer, make_blocks
from torchlc.diagnosis.families import families
from torchlc.diagnosis.gate import Battery, Gate, gate
from torchlc.diagnosis.plan import Option, next_nights, sentence
from torchlc.diagnosis.probes import Probe, probe
from torchlc.diagnosis.refit import Hypothesis, Refit, Workbench, linearised
from torchlc.diagnosis.result import Diagnosis
from torchlc.diagnosis.search import (
    EVIDENCE_GAIN,
    GROSS,
    Found,
    affordable,
    candidate_entries,
    consistent,
    explored,
    judged,
    minima,
    nameable,
    not_carried,
    search,
)
from torchlc.diagnosis.sizes import resized
from torchlc.diagnosis.where import Where, best_coordinate, intervals, locate
from torchlc.effects import effect_class, with_title
from torchlc.inference.optimiser import find_modes
from torchlc.lightcurve.assembly import assemble
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.stages.effect import Entry

ADEQUATE_P = 0.01
STRUCTURE_P = 1e-3
"""The global p below which what a noise model, or several effects together, leave behind is structure."""
NOISE_EVIDENCE = 5.0
NOISE_HELDOUT = 3.0
MOST_NOISE = 0.2
"""Standard deviation of what noise adds, mag: four times the scale of the priors of jitter and red noise."""
LEFT_AFTER = 0.5
LAW_EVIDENCE = 10.0
"""Another law of reflection is tried where a gross mismatch is left, and taken where its best model gains this
over that of the scene's own law."""
SIZES_AS_WELL = "sizes of the components some per cent from the scene's explain it as well as {}"
DEAR = "each of its geometries costs a pass over the whole mesh"
QUICK_REFITS = 3
BASELINE_STARTS = 32
MOST_MODES = 3


def diagnose(
    scene: Scene,
    recording: Recording,
    *,
    quick: bool = False,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """What the scene's model leaves out of a recording.

    ``effects`` restricts the candidates (noise is always considered), each as :func:`check_candidates` takes it;
    ``quick`` makes at most QUICK_REFITS refits in the first round, and stays with the scene's law of reflection. Upper
    limits are left out, and counted as dropped: evidence, held-out scores and the gate are those of measured rows.
    Raises InputError for an unknown effect name.
    """
    recording = recording.keep(~recording.upper_limit, "upper limit, which a diagnosis does not use")
    if effects is not None:
        check_candidates(effects, assemble(scene, recording))
    own = Start(scene, recording, seed)
    found = _under_one_law(own, quick=quick, effects=effects, progress=progress)
    if quick or not _left_over(found):
        return found
    others = {law: Start(other, recording, seed) for law, other in under_other_laws(scene).items()}
    told, best = found, found.final.log_evidence + LAW_EVIDENCE
    for law in sorted(others, key=lambda one: others[one].modes[0].objective):
        new = _under_one_law(others[law], effects=effects, progress=progress)
        if new.verdict in ("missing_physics", "adequate") and new.final.log_evidence > best:
            told, best = _told(found, new, law), new.final.log_evidence
        if not _left_over(new):
            break
    return replace(told, seconds=time.monotonic() - own.began)


def _told(own: Diagnosis, other: Diagnosis, law: str) -> Diagnosis:
    """What is said where another law does better: its named effects with the gate of the scene's own; no name where
    the law alone is what was missing, for that is no effect."""
    if other.verdict == "adequate":
        return replace(own, verdict="unexplained", named=(), families=(), law=law)
    return replace(other, gate=own.gate, law=law)


def _left_over(found: Diagnosis) -> bool:
    """Whether the verdict leaves so much that the law of reflection itself is in doubt; noise that has no memory is
    no trace of another law, nor is what can be described but not named. Beside another effect a tail may stand for
    another lobe, and the other for what it does not bend right."""
    likelihood = found.final.refit.likelihood
    forgetful = found.verdict == "noise_model" and not any(
        found.scorer.kinds[name].correlates for name in found.named
    )
    if found.verdict == "adequate" or forgetful or found.doubt or likelihood.fitted_errors:
        return False
    if consistent(found.baseline.refit):
        return False
    gross = likelihood.degrees_of_freedom + GROSS * likelihood.chi2_sd
    reshaped = len(found.named) > 1 and any(effect_class(name).reshapes_lobe for name in found.named)
    return found.verdict == "unexplained" or reshaped or found.final.refit.chi2 > gross


class Start:
    """A scene, a recording and the minima of the scene's own model, from which a diagnosis begins."""

    def __init__(self, scene: Scene, recording: Recording, seed: int) -> None:
        self.began = time.monotonic()
        self.scene, self.recording, self.seed = scene, recording, seed
        self.bench = Workbench(assemble(scene, recording), seed)
        self.likelihood = self.bench.likelihood(Hypothesis())
        self.modes, _, _ = find_modes(self.likelihood, starts=BASELINE_STARTS, adam_steps=60, seed=seed)


def _under_one_law(
    own: Start,
    *,
    quick: bool = False,
    effects: Sequence[str] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """The diagnosis with surfaces that reflect as the scene says."""
    scene, recording, seed = own.scene, own.recording, own.seed
    bench, likelihood = own.bench, own.likelihood
    baseline = [linearised(likelihood, Hypothesis(), mode.theta) for mode in own.modes[:MOST_MODES]]
    if progress is not None:
        progress("baseline", 0.05)
    context = bench.base.context
    group = context.curve if len(recording.curve_ids) >= 4 else context.night
    scorer = Scorer(context, make_blocks(context.seconds, group))
    found_coordinates = coordinates(likelihood.model, baseline[0].theta)
    possible = candidate_entries(bench, effects)
    entries = affordable(bench, possible)
    probes = {}
    for number, entry in enumerate(entries):
        probes[entry] = probe(bench, baseline[0], entry, seed + number)
        if progress is not None:
            progress("signatures", 0.05 + 0.1 * (number + 1) / len(entries))
    gates = [_gate(refit, scorer, found_coordinates, probes, seed) for refit in baseline]
    first_gate = max(gates, key=lambda one: one.global_p)
    adequate = first_gate.global_p >= ADEQUATE_P
    deepest = replace(baseline[0], others=tuple(baseline[1:]))
    start = (
        judged(deepest, scorer)
        if adequate
        else max(minima(deepest, scorer), key=lambda found: found.log_evidence)
    )
    common = {
        "scorer": scorer,
        "gate": first_gate,
        "probes": probes,
        "coordinates": found_coordinates,
        "quick": quick,
        "seed": seed,
        "untried": not_carried(bench, effects) | {entry: DEAR for entry in possible if entry not in entries},
    }
    if adequate:
        return Diagnosis(
            verdict="adequate",
            baseline=start,
            final=start,
            named=(),
            families=(),
            first=(),
            where=None,
            final_gate=first_gate,
            seconds=time.monotonic() - own.began,
            **common,
        )

    def is_clean(found: Found, beside: Mapping[str, Probe]) -> bool:
        return _gate(found.refit, scorer, found_coordinates, beside, seed).global_p >= ADEQUATE_P

    start, final, first, others = search(
        bench,
        scorer,
        start,
        baseline,
        probes,
        is_clean,
        seed=seed,
        most_refits=QUICK_REFITS if quick else None,
        progress=progress,
    )
    if final is not start:
        final = explored(final, scorer, seed)
    first = _deepest(first, [*others, final])
    after = _gate(final.refit, scorer, found_coordinates, {}, seed)
    verdict, named = _verdict(start, final, scorer, found_coordinates, seed, after.global_p)
    if verdict == "noise_model" and final is not start:
        final, after = start, _gate(start.refit, scorer, found_coordinates, {}, seed)
    doubt = ""
    if verdict == "missing_physics" and any(effect_class(name).adds_area for name in named):
        sized = resized(scene, recording, scorer, start.refit, final.refit, seed)
        if sized is not None and sized.log_evidence > final.log_evidence - EVIDENCE_GAIN:
            areas = " and ".join(with_title(name) for name in named if effect_class(name).adds_area)
            verdict, named, doubt = "unexplained", [], SIZES_AS_WELL.format(areas)
    groups = (
        families(final, [start, *first, *others], named)
        if verdict == "missing_physics"
        else [[n] for n in named]
    )
    where = (
        locate(start.refit, final.refit, found_coordinates)
        if verdict == "missing_physics"
        else _windows(start.refit, first_gate, found_coordinates)
    )
    nights, advice = _next(verdict, final, [*first, *others], groups, scene)
    return Diagnosis(
        verdict=verdict,
        baseline=start,
        final=final,
        nights=nights,
        next_observation=advice,
        named=tuple(named),
        families=tuple(tuple(one) for one in groups),
        first=tuple(first),
        others=tuple(others),
        doubt=doubt,
        where=where,
        final_gate=after,
        seconds=time.monotonic() - own.began,
        **common,
    )


def _deepest(first: Sequence[Found], later: Sequence[Found]) -> list[Found]:
    """The first round, best first, with what later refits of the same hypotheses have found better."""
    best = {found.hypothesis.plain: found for found in first}
    for found in later:
        own = best.get(found.hypothesis.plain)
        if own is not None and found.log_evidence > own.log_evidence:
            best[found.hypothesis.plain] = found
    return sorted(best.values(), key=lambda found: -found.log_evidence)


def _next(
    verdict: str, final: Found, made: Sequence[Found], groups: Sequence[Sequence[str]], scene: Scene
) -> tuple[list[Option], str]:
    """Candidate nights for the first tied family, and the advice in a sentence."""
    tied = next((group for group in groups if len(group) > 1), None) if verdict == "missing_physics" else None
    if tied is None:
        return [], ""
    own = next(entry for entry in final.hypothesis.plain if Entry.parse(entry).name == tied[0])
    others = frozenset(final.hypothesis.plain) - {own}
    rival = next(
        found
        for found in made
        if others <= frozenset(found.hypothesis.plain)
        and len(found.hypothesis.added) == len(final.hypothesis.added)
        and tied[1] in found.hypothesis.names
    )
    options = next_nights(final, rival)
    return options, sentence(options, tied[0], tied[1], scene.orbit.known)


def _gate(
    refit: Refit,
    scorer: Scorer,
    found: dict[str, torch.Tensor],
    probes: Mapping[str, Probe],
    seed: int,
    noise: NoiseModel | None = None,
) -> Gate:
    """The gate at the quoted errors, or after whitening by a noise model (then without chi-square, which the
    noise was fitted to)."""
    likelihood = refit.likelihood
    signatures = {entry: one.signatures[~one.aimed] for entry, one in probes.items() if not one.aimed.all()}
    battery = Battery(
        scorer.seconds,
        likelihood.curve,
        found,
        signatures,
        with_chi2=not likelihood.fitted_errors and noise is None,
    )
    return gate(refit, battery, seed, noise=noise, scorer=scorer)


def _verdict(
    start: Found, final: Found, scorer: Scorer, found: dict[str, torch.Tensor], seed: int, p_after: float
) -> tuple[str, list[str]]:
    """The verdict and the names. Several effects together bend a model to much that is none of them: they are
    named where they leave no structure behind, a single one also where it takes the larger part away and describes
    the recording better at the quoted errors than noise alone. Where it does not, the errors may be at fault, but not
    noise that is correlated, which takes up whatever physics has begun to explain, nor noise that is MOST_NOISE loud. Where errors
    are fitted, rows that were not seen have to be predicted nearer."""
    likelihood = start.refit.likelihood
    white, heldout_white = start.score.white
    kinds = start.score.by_kind
    best = max(kinds, key=lambda kind: kinds[kind][0])
    begun = bool(final.hypothesis.added) and nameable(final)
    if begun:
        own = sorted(map(Entry.parse, final.hypothesis.added), key=lambda entry: entry.per is not None)
        named = list(dict.fromkeys(entry.name for entry in own))
        if likelihood.fitted_errors:
            done = scorer.heldout_rms(final.refit) < scorer.heldout_rms(start.refit)
        else:
            before = start.refit.chi2 - likelihood.degrees_of_freedom
            left = final.refit.chi2 - final.refit.likelihood.degrees_of_freedom
            pairs = zip(final.score.white, kinds[best], strict=True)
            single = len(final.hypothesis.added) == 1 and all(alone > noisy for alone, noisy in pairs)
            little = left <= LEFT_AFTER * before or consistent(final.refit)
            done = (single or p_after >= STRUCTURE_P) and little
        if done:
            return "missing_physics", named
    noise = start.score.noise
    gained = kinds[best][0] - white > NOISE_EVIDENCE and kinds[best][1] - heldout_white > NOISE_HELDOUT
    if gained and not (begun and noise.correlates) and not loud(noise):
        whitened = _gate(start.refit, scorer, found, {}, seed, noise=noise)
        if whitened.global_p >= STRUCTURE_P:
            return "noise_model", [best]
    return "unexplained", []


def loud(noise: NoiseModel) -> bool:
    """Whether noise is louder than what recordings have of it, so that it stands for something else."""
    return noise.noise.loudest > MOST_NOISE


def _windows(refit: Refit, found: Gate, coordinates_: dict[str, torch.Tensor]) -> Where:
    """The windows of the scan, for a mismatch without a name."""
    rows = torch.zeros(len(refit.delta), dtype=torch.bool)
    order = torch.argsort(refit.model.assembly.context.seconds)
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order))
    for a, b, _ in found.windows:
        rows[order[int(place[a]) : int(place[b]) + 1]] = True
    strength = refit.delta / refit.sigma
    return Where(rows, intervals(rows, strength, refit), [], *best_coordinate(strength, coordinates_, rows))
