"""The numbers of a model, free and fixed: those of the scene, the zero point, and those of its effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, cast

from torch import Tensor

from torchlc.brdf.base import Brdf
from torchlc.errors import InputError
from torchlc.lightcurve.given import cut, from_population, given_number
from torchlc.naming import Origin
from torchlc.parameters import Free, ParameterSet, Prior, Quantity
from torchlc.parameters.prior import prior_of
from torchlc.scene import Free as SceneFree
from torchlc.scene import Number, Scene
from torchlc.stages.effect import Effect

ZERO_POINT = Quantity("zero_point", "mag", -math.inf, math.inf, "offset added to every magnitude", off=0.0)
POLE_LATITUDE = Quantity("pole_lat", "deg", -90.0, 90.0, "latitude of the pole", prior="isotropic")


@dataclass
class Numbers:
    """The numbers of a model as they are gathered, in the order of the vector of the free ones."""

    scene: Scene
    models: Mapping[str, type[Brdf]]
    row_index: Mapping[str, tuple[Tensor, Sequence[str]]]
    pinned: Mapping[str, float]
    free: list[Free] = field(default_factory=list)
    fixed: dict[str, float] = field(default_factory=dict)
    divided: dict[str, str] = field(default_factory=dict)
    """By full name, what a number has a value for each of."""
    origins: dict[str, Origin] = field(default_factory=dict)
    """By full name, whose each number is, free or fixed."""
    warnings: list[str] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        scene: Scene,
        effects: Sequence[Effect],
        models: Mapping[str, type[Brdf]],
        row_index: Mapping[str, tuple[Tensor, Sequence[str]]],
        pinned: Mapping[str, float],
    ) -> Numbers:
        """Those of the scene, the zero point, and those of the effects."""
        numbers = cls(scene, models, row_index, pinned)
        numbers.add_scene()
        numbers.add_zero_point()
        for effect in effects:
            numbers.add_effect(effect)
        return numbers

    def parameters(self, effects: Sequence[Effect]) -> ParameterSet:
        """The vector of the free ones, with the pairs of reflectances whose sum is at most 1."""
        names = {origin: name for name, origin in self.scene.origins().items()}
        pairs, coupled = [], set()
        for material in self.scene.materials:
            model = self.models[material]
            for a, b in pairwise(model.simplex):
                pairs.append(
                    (names[Origin("materials", material, a)], names[Origin("materials", material, b)])
                )
                coupled |= {pairs[-1]} if model.coupled else set()
        for effect in effects:
            for a, b in pairwise(effect.simplex):
                pairs.append((effect.full_name(a), effect.full_name(b)))
                coupled |= {pairs[-1]} if effect.coupled else set()
        return ParameterSet(self.free, self.fixed, pairs, coupled=coupled)

    def add_scene(self) -> None:
        numbers = self.scene.numbers()
        components = {component.name: component for component in self.scene.components}
        for name, origin in self.scene.origins().items():
            short = origin.quantity
            if origin.role == "materials":
                quantity = self.models[origin.owner].quantity(short)
            elif origin.role == "components":
                quantity = Quantity(short, "m", 0.0, math.inf, components[origin.owner].meaning(short))
            elif origin.role == "attitude" and short == POLE_LATITUDE.name:
                quantity = POLE_LATITUDE
            else:
                meaning, unit = self.scene.attitude.MEANINGS[short]
                quantity = Quantity(short, unit, -math.inf, math.inf, meaning)
            self.add(name, origin, numbers[name], quantity)

    def add_zero_point(self) -> None:
        number = self.scene.model.parameters.get("zero_point", 0.0)
        if isinstance(number, SceneFree) and from_population(self.scene):
            if number.values is not None:
                expected = "no values: the offsets of objects are integrated out"
                place = "model.parameters.zero_point.values"
                raise InputError(self.scene.source, place, "a table", expected)
            number = number.model_copy(update={"per": None})  # that of the population
        self.add("zero_point", Origin("calibration", "", "zero_point"), number, ZERO_POINT)

    def add_effect(self, effect: Effect) -> None:
        for quantity in effect.quantities:
            name, origin = effect.full_name(quantity.name), effect.origin(quantity.name)
            if effect.by is not None:
                self.divide(name, origin, divided_offset(effect, quantity), quantity)
                continue
            number = given_number(effect, quantity, self.scene)
            if isinstance(number, SceneFree):
                self.warnings += cut(name, number, quantity)
            whole = effect.brdf is not None or effect.stage == "material"
            if whole and isinstance(number, SceneFree) and number.per is not None:
                of = "a part" if effect.brdf is not None else "of a material"
                place, expected = f"{name}.per", f"one value for the whole recording: the effect is {of}"
                raise InputError(self.scene.source, f"model.parameters.{place}", f'"{number.per}"', expected)
            self.add(name, origin, number, quantity)

    def add(self, name: str, origin: Origin, number: Number | None, quantity: Quantity) -> None:
        """One number as the scene gives it; of an effect whose number it does not give, that of the effect."""
        self.origins[name] = origin
        if name in self.pinned:
            self.fixed[name] = self.pinned[name]
        elif number is None and quantity.unless_set is not None:
            self.fixed[name] = quantity.unless_set
        elif number is None:
            start = quantity.mean if quantity.mean is not None else quantity.typical
            self._free(name, origin, prior_of(quantity), 0.0 if start is None else start, quantity)
        elif isinstance(number, SceneFree):
            self._check_isotropy(name, number, quantity)
            self.divide(name, origin, number, quantity)
        else:
            self.fixed[name] = float(number)

    def divide(self, name: str, origin: Origin, number: SceneFree, quantity: Quantity) -> None:
        """One free number, or one for each member of a division, free or fixed."""
        division = number.per
        members = [(name, origin, number)]
        if division is not None:
            if division not in self.row_index:
                found, expected = f'per = "{division}"', f"a column {division}, which the recording lacks"
                raise InputError(self.scene.source, name, found, expected)
            self.divided[name] = division
            ids = self.row_index[division][1]
            members = [
                (f"{name}[{member}]", origin.of(division, member), number.of(member)) for member in ids
            ]
            self.warnings += _unmet(name, number, ids)
        for full, whose, member_number in members:
            self.origins[full] = whose
            if full in self.pinned:
                self.fixed[full] = self.pinned[full]
            elif number.fixed:
                self.fixed[full] = member_number.value
            else:
                self._free(full, whose, prior_within(member_number, quantity), member_number.value, quantity)

    def _free(self, name: str, origin: Origin, prior: Prior, start: float, quantity: Quantity) -> None:
        self.free.append(Free(name, prior, start, quantity.unit, quantity.meaning, origin, quantity.role))

    def _check_isotropy(self, name: str, number: SceneFree, quantity: Quantity) -> None:
        """InputError where a prior uniform on the sphere is given to what is no latitude; a word where it is not given to one."""
        if number.prior == "isotropic" and quantity.prior != "isotropic":
            raise InputError(
                self.scene.source,
                f"{name}.prior",
                '"isotropic" for a number that is no latitude of a direction',
                "another prior",
                "The longitude of a direction that may point anywhere is uniform.",
            )
        if quantity.prior == "isotropic" and "prior" not in number.model_fields_set:
            self.warnings.append(
                f"{name} has a prior uniform in degrees, which favours directions near the poles; "
                'prior = "isotropic" is uniform on the sphere'
            )


def divided_offset(effect: Effect, quantity: Quantity) -> SceneFree:
    """The prior of an offset that an effect divides, as a scene would give it."""
    alone = effect.width is None and quantity.apart is not None
    sigma = quantity.apart if alone else effect.width or quantity.sigma or 1.0
    return SceneFree(
        value=quantity.off or 0.0,
        sigma=sigma,
        prior="cauchy" if alone else "normal",
        per=cast(Any, effect.by),
    )


def _unmet(name: str, number: SceneFree, members: Sequence[str]) -> list[str]:
    """What has to be said where the values of a number and the nights, say, of the recording are not the same."""
    if number.values is None:
        return []
    lacking = [member for member in members if member not in number.values]
    spare = [member for member in number.values if member not in members]
    sentences = []
    if lacking:
        sentences.append(
            f"{name} has no value for the {number.per} {', '.join(lacking)}: {number.value:g} is taken"
        )
    if spare:
        sentences.append(f"{name} has values for no {number.per} of the recording: {', '.join(spare)}")
    return sentences


def prior_within(number: SceneFree, quantity: Quantity) -> Prior:
    kind = number.prior or ("normal" if number.sigma is not None else "uniform")
    low = -math.inf if number.low is None else number.low
    high = math.inf if number.high is None else number.high
    low, high = max(low, quantity.low), min(high, quantity.high)
    if kind == "lognormal":
        low = max(low, 0.0)
    if kind == "halfnormal":
        low = max(low, 0.0)
        return Prior(kind, low, high, low, number.sigma or 1.0)
    return Prior(kind, low, high, number.value, number.sigma or 1.0)
