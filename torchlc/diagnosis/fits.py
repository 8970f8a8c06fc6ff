"""Hypotheses at their minima: how each is fitted, from where, and which of them lead."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.counts import Counted, counted, phase_entry
from torchlc.diagnosis.hypotheses import (
    SCALE,
    Hypothesis,
    Workbench,
    carried,
    effect_columns,
    effect_starts,
)
from torchlc.diagnosis.probes import (
    Probe,
    apart,
    scanned_column,
    scanned_hours,
)
from torchlc.effects import effect_class
from torchlc.files.steps import Steps
from torchlc.inference.density import Fitted, Posterior
from torchlc.inference.evidence import Evidence
from torchlc.inference.optimiser import find_modes
from torchlc.inference.posterior import (
    fit,
    fitted_at,
    integrated,
    material_starts,
    merged,
)
from torchlc.stages.entry import Entry

REACH = 12.0
"""Log odds below the leader within which a hypothesis is looked at closely: one in 160,000."""
STARTS = 48
"""Draws of the materials that a minimum is looked for from, each as drawn and with its reflectances regressed: of 17 nominal scenes without
anything missing 12 draws miss the true minimum of two by 2 and 9 in log evidence, 48 that of none, in half a second more."""
MODES = 24
"""Starts of a search for minima where the rows have no errors."""
PLACES = 3
"""Values of an effect's own parameters that a refit begins from."""
ROOM = 2.0
"""Standard deviations of its prior that a number of the nominal geometry is moved at most to begin a fit."""
MOST_CHARTED = 12
"""Minima that the table of the answer's materials rests on: 2 s."""
BEAM = 3
"""Sets of each size that grow, and modes of the noise level that the scene's own model is fitted from."""


@dataclass(frozen=True)
class Minimum:
    """Coordinates of a minimum, (P,)."""

    g: Tensor


