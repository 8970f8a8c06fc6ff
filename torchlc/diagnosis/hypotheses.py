"""What may be missing, as hypotheses with prior odds, and the models of each.

A hypothesis is a set of effects beside the scene's own, a way in which the rows err, and a law of reflection. Odds are
relative to nothing missing, errors as quoted and the scene's own law, and multiply.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from torchlc.diagnosis.alternatives import NOMINAL, under_other_laws, with_free_sizes
from torchlc.effects import effect_class, nameable, registry, unlisted
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.assembled import Assembly
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.kind import NoiseKind
from torchlc.parameters import ParameterSet
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.stages.entry import Entry

SCALE = "error scale"
"""The quoted errors times a factor, which is no effect of the library: log-normal about 1."""
NOISE_ODDS = 0.3
"""Of each way to err, one in four, times what its class says: errors that are 30 % off and a few bad rows are what recordings have."""
LAW_ODDS = 0.2
"""Of another law of reflection, shared by those that are asked: the scene's author chose for a reason, and one more law in the library makes
none of the others less likely to be right."""
SIZES_ODDS = 0.1
"""Of sizes that are only nominal where the scene gives them as certain."""
FEW_EFFECTS = 3
"""Effects of a set up to which any gain is enough that it grows."""
MOST_OBJECTS = 30
"""Objects that an offset is divided by in a search: each is a number of its own, and a minimum costs their square."""
LONGEST_CURVE = 1500
"""Rows of a curve that may err together: the factorisation of their covariance takes a tenth of a second."""
LADDER = (1.0, -1.0, 0.3, -0.3, 3.0, -3.0, 2.0, -2.0)
"""Sizes of an effect that are tried, in units of its typical one."""


@dataclass(frozen=True)
class Hypothesis:
    """``added`` effects beyond the scene's own, each ``name`` or ``name[target]``, with ``noise``, the names of kinds of
    noise and SCALE, and another ``law`` of reflection than the scene's, or NOMINAL sizes."""

    added: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    law: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(Entry.parse(entry).name for entry in self.added)

    @property
    def plain(self) -> tuple[str, ...]:
        """The entries without the widths of divided offsets."""
        return tuple(Entry.parse(entry).plain for entry in self.added)

    @property
    def seed(self) -> int:
        """Of its random numbers: its own name's, so that another effect in the library changes none of its results."""
        return zlib.crc32("|".join([*sorted(self.added), *sorted(self.noise), self.law]).encode())

    @property
    def unlisted(self) -> tuple[str, ...]:
        """Those of ``added`` that are none of the library's."""
        known = unlisted()
        return tuple(entry for entry in self.added if Entry.parse(entry).name in known)

    def with_effect(self, entry: str) -> Hypothesis:
        return replace(self, added=(*self.added, entry))

    def without(self, entry: str) -> Hypothesis:
        return replace(self, added=tuple(other for other in self.added if other != entry))

    def under(self, *noise: str) -> Hypothesis:
        return replace(self, noise=noise)


