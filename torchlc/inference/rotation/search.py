"""From a scene and a recording to rotation states: the periods to look at, a grid of poles, least squares, the counts of
turns between passes, and the model with everything in it. What turns about no axis fixed in it is looked for where that leaves
structure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from torchlc.errors import InputError, option
from torchlc.files.steps import Steps
from torchlc.inference.rotation import fixed_axis, pole_grid
from torchlc.inference.rotation.course import Allowed, Course
from torchlc.inference.rotation.fixed_axis import Turns, with_sides
from torchlc.inference.rotation.kinds import Progress, free_rotations
from torchlc.inference.rotation.model_fit import Candidate, fitted
from torchlc.inference.rotation.modes import CHANGED, NOISY, RotationSearch, verdict
from torchlc.inference.rotation.modes import RotationMode as RotationMode
from torchlc.inference.rotation.nights_apart import Settled, settled
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.problem import Problem
from torchlc.inference.rotation.refine import Local
from torchlc.inference.rotation.trials import alike, tumbling_trial
from torchlc.inference.rotation.tumble_refine import Tumble
from torchlc.inference.rotation.turn_fits import FITS, any_finite, fits_of_turns
from torchlc.inference.rotation.windows import windows
from torchlc.readers import Recording
from torchlc.scene import Scene

UNLIKE = 0.01
"""Relative difference that the periods of passes may have, from which on these are asked before a free rotation. Nights of two weeks are
below it, so what tumbles is not taken for what changes."""


def search_rotation(
    scene: Scene,
    recording: Recording,
    *,
    shortest_s: float | None = None,
    longest_s: float | None = None,
    progress: Progress | None = None,
    steps: Steps | None = None,
    budget_s: float | None = None,
) -> RotationSearch:
    """Rotation states of a body: about a direction fixed in it and in space, or, where that leaves structure, free.

    ``budget_s``: CPU seconds after which no further stage is begun; then nothing is decided, and what was left out is said.
    """
    course = Course(Allowed(budget_s), steps or Steps(), progress or (lambda _text, _share: None))
    problem = Problem.posed(scene, recording, shortest_s, longest_s)
    ranges, frequency, power = windows(problem.rows, problem.low, problem.high)
    turns = fixed_axis.turns(problem, ranges, course)
    tumbles, told_of_tumbles = _tumbles(problem, turns, course)
    turns = with_sides(problem, turns, course)
    fits, told_of_fits = _fits(problem, turns, tumbles, course)
    answer = settled(problem, turns, fits, course)
    if not answer.modes:
        raise _nothing_found(problem, course.allowed)
    decided, words = _verdict(problem, turns, answer, course.allowed)
    warnings = [*problem.told, *turns.told, *told_of_tumbles, *told_of_fits, *answer.told]
    best = answer.modes[0]
    return RotationSearch(
        modes=answer.modes,
        rows=len(problem.rows.flux),
        dof=_dof(problem, answer),
        passes=problem.rows.passes,
        symmetry=turns.symmetry,
        searched_s=(1 / problem.high, 1 / problem.low),
        frequency=frequency,
        power=power,
        pole_map=(turns.poles.numpy(), np.array(turns.misfits())),
        connected=problem.rows.passes == 1 or (best.possible == 1 and not best.apart),
        decided=decided,
        verdict=words,
        recording=recording,
        warnings=tuple(dict.fromkeys(warnings)),
        loose=answer.loose,
    )


def _tumbles(problem: Problem, turns: Turns, course: Course) -> tuple[list[Tumble], list[str]]:
    """Free rotations that explain the light better than the best turn about an axis, where that leaves structure, and what there is
    to say of them."""
    best = turns.best[0]
    if not problem.scene.attitude.tumbles and not turns.leaves_structure:
        return [], []
    if _changed(problem.rows, best):
        least, most = (1 / float(frequency) for frequency in (best.frequencies.max(), best.frequencies.min()))
        return [], [
            f"the passes have turns of {least:.5g} to {most:.5g} s: no one free rotation holds over them, and none was looked for; "
            "search one pass to look for it"
        ]
    if not course.allowed("free rotations"):
        return [], []
    tumbles = course.kept.of(
        "free",
        Tumble,
        lambda: free_rotations(
            problem.rows, problem.body, problem.low, problem.high, turns.dof, best.chi2, course.say
        ),
    )
    sentences = [] if tumbles else ["no pair of frequencies of a free rotation explains the light"]
    return [tumble for tumble in tumbles if tumble.chi2 < best.chi2 - CHANGED], sentences


def _changed(rows: Rows, best: Local) -> bool:
    """Whether passes are so far apart that their periods may differ by UNLIKE, and those of the best turn do: free of torques the
    frequencies of a body are the same in every pass."""
    return pole_grid.DRIFT_SD * float(rows.drift.max()) > UNLIKE and not alike(best)


def _fits(
    problem: Problem, turns: Turns, tumbles: Sequence[Tumble], course: Course
) -> tuple[list[Candidate], list[str]]:
    """The model fitted to the free rotations and, where none of these explains the light, to turns about one axis, and what there is
    to say."""
    course.say("model", 0.0)
    fits: list[Candidate] = []
    sentences: list[str] = []
    for tumble in tumbles:
        if not any_finite(fits) or course.allowed(FITS):
            trial = tumbling_trial(problem.scene, problem.recording, problem.rows, tumble)
            fits.append(fitted(trial, problem.recording))
    if not any(_explains(problem, fit) for fit in fits):
        steady, sentences = fits_of_turns(problem, turns, course)
        fits += steady
    return [fit for fit in fits if math.isfinite(fit.chi2)], sentences


def _explains(problem: Problem, fit: Candidate) -> bool:
    """Whether a fit leaves little enough that no other kind of rotation is asked for. Errors that are fitted bring chi-square to
    the count of rows whatever is left, so there the rms is held against the noise of successive rows."""
    noise = problem.noise_mag
    return fit.chi2 <= 2 * len(problem.rows.flux) if noise is None else fit.rms <= NOISY * noise


def _nothing_found(problem: Problem, allowed: Allowed) -> InputError:
    return InputError(
        problem.recording.source,
        None,
        f"no rotation of {1 / problem.high:.6g} to {1 / problem.low:.6g} s a turn that joins the passes and that the model can fit",
        f"a wider range of periods ({option('shortest')}, {option('longest')}), or passes nearer to each other"
        + (f", or a longer {option('budget')}" if allowed.omitted else ""),
    )


def _dof(problem: Problem, answer: Settled) -> int:
    return len(problem.rows.flux) - len(answer.modes[0].theta)


def _verdict(problem: Problem, turns: Turns, answer: Settled, allowed: Allowed) -> tuple[bool, str]:
    """Whether one mode is left, and in words; nothing is decided where the budget left a stage out, or where the multiple hangs on
    the paint."""
    dof = _dof(problem, answer)
    seconds = problem.rows.seconds
    decided, words = verdict(
        answer.modes,
        dof,
        problem.rows.passes,
        problem.longest_pass_s,
        problem.noise_mag,
        all_s=float(seconds.max() - seconds.min()),
    )
    other = None if answer.modes[0].tumbling else turns.other_turn(answer.modes[0].period_s)
    if decided and other is not None:
        decided = False
        words = (
            f"cannot tell: {words} with the paint of the scene, in {other:.6g} s with sides that shine unlike"
        )
    return (False, allowed.told(words)) if allowed.omitted else (decided, words)
