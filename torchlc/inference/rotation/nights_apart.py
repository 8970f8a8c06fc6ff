"""Nights each for itself: whether the rotations that join them stand, or only a phase, or a period too, of each night does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchlc.inference.rotation.course import Course
from torchlc.inference.rotation.fixed_axis import Turns
from torchlc.inference.rotation.model_fit import Candidate, fitted, sharpened
from torchlc.inference.rotation.modes import (
    CHANGED,
    SAME_DEG,
    SAME_PERIOD,
    RotationMode,
    apart_deg,
    merged,
)
from torchlc.inference.rotation.problem import Problem
from torchlc.inference.rotation.refine import Local
from torchlc.inference.rotation.trials import alike, loose_trial
from torchlc.inference.rotation.turn_fits import LOCALS, fits_of_turns

APART = 2
"""Poles at which the model is fitted with a phase for each night too, where counts of turns explain the light already."""


@dataclass(frozen=True)
class Settled:
    """The ``modes``, best first; ``loose`` those with a phase for each night beside modes that join the nights; what has to be said."""

    modes: list[RotationMode]
    loose: list[RotationMode]
    told: list[str]


def settled(problem: Problem, turns: Turns, found: Sequence[Candidate], course: Course) -> Settled:
    """The modes of the fits ``found``, after each night was looked at for itself where these leave something open."""
    rows, recording = problem.rows, problem.recording
    modes = merged(found, rows)
    several = len(np.unique(recording.night[rows.index.numpy()])) > 1
    if not (several and _unjoined(problem, found) and course.allowed("each night for itself")):
        return Settled(modes, [], [])
    apart, sharp = _apart(problem, turns, found, course)
    sentences: list[str] = []
    if sharp:
        joined, sentences = fits_of_turns(problem, replace(turns, best=sharp), course, changing=True)
        found = joined + [fit for fit in found if not any(_one_turn(fit, other) for other in joined)]
        modes = merged(found, rows)
    loose = merged(apart, rows)
    if not loose or not _one_rate_fails(problem, apart, found):
        return Settled(modes, loose, sentences)
    if modes:
        sentences.append(
            f"no one rotation holds over the nights: the best leaves {modes[0].rms:.3g} mag rms, that with "
            f"{' and '.join(loose[0].apart)} of each night for itself {loose[0].rms:.3g} mag"
        )
    return Settled(loose, [], sentences)


def _unjoined(problem: Problem, fits: Sequence[Candidate]) -> bool:
    """Whether the best of the rotations that join the passes takes one of several counts for granted, or leaves structure."""
    best = min(fits, key=lambda fit: fit.deviance, default=None)
    if best is None or not problem.fits(best):
        return True
    return not best.tumbling and (best.trial.possible > 1 or not best.trial.complete)


def _apart(
    problem: Problem, turns: Turns, joined: Sequence[Candidate], course: Course
) -> tuple[list[Candidate], list[Local]]:
    """The model fitted at the leading poles with a phase for each night; where the passes have unlike periods, or one for all leaves
    structure, with a period for each too. Where a count of turns explains the light, also the solutions with the phases and periods of
    the passes as the model has them, by which fewer counts are possible than by the light of facets."""
    explained = any(problem.fits(candidate) for candidate in joined)
    fits: list[Candidate] = []
    sharp: list[Local] = []
    most = APART if explained else LOCALS
    tried = [(local, kind.tilted) for kind in turns.kinds for local in kind.leading(most)]
    for number, (local, tilted) in enumerate(tried):
        enough = False
        for periods in (False, True):
            if (not periods and not alike(local)) or (enough and not explained):
                continue
            trial = loose_trial(
                problem.scene, problem.recording, problem.rows, local, periods=periods, tilted=tilted
            )
            fit = fitted(trial, problem.recording)
            if not math.isfinite(fit.chi2):
                continue
            if not enough:
                fits.append(fit)
                enough = problem.fits(fit)
            better = sharpened(problem.recording, problem.rows, local, fit) if periods and explained else None
            sharp += [] if better is None else [better]
        course.say("nights apart", (number + 1) / len(tried))
    return fits, sharp


def _one_turn(fit: Candidate, other: Candidate) -> bool:
    """Whether two fits of a turn about an axis are of one pole and period."""
    return (
        not fit.tumbling
        and apart_deg(fit.pole, other.pole) < SAME_DEG
        and abs(fit.numbers["period"] / other.numbers["period"] - 1) < SAME_PERIOD
    )


def _one_rate_fails(problem: Problem, apart: Sequence[Candidate], fits: Sequence[Candidate]) -> bool:
    """Whether nights by themselves are so much better than joined that no rotation joins them: where that leaves structure, by
    CHANGED for each further number."""
    if not fits or not apart:
        return not fits
    best = min(fits, key=lambda fit: fit.deviance)
    loose = min(apart, key=lambda fit: fit.deviance)
    further = max(1, len(loose.theta) - len(best.theta))
    return not problem.fits(best) and loose.deviance < best.deviance - CHANGED * further
