"""The search: what may be missing is fitted, and what can matter is integrated, as long as there is time.

Signatures rank the candidates; each is then refitted from what its signature says; the leaders' materials are tried under
every other; sets of effects grow, shrink and swap; and whatever comes within reach of the leader is told apart under
every way to err, with its evidence. Nothing is decided here: the odds of all that was visited are
:mod:`torchlc.diagnosis.probabilities`.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from torchlc.diagnosis.alternatives import NOMINAL
from torchlc.diagnosis.discrepancy import Discrepancy, discrepancies
from torchlc.diagnosis.hypotheses import (
    FEW_EFFECTS,
    SCALE,
    Hypothesis,
    Workbench,
    carried,
    effect_columns,
    effect_starts,
)
from torchlc.diagnosis.joint import joint_sets
from torchlc.diagnosis.probes import (
    Probe,
    apart,
    least_seconds,
    probe,
    rescored,
    scanned_column,
    scanned_hours,
    turns,
)
from torchlc.effects import effect_class
from torchlc.files.steps import Steps
from torchlc.inference.budget import Budget
from torchlc.inference.evidence import Evidence
from torchlc.inference.optimiser import find_modes
from torchlc.inference.posterior import (
    UNLIKE,
    Fitted,
    Linear,
    Posterior,
    fit,
    fitted_at,
    integrated,
    material_starts,
    merged,
)
from torchlc.stages.effect import Entry

REACH = 12.0
"""Log odds below the leader within which a hypothesis is looked at closely: one in 160,000."""
NEAR = 6.0
"""The same within which its evidence is integrated, and told under every noise: one in 400."""
STARTS = 12
"""Draws of the materials that a minimum is looked for from, each as drawn and with its reflectances regressed."""
LAW_STARTS = 48
"""The same under another law, of whose lobes the scene says nothing."""
PLACES = 3
"""Values of an effect's own parameters that a refit begins from."""
CLEAN_P = 0.05
"""p-value of what a set leaves above which its rivals are not grown."""
LEAST_SCORE = 6.0
"""Twice what a signature has to promise in log density, that an effect is added to a set for it: probed values lie apart, and
the best may reach half as much again, the 9 below which an effect counts as not seen."""
BETTER = 0.5
"""Log evidence by which a minimum has to be better that what was asked beside the one before is asked anew."""
GROWN = 8
BEAM = 3
JOINT = 4
MOST_LOOKED = 6
DRAWS = 500
RIVALS_SHARE = 2
"""What the draws of a rival's evidence are divided by: those of the leader are the table of the materials as well."""
DEAR_STEPS = 24
"""Steps of a refit, each of which takes one geometry and one more for every number that is fitted."""
MOST_S = 900.0
"""CPU seconds after which a search without a budget ends: thirty times what most take, and as long as somebody waits unasked."""
PROBING_S = 10.0
"""CPU seconds of all probes beside one set of effects, of which each takes some hundredths where the geometry is not dear."""
DEAR_FIT_S, MOST_FIT_S = 2.0, 150.0
"""CPU seconds of a refit beyond which it is made only of what its linear form says is within reach, and not at all; and of a probe,
beyond which that of the first round serves for all sets."""


class Clock(Budget):
    """The budget of a search, MOST_S if nobody ``gave`` one, that tells how far it is, and that a person may stop. ``cut`` is
    whether something was left out for want of time."""

    def __init__(self, budget: float | None, progress: Callable[[str, float], None] | None = None) -> None:
        super().__init__(MOST_S if budget is None else budget)
        self.progress = progress
        self.gave = budget is not None
        self.stopped = self.cut = False

    def left(self, share: float = 1.0) -> bool:
        in_time = super().left(share)
        self.cut |= not in_time
        return in_time and not self.stopped

    def affords(self, seconds: float) -> bool:
        """Whether a step of so many seconds is worth it: within half of what is left of the budget, and MOST_FIT_S."""
        return not self.stopped and seconds < min(MOST_FIT_S, 0.5 * self.remaining)

    def tell(self, text: str, part: float) -> None:
        if self.progress is not None:
            self.progress(text, part)


