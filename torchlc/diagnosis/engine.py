"""The search: what may be missing is fitted, and what can matter is integrated, as long as there is time.

Signatures rank the candidates; each is then refitted from what its signature says; the leaders' materials are tried under
every other; sets of effects grow, shrink and swap; and whatever comes within reach of the leader is told apart under
every way to err, with its evidence. Nothing is decided here: the odds of all that was visited are
:mod:`torchlc.diagnosis.probabilities`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from torchlc.diagnosis.alternatives import NOMINAL
from torchlc.diagnosis.discrepancy import FAR, Discrepancy, discrepancies
from torchlc.diagnosis.fits import BEAM, REACH, STARTS, sorted_as
from torchlc.diagnosis.hypotheses import FEW_EFFECTS, Hypothesis, carried, effect_columns
from torchlc.diagnosis.joint import joint_sets
from torchlc.diagnosis.probes import Probe, rescored
from torchlc.diagnosis.promises import DEAR_FIT_S, NEAR, Promises, refit_seconds
from torchlc.effects import effect_class
from torchlc.inference.density import SCALE_SIGMA, Fitted
from torchlc.inference.posterior import MOST_MINIMA, UNLIKE, likeliest, material_starts
from torchlc.stages.entry import Entry

LAW_STARTS = 48
"""Draws of the materials under another law, of whose lobes the scene says nothing: four times STARTS."""
CLEAN_P = 0.05
"""p-value of what a set leaves above which its rivals are not grown."""
BETTER = 0.5
"""Log evidence by which a minimum has to be better that what was asked beside the one before is asked anew."""
GROWN = 8
"""Effects that the best set of a size grows by, half as many for the others."""
JOINT = 4
"""Sets of two, and of FEW_EFFECTS, that are fitted for what their probes promise together: half a second each."""
MANY = 3
"""Numbers of an effect, from which on it may sit in several places."""
MOST_LOOKED = 6
DRAWS = 500
RIVALS_SHARE = 2
"""What the draws of a rival's evidence are divided by: those of the leader are the table of the materials as well."""


def near_quoted(at: Fitted) -> bool:
    """Whether the errors that a fit leaves are within twice what is believed of those quoted, a row counted as FAR off at most:
    larger ones, or many bad rows, leave nothing to be seen either."""
    squares = (at.delta / at.quoted).square().clamp(max=FAR**2)
    return float(squares.mean()) < math.exp(2 * SCALE_SIGMA) ** 2


