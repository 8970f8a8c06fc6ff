"""Sets of effects that grow, shrink and exchange their members."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

from torchlc.diagnosis.fits import BEAM, REACH, sorted_as
from torchlc.diagnosis.hypotheses import FEW_EFFECTS, Hypothesis
from torchlc.diagnosis.probes import Probe, rescored
from torchlc.diagnosis.promises import DEAR_FIT_S, refit_seconds
from torchlc.diagnosis.standing import Standing
from torchlc.inference.density import Fitted
from torchlc.stages.entry import Entry

GROWN = 8
"""Effects that the best set of a size grows by, half as many for the others."""
JOINT = 4
"""Sets of two, and of FEW_EFFECTS, that are fitted for what their probes promise together: half a second each."""
MANY = 3
"""Numbers of an effect, from which on it may sit in several places."""


@dataclass(frozen=True)
class Step:
    """An effect ``entry`` added to a set, with its probe and the log odds that this promises."""

    stem: Hypothesis
    entry: str
    probe: Probe
    odds: float

    @property
    def key(self) -> frozenset[str]:
        """The same for sets that come to one by different ways."""
        return frozenset((self.stem.law, *self.stem.plain, self.entry))


@dataclass
class Growth(Standing):
    """How sets come from others."""

    grown: set[frozenset[str]] = field(default_factory=set)
    """Steps that were taken."""
    begun_beside: set[tuple[Hypothesis, str]] = field(default_factory=set)
    """Sets beside which an effect was begun anew."""

    def sets(self, entries: Sequence[str], left: Callable[[Fitted], float]) -> None:
        """Sets of effects, as long as they gain: grown from the leaders, then without each of their members, and with each
        exchanged; beyond FEW_EFFECTS of the first leader alone, as long as each further effect gains REACH. A leader that is :meth:`clean` is only
        asked for what may hide beside it, and others for what lifts them above it; where it has another law than the scene, the best under the scene's own grows beside it;
        where something unknown alone is far ahead of all leaders, only the first of them grows; and none does that would stay
        behind if FEW_EFFECTS more gained as much each as the last one."""
        for size in itertools.count(1):
            sized = self.of_size(size)
            if not sized or self.ahead_of_foremost > REACH + FEW_EFFECTS * self.last_gain(size):
                break
            clean = self.clean(left)
            self.settled = clean and self.as_quoted
            if clean and len(self.foremost.added) < size:
                break
            beyond = size >= FEW_EFFECTS
            stems = sized[: 1 if clean or beyond or self.stranger_leads else BEAM]
            if stems[0].law:  # beside the wrong law others lead
                stems += [hypothesis for hypothesis in sized if not hypothesis.law][:1]
            first, *others = dict.fromkeys(stems)  # the last may be among them already
            # probes beside others take as long as those beside a leader that is far ahead of them
            for group in ([first, *others],) if self.behind(sized) else ([first], others):
                steps: list[Step] = []
                for stem in group:
                    most = GROWN if stem == first else GROWN // 2
                    steps += self.promising(stem, entries, most, anew=stem == first)
                if self.take(steps, None if clean else left):
                    break
            if self.settled:
                # what probes promise beside fits that are far apart does not compare
                for stems in (self.behind(sized), *([hypothesis] for hypothesis in self.shorter())):
                    self.overtake(stems, entries)
            best = self.ranked(hypothesis for hypothesis in self.visited if len(hypothesis.added) == size + 1)
            if not best:
                break
            gained = self.log_odds(best[0]) - self.log_odds(sized[0])
            if gained > (REACH if beyond else -REACH):
                if not self.clean(left):
                    self.exchange(best[0], entries)
                self.rivals_anew(size + 1)
            best = self.ranked(hypothesis for hypothesis in self.visited if len(hypothesis.added) == size + 1)
            gained = self.log_odds(best[0]) - self.log_odds(sized[0])
            if gained <= (REACH if size + 1 >= FEW_EFFECTS else 0.0):
                break
            self.clock.tell(self.state(), 0.5 + 0.2 * min(size, FEW_EFFECTS - 1))
        self.of_fewer_numbers(entries)

    def promising(self, stem: Hypothesis, entries: Sequence[str], most: int, anew: bool) -> list[Step]:
        """The ``most`` effects that promise the most evidence beside a set; where probes take long, they are made ``anew`` or held against what the set
        leaves."""
        at = self.visited[stem]
        seen = [entry for entry in entries if entry not in self.invisible]
        possible = [
            entry
            for entry in seen
            if self.bench.compatible(stem, entry) and self.bench.carries(stem.with_effect(entry))
        ]
        probes = self.probe_all(at, possible, anew=anew)
        steps = [
            self.step(stem, entry, probe)
            for entry, probe in probes.items()
            if probe.score > self.least_score(stem, entry) or not probe.psi.shape[-1]
        ]
        fresh = [step for step in steps if step.key not in self.grown]
        return sorted(fresh, key=lambda step: -step.probe.worth)[:most]

    def step(self, stem: Hypothesis, entry: str, probe: Probe) -> Step:
        """An effect added to a set, with the log odds that its probe promises."""
        odds = self.visited[stem].log_z + self.bench.log_odds(stem.with_effect(entry)) + 0.5 * probe.worth
        return Step(stem, entry, probe, odds)

    def take(self, steps: Iterable[Step], left: Callable[[Fitted], float] | None = None) -> bool:
        """What promises the highest odds first, whichever set it grows: what is refitted early spares what falls behind it. With ``left``, until
        the foremost is clean, and returns whether it is: what may overtake it is asked next."""
        for step in sorted(steps, key=lambda step: -step.odds):
            at = self.visited[step.stem]
            if step.key in self.grown or not self.clock.left(0.8):
                continue
            if self.within_reach(step.entry, at, step.probe) and self.affordable(step.entry, at, step.probe):
                self.grown.add(step.key)
                foremost = self.foremost
                self.extend(at, step.entry, step.probe)
                if left is not None and self.foremost != foremost and self.as_quoted and self.clean(left):
                    return True
        return False

    def exchange(self, whole: Hypothesis, entries: Sequence[str]) -> None:
        """A set without each of its effects, and with another in the place of each."""
        at = self.visited[whole]
        for entry in whole.added:
            fewer = self.less(at, entry)
            quick = refit_seconds(self.posterior(fewer)) < DEAR_FIT_S
            if quick and self.clock.left(0.8):
                self.shrunk(at, entry)
            if fewer in self.visited and self.clock.left(0.8):
                self.take(self.promising(fewer, entries, GROWN // 2, anew=False))

    def rivals_anew(self, size: int) -> None:
        """The best sets of a size once more with each of their effects of MANY numbers begun anew beside the others: alone, or beside what was
        exchanged, it took their light for its own."""
        sized = self.of_size(size)
        for whole in [
            hypothesis for hypothesis in sized if self.log_odds(hypothesis) > self.log_odds(sized[0]) - REACH
        ][:BEAM]:
            for entry in whole.added:
                fewer = self.less(self.visited[whole], entry)
                quick = refit_seconds(self.posterior(fewer)) < DEAR_FIT_S and self.clock.left(0.8)
                if not quick or self.numbers(Hypothesis((entry,))) < MANY:
                    continue
                if fewer not in self.visited:
                    self.shrunk(self.visited[whole], entry)
                self.begun_anew(fewer, entry)

    def begun_anew(self, fewer: Hypothesis, entry: str) -> None:
        """A set from probes of one of its effects beside the others, once."""
        if (fewer, entry) in self.begun_beside:
            return
        self.begun_beside.add((fewer, entry))
        beside = self.visited[fewer]
        probes = self.probe_all(beside, [entry])
        if entry in probes and self.affordable(entry, beside, probes[entry]):
            self.extend(beside, entry, probes[entry])

    def behind(self, sized: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Sets within reach of the foremost, of those that are ranked, but the first."""
        return [hypothesis for hypothesis in sized[1:] if self.log_odds(hypothesis) > self.mark - REACH]

    def shorter(self) -> list[Hypothesis]:
        """The foremost without each of its effects, where it has several, fitted from its numbers."""
        at = self.visited[self.foremost]
        hypotheses = []
        for entry in at.hypothesis.added if len(at.hypothesis.added) > 1 else ():
            fewer = self.less(at, entry)
            if refit_seconds(self.posterior(fewer)) < DEAR_FIT_S and self.clock.left(0.8):
                self.shrunk(at, entry)
            if fewer in self.visited:
                hypotheses.append(fewer)
        return hypotheses

    def of_fewer_numbers(self, entries: Sequence[str]) -> None:
        """Sets in the place of a leader of many numbers, which bends to what several effects of few numbers do: the best of those of at
        most half as many grows by others, as long as that gains and the set has no more numbers than the leader."""
        leading = self.foremost
        most = self.numbers(leading)
        if most < 2:  # one number bends to one thing
            return
        few = [
            entry
            for entry in entries
            if 2 * self.numbers(Hypothesis((entry,))) <= most
            and Entry.parse(entry).plain not in leading.plain
        ]
        possible = {Entry.parse(entry).plain for entry in few}

        def best(stem: Hypothesis) -> Hypothesis | None:
            more = (
                hypothesis
                for hypothesis in self.ranked()
                if (hypothesis.noise, hypothesis.law) == (leading.noise, leading.law)
                and set(stem.plain) < set(hypothesis.plain) <= possible
                and len(hypothesis.added) == len(stem.added) + 1
            )
            return next(more, None)

        stem = best(replace(leading, added=()))
        while stem is not None and self.numbers(stem) < most and self.clock.left(0.8):
            self.take(self.promising(stem, few, GROWN // 2, anew=False))
            more = best(stem)
            if more is None or not self.ahead(more, stem):
                break
            stem = more
        if stem is not None and len(stem.added) > 1 and self.log_odds(stem) > self.mark - REACH:
            self.exchange(stem, few)

    def overtake(self, stems: Sequence[Hypothesis], entries: Sequence[str]) -> None:
        """What may lift a set that is behind a clean leader above it: those of one of these and one effect more that promise most, from
        probes as they were made last."""
        steps: list[Step] = []
        for stem in stems:
            at = self.visited[stem]
            for entry in entries:
                if entry not in self.latest or not self.bench.compatible(stem, entry):
                    continue
                more = stem.with_effect(entry)
                known = sorted_as(self.visited, more) in self.visited
                probe = rescored(*self.latest[entry], at)
                if known or not probe.visible or not self.bench.carries(more):
                    continue
                if self.within_reach(entry, at, probe):
                    steps.append(self.step(stem, entry, probe))
        self.take(sorted(steps, key=lambda step: -step.odds)[:JOINT])