class Workbench:
    """Builds likelihoods of hypotheses on one scene and recording, which share track, attitude, shape and, where the
    geometry is fixed, tables."""

    def __init__(self, scene: Scene, recording: Recording) -> None:
        self.scene, self.recording = scene, recording
        self.base = assemble(scene, recording)
        freed = with_free_sizes(scene)
        self.laws: Mapping[str, Scene] = under_other_laws(scene)
        self._scenes = {**self.laws, **({} if freed is None else {NOMINAL: freed})}
        self._bases: dict[str, Assembly] = {"": self.base}
        self._likelihoods: dict[tuple[str, tuple[str, ...]], Likelihood] = {}
        self._entries: list[str] = []
        self._log_odds: dict[Hypothesis, float] = {}

    @property
    def entries(self) -> list[str]:
        """Candidates, among which prior odds are shared."""
        return self._entries

    @entries.setter
    def entries(self, entries: list[str]) -> None:
        self._entries, self._log_odds = entries, {}

    def likelihood(self, hypothesis: Hypothesis) -> Likelihood:
        kinds = tuple(kind for kind in hypothesis.noise if kind != SCALE)
        key = hypothesis.law, (*hypothesis.added, *kinds)
        if key not in self._likelihoods:
            self._likelihoods[key] = Likelihood(self._model(*key))
        return self._likelihoods[key]

    def _base(self, law: str) -> Assembly:
        if law not in self._bases:
            self._bases[law] = assemble(self._scenes[law], self.recording)
        return self._bases[law]

    def carries(self, hypothesis: Hypothesis) -> bool:
        """Whether every effect of a hypothesis can be applied under its law of reflection."""
        context = self._base(hypothesis.law).context
        parsed = [(effect_class(entry), Entry.parse(entry).target) for entry in hypothesis.added]
        return all(cls(target).missing(context) is None for cls, target in parsed)

    def _model(self, law: str, entries: Sequence[str]) -> LightCurve:
        base = self._base(law)
        present = [effect.entry for effect in base.effects]
        assembly = assemble(base.scene, self.recording, [*present, *entries], base=base) if entries else base
        model = LightCurve(base.scene, self.recording, assembly=assembly)
        for (other_law, _), other in self._likelihoods.items():
            if other_law == law and other.model.tables_key == model.tables_key:
                return LightCurve(base.scene, self.recording, assembly=assembly, sibling=other.model)
        return model

    def log_odds(self, hypothesis: Hypothesis) -> float:
        """ln of the prior odds: an effect has 1 : (N - 1) of N names, times what its class says, shared by its targets
        and divisions; a way to err NOISE_ODDS times what its class says."""
        if hypothesis not in self._log_odds:
            self._log_odds[hypothesis] = self._prior(hypothesis)
        return self._log_odds[hypothesis]

    def _prior(self, hypothesis: Hypothesis) -> float:
        known = registry()
        kinds = [known[kind].prior_odds if kind != SCALE else 1.0 for kind in hypothesis.noise]
        total = sum(math.log(NOISE_ODDS * odds) for odds in kinds)
        if hypothesis.law:
            total += math.log(LAW_ODDS / len(self.laws) if hypothesis.law in self.laws else SIZES_ODDS)
        names = [Entry.parse(entry).name for entry in self.entries]
        usual = 1 / max(len(set(names) - set(unlisted())) - 1, 1)
        for entry in hypothesis.added:
            name = Entry.parse(entry).name
            total += math.log(effect_class(entry).prior_odds * usual / max(names.count(name), 1))
        return total

    # ------------------------------------------------------------------ candidates

    def candidates(self, only: Sequence[str] | None) -> list[str]:
        """Every physical effect that the scene's list leaves out and these data could carry, as ``name`` or
        ``name[target]``, offsets also divided, and what the library does not hold; of those in ``only`` if given, where a name stands
        for all its targets and divisions."""
        present = {effect.name for effect in self.base.effects}
        entries = []
        for name, cls in nameable().items():
            if cls.stage == "noise" or name in present:
                continue
            for target in cls.targets(self.base.context):
                if cls(target).missing(self.base.context) is None:
                    divided = self.divisions() if cls.divisible else ()
                    entries += [str(Entry(name, target, per)) for per in (None, *divided)]
        if only is None:
            return entries
        asked = set(only)
        return [
            entry
            for entry in entries
            if {entry, (parsed := Entry.parse(entry)).name, Entry(parsed.name, parsed.target).plain} & asked
        ]

    def not_carried(self, only: Sequence[str] | None) -> dict[str, str]:
        """Why, by entry, what ``only`` asks for is no candidate: each that :meth:`candidates` drops, and noise not."""
        context, known = self.base.context, registry()
        present = {effect.name for effect in self.base.effects}
        reasons = {}
        for text in only or ():
            entry = Entry.parse(text)
            cls = known[entry.name]
            if cls.stage == "noise" or self.candidates([text]):
                continue
            if entry.name in present:
                reasons[text] = "it is in the scene's model already"
                continue
            targets = [entry.target] if entry.target is not None else cls.targets(context)
            missing = [
                why for target in targets or [None] if (why := cls(target).missing(context)) is not None
            ]
            reasons[text] = missing[0] if missing else "the scene has nothing that it could be applied to"
        return reasons

    @property
    def has_free_sizes(self) -> bool:
        """Whether the scene gives a size as certain that could be free."""
        return NOMINAL in self._scenes

    def divisions(self) -> list[str]:
        """What an offset may be divided by in this recording: curves, nights where they are not the curves, and objects
        where they are neither and not too many."""
        curves, nights = len(self.recording.curve_ids), len(self.recording.night_ids)
        pairs = len(set(zip(self.recording.curve.tolist(), self.recording.night.tolist(), strict=True)))
        divisions = ["curve"] if curves > 1 else []
        if nights > 1 and not (pairs == curves == nights):
            divisions.append("night")
        objects = self.recording.object
        if objects is not None and 1 < len(self.recording.object_ids) <= MOST_OBJECTS:
            count = len(self.recording.object_ids)
            others = {"curve": self.recording.curve, "night": self.recording.night}
            alike = (
                count == len(np.unique(labels)) == len(set(zip(objects, labels, strict=True)))
                for name, labels in others.items()
                if name in divisions
            )
            if not any(alike):
                divisions.append("object")
        return divisions

    @cached_property
    def kinds(self) -> dict[str, NoiseKind]:
        """The kinds of noise that these data could have beyond the scene's own, by name."""
        context = self.base.context
        present = [effect for effect in self.base.effects if effect.stage == "noise"]
        longest = int(torch.bincount(context.curve).max())
        kinds = {}
        for name, cls in registry().items():
            if not issubclass(cls, NoiseKind) or name in {effect.name for effect in present}:
                continue
            kind = cls()
            able = kind.missing(context) is None and kind.beside(present) is None
            able = able and all(effect.beside([kind]) is None for effect in present)
            if able and not (kind.correlates and longest > LONGEST_CURVE):
                kinds[name] = kind
        return kinds

    def compatible(self, hypothesis: Hypothesis, entry: str) -> bool:
        """Whether an effect may join a set: one that is not there, or the same in another material."""
        if Entry.parse(entry).plain in hypothesis.plain:
            return False
        return effect_class(entry).stage == "material" or Entry.parse(entry).name not in hypothesis.names


