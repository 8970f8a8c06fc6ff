"""What [model.parameters] of a scene gives to its effects."""

from __future__ import annotations

import math
from collections.abc import Sequence

from torchlc.effects import nameable
from torchlc.errors import InputError
from torchlc.parameters import Quantity
from torchlc.scene import Free as SceneFree
from torchlc.scene import Number, Scene
from torchlc.scene.checks import PARAMETER_KEY
from torchlc.scene.problems import shown
from torchlc.stages.effect import Context, Effect
from torchlc.suggest import did_you_mean


def check_given(scene: Scene, context: Context) -> None:
    """InputError where [model.parameters] gives a number that its effect does not have, or not on that target."""
    for key in scene.model.parameters:
        match = PARAMETER_KEY.fullmatch(key)
        if match is None:
            continue
        name, quantity, target = match["effect"], match["quantity"], match["target"]
        place, known = f'model.parameters."{key}"', nameable()
        if name not in known:
            found, expected = (
                f"unknown effect {shown(name)}",
                f"one of the {len(known)} that torchlc effects lists",
            )
            raise InputError(scene.source, place, found, expected, did_you_mean(name, known))
        numbers = [number.name for number in known[name].quantities]
        if quantity not in numbers:
            expected = f"one of {', '.join(numbers)}" if numbers else "no such key: the effect has no numbers"
            hint = did_you_mean(quantity, numbers)
            raise InputError(scene.source, place, f"{name} has no number {shown(quantity)}", expected, hint)
        if target is None:
            continue
        targets = [candidate for candidate in known[name].targets(context) if candidate is not None]
        if target not in targets:
            expected = f"one of {', '.join(targets)}" if targets else f'"{name}.{quantity}", without brackets'
            found, hint = f"{name} cannot be applied to {shown(target)}", did_you_mean(target, targets)
            raise InputError(scene.source, place, found, expected, hint)


def keys_of(effect: Effect, quantity: Quantity) -> tuple[str, str]:
    """How [model.parameters] may name a number of an effect: with its target, or for all targets at once."""
    return effect.origin(quantity.name).full_name(), f"{effect.name}.{quantity.name}"


def given_number(effect: Effect, quantity: Quantity, scene: Scene) -> Number | None:
    """What [model.parameters] says of an effect's number; InputError where its value is beyond the number's range."""
    given = scene.model.parameters
    key = next((key for key in keys_of(effect, quantity) if key in given), None)
    if key is None:
        return None
    number = given[key]
    for value in number.starts if isinstance(number, SceneFree) else [float(number)]:
        if not quantity.low <= value <= quantity.high:
            place = f'model.parameters."{key}"' + (".value" if isinstance(number, SceneFree) else "")
            raise InputError(scene.source, place, f"{value:g}", range_of(quantity))
    return number


def cut(name: str, number: SceneFree, quantity: Quantity) -> list[str]:
    """A sentence where a prior reaches beyond the range of its number."""
    beyond = (number.low is not None and number.low < quantity.low) or (
        number.high is not None and number.high > quantity.high
    )
    return [f"the prior of {name} is cut to {range_of(quantity)}, the range of this number"] if beyond else []


def range_of(quantity: Quantity) -> str:
    unit = f" {quantity.unit}" if quantity.unit else ""
    if quantity.high == math.inf:
        return f"{quantity.low:g}{unit} or more"
    return f"{quantity.low:g} to {quantity.high:g}{unit}"


def unused(scene: Scene, effects: Sequence[Effect]) -> list[str]:
    """A sentence for each number of [model.parameters] that none of the model's effects has."""
    names = {effect.name for effect in effects}
    used = {key for effect in effects for quantity in effect.quantities for key in keys_of(effect, quantity)}
    warnings = []
    for key in scene.model.parameters:
        match = PARAMETER_KEY.fullmatch(key)
        if match is None or key in used:
            continue
        why = (
            f"{match['effect']} takes what it needs from the recording"
            if match["effect"] in names
            else f"{match['effect']} is not among the model's effects; a diagnosis takes it as a prior"
        )
        warnings.append(f"[model.parameters] {key} is not used: {why}")
    return warnings


def from_population(scene: Scene) -> bool:
    """Whether each object has a zero point of its own, from a population whose spread is learnt."""
    number = scene.model.parameters.get("zero_point")
    return isinstance(number, SceneFree) and number.per == "object"
