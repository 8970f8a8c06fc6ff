"""The search: what may be missing is fitted, and what can matter is integrated, as long as there is time.

Signatures rank the candidates; each is then refitted from what its signature says; the leaders' materials are tried under
every other; sets of effects grow, shrink and swap; and whatever comes within reach of the leader is told apart under
every way to err, with its evidence. Nothing is decided here: the odds of all that was visited are
:mod:`torchlc.diagnosis.probabilities`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from torchlc.diagnosis.alternatives import NOMINAL
from torchlc.diagnosis.discrepancy import discrepancies
from torchlc.diagnosis.fits import REACH, STARTS
from torchlc.diagnosis.growth import GROWN, JOINT, Growth
from torchlc.diagnosis.hypotheses import FEW_EFFECTS, Hypothesis, carried, effect_columns
from torchlc.diagnosis.joint import joint_sets
from torchlc.diagnosis.promises import DEAR_FIT_S, NEAR, first_steps_seconds, refit_seconds
from torchlc.effects import effect_class
from torchlc.inference.density import Fitted
from torchlc.inference.posterior import LONGEST, MOST_MINIMA, UNLIKE, likeliest, material_starts
from torchlc.stages.entry import Entry

LAWS_IF_SLOW = 2
"""Best laws that the leading sets are refitted under where each geometry of a free one takes long: a set then takes some 5 s under each."""
FOLLOWED = 12
"""Draws of the materials under another law that are followed where the geometry is free: light is then worked out anew for every lobe."""
BETTER = 0.5
"""Log evidence by which a minimum has to be better that what was asked beside the one before is asked anew."""
MOST_LOOKED = 6
"""Sets of effects that are told under every noise, the best first: some ten fits each."""
DRAWS = 500
"""For the evidence of the leader: its error is then some 0.05 where weights are even, a tenth of what tells two answers apart."""
RIVALS_SHARE = 2
"""What the draws of a rival's evidence are divided by: those of the leader are the table of the materials as well."""


