"""The effects of a model: those that are asked for, or that usually act, made ready for the data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from torchlc.effects import nameable, object_kind, registry
from torchlc.errors import InputError
from torchlc.lightcurve.given import from_population, given_number
from torchlc.lightcurve.numbers import prior_within
from torchlc.parameters import Prior, Quantity
from torchlc.scene import Free as SceneFree
from torchlc.scene import Number, Scene
from torchlc.scene.problems import shown
from torchlc.stages.effect import Context, Effect
from torchlc.stages.entry import Entry
from torchlc.suggest import did_you_mean


def held_already(wanted: Sequence[str], context: Context) -> dict[str, str]:
    """Entries of a scene's list that a model of these data has without them, and why."""
    known = registry()
    asked = ((entry, known.get(Entry.parse(entry).name)) for entry in wanted)
    reasons = {entry: cls().held_already(context) for entry, cls in asked if cls is not None}
    return {entry: reason for entry, reason in reasons.items() if reason is not None}


def effects_of(wanted: Sequence[str] | None, scene: Scene, context: Context) -> tuple[Effect, ...]:
    known = nameable()
    numbers = frozenset(scene.origins())
    parts = frozenset(component.name for component in scene.components)

    def made(effect: Effect, by: str | None = None, width: float | None = None) -> Effect:
        effect.taken, effect.by, effect.width = numbers | parts, by, width
        return effect

    effects: list[Effect] = []
    if wanted is None:
        standard = [effect for cls in registry().values() if (effect := cls()).standard(context)]
        effects = [made(effect) for effect in standard if effect.missing(context) is None]
    asked = list(wanted or ())
    if from_population(scene) and (differ := object_kind().name) not in asked:
        asked.append(
            differ
        )  # what a zero point of each object amounts to: the population's, and noise that its rows share
    for entry in asked:
        parsed = Entry.parse(entry)
        name, target = parsed.name, parsed.target
        if name not in known:
            raise InputError(
                scene.source,
                "model.effects",
                f"{shown(entry)} is no effect",
                f"one of the {len(known)} that torchlc effects lists",
                did_you_mean(name, known),
            )
        cls = known[name]
        targets = [target] if target else _set_targets(cls, scene) or cls.targets(context) or [None]
        for chosen_target in targets:
            effect = cls(chosen_target)
            reason = effect.missing(context)
            if reason is None and chosen_target not in cls.targets(context):
                reason = "it has no target: it is of the whole object"
            if reason is not None:
                raise InputError(
                    scene.source,
                    "model.effects",
                    f"{Entry(name, chosen_target).plain} cannot be applied: {reason}",
                )
            _check_axes(effect, scene, context)
            effects.append(made(effect, parsed.per, parsed.width))
    for effect in effects:
        reason = effect.beside([other for other in effects if other is not effect])
        if reason is not None:
            raise InputError(scene.source, "model.effects", f"{effect.name} cannot be applied: {reason}")
    order = list(known)
    return tuple(sorted(effects, key=lambda effect: order.index(effect.name)))


def _set_targets(cls: type[Effect], scene: Scene) -> list[str]:
    """Targets that [model.parameters] names in brackets for an effect that has one set of parameters for
    each."""
    if cls.per is None:
        return []
    marked = [
        key.partition("[")[2].rstrip("]") for key in scene.model.parameters if key.startswith(f"{cls.name}.")
    ]
    return [target for target in dict.fromkeys(marked) if target]


def _check_axes(effect: Effect, scene: Scene, context: Context) -> None:
    """InputError where an effect on a material gives it numbers along u and v, and the facets of a part of it have no such axes."""
    numbers = {quantity.name for quantity in effect.quantities}
    for component in scene.components if effect.stage == "material" else ():
        if component.axes_wanted is None:
            continue
        apart = context.models[component.material].along_axes
        if effect.target in (None, component.material) and len(numbers.intersection(apart)) > 1:
            found = f"{effect.name} has {' and '.join(apart)} apart, and the {component.shape} says nothing of the direction of u"
            raise InputError(scene.source, f"component {component.name!r}", found, component.axes_wanted)


def prepared(
    effects: Sequence[Effect], scene: Scene, context: Context, pinned: Mapping[str, float]
) -> tuple[tuple[Effect, ...], Context]:
    """The effects made ready for these data, and the context that knows of them and of their numbers' bounds."""
    bounds: dict[str, tuple[float, float]] = {}

    def bound(name: str, number: Number | None, quantity: Quantity) -> None:
        if name in pinned:
            bounds[name] = (pinned[name], pinned[name])
        elif isinstance(number, SceneFree):
            several = [number.of(member) for member in number.values or ()]
            ends = [_ends(entry, quantity) for entry in (number, *several)]
            bounds[name] = (min(low for low, _ in ends), max(high for _, high in ends))
        elif number is not None:
            bounds[name] = (float(number), float(number))
        elif quantity.unless_set is not None:
            bounds[name] = (quantity.unless_set, quantity.unless_set)
        else:
            bounds[name] = (quantity.low, quantity.high)

    numbers = scene.numbers()
    for name, origin in scene.origins().items():
        if origin.role == "attitude":
            bound(origin.full_name(), numbers[name], Quantity(name, "", -math.inf, math.inf, ""))
    for effect in effects:
        for quantity in effect.quantities:
            name = effect.full_name(quantity.name)
            bound(name, None if effect.by else given_number(effect, quantity, scene), quantity)
    context = replace(context, bounds=bounds, effects=effects)
    # how finely exposures are divided depends on what the others do
    others = [effect if effect.spans_exposure else effect.prepared(context) for effect in effects]
    context = replace(context, effects=others)
    ready = tuple(effect.prepared(context) if effect.spans_exposure else effect for effect in others)
    return ready, replace(context, effects=ready)


def _ends(number: SceneFree, quantity: Quantity) -> tuple[float, float]:
    """Between what a number lies: itself where it is fixed."""
    if number.sigma is number.low is number.high is None:
        return number.value, number.value
    prior = prior_within(number, quantity)
    return _end(prior, -1.0), _end(prior, 1.0)


def _end(prior: Prior, side: float) -> float:
    """The lower (side -1) or upper (1) end of a prior, five standard deviations away where it has none."""
    end = prior.low if side < 0 else prior.high
    return end if math.isfinite(end) else prior.centre + side * 5 * prior.sigma
