"""The model fitted to turns about one axis, at the counts of turns between passes that may be right, and what those that are as
possible leave open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchlc.inference.rotation.connect import Connection, Connections, connections, differences
from torchlc.inference.rotation.course import Course
from torchlc.inference.rotation.fixed_axis import Turns
from torchlc.inference.rotation.model_fit import Candidate, fitted
from torchlc.inference.rotation.modes import KEPT_CHI2
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.problem import Problem
from torchlc.inference.rotation.refine import Local
from torchlc.inference.rotation.trials import Count, Trial, epoch_seconds, steady_trial
from torchlc.scene import Free

FITS = "fits of the model to the less likely"
LOCALS, JOINED = 4, 3
"""Solutions of different poles, and counts of turns of the best, that the model is fitted to."""
LIKELY = 12
"""Counts of turns that are told of a mode, if its phases leave several."""
UNSTEADY = 150.0
"""Squared distance, in standard deviations, of the phases from any steady spin beyond which the model is not tried on one."""


def fits_of_turns(
    problem: Problem, turns: Turns, course: Course, *, changing: bool = False
) -> tuple[list[Candidate], list[str]]:
    """The model fitted at the best turns and the counts between passes that may be right, and what there is to say. ``changing``: a
    change of the period is tried even where a steady turn explains the light."""
    always = changing or isinstance(problem.scene.attitude.period_rate, Free)
    trials = [trial for kind in turns.kinds for trial in _trials(problem, kind)]
    sentences: list[str] = []
    if not trials:
        sentences.append(
            "no count of turns between the passes joins their phases to one rotation within its bounds"
        )
    fits: list[Candidate] = []
    for number, trial in enumerate(trials):
        if trial.changing and not always and fits and not _wanting(fits, problem.rows):
            continue
        if any_finite(fits) and not course.allowed(FITS):
            break
        fits.append(fitted(trial, problem.recording))
        course.say("model", (number + 1) / len(trials))
    if fits and not fits[0].trial.complete:
        sentences.append(
            "the passes are too far apart for their phases to be connected: the counts of turns between them that are "
            "told are some of many"
        )
    return fits, sentences


def any_finite(found: Sequence[Candidate]) -> bool:
    """Whether a fit has a chi-square; one whose light is nowhere has none."""
    return any(math.isfinite(fit.chi2) for fit in found)


def period_at(one: Connection, seconds: float) -> float:
    """Period, s, at a time in seconds of the rows."""
    return 1 / one.at(seconds)[1]


@dataclass(frozen=True)
class _Ways:
    """Ways to join the passes of one solution: ``joined``, and ``changes``, those with a change of the period, None of one pass.
    ``epoch`` is that of the scene, in seconds of the rows."""

    joined: Connections
    changes: Connections | None
    symmetry: int
    epoch: float

    @property
    def near(self) -> list[Connection]:
        """Those about as possible as the best."""
        return _about_as_possible(self.joined)

    def spread(self, connection: Connection) -> dict[str, float]:
        """What the other ways leave open of the period and of its rate, of a trial of ``connection``. Where the period is taken as steady,
        the rate that would not show is that of all counts with one."""
        near = self.near
        spread: dict[str, float] = {}
        if len(near) > 1:
            periods = np.array([period_at(other, self.epoch) for other in near]) / 3600
            off = periods - period_at(connection, self.epoch) / 3600
            spread["period"] = float(np.sqrt(_chances(near) @ off**2))
        if self.changes is not None and self.changes.found:
            most = _about_as_possible(self.changes)
            rates = np.array([other.rate for other in most])
            spread["period_rate"] = float(np.sqrt(_chances(most) @ (rates - connection.rate) ** 2))
        return spread

    def likely(self, connection: Connection) -> tuple[Count, ...]:
        """The counts that are as possible, from those of ``connection``; none where there is only it."""
        near = self.near
        if len(near) < 2:
            return ()
        base = np.array(differences(connection.counts, self.symmetry))
        return tuple(
            Count(
                tuple((np.array(differences(other.counts, self.symmetry)) - base).tolist()),
                float(chance),
                period_at(other, self.epoch),
                other.rate,
            )
            for other, chance in list(zip(near, _chances(near), strict=True))[:LIKELY]
        )

    def left_open(self, trial: Trial, connection: Connection) -> Trial:
        """A trial of ``connection`` with what the other ways leave open."""
        near = self.near
        return replace(
            trial,
            possible=max(1, len(near)),
            complete=self.joined.complete or len(near) < len(self.joined.found),
            spread=self.spread(connection),
            likely=self.likely(connection),
        )


def _trials(problem: Problem, turns: Turns) -> list[Trial]:
    """What to fit at the leading solutions: for each first steady turns, then with a period that changes, where it may."""
    scene, recording, rows = problem.scene, problem.recording, problem.rows
    may_change = isinstance(scene.attitude.period_rate, Free) or rows.passes > 2
    epoch = epoch_seconds(scene, recording)[1]
    trials: list[Trial] = []
    for number, local in enumerate(turns.leading(LOCALS)):
        changes = _joined(problem, turns, local, changing=True) if rows.passes > 1 else None
        for drifts in (False, True) if may_change else (False,):
            joined = changes if drifts and changes else _joined(problem, turns, local, changing=False)
            if not drifts and joined.found and joined.found[0].distance > UNSTEADY:
                continue  # no steady spin has these phases
            ways = _Ways(joined, changes, turns.symmetry, epoch)
            # of counts that are some of many, one fit tells what any leaves
            tried = JOINED if number == 0 and joined.complete else 1
            for connection in ways.near[:tried]:
                trial = steady_trial(
                    scene,
                    recording,
                    rows,
                    local,
                    connection,
                    turns.symmetry,
                    changing=drifts,
                    tilted=turns.tilted,
                )
                trials.append(ways.left_open(trial, connection))
    return trials


def _joined(problem: Problem, turns: Turns, local: Local, *, changing: bool) -> Connections:
    return connections(problem.rows, local, turns.symmetry, changing=changing, bounds=problem.wide)


def _about_as_possible(ways: Connections) -> list[Connection]:
    return [
        connection for connection in ways.found if connection.distance < ways.found[0].distance + KEPT_CHI2
    ]


def _chances(near: Sequence[Connection]) -> np.ndarray:
    """Probabilities of counts of turns by the distances of their phases."""
    weight = np.exp(-0.5 * (np.array([connection.distance for connection in near]) - near[0].distance))
    return weight / weight.sum()


def _wanting(fits: Sequence[Candidate], rows: Rows) -> bool:
    """Whether steady spin leaves more than the errors allow: chi-square beyond 3 of its standard deviations."""
    least = min((fit.chi2 for fit in fits if not fit.trial.changing), default=math.inf)
    count = len(rows.flux)
    return least > count + 3 * math.sqrt(2 * count)