@dataclass
class Search(Growth):
    """The rounds of a search: the probes of candidates, what is fitted because of them, what was left out and why."""

    begun_afresh: set[Hypothesis] = field(default_factory=set)
    """Sets of effects that were fitted from materials of their own."""

    def singles(self, entries: Sequence[str], left: Callable[[Fitted], float]) -> None:
        """Every candidate alone, first those that are fitted fast, by the evidence that their signatures promise, most first: a budget then ends among
        those that promise least, and they set the mark that slow ones have to come near. Then all from the leaders' materials."""
        at = self.best()
        at = self.visited[at.hypothesis.under(*self.robust)]
        self.probes = self.probe_all(at, entries, 0.5)  # refits of these go on until 0.8
        self.settled = self.clean(left) and self.as_quoted
        slow = {
            entry: refit_seconds(self.posterior(at.hypothesis.with_effect(entry))) >= DEAR_FIT_S
            for entry in self.probes
        }
        order = sorted(self.probes, key=lambda entry: (slow[entry], -self.probes[entry].worth))
        # beside materials that are wrong for want of the effect, which a probe holds, the true one may promise an eighth of its gain
        first = sorted(self.probes, key=lambda entry: -self.probes[entry].score)[:GROWN]
        clean: dict[Hypothesis, bool] = {}
        for number, entry in enumerate(order):
            if self.foremost not in clean:
                clean[self.foremost] = self.clean(left)
            # as long as structure is left, what comes next has nothing to begin from; beside a clean one what was not asked may be the answer
            if not self.clock.left(0.8):
                break
            probe = self.probes[entry]
            if not probe.visible:
                self.invisible.add(entry)
                continue
            # as long as structure is left the light is not near what probes were made beside, and their promise is no bound
            asked = entry in first or not clean[self.foremost] or self.within_reach(entry, at, probe)
            if asked and self.affordable(entry, at, probe):
                self.extend(at, entry, probe)
            self.clock.tell(self.state(), 0.1 + 0.4 * number / max(len(order), 1))
        self.shared_materials()

    def jointly(self, clean: bool) -> None:
        """Sets of two and of FEW_EFFECTS by what their probes promise together: what one effect alone would be blamed for may be several
        that each take little of it. Beside a leader that is ``clean``, or far ahead of all others, those without its effects: what hides beside
        these is asked of it. Where its errors are as quoted, none of more numbers than it has: there is nothing more to describe. And none
        that would stay behind the leader if it gained LONGEST times what it promises."""
        most = self.numbers(self.foremost) if clean and self.as_quoted else math.inf
        at = self.visited[Hypothesis().under(*self.robust)]
        apart = clean or not self.behind(self.of_size(1))
        quick = {
            entry: probe
            for entry, probe in self.probes.items()
            if probe.visible
            and len(probe.scores)
            and not (apart and Entry.parse(entry).plain in self.foremost.plain)
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
            among = {entry: probe for entry, probe in quick.items() if size == 2 or probe.psi.shape[-1]}
            for chosen, promised in joint_sets(among, at, size, log_odds, JOINT):
                reached = at.log_z + log_odds(sorted(chosen)) + LONGEST * promised
                if reached < self.mark - NEAR or self.exactly(*chosen) or not self.clock.left(0.7):
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
        judged = {hypothesis.plain for hypothesis in (*self.visited, *self.linear)}
        for entry in self.bench.entries:
            if (entry,) not in judged and entry not in self.invisible:
                self.unexamined.setdefault(entry, "there was no time")

    def shared_materials(self) -> None:
        """The best hypotheses of the first round, and the scene's own model, from the materials of the leaders: what an effect
        is blamed for may sit in the materials."""
        first = [
            hypothesis
            for hypothesis in self.ranked()
            if len(hypothesis.added) <= 1 and hypothesis.noise == self.robust and not hypothesis.law
        ]
        leaders = [self.visited[hypothesis] for hypothesis in first[:2]]
        for hypothesis in dict.fromkeys((*first[:GROWN], Hypothesis().under(*self.robust))):
            at = self.visited[hypothesis]
            if not self.clock.left(0.7) or at.posterior.dear or not at.posterior.physical:
                continue
            parameters = at.model.parameter_set
            materials = [k for k, free in enumerate(parameters.free) if free.origin.role == "materials"]
            known = [other.g[materials] for other in at.minima]
            starts = []
            for leader in leaders:
                theta = carried(parameters, leader.theta[None], leader.names)
                columns = [c for entry in hypothesis.added for c in effect_columns(parameters, entry)]
                theta[:, columns] = at.theta[columns]
                g = at.posterior.coordinates(theta)[0, materials]
                if materials and all(float((g - other).abs().max()) > UNLIKE for other in known):
                    known.append(g)
                    starts.append(theta)
            if starts:
                self.refit(hypothesis, torch.cat(starts), at, turns=1, most=1)

    def afresh(self) -> None:
        """The leading sets of effects once more from materials drawn from their priors: where the scene's own model came to a
        wrong minimum of the materials, for want of the effect, all that grew from it may stand there."""
        ranked = [
            hypothesis for hypothesis in self.ranked() if hypothesis.added and hypothesis.noise == self.robust
        ]
        # what holds a better set gained nothing from the effects that it has more
        best = [
            hypothesis
            for rank, hypothesis in enumerate(ranked)
            if not any(set(other.added) < set(hypothesis.added) for other in ranked[:rank])
        ]
        for hypothesis in best[:2]:
            at = self.visited[hypothesis]
            if hypothesis in self.begun_afresh or at.posterior.dear or not self.clock.left(0.8):
                continue
            generator = torch.Generator().manual_seed(hypothesis.seed + self.seed)
            starts = material_starts(at.posterior, at.theta, STARTS, generator)
            if not self.clock.affords(first_steps_seconds(at.posterior, starts)):
                continue
            self.begun_afresh.add(hypothesis)
            # each point that is followed further takes geometries of its own
            most = MOST_MINIMA // 2 if at.posterior.slow else MOST_MINIMA
            self.refit(hypothesis, torch.cat([at.theta[None], starts]), at, most=most)

    def noise_of_leaders(self) -> None:
        """What is within reach under every way to err, then its evidence. That rows err together takes the most time, and is asked
        of the leader and of the leading effects; and sets whose geometry is slow are only asked where they are near."""
        top = self.log_odds(self.leader)
        near = [
            hypothesis
            for hypothesis in self.ranked()
            if self.log_odds(hypothesis) > top - (NEAR if self.visited[hypothesis].posterior.slow else REACH)
        ]
        # red noise far ahead may stand in for effects: how far these are behind is only told with it beside them
        near.append(self.foremost)
        sets = list(dict.fromkeys(replace(hypothesis, noise=self.robust) for hypothesis in near))[
            :MOST_LOOKED
        ]
        null = Hypothesis(law=self.leader.law).under(*self.robust)
        together = {*sets[:1], *[hypothesis for hypothesis in sets if hypothesis.added][:1]}
        noises = self.noises()
        for number, hypothesis in enumerate(dict.fromkeys((*sets, null))):
            if hypothesis not in self.visited:
                continue
            for noise in noises:
                asked = hypothesis in together or not self.correlated(hypothesis.under(*noise))
                if asked and hypothesis.under(*noise) not in self.visited and self.clock.left(0.9):
                    self.renoise(self.visited[hypothesis], noise)
            if number == 0:
                noises = self.useful(hypothesis, noises)
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

    def useful(self, hypothesis: Hypothesis, noises: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
        """Ways to err that a set of effects has a use for, those of rows that err together told apart from the others: they may stand in
        for what an effect does, and say nothing then of how its rows err."""
        visited = [hypothesis.under(*noise) for noise in noises if hypothesis.under(*noise) in self.visited]
        useful = []
        for joint in (False, True):
            alike = [other for other in visited if self.correlated(other) == joint]
            best = max(map(self.log_odds, alike), default=-math.inf)
            useful += [other.noise for other in alike if self.log_odds(other) > best - NEAR]
        return useful

    def integrate(self) -> None:
        """Evidence by importance sampling of what is near the leader, until the order of the leaders stands; of all linear forms where the
        geometry of any is slow. Where time ends before all of them have it none gets it: Laplace's method, and a linear form, may be off
        by as much as they are apart, and alike for all."""
        for _ in range(2):
            top = self.log_odds(self.leader)
            near = [
                hypothesis
                for hypothesis in self.ranked()[: 2 * MOST_LOOKED]
                if self.log_odds(hypothesis) >= top - NEAR
            ]
            linear = any(self.visited[hypothesis].posterior.slow for hypothesis in near)
            made = {
                hypothesis: self.visited[hypothesis]
                for hypothesis in near
                if self.visited[hypothesis].evidence is not None
            }
            # those whose rows err together last: their draws are few, and others may stand in for them
            for hypothesis in sorted(near, key=self.correlated):
                if not self.clock.left(0.95):
                    return
                at = self.visited[hypothesis]
                if hypothesis not in made and not at.missed:
                    same = (
                        two for other, two in made.items() if other.under(*hypothesis.noise) == hypothesis
                    )
                    beside = next((two for two in same if two.evidence is not None), None)
                    draws = DRAWS if hypothesis == self.leader else DRAWS // RIVALS_SHARE
                    # how the rows err where nothing is missing is an answer itself, and cheap
                    moving = beside is None or not hypothesis.added
                    made[hypothesis] = self.weighed(at, draws, linear, beside, moving)
            self.visited.update(made)

    def nominal_sizes(self) -> None:
        """Sizes that are only nominal in the place of the area that the leading set adds."""
        kept = tuple(entry for entry in self.leader.added if not effect_class(entry).adds_area)
        if len(kept) < len(self.leader.added) and self.bench.has_free_sizes:
            self.alternatives([NOMINAL], [kept])

    def laws(self, entries: Sequence[str], clean: bool) -> None:
        """The scene's own model under other laws of reflection. Where one describes the rows better than the scene's own, it grows by what
        its probes promise, unless the foremost is ``clean`` and far ahead of it; and unless that is clean its effects are refitted under the
        other law: beside the wrong law others lead. A leader of several numbers is not enough of an answer to a law far ahead of the scene's
        own: it may have bent to what the law and an effect of one number do."""
        self.alternatives(self.bench.laws, [()])
        null = Hypothesis().under(*self.robust)
        others = [replace(null, law=law) for law in self.bench.laws]
        better = [
            hypothesis.law
            for hypothesis in self.ranked(hypothesis for hypothesis in others if self.ahead(hypothesis, null))
        ]
        if not better:
            return
        if self.posterior(replace(null, law=better[0])).slow:
            better = better[:LAWS_IF_SLOW]
        if not clean:
            leaders = [
                hypothesis.added
                for hypothesis in self.ranked()
                if hypothesis.noise == self.robust and hypothesis.added
            ]
            self.alternatives(better, list(dict.fromkeys(leaders))[:2])
        best = replace(null, law=better[0])
        # near is what FEW_EFFECTS would bring as far
        near = self.log_odds(best) > self.mark - FEW_EFFECTS * REACH
        bent = self.numbers(self.foremost) > 1 and self.log_odds(best) > self.log_odds(null) + REACH
        if not clean or near or bent:
            self.take(self.promising(best, entries, GROWN, anew=True))

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
                    starts = material_starts(posterior, theta, STARTS, generator)
                if posterior.model.geometry_free:
                    # light of a free geometry is worked out anew for every lobe: only the best are followed
                    starts = posterior.theta(likeliest(posterior, starts, FOLLOWED))
                self.refit(hypothesis, starts, at)

    def strangers(self, coordinates: dict[str, Tensor]) -> None:
        """What the library does not hold, beside nothing and beside the leading set, each under the best noise that is independent
        between rows, where that was not asked before, or where a better minimum was found since."""
        self.odd = [odd for odd in self.odd if self.visited[odd.beside].log_z < odd.log_z + BETTER]
        known = {odd.beside for odd in self.odd}
        for added in dict.fromkeys([(), self.leader.added]):
            alike = [
                hypothesis
                for hypothesis in self.visited
                if hypothesis.added == added and not self.correlated(hypothesis)
            ]
            best = self.ranked(alike)[0] if alike else None
            if best is not None and best not in known:
                self.odd += discrepancies(self.visited[best], coordinates, self.bench)