@dataclass
class Search(Promises):
    """The rounds of a search: the probes of candidates, what is fitted because of them, what was left out and why."""

    odd: list[Discrepancy] = field(default_factory=list)
    begun_afresh: set[Hypothesis] = field(default_factory=set)
    """Sets of effects that were fitted from materials of their own."""
    begun_beside: set[tuple[Hypothesis, str]] = field(default_factory=set)
    """Sets beside which an effect was begun anew."""

    def singles(self, entries: Sequence[str], left: Callable[[Fitted], float]) -> None:
        """Every candidate alone, first those that are fitted fast, by what their signatures promise, most first: a budget then ends among
        those that promise least, and they set the mark that slow ones have to come near. Then all from the leaders' materials."""
        at = self.best()
        at = self.visited[at.hypothesis.under(*self.robust)]
        self.probes = self.probe_all(at, entries, 0.4)  # refits of these go on until 0.6
        self.settled = self.clean(left) and self.as_quoted
        slow = {
            entry: refit_seconds(self.posterior(at.hypothesis.with_effect(entry))) >= DEAR_FIT_S
            for entry in self.probes
        }
        order = sorted(self.probes, key=lambda entry: (slow[entry], -self.probes[entry].score))
        # beside materials that are wrong for want of the effect, which a probe holds, the true one may promise an eighth of its gain
        first = sorted(self.probes, key=lambda entry: -self.probes[entry].score)[:GROWN]
        for number, entry in enumerate(order):
            if not self.clock.left(0.6):
                break
            one = self.probes[entry]
            if not one.visible:
                self.invisible.add(entry)
                continue
            asked = entry in first or self.within_reach(entry, at, one)
            if asked and self.affordable(entry, at, one):
                self.extend(at, entry, one)
            self.clock.tell(self.state(), 0.1 + 0.4 * number / max(len(order), 1))
        self.shared_materials()

    def jointly(self, clean: bool) -> None:
        """Sets of two and of FEW_EFFECTS by what their probes promise together: what one effect alone would be blamed for may be several
        that each take little of it. Beside a ``clean`` leader those without its effects: what hides beside these is asked of it. Where its errors
        are as quoted, none of more numbers than it has: there is nothing more to describe."""
        most = self.numbers(self.foremost) if clean and self.as_quoted else math.inf
        at = self.visited[Hypothesis().under(*self.robust)]
        quick = {
            entry: one
            for entry, one in self.probes.items()
            if one.visible
            and len(one.scores)
            and not (clean and Entry.parse(entry).plain in self.foremost.plain)
            and refit_seconds(self.posterior(at.hypothesis.with_effect(entry))) < DEAR_FIT_S
        }
        numbers = {entry: self.numbers(Hypothesis((entry,))) for entry in quick}

        def log_odds(entries: Sequence[str]) -> float:
            if sum(numbers[entry] for entry in entries) > most:
                return -math.inf
            together = Hypothesis()
            for entry in entries:
                if not self.bench.compatible(together, entry):
                    return -math.inf
                together = together.with_effect(entry)
            return self.bench.log_odds(together)

        for size in (2, FEW_EFFECTS):
            # threes with one that has no number are grown to: begun together they led, and left a fourth unseen
            among = {entry: one for entry, one in quick.items() if size == 2 or one.psi.shape[-1]}
            for chosen in joint_sets(among, at, size, log_odds, JOINT):
                if not self.clock.left(0.7) or self.exactly(*chosen):
                    continue
                hypothesis = Hypothesis(tuple(chosen), self.robust)
                if refit_seconds(self.posterior(hypothesis)) >= DEAR_FIT_S:
                    continue  # dear together, though each of them alone is not
                parameters = self.posterior(hypothesis).model.parameter_set
                theta = carried(parameters, at.theta[None], at.names)
                for entry, psi in chosen.items():
                    theta[:, effect_columns(parameters, entry)] = psi
                self.refit(hypothesis, theta, at, turns=1, most=1)

    def tell_unexamined(self) -> None:
        """Candidates that were not refitted, nor judged by their linear form, nor without a trace here."""
        judged = {one.plain for one in (*self.visited, *self.linear)}
        for entry in self.bench.entries:
            if (entry,) not in judged and entry not in self.invisible:
                self.unexamined.setdefault(entry, "there was no time")

    def shared_materials(self) -> None:
        """The best hypotheses of the first round, and the scene's own model, from the materials of the leaders: what an effect
        is blamed for may sit in the materials."""
        first = [
            one for one in self.ranked() if len(one.added) <= 1 and one.noise == self.robust and not one.law
        ]
        leaders = [self.visited[one] for one in first[:2]]
        for one in dict.fromkeys((*first[:GROWN], Hypothesis().under(*self.robust))):
            at = self.visited[one]
            if not self.clock.left(0.7) or at.posterior.dear or not at.posterior.physical:
                continue
            parameters = at.model.parameter_set
            materials = [k for k, free in enumerate(parameters.free) if free.origin.role == "materials"]
            known = [other.g[materials] for other in at.minima]
            starts = []
            for leader in leaders:
                theta = carried(parameters, leader.theta[None], leader.names)
                columns = [c for entry in one.added for c in effect_columns(parameters, entry)]
                theta[:, columns] = at.theta[columns]
                g = at.posterior.coordinates(theta)[0, materials]
                if materials and all(float((g - other).abs().max()) > UNLIKE for other in known):
                    known.append(g)
                    starts.append(theta)
            if starts:
                self.refit(one, torch.cat(starts), at, turns=1, most=1)

    def afresh(self) -> None:
        """The leading sets of effects once more from materials drawn from their priors: where the scene's own model came to a
        wrong minimum of the materials, for want of the effect, all that grew from it may stand there."""
        ranked = [one for one in self.ranked() if one.added and one.noise == self.robust]
        # what holds a better set gained nothing from the effects that it has more
        best = [
            one
            for place, one in enumerate(ranked)
            if not any(set(other.added) < set(one.added) for other in ranked[:place])
        ]
        for one in best[:2]:
            at = self.visited[one]
            if one in self.begun_afresh or at.posterior.dear or not self.clock.left(0.8):
                continue
            self.begun_afresh.add(one)
            generator = torch.Generator().manual_seed(one.seed + self.seed)
            starts = material_starts(at.posterior, at.theta, STARTS, generator)
            # each point that is followed further takes geometries of its own
            most = MOST_MINIMA // 2 if at.posterior.slow else MOST_MINIMA
            self.refit(one, torch.cat([at.theta[None], starts]), at, most=most)

    def sets(self, entries: Sequence[str], left: Callable[[Fitted], float]) -> None:
        """Sets of effects, as long as they gain: grown from the leaders, then without each of their members, and with each
        exchanged; beyond FEW_EFFECTS of the first leader alone, as long as each further effect gains REACH. A leader that is :meth:`clean` is only
        asked for what may hide beside it, and others for what lifts them above it; where it has another law than the scene, the best under the scene's own grows beside it;
        where something unknown alone is far ahead of all leaders, only the first of them grows; and none does that would stay
        behind if FEW_EFFECTS more gained as much each as the best one alone."""
        grown: set[frozenset[str]] = set()
        for size in itertools.count(1):
            sized = [one for one in self.ranked() if len(one.added) == size and one.noise == self.robust]
            if not sized or self.ahead_of_foremost > REACH + FEW_EFFECTS * self.gain_alone:
                break
            clean = self.clean(left)
            self.settled = clean and self.as_quoted
            if clean and len(self.foremost.added) < size:
                break
            beyond = size >= FEW_EFFECTS
            stems = sized[: 1 if clean or beyond or self.stranger_leads else BEAM]
            if stems[0].law:  # beside the wrong law others lead
                stems += [one for one in sized if not one.law][:1]
            for number, stem in enumerate(dict.fromkeys(stems)):  # that may be among them already
                self.grow(stem, entries, grown, GROWN if number == 0 else GROWN // 2, anew=number == 0)
            if self.settled:
                # what probes promise beside fits that are far apart does not compare
                for stems in (self.behind(sized), *([one] for one in self.shorter())):
                    self.overtake(stems, entries, grown)
            best = self.ranked(one for one in self.visited if len(one.added) == size + 1)
            if not best:
                break
            gained = self.log_odds(best[0]) - self.log_odds(sized[0])
            if gained > (REACH if beyond else -REACH):
                if not clean:
                    self.exchange(best[0], entries, grown)
                self.rivals_anew(size + 1)
            best = self.ranked(one for one in self.visited if len(one.added) == size + 1)
            gained = self.log_odds(best[0]) - self.log_odds(sized[0])
            if gained <= (REACH if size + 1 >= FEW_EFFECTS else 0.0):
                break
            self.clock.tell(self.state(), 0.5 + 0.2 * min(size, FEW_EFFECTS - 1))
        self.of_fewer_numbers(entries, grown)

    def exchange(self, whole: Hypothesis, entries: Sequence[str], grown: set[frozenset[str]]) -> None:
        """A set without each of its effects, and with another in the place of each."""
        at = self.visited[whole]
        for entry in whole.added:
            fewer = self.less(at, entry)
            quick = refit_seconds(self.posterior(fewer)) < DEAR_FIT_S
            if quick and self.clock.left(0.8):
                self.shrunk(at, entry)
            if fewer in self.visited and self.clock.left(0.8):
                self.grow(fewer, entries, grown, GROWN // 2, anew=False)

    def rivals_anew(self, size: int) -> None:
        """The best sets of a size once more with each of their effects of MANY numbers begun anew beside the others: alone, or beside what was
        exchanged, it took their light for its own."""
        sized = [one for one in self.ranked() if len(one.added) == size and one.noise == self.robust]
        for whole in [one for one in sized if self.log_odds(one) > self.log_odds(sized[0]) - REACH][:BEAM]:
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
        found = self.probe_all(beside, [entry])
        if entry in found and self.affordable(entry, beside, found[entry]):
            self.extend(beside, entry, found[entry])

    @property
    def ahead_of_foremost(self) -> float:
        """Log odds by which what errs otherwise, or something unknown alone, is ahead of the foremost."""
        return max(self.log_odds(self.leader), self.stranger_alone) - self.log_odds(self.foremost)

    def clean(self, left: Callable[[Fitted], float]) -> bool:
        """Whether the foremost leaves nothing, by the p-value that ``left`` gives, and neither red noise nor something unknown beside it is
        ahead of it; another way to err independently is no sign that anything is left."""
        hidden = self.correlated(self.leader) and self.ahead_of_foremost > NEAR
        beside = (self.odd_log_odds(odd) for odd in self.odd if odd.beside.added == self.foremost.added)
        hidden = hidden or max(beside, default=-math.inf) > self.log_odds(self.leader)
        return not hidden and left(self.visited[self.foremost]) > CLEAN_P

    def grow(
        self, stem: Hypothesis, entries: Sequence[str], grown: set[frozenset[str]], most: int, anew: bool
    ) -> None:
        """The most promising effects added to a set; where probes take long, they are made ``anew`` or held against what the set
        leaves."""
        at = self.visited[stem]
        seen = [entry for entry in entries if entry not in self.invisible]
        possible = [
            entry
            for entry in seen
            if self.bench.compatible(stem, entry) and self.bench.carries(stem.with_effect(entry))
        ]
        found = self.probe_all(at, possible, anew=anew)
        promising = [
            entry
            for entry, one in found.items()
            if frozenset((stem.law, *stem.plain, entry)) not in grown
            and (one.score > self.least_score(stem, entry) or not one.psi.shape[-1])
        ]
        for entry in sorted(promising, key=lambda one: -found[one].score)[:most]:
            one = found[entry]
            if self.clock.left(0.8) and self.within_reach(entry, at, one) and self.affordable(entry, at, one):
                grown.add(frozenset((stem.law, *stem.plain, entry)))
                self.extend(at, entry, one)

    @property
    def as_quoted(self) -> bool:
        """Whether the errors that the foremost leaves are :func:`near_quoted`."""
        return near_quoted(self.visited[self.foremost])

    def behind(self, sized: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Sets within reach of the foremost, of those that are ranked, but the first."""
        return [one for one in sized[1:] if self.log_odds(one) > self.mark - REACH]

    def shorter(self) -> list[Hypothesis]:
        """The foremost without each of its effects, where it has several, fitted from its numbers."""
        at = self.visited[self.foremost]
        found = []
        for entry in at.hypothesis.added if len(at.hypothesis.added) > 1 else ():
            fewer = self.less(at, entry)
            if refit_seconds(self.posterior(fewer)) < DEAR_FIT_S and self.clock.left(0.8):
                self.shrunk(at, entry)
            if fewer in self.visited:
                found.append(fewer)
        return found

    def numbers(self, one: Hypothesis) -> int:
        """How many numbers the effects of a set have."""
        parameters = self.bench.likelihood(one).model.parameter_set
        return sum(len(effect_columns(parameters, entry)) for entry in one.added)

    def of_fewer_numbers(self, entries: Sequence[str], grown: set[frozenset[str]]) -> None:
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
                one
                for one in self.ranked()
                if (one.noise, one.law) == (leading.noise, leading.law)
                and set(stem.plain) < set(one.plain) <= possible
                and len(one.added) == len(stem.added) + 1
            )
            return next(more, None)

        stem = best(replace(leading, added=()))
        while stem is not None and self.numbers(stem) < most and self.clock.left(0.8):
            self.grow(stem, few, grown, GROWN // 2, anew=False)
            more = best(stem)
            if more is None or not self.ahead(more, stem):
                break
            stem = more
        if stem is not None and len(stem.added) > 1 and self.log_odds(stem) > self.mark - REACH:
            self.exchange(stem, few, grown)

    def overtake(
        self, stems: Sequence[Hypothesis], entries: Sequence[str], grown: set[frozenset[str]]
    ) -> None:
        """What may lift a set that is behind a clean leader above it: those of one of these and one effect more that promise most, from
        probes as they were made last."""
        promised: list[tuple[float, Hypothesis, str, Probe]] = []
        for stem in stems:
            at = self.visited[stem]
            for entry in entries:
                if entry not in self.latest or not self.bench.compatible(stem, entry):
                    continue
                more = stem.with_effect(entry)
                known = sorted_as(self.visited, more) in self.visited
                one = rescored(*self.latest[entry], at)
                if known or not one.visible or not self.bench.carries(more):
                    continue
                if self.within_reach(entry, at, one):
                    odds = at.log_z + self.bench.log_odds(more) + 0.5 * one.score
                    promised.append((odds, stem, entry, one))
        for _, stem, entry, one in sorted(promised, key=lambda pair: -pair[0])[:JOINT]:
            pair, at = frozenset((stem.law, *stem.plain, entry)), self.visited[stem]
            if pair not in grown and self.clock.left(0.8) and self.affordable(entry, at, one):
                grown.add(pair)
                self.extend(at, entry, one)

    def noise_of_leaders(self) -> None:
        """What is within reach under every way to err, then its evidence. That rows err together takes the most time, and is asked
        of the leader and of the leading effects; and sets whose geometry is slow are only asked where they are near."""
        top = self.log_odds(self.leader)
        near = [
            one
            for one in self.ranked()
            if self.log_odds(one) > top - (NEAR if self.visited[one].posterior.slow else REACH)
        ]
        # red noise far ahead may stand in for effects: how far these are behind is only told with it beside them
        near.append(self.foremost)
        sets = list(dict.fromkeys(replace(one, noise=self.robust) for one in near))[:MOST_LOOKED]
        null = Hypothesis(law=self.leader.law).under(*self.robust)
        together = {*sets[:1], *[one for one in sets if one.added][:1]}
        noises = self.noises()
        for number, one in enumerate(dict.fromkeys((*sets, null))):
            if one not in self.visited:
                continue
            for noise in noises:
                asked = one in together or not self.correlated(one.under(*noise))
                if asked and one.under(*noise) not in self.visited and self.clock.left(0.9):
                    self.renoise(self.visited[one], noise)
            if number == 0:
                noises = self.useful(one, noises)
        self.pruned()
        self.integrate()

    def pruned(self) -> None:
        """A leader whose rows err together without each of its effects, as long as one fewer is better: what the others were added for
        may be what rows share."""
        while self.correlated(self.leader) and len(self.leader.added) > 1:
            best = self.leader
            at = self.visited[best]
            for entry in best.added:
                fewer = self.less(at, entry)
                cost = refit_seconds(self.posterior(fewer))
                if fewer not in self.visited and self.clock.left(0.9) and self.clock.affords(cost):
                    self.shrunk(at, entry, turns=1)
            if self.leader == best:
                break

    def useful(self, one: Hypothesis, noises: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
        """Ways to err that a set of effects has a use for, those of rows that err together told apart from the others: they may stand in
        for what an effect does, and say nothing then of how its rows err."""
        visited = [one.under(*noise) for noise in noises if one.under(*noise) in self.visited]
        found = []
        for joint in (False, True):
            alike = [other for other in visited if self.correlated(other) == joint]
            best = max(map(self.log_odds, alike), default=-math.inf)
            found += [other.noise for other in alike if self.log_odds(other) > best - NEAR]
        return found

    def integrate(self) -> None:
        """Evidence by importance sampling of what is near the leader, until the order of the leaders stands; of all linear forms where the
        geometry of any is slow. Where time ends before all of them have it none gets it: Laplace's method, and a linear form, may be off
        by as much as they are apart, and alike for all."""
        for _ in range(2):
            top = self.log_odds(self.leader)
            near = [one for one in self.ranked()[: 2 * MOST_LOOKED] if self.log_odds(one) >= top - NEAR]
            linear = any(self.visited[one].posterior.slow for one in near)
            made = {one: self.visited[one] for one in near if self.visited[one].evidence is not None}
            # those whose rows err together last: their draws are few, and others may stand in for them
            for one in sorted(near, key=self.correlated):
                if not self.clock.left(0.95):
                    return
                at = self.visited[one]
                if one not in made and not at.missed:
                    same = (two for other, two in made.items() if other.under(*one.noise) == one)
                    beside = next((two for two in same if two.evidence is not None), None)
                    draws = DRAWS if one == self.leader else DRAWS // RIVALS_SHARE
                    # how the rows err where nothing is missing is an answer itself, and cheap
                    moving = beside is None or not one.added
                    made[one] = self.weighed(at, draws, linear, beside, moving)
            self.visited.update(made)

    def nominal_sizes(self) -> None:
        """Sizes that are only nominal in the place of the area that the leading set adds."""
        kept = tuple(entry for entry in self.leader.added if not effect_class(entry).adds_area)
        if len(kept) < len(self.leader.added) and self.bench.has_free_sizes:
            self.alternatives([NOMINAL], [kept])

    def laws(self, entries: Sequence[str], clean: bool) -> None:
        """The scene's own model under other laws of reflection. Where one describes the rows better than the scene's own, it grows by what
        its probes promise, unless the foremost is ``clean`` and far ahead of it; and unless that is clean its effects are refitted under the
        other law: beside the wrong law others lead."""
        self.alternatives(self.bench.laws, [()])
        null = Hypothesis().under(*self.robust)
        better = [law for law in self.bench.laws if self.ahead(replace(null, law=law), null)]
        if not better:
            return
        if not clean:
            leaders = [one.added for one in self.ranked() if one.noise == self.robust and one.added]
            self.alternatives(better, list(dict.fromkeys(leaders))[:2])
        # a clean leader beside the wrong law may have bent to it: near is what FEW_EFFECTS would bring as far
        best = max((replace(null, law=law) for law in better), key=self.log_odds)
        if not clean or self.log_odds(best) > self.mark - FEW_EFFECTS * REACH:
            self.grow(best, entries, set(), GROWN, anew=True)

    def alternatives(self, laws: Iterable[str], sets: Sequence[tuple[str, ...]]) -> None:
        """Sets of effects in other scenes than the given one."""
        for law in laws:
            for added in sets:
                hypothesis = Hypothesis(added, self.robust, law)
                if not self.clock.left(0.85):
                    self.unexamined[law] = "there was no time"
                    break
                if not self.bench.carries(hypothesis):
                    continue
                posterior = self.posterior(hypothesis)
                # a set of the leader without one of its members may not have been fitted: then from the leader's own numbers
                at = self.visited[[*self.exactly(*hypothesis.plain), self.leader][0]]
                theta = carried(posterior.model.parameter_set, at.theta[None], at.names)[0]
                generator = torch.Generator().manual_seed(hypothesis.seed + self.seed)
                starts = theta[None]
                if not posterior.dear:
                    starts = material_starts(posterior, theta, LAW_STARTS, generator)
                if posterior.model.geometry_free:
                    # light of a free geometry is worked out anew for every lobe: only the best are followed
                    starts = posterior.theta(likeliest(posterior, starts, STARTS))
                self.refit(hypothesis, starts, at)

    def strangers(self, coordinates: dict[str, Tensor]) -> None:
        """What the library does not hold, beside nothing and beside the leading set, each under the best noise that is independent
        between rows, where that was not asked before, or where a better minimum was found since."""
        self.odd = [odd for odd in self.odd if self.visited[odd.beside].log_z < odd.log_z + BETTER]
        known = {odd.beside for odd in self.odd}
        for added in dict.fromkeys([(), self.leader.added]):
            alike = [one for one in self.visited if one.added == added and not self.correlated(one)]
            best = self.ranked(alike)[0] if alike else None
            if best is not None and best not in known:
                self.odd += discrepancies(self.visited[best], coordinates, self.bench)

    @property
    def stranger_leads(self) -> bool:
        """Whether something unknown alone is beyond the reach of the leader."""
        return self.stranger_alone > self.log_odds(self.leader) + REACH

    @property
    def stranger_alone(self) -> float:
        """Log odds of the best of something unknown beside no effect."""
        return max((self.odd_log_odds(odd) for odd in self.odd if not odd.beside.added), default=-math.inf)

    def odd_log_odds(self, odd: Discrepancy) -> float:
        """Log odds of a discrepancy with what it stands beside."""
        return odd.log_z + self.bench.log_odds(odd.beside) + odd.log_gain + odd.log_odds

    def strongest(self) -> Discrepancy | None:
        """The discrepancy of highest odds."""
        return max(self.odd, key=self.odd_log_odds, default=None)

    def state(self) -> str:
        """The leader with its odds against the second, for a progress bar."""
        order = self.ranked()
        name = " + ".join(order[0].names) or ("noise" if order[0].noise else "nothing missing")
        return f"leads: {name}"
