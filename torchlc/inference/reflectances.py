"""Reflectances, in which light is linear once everything else is settled: which they are, what light is of them,
and the data as a regression for them needs them.

Letters: B batch, P parameters, K reflectances, T rows.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchlc.lightcurve.model import LightCurve
from torchlc.lightcurve.tables import Tables
from torchlc.noise.error_law import MAG_PER_LN, power_at, power_difference
from torchlc.parameters import FRESNEL, LOBE_REFLECTANCE, REFLECTANCE

LINEAR = frozenset({REFLECTANCE, LOBE_REFLECTANCE, FRESNEL})
"""Roles of the numbers of which light is linear, unless the law says otherwise."""
REWEIGHTED = 2
"""Times that a regression is done again about its own result, so that it is one of magnitudes, not of flux."""


def linear_columns(model: LightCurve) -> list[int]:
    """Columns of theta that are reflectances, of which light is linear, and do not move the geometry."""
    moving = set(model.assembly.geometry_columns)
    laws = model.assembly.models
    curved = {(owner, name) for owner, law in laws.items() for name in law.curved}
    return [
        i
        for i, free in enumerate(model.parameter_set.free)
        if free.role in LINEAR and i not in moving and (free.origin.owner, free.origin.quantity) not in curved
    ]


def linear_light(model: LightCurve, x: Tensor, linear: list[int]) -> tuple[Tensor, Tensor]:
    """Flux (B, T) at straight coordinates x (B, P) with the ``linear`` ones at zero, and what each of them adds
    for a whole one (B, T, K), bounces between parts left out: these are products."""
    served = model.evaluator.served(model.parameter_set.from_straight(x)[0])
    if bool(served.all()):
        return _of_tables(model, x, linear)
    pieces = [x.new_zeros(len(x), model.assembly.T), x.new_zeros(len(x), model.assembly.T, len(linear))]
    for way, chosen in ((_of_tables, served), (_anew, ~served)):
        rows = torch.nonzero(chosen)[:, 0]
        if len(rows):
            light = way(model, x[rows], linear)
            pieces = [whole.index_copy(0, rows, part) for whole, part in zip(pieces, light, strict=True)]
    return pieces[0], pieces[1]


def _units(x: Tensor, linear: list[int]) -> Tensor:
    """Straight coordinates (K + 1, P) with no reflectance, then with one whole and no other."""
    units = x[:1].repeat(len(linear) + 1, 1)
    units[:, linear] = 0.0
    for index, column in enumerate(linear):
        units[index + 1, column] = 1.0
    return units


def _anew(model: LightCurve, x: Tensor, linear: list[int]) -> tuple[Tensor, Tensor]:
    """`linear_light` by as many calls as there are reflectances, and one."""
    units = _units(x, linear)
    points = x[:, None].repeat(1, len(units), 1)
    points[:, :, linear] = units[:, linear]
    flux = model.brightness(model.parameter_set.from_straight(points)[0]).flux
    return flux[:, 0], (flux[:, 1:] - flux[:, :1]).transpose(1, 2)


def _of_tables(model: LightCurve, x: Tensor, linear: list[int]) -> tuple[Tensor, Tensor]:
    """`linear_light` where tables serve all: the lobes are those of one evaluation, only their shares differ."""
    parameters, evaluator = model.parameter_set, model.evaluator
    units = _units(x, linear)
    whole = dict(zip(parameters.names, parameters.from_straight(units)[0].unbind(-1), strict=True))
    names = [parameters.names[column] for column in linear]
    none = {name: whole[name][:1] for name in names}
    pieces, dark = [], []
    size = max(1, evaluator.batch_size(_direct(model, x[:1])) // len(units))
    for rows in x.split(size):
        theta = parameters.from_straight(rows)[0][:, None]
        values = parameters.values(theta)
        tables = evaluator.tables_at(theta, model.assembly.needs_shares)
        assert tables is not None  # they serve
        direct = replace(tables, scatter=())
        light = model.shine(direct, {**values, **{name: whole[name] for name in names}}).flux
        pieces.append(light.expand(len(rows), len(units), -1))
        if tables.scatter:
            dark.append(model.shine(tables, {**values, **none}).flux[:, 0])
    flux = torch.cat(pieces)
    design = (flux[:, 1:] - flux[:, :1]).transpose(1, 2)
    return (torch.cat(dark) if dark else flux[:, 0]), design


def _direct(model: LightCurve, x: Tensor) -> Tables:
    tables = model.evaluator.tables_at(model.parameter_set.from_straight(x)[0], model.assembly.needs_shares)
    assert tables is not None  # asked where they serve
    return replace(tables, scatter=())


def about(
    dark: Tensor, design: Tensor, values: Tensor, observed: Tensor, power: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Flux (B, T) to compare with, and the flux that a magnitude's error is relative to, for a regression of
    magnitudes, or of a ``power`` (T,) of flux, about reflectances ``values`` (B, K): the tangent of the logarithm or
    the power there."""
    predicted = dark + (values[:, None] @ design.mT)[:, 0]  # seven times as fast as the other way round
    near = torch.minimum(torch.maximum(predicted, 0.2 * observed), 5.0 * observed)
    if power is None:
        return near * (1.0 + torch.log(observed / near)), near
    difference, share = power_difference(observed / near, power_at(power, near / observed))
    return near * (1.0 + difference / MAG_PER_LN), near * share
