"""The one object that verdict, names, families and what remains are read off: posterior probabilities of what was visited."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import NormalDist

import torch
from torch import Tensor

from torchlc.diagnosis.discrepancy import FAR, ODDS
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import FEW_EFFECTS, SCALE, Hypothesis
from torchlc.diagnosis.promises import LINEAR_NEAR
from torchlc.diagnosis.standing import near_quoted
from torchlc.diagnosis.unseen import unseen_noise_share, unseen_shares
from torchlc.effects import mending_kind
from torchlc.inference.density import BAD_ROW, Fitted
from torchlc.inference.posterior import LONGEST
from torchlc.stages.entry import Entry

UNKNOWN_ODDS = 0.02
"""Prior odds of something that no hypothesis here describes, beside the leader."""
FAMILY_SHARE = 0.1
"""Of the named effect's probability that another in its place must have to be told beside it."""
LEAST_TAKEN = 0.5
"""Effects that leave structure, more likely than not, stand in for something else unless each takes this share of the misfit
that the others leave, of which a row counts for FAR errors at most: several bend a model to much that is none of them."""
WEIGHED = 1e-3
"""Probability below which it makes no difference what of a hypothesis could be seen."""
PROMISE_SPREAD = 0.3
"""Standard deviation of what a refit gains, as a share of what its probe has it expected to. Of six effects that each described
a wrong attitude, gains were 1.3 to 1.9 times what their probes promised."""
TOLD = 0.5
"""Probability above which something is named."""


@dataclass(frozen=True)
class Probabilities:
    """Of ``nothing`` missing, of ``noise`` alone, of each effect of the library by name, and of something ``unknown`` alone;
    ``sets`` are the sets of entries, best first, with theirs, ``kinds`` those of the noise by name; ``leftover`` is that of
    something unknown beside the best set; ``unexamined`` that of effects of the library for which there was no time. ``spare`` counts the rows that are more than the scene's own model has free numbers:
    with none to spare nothing can be told, and nothing is. ``too_weak`` is that of single effects of sizes that these data could not surely
    show, where nothing else is wrong and where noise is. ``laws`` are the shares of ``unknown`` of other scenes without any effect: laws of
    reflection, or nominal sizes."""

    nothing: float
    noise: float
    unknown: float
    effects: Mapping[str, float]
    sets: Sequence[tuple[tuple[str, ...], float]]
    kinds: Mapping[str, float]
    leftover: float
    spare: int
    unexamined: float = 0.0
    too_weak: tuple[float, float] = (0.0, 0.0)
    laws: Mapping[str, float] = field(default_factory=dict)

    @property
    def some_effect(self) -> float:
        return max(1.0 - self.nothing - self.noise - self.unexplained, 0.0)

    @property
    def unexplained(self) -> float:
        """That none of what was examined is the cause."""
        return self.unknown + self.unexamined

    @property
    def shapeless(self) -> float:
        """That something is missing of which the shape alone is known."""
        return self.unexplained - sum(self.laws.values())

    @property
    def verdict(self) -> str:
        """The answer of highest probability; where none has half, what is missing cannot be told."""
        answers = {
            "adequate": self.nothing,
            "noise_model": self.noise,
            "missing_physics": self.some_effect,
            "unexplained": self.unexplained,
        }
        if self.spare <= 0:
            return "adequate"
        best = max(answers, key=lambda name: answers[name])
        if best in ("adequate", "noise_model") or answers[best] > TOLD:
            return best
        return "adequate" if self.nothing + self.noise > TOLD else "unexplained"

    @property
    def named(self) -> tuple[str, ...]:
        if self.verdict == "noise_model":
            return (max(self.kinds, key=lambda name: self.kinds[name]),)
        if self.verdict != "missing_physics":
            return ()
        return tuple(dict.fromkeys(Entry.parse(entry).name for entry in self.best))

    @property
    def best(self) -> tuple[str, ...]:
        """Entries of the best set that holds anything."""
        return next((entries for entries, _ in self.sets if entries), ())

    @property
    def families(self) -> tuple[tuple[str, ...], ...]:
        """For each named effect, itself and what may stand in its place beside the other named ones, most probable first."""
        if self.verdict != "missing_physics":
            return tuple((name,) for name in self.named)
        families = []
        whole = _named_sets(self.sets)
        members = frozenset(self.named)
        for name in self.named:
            others = members - {name}
            own = whole.get(members, 0.0)
            rivals = {
                next(iter(rival)): p
                for names, p in whole.items()
                if others <= names and len(rival := names - others) == 1 and len(names) == len(members)
            }
            rivals.pop(name, None)
            near = [other for other, p in rivals.items() if p >= FAMILY_SHARE * own]
            families.append((name, *sorted(near, key=lambda other: -rivals[other])))
        return tuple(families)

    @property
    def told(self) -> float:
        """Probability of the answer as it is told, its families included: that nothing is missing which these data could show holds where
        an effect is too weak for them as well."""
        verdict = self.verdict
        if verdict != "missing_physics":
            return {
                "adequate": self.nothing + self.too_weak[0],
                "noise_model": self.noise + self.too_weak[1],
                "unexplained": self.unexplained,
            }[verdict]
        allowed = [frozenset(family) for family in self.families]
        return sum(
            p
            for names, p in _named_sets(self.sets).items()
            if len(names) == len(allowed) and all(names & family for family in allowed)
        )


