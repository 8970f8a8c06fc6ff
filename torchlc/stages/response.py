"""What effects of a detector share that resolves the object, and is not linear in radiance."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from torchlc.stages.effect import Context
from torchlc.stages.light import Patch, Response, View


def not_resolved(context: Context) -> str | None:
    """Why the radiance of parts of the object has no bearing on these data, in words; None if it may have."""
    if not any(context.models[name].radiance_as_irradiance for name in context.materials):
        return "no material is of Lambert's law, whose radiance is the irradiance times a number"
    return context.a_point


def recorded(patches: tuple[Patch, ...], view: View, name: str, value: Tensor) -> tuple[Patch, ...]:
    """Patches whose radiance is recorded with a number of the response, (..., 1 or T), in the place of a linear detector's."""
    number = view.every(value)
    unit, none = number.new_ones(1, 1), number.new_zeros(1, 1)
    linear = Response(unit, none, none)
    return tuple(
        replace(patch, response=replace(patch.response or linear, **{name: number}))
        if patch.model.radiance_as_irradiance
        else patch
        for patch in patches
    )