@dataclass(frozen=True)
class Minimum:
    """Coordinates of a minimum, (P,)."""

    g: Tensor


@dataclass
class Search:
    """What has been visited: every hypothesis at its minima, the probes of candidates, what was left out and why."""

    bench: Workbench
    clock: Clock
    seed: int
    visited: dict[Hypothesis, Fitted] = field(default_factory=dict)
    probes: dict[str, Probe] = field(default_factory=dict)
    """Of the first round, beside the scene's own model."""
    latest: dict[str, tuple[Probe, Fitted]] = field(default_factory=dict)
    """The last probe of each that was made and not only held against another fit, with what it was made beside."""
    odd: list[Discrepancy] = field(default_factory=list)
    unexamined: dict[str, str] = field(default_factory=dict)
    """Why, by entry, a candidate was not refitted."""
    linear: dict[Hypothesis, float] = field(default_factory=dict)
    """Log odds of what was judged by its linear form alone."""
    invisible: set[str] = field(default_factory=set)
    """Candidates that would leave no trace in these data, whatever their numbers."""
    steps: Steps = field(default_factory=Steps)
    """Refits and evidences as they are finished, those of an earlier run that was killed among them."""
    begun_afresh: set[Hypothesis] = field(default_factory=set)
    """Sets of effects that were fitted from materials of their own."""
    _posteriors: dict[Hypothesis, Posterior] = field(default_factory=dict)

    def log_odds(self, hypothesis: Hypothesis) -> float:
        """ln of posterior odds, up to a constant."""
        return self.visited[hypothesis].log_z + self.bench.log_odds(hypothesis)

    def ranked(self, among: Iterable[Hypothesis] | None = None) -> list[Hypothesis]:
        """Visited hypotheses, best first."""
        return sorted(self.visited if among is None else among, key=self.log_odds, reverse=True)

    @property
    def leader(self) -> Hypothesis:
        return self.ranked()[0]

    @property
    def foremost(self) -> Hypothesis:
        """The leader under the robust noise."""
        return self.ranked(one for one in self.visited if one.noise == self.robust)[0]

    @property
    def mark(self) -> float:
        """Log odds of the foremost, which candidates under the same noise have to come near."""
        return self.log_odds(self.foremost)

    def best(self, *added: str) -> Fitted:
        """The best of what was visited with exactly these effects."""
        return self.visited[self.exactly(*added)[0]]

    def exactly(self, *added: str) -> list[Hypothesis]:
        """What was visited with exactly these effects, best first."""
        return self.ranked(one for one in self.visited if set(one.plain) == set(added))

    def counterpart(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """The hypothesis as it was visited, whatever the order of its effects, or else under the robust noise."""
        for one in (hypothesis, hypothesis.under(*self.robust)):
            found = _sorted_as(self.visited, one)
            if found in self.visited:
                return found
        return None

    # ------------------------------------------------------------------ noise

    @property
    def robust(self) -> tuple[str, ...]:
        """The noise under which candidates are compared: a free scale of the errors and bad rows."""
        if self.bench.base.context.errors is False:
            return ()
        laws = [name for name, kind in self.bench.kinds().items() if kind.reshapes]
        return (SCALE, *laws[:1])

    def correlated(self, hypothesis: Hypothesis) -> bool:
        """Whether its rows err together."""
        kinds = self.bench.kinds()
        return any(kinds[kind].correlates for kind in hypothesis.noise if kind in kinds)

    def noises(self) -> list[tuple[str, ...]]:
        """Ways to err: as quoted, each kind alone, a scale of the errors alone and with each kind that is independent
        between rows."""
        kinds = self.bench.kinds()
        found: list[tuple[str, ...]] = [(), *((name,) for name in kinds)]
        if self.bench.base.context.errors:
            found += [(SCALE,), *((SCALE, name) for name, kind in kinds.items() if kind.reshapes)]
        return found

    # ------------------------------------------------------------------ fits

    def posterior(self, hypothesis: Hypothesis) -> Posterior:
        if hypothesis not in self._posteriors:
            likelihood = self.bench.likelihood(hypothesis)
            self._posteriors[hypothesis] = Posterior(likelihood, SCALE in hypothesis.noise)
        return self._posteriors[hypothesis]

    def keep(self, new: Fitted) -> Fitted:
        """The hypothesis with its minima and those that it had before."""
        old = self.visited.get(new.hypothesis)
        if old is not None:
            new = merged([*old.minima, *new.minima])
            new = old if new.laplace <= old.laplace + 1e-3 and len(new.minima) == len(old.minima) else new
        self.visited[new.hypothesis] = new
        return new

    def refit(
        self, hypothesis: Hypothesis, starts: Tensor, noise_from: Fitted | None = None, **options
    ) -> Fitted:
        """A fit from natural values (S, P) kept; noise begins as in another fit, or as its prior has it."""
        posterior = self.posterior(hypothesis)
        g = posterior.coordinates(starts)
        g[:, posterior.noise_columns] = 0.0
        if noise_from is not None:
            for column, name in zip(posterior.noise_columns, _noise_names(posterior), strict=True):
                known = dict(
                    zip(_noise_names(noise_from.posterior), noise_from.posterior.noise_columns, strict=True)
                )
                if name in known:
                    g[:, column] = noise_from.g[known[name]]
        best = max(map(self.log_odds, self.visited), default=-math.inf)
        # the scene's own model, which all gains are counted from, is fitted to the end
        floor = best - REACH - self.bench.log_odds(hypothesis) if hypothesis.added else -math.inf
        nominal = self.nominal_columns(posterior)
        made: list[Fitted] = []

        def minima() -> list[Minimum]:
            made.append(fit(hypothesis, posterior, g, floor=floor, nominal=nominal, **options))
            return [Minimum(one.g) for one in made[0].minima]

        name = f"{hypothesis} from {hashlib.sha256(g.numpy().tobytes()).hexdigest()} {options}"
        found = self.steps.of(name, Minimum, minima)
        return self.keep(
            made[0] if made else merged([fitted_at(hypothesis, posterior, one.g) for one in found])
        )

    def nominal_columns(self, posterior: Posterior) -> list[int]:
        """Columns of the scene's own geometry, where there are others that leave that as it is."""
        own = set(self.bench.likelihood(Hypothesis()).model.names)
        names = posterior.model.names
        found = [column for column in posterior.model.assembly.geometry_columns if names[column] in own]
        return found if set(posterior.physical) - set(found) else []

    def null(self) -> None:
        """The scene's own model, under the robust noise and under every other."""
        hypothesis = Hypothesis().under(*self.robust)
        posterior = self.posterior(hypothesis)
        theta = posterior.theta(torch.zeros(posterior.size, dtype=torch.float64))
        generator = torch.Generator().manual_seed(hypothesis.seed + self.seed)
        starts = [posterior.model.parameter_set.start()[None], theta[None]]
        starts.append(material_starts(posterior, theta, STARTS, generator))
        if posterior.likelihood.fitted_errors:
            modes = find_modes(posterior.likelihood, starts=2 * STARTS, adam_steps=60, seed=self.seed)[0]
            starts = [torch.stack([mode.theta for mode in modes[:BEAM]])]
        found = self.refit(hypothesis, torch.cat(starts))
        for noise in self.noises():
            if noise != self.robust:
                self.renoise(found, noise, starts=torch.cat(starts) if not noise else None)

    def renoise(self, at: Fitted, noise: tuple[str, ...], starts: Tensor | None = None) -> Fitted:
        """A hypothesis under another noise, from its minima."""
        hypothesis = at.hypothesis.under(*noise)
        parameters = self.bench.likelihood(hypothesis).model.parameter_set
        begin = [carried(parameters, one.theta[None], at.names) for one in at.minima]
        if starts is not None:
            begin.append(carried(parameters, starts, at.names))
        return self.refit(hypothesis, torch.cat(begin), at, turns=1)

    def extend(self, at: Fitted, entry: str, found: Probe | None, *, others: Sequence[Fitted] = ()) -> Fitted:
        """``entry`` added to a fit: from its minima with the best probed values, and from the materials of others."""
        hypothesis = at.hypothesis.with_effect(entry)
        posterior = self.posterior(hypothesis)
        parameters = posterior.model.parameter_set
        columns = effect_columns(parameters, entry)
        generator = torch.Generator().manual_seed(hypothesis.seed + self.seed)
        places = PLACES if columns and not posterior.dear else 1
        psi = effect_starts(parameters, entry, places, generator)
        if found is not None and len(found.psi) and columns:
            likely = apart(self.bench, entry, found.psi[torch.argsort(found.scores, descending=True)])
            psi[: len(likely)] = likely[:places]
        if found is not None and found.begin is not None:
            psi[0] = found.begin
        pool = (*at.minima[:2], *others)[: 1 if posterior.dear else None]
        starts = torch.cat(
            [carried(parameters, one.theta[None], one.names).repeat(len(psi), 1) for one in pool]
        )
        starts[:, columns] = psi.repeat(len(pool), 1)
        new = self.refit(hypothesis, starts, at, turns=1, most=2)
        posterior.model.forget()
        return self.rescanned(entry, new)

    def rescanned(self, entry: str, at: Fitted) -> Fitted:
        """A fit of an effect that no descent finds the row of, tried again at every row from where it came to."""
        column = scanned_column(entry)
        if column is None or at.posterior.dear:
            return at
        place = effect_columns(at.model.parameter_set, entry)[column]
        hours = scanned_hours(self.bench)
        theta = at.theta.repeat(len(hours), 1)
        theta[:, place] = hours
        g = at.posterior.coordinates(theta)
        g[:, at.posterior.noise_columns] = at.g[at.posterior.noise_columns]
        # rows before its instant are as if it came last, the others as if it came first
        seconds = self.bench.base.context.seconds
        begun = seconds / 3600 > hours[:, None]

        def at_every(ends: Tensor) -> Tensor:
            first, last = ends.expand(2, len(seconds))
            return torch.where(begun, first, last)

        with torch.no_grad():
            every = at.posterior.residuals(g[[0, -1]]).each(at_every)
            density = at.posterior.held_density(every, g)
        best = torch.argsort(density, descending=True)[:PLACES]
        return self.refit(at.hypothesis, theta[best], at, turns=1, most=1)

    # ------------------------------------------------------------------ rounds

    def probe_all(
        self, at: Fitted, entries: Sequence[str], share: float = 0.8, anew: bool = True
    ) -> dict[str, Probe]:
        """Probes of candidates beside a fit, as long as less than a share of the budget is spent: first those that leave the geometry as
        it is. Those that take long are made once, beside the scene's own model. Others are made ``anew``, what the last probe promises
        most first, as long as all together take PROBING_S; those of dear geometries otherwise are held against this fit as they were
        made last."""
        held = {entry: rescored(*self.latest[entry], at) for entry in entries if entry in self.latest}
        alone = {entry: self.posterior(Hypothesis((entry,), self.robust)) for entry in entries}

        def place(entry: str) -> tuple[bool, float, bool]:
            return entry in held, -held[entry].score if entry in held else 0.0, turns(alone[entry], entry)

        found = {}
        began = self.clock.spent
        for entry in sorted(entries, key=place):
            if not self.clock.left(share):
                break
            spent = self.clock.spent - began > PROBING_S
            if entry in held and (spent or (not anew and (at.posterior.dear or alone[entry].dear))):
                found[entry] = held[entry]
                continue
            hypothesis = at.hypothesis.with_effect(entry)
            posterior = self.posterior(hypothesis)
            as_last = entry in held and not anew and posterior.dear
            cost = 0.0 if as_last else least_seconds(posterior, entry)
            if entry in held and (as_last or cost > DEAR_FIT_S):
                found[entry] = held[entry]
            elif self.clock.affords(cost):
                found[entry] = probe(self.bench, at, posterior, entry, hypothesis.seed + self.seed)
                self.latest[entry] = found[entry], at
            else:
                self.unexamined[entry] = (
                    f"{cost:.0f} s of light worked out anew before anything is known of it"
                )
            posterior.model.forget()
        return found

    def affordable(self, entry: str, at: Fitted, found: Probe) -> bool:
        """Whether an effect is refitted. One whose geometry is dear is judged by its linear form, which is kept, and refitted
        only if that could be the answer and there is time."""
        hypothesis = at.hypothesis.with_effect(entry)
        posterior = self.posterior(hypothesis)
        cost = refit_seconds(posterior)
        if cost < DEAR_FIT_S:
            return True
        if Entry.parse(entry).per is not None:
            promised = at.log_z + self.bench.log_odds(hypothesis) + 0.5 * found.together
            if promised < self.mark - NEAR:
                return False
            if self.clock.affords(cost):
                return True
            self.unexamined[entry] = (
                f"{cost:.0f} s of light worked out anew; its parts together promise enough"
            )
            return False
        if not len(found.scores):
            return False
        moved = replace(at.found, delta=at.delta - found.promised(at) * at.sigma)
        shifted = replace(at, found=moved)
        with torch.no_grad():
            linear = fit(at.hypothesis, Linear(shifted), shifted.g[None], turns=1)
        self.linear[hypothesis] = linear.laplace + self.bench.log_odds(hypothesis)
        if self.linear[hypothesis] < self.mark - NEAR:
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

    def singles(self, entries: Sequence[str]) -> None:
        """Every candidate alone, first those that are fitted fast, by what their signatures promise, most first: a budget then ends among
        those that promise least, and they set the mark that slow ones have to come near. Then all from the leaders' materials."""
        at = self.best()
        at = self.visited[at.hypothesis.under(*self.robust)]
        self.probes = self.probe_all(at, entries, 0.4)  # refits of these go on until 0.6
        slow = {
            entry: refit_seconds(self.posterior(at.hypothesis.with_effect(entry))) >= DEAR_FIT_S
            for entry in self.probes
        }
        order = sorted(self.probes, key=lambda entry: (slow[entry], -self.probes[entry].score))
        for number, entry in enumerate(order):
            if not self.clock.left(0.6):
                break
            if not self.probes[entry].visible:
                self.invisible.add(entry)
            elif self.affordable(entry, at, self.probes[entry]):
                self.extend(at, entry, self.probes[entry])
            self.clock.tell(self.state(), 0.1 + 0.4 * number / max(len(order), 1))
        self.shared_materials()

    def jointly(self) -> None:
        """Sets of two and of FEW_EFFECTS by what their probes promise together: what one effect alone would be blamed for may be several
        that each take little of it."""
        at = self.visited[Hypothesis().under(*self.robust)]
        quick = {
            entry: one
            for entry, one in self.probes.items()
            if one.visible
            and len(one.scores)
            and one.psi.shape[-1]
            and refit_seconds(self.posterior(at.hypothesis.with_effect(entry))) < DEAR_FIT_S
        }

        def log_odds(entries: Sequence[str]) -> float:
            together = Hypothesis()
            for entry in entries:
                if not self.bench.compatible(together, entry):
                    return -math.inf
                together = together.with_effect(entry)
            return self.bench.log_odds(together)

        for size in (2, FEW_EFFECTS):
            for chosen in joint_sets(quick, at, size, log_odds, JOINT):
                if not self.clock.left(0.7) or self.exactly(*chosen):
                    continue
                hypothesis = Hypothesis(tuple(chosen), self.robust)
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
        """Each hypothesis of the first round, and the scene's own model, from the materials of the leaders: what an effect
        is blamed for may sit in the materials."""
        first = [
            one for one in self.ranked() if len(one.added) <= 1 and one.noise == self.robust and not one.law
        ]
        leaders = [self.visited[one] for one in first[:2]]
        for one in first:
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
        leaders = [one for one in self.ranked() if one.added and one.noise == self.robust][:2]
        for one in leaders:
            at = self.visited[one]
            if one in self.begun_afresh or at.posterior.dear or not self.clock.left(0.8):
                continue
            self.begun_afresh.add(one)
            generator = torch.Generator().manual_seed(one.seed + self.seed)
            starts = material_starts(at.posterior, at.theta, STARTS, generator)
            self.refit(one, torch.cat([at.theta[None], starts]), at)

    def sets(self, entries: Sequence[str], left: Callable[[Fitted], float]) -> None:
        """Sets of effects, as long as they gain: grown from the leaders, then without each of their members, and with each
        exchanged; beyond FEW_EFFECTS of the first leader alone, as long as each further effect gains REACH. A leader whose rows
        err independently that leaves nothing, by the p-value that ``left`` gives, and has nothing ahead of it, is only asked for what
        may hide beside it; where it has another law than the scene, the best under the scene's own grows beside it;
        where something unknown alone is far ahead of all leaders, only the first of them grows; and none does that would stay
        behind if FEW_EFFECTS more gained as much each as the best one alone."""
        grown: set[frozenset[str]] = set()
        for size in itertools.count(1):
            sized = [one for one in self.ranked() if len(one.added) == size and one.noise == self.robust]
            alike = self.foremost
            ahead = max(self.log_odds(self.leader), self.stranger_alone) - self.log_odds(alike)
            clean = ahead <= NEAR and left(self.visited[alike]) > CLEAN_P
            behind = ahead > REACH + FEW_EFFECTS * self.gain_alone
            if not sized or (clean and len(alike.added) < size) or behind:
                break
            beyond = size >= FEW_EFFECTS
            stems = sized[: 1 if clean or beyond or self.stranger_leads else BEAM]
            if stems[0].law:  # beside the wrong law others lead
                stems += [one for one in sized if not one.law][:1]
            for number, stem in enumerate(dict.fromkeys(stems)):
                self.grow(stem, entries, grown, GROWN if number == 0 else GROWN // 2, anew=number == 0)
            best = self.ranked(one for one in self.visited if len(one.added) == size + 1)
            if not best:
                break
            gained = self.log_odds(best[0]) - self.log_odds(sized[0])
            close = not clean and gained > (REACH if beyond else -REACH)
            for entry in best[0].added if close else ():  # shrink, then swap
                at = self.visited[best[0]]
                fewer = self.less(at, entry)
                quick = refit_seconds(self.posterior(fewer)) < DEAR_FIT_S
                if quick and self.clock.left(0.8):
                    self.shrunk(at, entry)
                if fewer in self.visited and self.clock.left(0.8):
                    self.grow(fewer, entries, grown, GROWN // 2, anew=False)
            best = self.ranked(one for one in self.visited if len(one.added) == size + 1)
            gained = self.log_odds(best[0]) - self.log_odds(sized[0])
            if gained <= (REACH if size + 1 >= FEW_EFFECTS else 0.0):
                break
            self.clock.tell(self.state(), 0.5 + 0.2 * min(size, FEW_EFFECTS - 1))

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
            if self.clock.left(0.8) and self.affordable(entry, at, found[entry]):
                grown.add(frozenset((stem.law, *stem.plain, entry)))
                self.extend(at, entry, found[entry])

    def least_score(self, stem: Hypothesis, entry: str) -> float:
        """What a signature has to promise that an effect is added to a set: LEAST_SCORE, and beyond FEW_EFFECTS, where each has to gain
        REACH beyond its prior odds, two thirds of that."""
        if len(stem.added) < FEW_EFFECTS:
            return LEAST_SCORE
        cost = self.bench.log_odds(stem) - self.bench.log_odds(stem.with_effect(entry))
        return 2 * (REACH + cost) / 1.5

    def noise_of_leaders(self) -> None:
        """What is within reach under every way to err, then its evidence. That rows err together takes the most time, and is asked
        of the leader and of the leading effects; and sets whose geometry is dear are only asked where they are near."""
        top = self.log_odds(self.leader)
        near = [
            one
            for one in self.ranked()
            if self.log_odds(one) > top - (NEAR if self.visited[one].posterior.dear else REACH)
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

    def less(self, at: Fitted, entry: str) -> Hypothesis:
        """The hypothesis of a fit without one of its effects, in the order in which it was visited, if it was."""
        return _sorted_as(self.visited, at.hypothesis.without(entry))

    def shrunk(self, at: Fitted, entry: str, **options) -> None:
        """A fit without one of its effects, from the numbers that it has."""
        fewer = self.less(at, entry)
        parameters = self.bench.likelihood(fewer).model.parameter_set
        self.refit(fewer, carried(parameters, at.theta[None], at.names), at, **options)

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
        """Evidence by importance sampling of what is near the leader, until the order of the leaders stands."""
        for _ in range(2):
            top = self.log_odds(self.leader)
            for one in self.ranked()[: 2 * MOST_LOOKED]:
                if self.log_odds(one) < top - NEAR or not self.clock.left(0.95):
                    break
                if self.visited[one].evidence is None:
                    draws = DRAWS if one == self.leader else DRAWS // RIVALS_SHARE
                    self.visited[one] = self.weighed(self.visited[one], draws)

    def weighed(self, at: Fitted, draws: int) -> Fitted:
        """A fit with its evidence by ``draws``."""

        def evidence() -> list[Evidence]:
            found = integrated(at, draws, at.hypothesis.seed + self.seed).evidence
            return [] if found is None else [found]

        place = hashlib.sha256(torch.stack([one.g for one in at.minima]).numpy().tobytes()).hexdigest()
        found = self.steps.of(f"evidence of {at.hypothesis} at {place} by {draws}", Evidence, evidence)
        return replace(at, evidence=found[0]) if found else at

    def nominal_sizes(self) -> None:
        """Sizes that are only nominal in the place of the area that the leading set adds."""
        kept = tuple(entry for entry in self.leader.added if not effect_class(entry).adds_area)
        if len(kept) < len(self.leader.added) and self.bench.has_free_sizes:
            self.alternatives([NOMINAL], [kept])

    def laws(self, entries: Sequence[str]) -> None:
        """The scene's own model under other laws of reflection. Under one that describes the rows better than the scene's own law, the
        leading effects are refitted and others looked for: beside the wrong law others lead."""
        self.alternatives(self.bench.laws, [()])
        null = Hypothesis().under(*self.robust)
        better = [law for law in self.bench.laws if self.ahead(replace(null, law=law), null)]
        if better:
            leaders = [one.added for one in self.ranked() if one.noise == self.robust and one.added]
            self.alternatives(better, list(dict.fromkeys(leaders))[:2])
        if self.foremost.law:
            self.grow(replace(null, law=self.foremost.law), entries, set(), GROWN, anew=True)

    def ahead(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether a hypothesis was visited and is better than another."""
        return one in self.visited and self.log_odds(one) > self.log_odds(other)

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
    def gain_alone(self) -> float:
        """What the best effect alone adds to the log odds of the scene's own model, each under the robust noise."""
        robust = [one for one in self.ranked() if one.noise == self.robust and not one.law]
        null, *_ = (one for one in robust if not one.added)
        alone = next((one for one in robust if len(one.added) == 1), null)
        return max(self.log_odds(alone) - self.log_odds(null), 0.0)

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


def refit_seconds(posterior: Posterior) -> float:
    """CPU seconds of a refit: its geometries, of which those of numbers that share no row are one."""
    colours = posterior.colours()
    slopes = len(posterior.physical) if colours is None else len(colours.groups)
    return posterior.seconds_each * (1 + slopes) * DEAR_STEPS


def _sorted_as(visited: dict[Hypothesis, Fitted], hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis in the order of effects in which it was visited, if it was."""
    return next(
        (
            one
            for one in visited
            if set(one.added) == set(hypothesis.added)
            and replace(one, added=()) == replace(hypothesis, added=())
        ),
        hypothesis,
    )


def _noise_names(posterior: Posterior) -> list[str]:
    names = [*posterior.model.names, SCALE]
    return [names[column] for column in posterior.noise_columns]