def _named_sets(sets: Sequence[tuple[tuple[str, ...], float]]) -> dict[frozenset[str], float]:
    whole: dict[frozenset[str], float] = {}
    for entries, p in sets:
        names = frozenset(Entry.parse(entry).name for entry in entries)
        whole[names] = whole.get(names, 0.0) + p
    return whole


def worth_of_p(p: float) -> float:
    """ln of the largest Bayes factor that a p-value can stand for, 1 / (-e p ln p) (Sellke, Bayarri & Berger 2001, Am. Stat.
    55, 62); 0 above 1/e."""
    if p >= 1 / math.e:
        return 0.0
    log_p = math.log(max(p, 1e-300))
    return -1.0 - log_p - math.log(-log_p)


def probabilities(search: Search, p_left: float) -> Probabilities:
    """What was visited, weighed; ``p_left`` is the p-value of what the leader leaves. What was judged by its linear form alone counts
    as long as that is out of reach of the leader; what is within it is told as not examined, and beside the leader as likely as it is
    to reach it."""
    rows: list[tuple[str, Hypothesis, float]] = []
    rows += [("", visited, search.log_odds(visited)) for visited in search.visited]
    far = search.log_odds(search.leader) - LINEAR_NEAR
    judged = {
        unfitted: odds
        for unfitted, odds in search.linear.items()
        if unfitted not in search.visited and odds < far
    }
    rows += [("", unfitted, odds) for unfitted, odds in judged.items()]
    late_singles = promised(search)
    rows += [("", hypothesis, odds) for hypothesis, odds in late_singles.items()]
    rows += [("odd", odd.beside, search.odd_log_odds(odd)) for odd in search.odd]
    leader = max(rows, key=lambda row: row[2])
    if leader[0] != "odd":
        rows.append(("odd", leader[1], leader[2] + worth_of_p(p_left) + math.log(UNKNOWN_ODDS)))
    weight = torch.softmax(torch.tensor([row[2] for row in rows], dtype=torch.float64), 0).tolist()
    masses = [(kind, hypothesis, p) for (kind, hypothesis, _), p in zip(rows, weight, strict=True)]
    nothing = noise = unknown = leftover = 0.0
    too_weak = [0.0, 0.0]
    laws: dict[str, float] = {}
    sets: dict[tuple[str, ...], float] = {}
    kinds: dict[str, float] = {}
    for kind, examined, p, unsure in less_unseen(search, masses):
        hypothesis = part_of_the_answer(search, examined) if kind and not examined.unlisted else examined
        entries = tuple(sorted(hypothesis.plain))
        name = "" if entries else noise_name(search, hypothesis)
        if hypothesis.unlisted or (not entries and (kind or hypothesis.law)):
            unknown += p
            if not kind and not hypothesis.unlisted:
                laws[hypothesis.law] = laws.get(hypothesis.law, 0.0) + p
        elif not entries and name:
            noise += p
            kinds[name] = kinds.get(name, 0.0) + p
        elif not entries:
            nothing += p
        else:
            sets[entries] = sets.get(entries, 0.0) + p
            leftover += p * (kind != "")
            too_weak[noise_name(search, hypothesis) != ""] += p * unsure
    effects: dict[str, float] = {}
    for entries, p in sets.items():
        for name in {Entry.parse(entry).name for entry in entries}:
            effects[name] = effects.get(name, 0.0) + p
    unfitted_sets = {hypothesis.plain for hypothesis in late_singles}
    # what was not fitted is told beside what was, and never before it
    order = sorted(sets.items(), key=lambda item: (item[0] in unfitted_sets, -item[1]))
    late = (unknown - sum(laws.values())) * share_of_unexamined(search)
    return Probabilities(
        nothing,
        noise,
        unknown - late,
        dict(sorted(effects.items(), key=lambda item: -item[1])),
        order,
        kinds,
        leftover,
        spare=search.visited[Hypothesis()].likelihood.degrees_of_freedom,
        unexamined=late,
        too_weak=(too_weak[0], too_weak[1]),
        laws=laws,
    )


