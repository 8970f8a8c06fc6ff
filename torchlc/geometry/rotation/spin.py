"""The numbers of a spin changed, whichever of them an attitude has: a rate and a phase about a body axis, or a period and a
phase about a pole.

``values`` are numbers by full name, as :meth:`Attitude.rotation` takes them; what is changed is in a new mapping.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

RATE, PERIOD = "attitude.spin_rate", "attitude.period"
PHASES = "attitude.spin_phase", "attitude.phase"
PERIOD_RATE = "attitude.period_rate"
SLOWEST = 1e-9
"""Revolutions in the time of one of the scene's, below which an object is taken to stand still."""


def faster(values: Mapping[str, Tensor], rev_per_hour: Tensor) -> dict[str, Tensor]:
    """The spin faster by ``rev_per_hour`` (...), which may be negative."""
    if PERIOD not in values:
        return {**values, RATE: values[RATE] + rev_per_hour}
    turns = 1 + values[PERIOD] * rev_per_hour
    turns = torch.where(turns.abs() < SLOWEST, SLOWEST, turns)
    return {**values, PERIOD: values[PERIOD] / turns}


def ahead(values: Mapping[str, Tensor], deg: Tensor) -> dict[str, Tensor]:
    """The spin further on by ``deg`` (...), at all times."""
    phase = next(name for name in PHASES if name in values)
    return {**values, phase: values[phase] + deg}


def slowing(
    values: Mapping[str, Tensor], numbers: Mapping[str, float], ms_per_day: Tensor
) -> dict[str, Tensor]:
    """The period growing by ``ms_per_day`` (...) more than in ``values``, or, where these have no growth, than in an
    attitude's own ``numbers``, if it has one."""
    growth = values.get(PERIOD_RATE, numbers.get(PERIOD_RATE, 0.0))
    return {**values, PERIOD_RATE: growth + ms_per_day}


def fastest(bounds: Mapping[str, tuple[float, float]]) -> list[dict[str, Tensor]]:
    """Numbers of an attitude with which it turns fastest within the ``bounds`` of each: those that are fixed, alone, and
    with each end of a free rate, or the least free period."""
    fixed = {name: _number(low) for name, (low, high) in bounds.items() if low == high}
    low, high = bounds.get(RATE, (0.0, 0.0))
    ends = [{RATE: _number(value)} for value in (low, high) if low != high and value != 0]
    low, high = bounds.get(PERIOD, (0.0, 0.0))
    ends += [{PERIOD: _number(low)}] if low != high and low != 0 else []
    return [fixed, *(fixed | end for end in ends)]


def _number(value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)
