"""What candidates promise beside a fit, by their signatures, and which of them are worth a refit, or judged by their linear form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchlc.diagnosis.fits import REACH, Fits
from torchlc.diagnosis.hypotheses import FEW_EFFECTS, Hypothesis
from torchlc.diagnosis.probes import (
    Probe,
    least_seconds,
    many_lights,
    probe,
    rescored,
    seconds_a_geometry,
    turns,
)
from torchlc.inference.density import Fitted, Linear, Posterior
from torchlc.inference.posterior import FIRST_STEPS, LONGEST, fit
from torchlc.stages.entry import Entry
from torchlc.tensors.work import Work

NEAR = 6.0
"""Log odds below the leader within which evidence is integrated, and a set told under every noise: one in 400."""
LINEAR_NEAR = 3.0
"""Log odds below the leader within which the linear form of a set of effects is not the last word on it: one in twenty."""
LEAST_SCORE = 6.0
"""Twice what a signature has to promise in log density, that an effect is added to a set for it: probed values lie apart, and
the best may reach half as much again, the 9 below which an effect counts as not seen."""
DEAR_STEPS = 24
"""Steps of a refit, each of which takes one geometry and one more for every number that is fitted."""
PROBING_S = 10.0
"""CPU seconds of the geometries of all probes beside one set of effects, of which each takes some hundredths where they are not dear."""
SLOW_FIT_S = 0.5
"""CPU seconds of a refit beside a clean leader beyond which its linear form, which takes some tenths, is asked first."""
LONG_FIT_S = 30.0
"""CPU seconds of a refit beside a leader that leaves nothing beyond which it is made only of what its linear form puts first: there is
nothing more to describe, and a dozen candidates that come near by chance would take a quarter of an hour."""
COUNTED = 8
"""Starts on which it is counted what all of them take."""
DEAR_FIT_S = 2.0
"""CPU seconds of a refit beyond which it is made only of what its linear form says is within reach; and of a probe, beyond which that of
the first round serves for all sets."""


@dataclass
class Promises(Fits):
    """Fits, with the probes of candidates, what was judged by these alone, and why others were not examined."""

    probes: dict[str, Probe] = field(default_factory=dict)
    """Of the first round, beside the scene's own model."""
    latest: dict[str, tuple[Probe, Fitted]] = field(default_factory=dict)
    """The last probe of each that was made and not only held against another fit, with what it was made beside."""
    whole: dict[str, tuple[Probe, Fitted]] = field(default_factory=dict)
    """The same of the first, which tried all values."""
    unexamined: dict[str, str] = field(default_factory=dict)
    """Why, by entry, a candidate was not refitted."""
    linear: dict[Hypothesis, float] = field(default_factory=dict)
    """Log odds of what was judged by its linear form alone."""
    invisible: set[str] = field(default_factory=set)
    """Candidates that would leave no trace in these data, whatever their numbers."""
    settled: bool = False
    """Whether the foremost was clean, with errors as quoted, when sets were last grown."""

    def probe_all(
        self, at: Fitted, entries: Sequence[str], share: float = 0.8, anew: bool = True
    ) -> dict[str, Probe]:
        """Probes of candidates beside a fit, as long as less than a share of the budget is spent: first those that leave the geometry as
        it is, and last those of light from many directions. Those that take long are made once, beside the scene's own model. Others are made ``anew``, what the last probe promises
        most first, as long as all together take PROBING_S; those of dear geometries otherwise are held against this fit as they were
        made last."""
        held = {entry: rescored(*self.latest[entry], at) for entry in entries if entry in self.latest}
        alone = {entry: self.posterior(Hypothesis((entry,), self.robust)) for entry in entries}

        def place(entry: str) -> tuple[bool, float, bool, bool]:
            promised = held[entry].score if entry in held else 0.0
            return entry in held, -promised, many_lights(entry), turns(alone[entry], entry)

        probes = {}
        spent = 0.0
        for entry in sorted(entries, key=place):
            if not self.clock.left(share):
                break
            if entry in held and (
                spent > PROBING_S or (not anew and (at.posterior.dear or alone[entry].dear))
            ):
                probes[entry] = held[entry]
                continue
            hypothesis = at.hypothesis.with_effect(entry)
            posterior = self.posterior(hypothesis)
            as_last = entry in held and not anew and posterior.dear
            cost = 0.0 if as_last else least_seconds(posterior, entry)
            if entry in held and (as_last or cost > DEAR_FIT_S):
                probes[entry] = held[entry]
            elif self.clock.affords(cost):
                seed = hypothesis.seed + self.seed
                known = rescored(*self.whole[entry], at) if entry in self.whole else None
                probes[entry] = probe(self.bench, at, posterior, entry, seed, known)
                spent += max(cost, len(probes[entry].psi) * seconds_a_geometry(posterior, entry))
                self.latest[entry] = probes[entry], at
                self.whole.setdefault(entry, self.latest[entry])
            else:
                self.unexamined[entry] = (
                    f"{cost:.0f} s of light worked out anew before anything is known of it"
                )
            posterior.model.forget()
        return probes

    def within_reach(self, entry: str, at: Fitted, probed: Probe) -> bool:
        """Whether an effect beside a fit could come near the best set of as many if it gained LONGEST times what its probe promises; if not, its
        linear form, which is kept, is all that is asked of it. Effects that have no value to try, or of which probes do not tell, are always asked."""
        if not len(probed.scores) or not probed.psi.shape[-1] or self.counted(entry):
            return True
        if not self.promises_hold(at):
            return True
        hypothesis = at.hypothesis.with_effect(entry)
        without = at.log_z + self.bench.log_odds(hypothesis)
        # larger sets are ahead of many that come to them by further effects
        alike = [
            other
            for other in self.visited
            if other.noise == self.robust and len(other.added) <= len(hypothesis.added)
        ]
        if without + LONGEST * 0.5 * probed.score > max(map(self.log_odds, alike)) - NEAR:
            return True
        self.linear[hypothesis] = without + 0.5 * probed.score
        return False

    def promises_hold(self, at: Fitted) -> bool:
        """Whether probes beside a fit bound what its candidates may gain: the best set of one effect more gained at most LONGEST times what the
        probe of this effect promised. Where a lobe has gone from the materials for want of an effect, a probe sees nothing of what would bring it back."""
        added = set(at.hypothesis.added)
        more = [
            larger
            for larger in self.of_size(len(added) + 1)
            if larger.law == at.hypothesis.law and added < set(larger.added)
        ]
        if not more:
            return True
        (entry,) = set(more[0].added) - added
        known, beside = self.latest.get(entry, (None, None))
        if known is None or beside is None or beside.hypothesis != at.hypothesis or not len(known.scores):
            return True
        return self.visited[more[0]].log_z - at.log_z <= LONGEST * 0.5 * known.score

    def affordable(self, entry: str, at: Fitted, probed: Probe) -> bool:
        """Whether an effect is refitted. One whose geometry is dear, or slow beside a clean leader, is judged by its linear form, which is
        kept, and refitted only if that could be the answer and there is time. Linear forms are good to LINEAR_NEAR where little is left
        to be gained, and far too low where much is."""
        hypothesis = at.hypothesis.with_effect(entry)
        posterior = self.posterior(hypothesis)
        settled = self.settled and self.promises_hold(at)
        cost = refit_seconds(posterior, posterior.geometry_seconds if settled else posterior.seconds_each)
        near = LINEAR_NEAR if settled else NEAR
        if cost < (SLOW_FIT_S if settled else DEAR_FIT_S):
            return True
        if Entry.parse(entry).per is not None:
            promised = at.log_z + self.bench.log_odds(hypothesis) + 0.5 * probed.together
            if promised < self.mark - NEAR:
                return False
            if self.clock.affords(cost):
                return True
            self.unexamined[entry] = (
                f"{cost:.0f} s of light worked out anew; its parts together promise enough"
            )
            return False
        if not len(probed.scores):
            return False
        line = Linear(at, probed.best_change(at)[:, None])
        start = torch.cat([at.g, at.g.new_tensor([probed.best_size(at)])])
        with torch.no_grad():
            linear = fit(at.hypothesis, line, start[None], turns=1)
        self.linear[hypothesis] = linear.laplace + self.bench.log_odds(hypothesis)
        if settled:
            self.linear[hypothesis] -= 0.5 * (probed.score - probed.worth)
        if self.linear[hypothesis] < self.mark - near:
            return False
        if settled and cost > LONG_FIT_S and self.linear[hypothesis] < self.mark:
            self.unexamined[entry] = (
                f"{cost:.0f} s of light worked out anew; its linear form is near, but behind what leaves nothing"
            )
            return False
        if self.clock.affords(cost):
            return True
        self.unexamined[entry] = (
            f"{cost:.0f} s of light worked out anew; its linear form is within reach of the answer"
        )
        return False

    def seconds_of(self, entry: str) -> float:
        """CPU seconds that a candidate's probe or refit takes where it moves the geometry of a large mesh, whichever is more; 0 of
        others."""
        hypothesis = Hypothesis((entry,)).under(*self.robust)
        if not self.bench.likelihood(hypothesis).model.unaffordable:
            return 0.0
        posterior = self.posterior(hypothesis)
        return max(least_seconds(posterior, entry), refit_seconds(posterior))

    def least_score(self, stem: Hypothesis, entry: str) -> float:
        """What a signature has to promise that an effect is added to a set: LEAST_SCORE, and beyond FEW_EFFECTS, where each has to gain
        REACH beyond its prior odds, two thirds of that."""
        if len(stem.added) < FEW_EFFECTS:
            return LEAST_SCORE
        cost = self.bench.log_odds(stem) - self.bench.log_odds(stem.with_effect(entry))
        return 2 * (REACH + cost) / 1.5


def refit_seconds(posterior: Posterior, each: float | None = None) -> float:
    """CPU seconds of a refit: its geometries of ``each`` seconds, of which those of numbers that share no row are one."""
    colours = posterior.colours()
    slopes = len(posterior.physical) if colours is None else len(colours.groups)
    return (posterior.seconds_each if each is None else each) * (1 + slopes) * DEAR_STEPS


def first_steps_seconds(posterior: Posterior, starts: Tensor) -> float:
    """CPU seconds of the first steps from natural values (S, P), counted on COUNTED of them: light between facets takes a hundred times as
    long as that of the Sun alone, wherever the geometry is known."""
    g = posterior.coordinates(starts[:COUNTED])
    with torch.no_grad():
        posterior.residuals(g[:1])  # what all have in common is made here
        with Work() as counted:
            posterior.residuals(g)
    return counted.seconds * len(starts) / len(g) * FIRST_STEPS * (1 + len(posterior.physical))