def promised(search: Search) -> dict[Hypothesis, float]:
    """Log odds of single effects for which there was no time, beside a leader that has effects, or rows that err together, which
    stand in for any: those of the leader, times how likely it is that the effect reaches them. Refitted, it is taken to gain as many
    times what its probe promises as the best single effect did, within a share PROMISE_SPREAD, normally distributed; one that was not
    even probed reaches them with the odds of something unknown."""
    null, leader = Hypothesis().under(*search.robust), search.leader
    explains = leader.added or search.correlated(leader)
    if not explains or null not in search.visited or leader.law:
        return {}
    top, bare = search.log_odds(leader), search.visited[null].log_z
    # beside errors far larger than quoted every probe promises too little
    times = 1.0 if near_quoted(search.visited[null]) else LONGEST
    singles = search.of_size(1)
    probe = search.probes.get(singles[0].added[0]) if singles else None
    if probe is not None and probe.score > 0:
        times = min(max((search.visited[singles[0]].log_z - bare) / (0.5 * probe.score), times), LONGEST)
    reached = {}
    for entry in _late(search):
        hypothesis = Hypothesis((entry,), search.robust)
        share = UNKNOWN_ODDS
        if entry in search.probes:
            expected = times * 0.5 * search.probes[entry].score
            missing = top - search.bench.log_odds(hypothesis) - bare - expected
            share = NormalDist().cdf(-missing / (PROMISE_SPREAD * expected)) if expected > 0 else 0.0
        if share > WEIGHED:
            reached[hypothesis] = top + math.log(share)
    return reached


def share_of_unexamined(search: Search) -> float:
    """Of what none of the examined effects explains, how much belongs to those that were not examined: they may explain it as well as
    something unknown does, and are to it as their prior odds."""
    odds = sum(math.exp(search.bench.log_odds(Hypothesis((entry,)))) for entry in _late(search))
    return odds / (odds + ODDS)


def _late(search: Search) -> list[str]:
    """Effects for which there was no time, without laws."""
    return [entry for entry in search.bench.entries if entry in search.unexamined]