@dataclass
class Fits:
    """What has been visited: every hypothesis at its minima."""

    bench: Workbench
    clock: Clock
    seed: int
    visited: dict[Hypothesis, Fitted] = field(default_factory=dict)
    steps: Steps = field(default_factory=Steps)
    """Refits and evidences as they are finished, those of an earlier run that was killed among them."""
    turns: dict[tuple[str, ...], Counted] = field(default_factory=dict)
    """What counts of turns between nights or curves leave open, by the set of effects."""
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
        return self.ranked(hypothesis for hypothesis in self.visited if hypothesis.noise == self.robust)[0]

    @property
    def mark(self) -> float:
        """Log odds of the foremost, which candidates under the same noise have to come near."""
        return self.log_odds(self.foremost)

    def best(self, *added: str) -> Fitted:
        """The best of what was visited with exactly these effects."""
        return self.visited[self.exactly(*added)[0]]

    def exactly(self, *added: str) -> list[Hypothesis]:
        """What was visited with exactly these effects, best first."""
        return self.ranked(hypothesis for hypothesis in self.visited if set(hypothesis.plain) == set(added))

    def likely(self, odds: Sequence[tuple[tuple[str, ...], float]]) -> list[tuple[Fitted, float]]:
        """The best fit of each of some sets of effects with its probability; without those that were judged by their linear form alone."""
        return [
            (self.visited[hypotheses[0]], p) for entries, p in odds if (hypotheses := self.exactly(*entries))
        ]

    def counterpart(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """The hypothesis as it was visited, whatever the order of its effects, or else under the robust noise."""
        for wanted in (hypothesis, hypothesis.under(*self.robust)):
            ordered = sorted_as(self.visited, wanted)
            if ordered in self.visited:
                return ordered
        return None

    @property
    def robust(self) -> tuple[str, ...]:
        """The noise under which candidates are compared: a free scale of the errors and bad rows."""
        if self.bench.base.context.errors is False:
            return ()
        laws = [name for name, kind in self.bench.kinds.items() if kind.reshapes]
        return (SCALE, *laws[:1])

    def correlated(self, hypothesis: Hypothesis) -> bool:
        """Whether its rows err together."""
        kinds = self.bench.kinds
        return any(kinds[kind].correlates for kind in hypothesis.noise if kind in kinds)

    def noises(self) -> list[tuple[str, ...]]:
        """Ways to err: as quoted, each kind alone, a scale of the errors alone and with each kind that is independent
        between rows."""
        kinds = self.bench.kinds
        noises: list[tuple[str, ...]] = [(), *((name,) for name in kinds)]
        if self.bench.base.context.errors:
            noises += [(SCALE,), *((SCALE, name) for name, kind in kinds.items() if kind.reshapes)]
        return noises

    def of_size(self, size: int) -> list[Hypothesis]:
        """Sets of ``size`` effects under the robust noise, best first."""
        return [
            hypothesis
            for hypothesis in self.ranked()
            if len(hypothesis.added) == size and hypothesis.noise == self.robust
        ]

    def last_gain(self, size: int) -> float:
        """What the best set of ``size`` effects adds to the log odds of the best with one fewer, each under the robust noise."""
        fewer, sized = self.of_size(size - 1), self.of_size(size)
        if not fewer or not sized:
            return 0.0
        return max(self.log_odds(sized[0]) - self.log_odds(fewer[0]), 0.0)

    def ahead(self, hypothesis: Hypothesis, other: Hypothesis) -> bool:
        """Whether a hypothesis was visited and is better than another."""
        return hypothesis in self.visited and self.log_odds(hypothesis) > self.log_odds(other)

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
        self,
        hypothesis: Hypothesis,
        starts: Tensor,
        noise_from: Fitted | None = None,
        slopes: Tensor | None = None,
        **options,
    ) -> Fitted:
        """A fit from natural values (S, P) kept; noise begins as in another fit, or as its prior has it. ``slopes`` (S, T, P) are d residual /
        d g at the starts, if they are known."""
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
        floor = self.floor(hypothesis) - self.bench.log_odds(hypothesis)
        nominal = self.nominal_columns(posterior)
        made: list[Fitted] = []

        def minima() -> list[Minimum]:
            made.append(fit(hypothesis, posterior, g, floor=floor, nominal=nominal, slopes=slopes, **options))
            return [Minimum(minimum.g) for minimum in made[0].minima]

        name = f"{hypothesis} from {hashlib.sha256(g.numpy().tobytes()).hexdigest()} {options}"
        points = self.steps.of(name, Minimum, minima)
        kept = self.keep(
            made[0] if made else merged([fitted_at(hypothesis, posterior, minimum.g) for minimum in points])
        )
        posterior.model.forget()  # tables of a rocket body take hundreds of MB, and there are some fifty models
        return kept

    def floor(self, hypothesis: Hypothesis) -> float:
        """Log odds below which a fit of a hypothesis need not be finished: out of reach of the leader, or, of another law alone, of the
        scene's own. The scene's own model, which all gains are counted from, is fitted to the end."""
        if hypothesis.added:
            return max(map(self.log_odds, self.visited), default=-math.inf) - REACH
        own = replace(hypothesis, law="")
        return self.log_odds(own) - REACH if hypothesis.law and own in self.visited else -math.inf

    def nominal_columns(self, posterior: Posterior) -> list[int]:
        """Columns of the scene's own geometry, where there are others that leave that as it is."""
        own_names = set(self.bench.likelihood(Hypothesis()).model.names)
        names = posterior.model.names
        nominal = [
            column for column in posterior.model.assembly.geometry_columns if names[column] in own_names
        ]
        return nominal if set(posterior.physical) - set(nominal) else []

    def null(self) -> None:
        """The scene's own model, under the robust noise and under every other."""
        hypothesis = Hypothesis().under(*self.robust)
        posterior = self.posterior(hypothesis)
        theta = posterior.theta(torch.zeros(posterior.size, dtype=torch.float64))
        generator = torch.Generator().manual_seed(hypothesis.seed + self.seed)
        starts = [posterior.model.parameter_set.start()[None], theta[None]]
        starts.append(material_starts(posterior, theta, STARTS, generator))
        if posterior.likelihood.fitted_errors:
            modes = find_modes(posterior.likelihood, starts=MODES, adam_steps=60, seed=self.seed)[0]
            starts = [torch.stack([mode.theta for mode in modes[:BEAM]])]
        fitted = self.refit(hypothesis, torch.cat(starts))
        fitted = self.from_counts(fitted, fitted)
        for noise in self.noises():
            if noise != self.robust:
                self.renoise(fitted, noise, starts=torch.cat(starts) if not noise else None)

    def renoise(self, at: Fitted, noise: tuple[str, ...], starts: Tensor | None = None) -> Fitted:
        """A hypothesis under another noise, from its minima; and from natural values (S, P) that get the geometry of the first of these,
        which then is worked out once for all of them."""
        hypothesis = at.hypothesis.under(*noise)
        parameters = self.bench.likelihood(hypothesis).model.parameter_set
        begin = [carried(parameters, minimum.theta[None], at.names) for minimum in at.minima]
        if starts is not None:
            geometry = at.model.assembly.geometry_columns
            starts = starts.index_copy(
                1, torch.tensor(geometry, dtype=torch.long), at.theta[geometry].expand(len(starts), -1)
            )
            begin.append(carried(parameters, starts, at.names))
            return self.refit(hypothesis, torch.cat(begin), at, turns=1)
        posterior = self.posterior(hypothesis)
        slopes = at.slopes.new_zeros(len(at.minima), len(at.delta), posterior.size)
        column_of = {name: column for column, name in enumerate(at.names)}
        columns = posterior.physical
        of = [column_of[posterior.model.names[column]] for column in columns]
        slopes[..., columns] = torch.stack([minimum.slopes for minimum in at.minima])[..., of]
        return self.refit(hypothesis, torch.cat(begin), at, slopes=slopes, turns=1)

    def extend(self, at: Fitted, entry: str, probe: Probe | None, *, others: Sequence[Fitted] = ()) -> Fitted:
        """``entry`` added to a fit: from its minima with the best probed values, and from the materials of others."""
        hypothesis = sorted_as(self.visited, at.hypothesis.with_effect(entry))
        posterior = self.posterior(hypothesis)
        parameters = posterior.model.parameter_set
        columns = effect_columns(parameters, entry)
        generator = torch.Generator().manual_seed(hypothesis.seed + self.seed)
        places = PLACES if columns and not posterior.dear else 1
        psi = effect_starts(parameters, entry, places, generator)
        likely: Tensor | None = None
        if probe is not None and len(probe.psi) and columns:
            order = torch.argsort(probe.scores, descending=True)
            likely = order[apart(self.bench, posterior, entry, probe.psi[order])][:places]
            psi[: len(likely)] = probe.psi[likely]
        if probe is not None and probe.begin is not None:
            psi[0] = probe.begin
        pool = (*at.minima[:2], *others)[: 1 if posterior.dear else None]
        starts = torch.cat(
            [carried(parameters, fitted.theta[None], fitted.names).repeat(len(psi), 1) for fitted in pool]
        )
        starts[:, columns] = psi.repeat(len(pool), 1)
        nominal = [] if posterior.dear else self.nominal_columns(at.posterior)
        if likely is not None and probe is not None and nominal:
            aside = _made_room(at, probe.moved[likely], nominal)
            starts[: len(likely)] = carried(parameters, aside, at.names)
            starts[: len(likely), columns] = psi[: len(likely)]
        new = self.from_no_size(self.refit(hypothesis, starts, at, turns=1, most=2), at, entry)
        if self.counted(entry):
            new = self.from_counts(new, at)
        posterior.model.forget()
        return self.rescanned(entry, new)

    def from_no_size(self, new: Fitted, at: Fitted, entry: str) -> Fitted:
        """A fit with one effect more than another, tried again from there with the effect at no size where it came to less than that:
        what probes promise far away may lead materials astray."""
        quantities = {quantity.name: quantity for quantity in effect_class(entry).quantities}
        parameters = new.model.parameter_set
        columns = effect_columns(parameters, entry)
        theta = carried(parameters, at.theta[None], at.names)
        theta[:, columns] = new.theta[columns]
        switched = False
        for column in columns:
            off = quantities[parameters.free[column].origin.quantity].off
            if off is not None and math.isfinite(off):
                theta[:, column], switched = off, True
        g = new.posterior.coordinates(theta)
        g[:, new.posterior.noise_columns] = at.g[at.posterior.noise_columns]
        with torch.no_grad():
            worse = switched and bool((new.posterior.log_density(g) > new.peak).all())
        return self.refit(new.hypothesis, theta, at, turns=1, most=1) if worse else new

    def counted(self, entry: str) -> bool:
        """Whether an effect is tried from counts of turns between nights or curves, of which no probe tells."""
        alike = effect_class(entry).stage == "spin" and Entry.parse(entry).per is None
        return alike and phase_entry(self.bench) is not None

    def from_counts(self, new: Fitted, at: Fitted) -> Fitted:
        """A fit of what turns tried again from each count of turns between nights or curves that suits the rows best, as told beside
        another fit: descents come to none but the nearest."""
        phase = phase_entry(self.bench)
        if phase is None or new.posterior.dear or not self.bench.compatible(new.hypothesis, phase):
            return new
        loose = self.posterior(new.hypothesis.with_effect(phase))
        if loose.dear:
            return new
        counts = counted(self.bench, at, new.posterior, loose, phase)
        if not len(counts.starts):
            return new
        self.turns[new.hypothesis.plain] = counts
        return self.refit(new.hypothesis, counts.starts[:PLACES], at, turns=1)

    def rescanned(self, entry: str, at: Fitted) -> Fitted:
        """A fit of an effect that no descent finds the row of, tried again at every row from where it came to."""
        column = scanned_column(entry)
        if column is None or at.posterior.dear:
            return at
        hours_column = effect_columns(at.model.parameter_set, entry)[column]
        hours = scanned_hours(self.bench)
        theta = at.theta.repeat(len(hours), 1)
        theta[:, hours_column] = hours
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

    def less(self, at: Fitted, entry: str) -> Hypothesis:
        """The hypothesis of a fit without one of its effects, in the order in which it was visited, if it was."""
        return sorted_as(self.visited, at.hypothesis.without(entry))

    def shrunk(self, at: Fitted, entry: str, **options) -> None:
        """A fit without one of its effects, from the numbers that it has."""
        fewer = self.less(at, entry)
        parameters = self.bench.likelihood(fewer).model.parameter_set
        self.refit(fewer, carried(parameters, at.theta[None], at.names), at, **options)

    def charted(self, at: Fitted) -> Fitted:
        """A fit with the minima that draws of its materials lead to, where it has several and none takes long: where two surfaces may make
        the same glint, the few that a search keeps are far from all that may be so."""
        if len(at.minima) < 2 or at.posterior.slow or at.noise.processes:
            return at
        generator = torch.Generator().manual_seed(at.hypothesis.seed + self.seed)
        starts = torch.cat([at.theta[None], material_starts(at.posterior, at.theta, STARTS, generator)])
        charted = fit(at.hypothesis, at.posterior, at.posterior.coordinates(starts), most=MOST_CHARTED)
        return merged([*at.minima, *charted.minima], MOST_CHARTED)

    def weighed(
        self,
        at: Fitted,
        draws: int,
        linear: bool = False,
        beside: Fitted | None = None,
        moving: bool = True,
    ) -> Fitted:
        """A fit with its evidence by ``draws``, of its ``linear`` form if so asked, which may be ``moving``. Where weights are not to be trusted, and the same
        set has its evidence under another noise, ``beside``, Laplace's method misses as much of this one: the shape of what is not noise is
        the same. Rows that err together take long: of these no draw is made then unless others would move."""
        missed = 0.0 if beside is None else beside.log_z - beside.laplace_of_all
        if beside is not None and not moving and at.noise.processes:
            return replace(at, missed=missed)

        def evidence() -> list[Evidence]:
            seed = at.hypothesis.seed + self.seed
            result = integrated(at, draws, seed, linear, moving=moving).evidence
            return [] if result is None else [result]

        digest = hashlib.sha256(
            torch.stack([minimum.g for minimum in at.minima]).numpy().tobytes()
        ).hexdigest()
        form = (" of its linear form" if linear else "") + ("" if moving else " as it stands")
        results = self.steps.of(
            f"evidence of {at.hypothesis} at {digest} by {draws}{form}", Evidence, evidence
        )
        at.model.forget()
        if beside is not None and not (results and results[0].trusted):
            return replace(at, missed=missed)
        return replace(at, evidence=results[0]) if results else at


def sorted_as(visited: dict[Hypothesis, Fitted], hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis in the order of effects in which it was visited, if it was."""
    return next(
        (
            known
            for known in visited
            if set(known.added) == set(hypothesis.added)
            and replace(known, added=()) == replace(hypothesis, added=())
        ),
        hypothesis,
    )


def _noise_names(posterior: Posterior) -> list[str]:
    names = [*posterior.model.names, SCALE]
    return [names[column] for column in posterior.noise_columns]


def _made_room(at: Fitted, moved: Tensor, nominal: Sequence[int]) -> Tensor:
    """Theta (G, P) of a fit with its ``nominal`` columns where its linear form has them beside changes of the light (G, T): what the
    geometry took up for want of an effect is what the effect is to explain."""
    rows = torch.cat([moved, moved.new_zeros(len(moved), len(at.g))], 1)
    tangent = at.tangent
    off = torch.linalg.solve(tangent.T @ tangent, (rows @ tangent).T).T
    g = at.g.repeat(len(moved), 1)
    g[:, nominal] += off[:, nominal].clamp(-ROOM, ROOM)
    return at.posterior.theta(g)