def carried(parameters: ParameterSet, theta: Tensor, names: Sequence[str]) -> Tensor:
    """Values (S, P) of another model's theta (S, P') for the parameters that both have; further ones at their starts."""
    values = parameters.start().expand(len(theta), -1).clone()
    column_of = {name: column for column, name in enumerate(names)}
    for column, name in enumerate(parameters.names):
        if name in column_of:
            values[:, column] = theta[:, column_of[name]]
    return values


def effect_columns(parameters: ParameterSet, effect: str) -> list[int]:
    """Indices in theta of the parameters of one effect entry."""
    entry = Entry.parse(effect)
    return [
        index
        for index, free in enumerate(parameters.free)
        if free.origin.role == "effects"
        and free.origin.owner == entry.name
        and entry.target in (None, free.origin.target)
    ]


def effect_starts(parameters: ParameterSet, effect: str, count: int, generator: torch.Generator) -> Tensor:
    """Values (count, k) for the parameters of one effect entry to start from: both signs and sizes 0.3 to 3 of the
    typical, then draws from the prior, as for directions and other wide quantities; offsets of single curves start at
    none. k = 0 for an effect without parameters."""
    entry = Entry.parse(effect)
    quantities = {q.name: q for q in effect_class(effect).quantities}
    ladder = torch.tensor(LADDER, dtype=torch.float64)
    columns = []
    for column in effect_columns(parameters, effect):
        free = parameters.free[column]
        quantity = quantities[free.origin.quantity]
        u = torch.rand(count, generator=generator, dtype=torch.float64)
        draw = free.prior.quantile(0.02 + 0.96 * u)
        if entry.per is not None:
            draw = torch.full_like(draw, free.start)
        elif quantity.off is not None and quantity.typical is not None and math.isfinite(quantity.off):
            sizes = (quantity.off + abs(quantity.typical - quantity.off) * ladder)[:count]
            inside = (sizes > free.prior.low) & (sizes < free.prior.high)
            draw[: len(sizes)] = torch.where(inside, sizes, draw[: len(sizes)])
        columns.append(draw)
    return torch.stack(columns, -1) if columns else torch.zeros(count, 0, dtype=torch.float64)