def less_unseen(
    search: Search, masses: Sequence[tuple[str, Hypothesis, float]]
) -> list[tuple[str, Hypothesis, float, float]]:
    """The same mass, where that of values of an effect or of noise which nobody could see counts for the set without it; with the share of
    what is left of a single effect that is not sure to be seen."""
    # mass may come to a set from several larger ones
    shares: dict[tuple[Hypothesis, str], tuple[float, float]] = {}
    of_noise: dict[Hypothesis, float] = {}
    pending = list(masses)
    done: list[tuple[str, Hypothesis, float, float]] = []
    while pending:
        kind, hypothesis, p = pending.pop()
        unsure = 0.0
        if not kind and p > WEIGHED and hypothesis in search.visited:
            for entry in hypothesis.added:
                without = search.counterpart(hypothesis.without(entry))
                if without is None:
                    continue
                if (hypothesis, entry) not in shares:
                    fits = search.visited[hypothesis], search.visited[without]
                    shares[hypothesis, entry] = unseen_shares(*fits, entry, hypothesis.seed)
                unseen, below = shares[hypothesis, entry]
                pending.append((kind, without, p * unseen))
                p *= 1 - unseen
                if len(hypothesis.added) == 1:
                    unsure = (below - unseen) / max(1 - unseen, WEIGHED)
            bare = Hypothesis()
            if hypothesis != bare and not hypothesis.added and not hypothesis.law:
                if hypothesis not in of_noise:
                    of_noise[hypothesis] = unseen_noise_share(
                        search.visited[hypothesis], search.visited[bare], hypothesis.seed
                    )
                unseen = of_noise[hypothesis]
                done.append((kind, bare, p * unseen, 0.0))
                p *= 1 - unseen
        done.append((kind, hypothesis, p, unsure))
    return done


def part_of_the_answer(search: Search, hypothesis: Hypothesis) -> Hypothesis:
    """What of a set that leaves structure is part of the answer: without the effect that takes least of the misfit which the others leave, one
    after another, as long as that is less than LEAST_TAKEN; without any where what is left stands for something else. It has to take what
    the whole set has to: effects that came with it bent the model with it. Rows err as they do beside what is left."""
    core, at = hypothesis, search.visited[hypothesis]
    curves = [odd for odd in search.odd if odd.beside == hypothesis and odd.errors is not None]
    errors = max(curves, key=search.odd_log_odds).errors if curves else None
    errors = at.wide if errors is None else torch.minimum(errors, at.wide)
    while len(core.added) > 1 and not at.likelihood.fitted_errors:
        fewer = [search.counterpart(core.without(entry)) for entry in core.added]
        shares = [
            (share_taken(search.visited[less], search.visited[core], errors), less)
            for less in fewer
            if less is not None
        ]
        share, less = min(shares, key=lambda pair: pair[0], default=(1.0, core))
        if share >= LEAST_TAKEN:
            break
        core = less
    many = len(hypothesis.added)
    return replace(core, added=()) if stands_for_something_else(search, core, many, errors) else core


def stands_for_something_else(search: Search, hypothesis: Hypothesis, many: int, errors: Tensor) -> bool:
    """Whether effects, of a set of so ``many``, that leave structure are no part of the answer: something unknown alone is more likely than
    they are, they are FEW_EFFECTS or more, or they take too little of the misfit in ``errors`` (T,)."""
    if not hypothesis.added:
        return False
    if search.stranger_alone > search.log_odds(hypothesis):
        return True
    if search.visited[hypothesis].likelihood.fitted_errors:  # nothing says what the misfit is
        return False
    share = share_taken(search.best(), search.visited[hypothesis], errors)
    return len(hypothesis.added) >= FEW_EFFECTS or share < 1 - (1 - LEAST_TAKEN) ** many


def share_taken(before: Fitted, after: Fitted, errors: Tensor) -> float:
    """How much of the excess of squared residuals of one fit, in ``errors`` (T,) of a row, another takes away, of rows that are good
    under it."""
    good = after.outlying() < BAD_ROW
    squares = [
        float((fitted.delta / errors)[good].square().clamp(max=FAR**2).sum()) for fitted in (before, after)
    ]
    excess = squares[0] - int(good.sum())
    return (squares[0] - squares[1]) / excess if excess > 0 else 0.0


def noise_name(search: Search, hypothesis: Hypothesis) -> str:
    """What noise of a hypothesis is called: its kinds; a scale of the errors alone is what mends errors that are too small, or
    nothing where they are too large."""
    kinds = [kind for kind in hypothesis.noise if kind != SCALE]
    if kinds:
        return kinds[0]
    if not hypothesis.noise:
        return ""
    fitted = search.visited[hypothesis]
    return mending_kind().name if float(fitted.g[-1]) > 0 else ""
