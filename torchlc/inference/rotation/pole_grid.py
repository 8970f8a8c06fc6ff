"""Uniform spin on a grid: every pole, period and phase, with reflectances of their own least squares.

Each pass has its phase; passes share pole, period (to the width of a step) and reflectances, so that neither a change
of the period nor the count of turns between passes matters here. Letters: D poles, N passes, G frequencies, H phases,
K reflectances, T rows of a pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import Rows

STEPS = 120
"""Angles of a turn, 3 deg apart, at which light is worked out; phases are every other one."""
NODES = 10
"""Instants of a pass at which the directions of Sun and observer are taken."""
EXPONENTS = (6.0, 60.0)
FLOOR = 0.15
"""Error, as a share of the light, that a grid of these steps has of itself."""
TYPICAL = 0.1
SWEEPS = 25
POLES_AT_ONCE = 8


@dataclass(frozen=True)
class GridState:
    """A place of the grid: pole as a unit vector in GCRS, turns a second, phase of each pass in turns at its middle, and its misfit."""

    pole: Tensor
    frequency: float
    phases: tuple[float, ...]
    misfit: float
    weights: Tensor


def directions(count: int) -> Tensor:
    """Unit vectors (D, 3) spread evenly, on a spiral."""
    k = torch.arange(count, dtype=torch.float64) + 0.5
    z = 1 - 2 * k / count
    longitude = math.pi * (1 + math.sqrt(5)) * k
    ring = torch.sqrt(1 - z * z)
    return torch.stack([ring * torch.cos(longitude), ring * torch.sin(longitude), z], -1)


def frame_of(pole: Tensor) -> Tensor:
    """Rows (..., 3, 3) x, y, z of the frame of `spin_pole` whose z is the unit vector ``pole`` (..., 3)."""
    ring = torch.sqrt((pole[..., 0] ** 2 + pole[..., 1] ** 2).clamp(min=1e-30))
    cos, sin = pole[..., 0] / ring, pole[..., 1] / ring
    z, zero = pole[..., 2], torch.zeros_like(ring)
    x = torch.stack([z * cos, z * sin, -ring], -1)
    y = torch.stack([-sin, cos, zero], -1)
    return torch.stack([x, y, pole], -2)


def search(
    rows: Rows,
    body: FacetLight,
    poles: Tensor,
    frequencies: Tensor,
    *,
    symmetry: int = 1,
    progress: Callable[[float], None] | None = None,
) -> list[GridState]:
    """The best period and phases of each pole, best pole first."""
    found: list[GridState] = []
    for start in range(0, len(poles), POLES_AT_ONCE):
        found += _some(rows, body, poles[start : start + POLES_AT_ONCE], frequencies, symmetry)
        if progress is not None:
            progress(min(1.0, (start + POLES_AT_ONCE) / len(poles)))
    return sorted(found, key=lambda one: one.misfit)


def _some(rows: Rows, body: FacetLight, poles: Tensor, frequencies: Tensor, symmetry: int) -> list[GridState]:
    frame = frame_of(poles)
    products, targets, sizes = [], [], []
    for one in range(rows.passes):
        normal, target, size = _normal_equations(
            rows, body, frame, frequencies, rows.of(one), rows.middle[one], symmetry
        )
        products.append(normal)
        targets.append(target)
        sizes.append(size)
    # reflectances of each place alone, then those that the passes have in common at the best of each
    misfits = [
        _misfit(a, b, non_negative(a, b), size, rows.scaled)
        for a, b, size in zip(products, targets, sizes, strict=True)
    ]
    poles_index = torch.arange(len(poles))
    weights = torch.zeros(0)
    total, phases = torch.zeros(0), []
    for _ in range(3):
        by_frequency = sum(one.amin(-1) for one in misfits)
        assert isinstance(by_frequency, Tensor)
        total, best = by_frequency.min(-1)
        phases = [one[poles_index, best].argmin(-1) for one in misfits]
        chosen = [(poles_index, best, phase) for phase in phases]
        if rows.scaled:
            strength = [b[at].amax(-1).clamp(min=1e-30) for b, at in zip(targets, chosen, strict=True)]
            a = sum(
                a[at] / s[:, None, None] ** 2 for a, at, s in zip(products, chosen, strength, strict=True)
            )
            b = sum(b[at] / s[:, None] ** 2 for b, at, s in zip(targets, chosen, strength, strict=True))
        else:
            a = sum(a[at] for a, at in zip(products, chosen, strict=True))
            b = sum(b[at] for b, at in zip(targets, chosen, strict=True))
        assert isinstance(a, Tensor) and isinstance(b, Tensor)
        weights = non_negative(a, b)
        misfits = [
            _misfit(a, b, weights[:, None, None].expand_as(b), size, rows.scaled)
            for a, b, size in zip(products, targets, sizes, strict=True)
        ]
    by_frequency = sum(one.amin(-1) for one in misfits)
    assert isinstance(by_frequency, Tensor)
    total, best = by_frequency.min(-1)
    phases = [one[poles_index, best].argmin(-1) for one in misfits]
    return [
        GridState(
            poles[k],
            float(frequencies[best[k]]),
            tuple(float(phase[k]) * 2 / STEPS for phase in phases),
            float(total[k]),
            weights[k],
        )
        for k in range(len(poles))
    ]


def _normal_equations(
    rows: Rows,
    body: FacetLight,
    frame: Tensor,
    frequencies: Tensor,
    here: Tensor,
    middle: Tensor,
    symmetry: int,
) -> tuple[Tensor, Tensor, float]:
    """Products (D, G, H, K, K) of the columns and (D, G, H, K) of these with the light, over a pass, and the square of
    the light, all over errors."""
    seconds = rows.seconds[here] - middle
    place = torch.linspace(0, len(here) - 1, min(NODES, len(here))).round().long()
    nodes = here[place]
    nearest = (seconds[:, None] - seconds[place]).abs().argmin(-1)
    sun, observer = (
        torch.einsum("dij,nj->dni", frame, one[nodes]) for one in (rows.to_sun, rows.to_observer)
    )
    angle = torch.arange(STEPS, dtype=torch.float64) * (2 * math.pi / STEPS)
    cos, sin = torch.cos(angle), torch.sin(angle)

    def turned(way: Tensor) -> Tensor:
        x, y, z = (part[..., None] for part in way.unbind(-1))
        return torch.stack([cos * x + sin * y, cos * y - sin * x, z.expand(*z.shape[:-1], STEPS)], -1)

    seen = [turned(one) for one in (sun, observer)]
    lobes = sum(body.lobed)
    first = body.light(seen[0], seen[1], torch.full((lobes,), EXPONENTS[0], dtype=torch.float64))
    tables = [first]
    if lobes:
        second = body.light(seen[0], seen[1], torch.full((lobes,), EXPONENTS[1], dtype=torch.float64))
        tables.append(second[..., len(body.names) :])
    table = torch.cat(tables, -1)  # (D, nodes, STEPS, K)
    weight = 1 / _spread(rows.flux[here], rows.error[here])
    target = rows.flux[here] * weight
    shift = (seconds * frequencies[:, None] * STEPS).round().long()  # (G, T)
    phase = torch.arange(0, STEPS // symmetry, 2)
    step = (shift[:, None] + phase[:, None]) % STEPS  # (G, H, T)
    flat = table.flatten(1, 2)  # (D, nodes STEPS, K)
    columns = flat[:, nearest * STEPS + step] * weight[:, None]  # (D, G, H, T, K)
    products = columns.mT @ columns
    return products, (columns.mT @ target[:, None])[..., 0], float((target**2).sum())


def _spread(flux: Tensor, error: Tensor) -> Tensor:
    """Error (T,) that the light of a grid has at rows of a pass: a share of it, a share of the typical light, and half of what
    changes from row to row, which a phase that is a step off does."""
    change = torch.zeros_like(flux)
    if len(flux) > 2:
        change[1:-1] = (flux[2:] - flux[:-2]).abs() / 4
    typical = flux.abs().median()
    return torch.sqrt((error**2 + FLOOR**2) * flux**2 + change**2 + (TYPICAL * typical) ** 2)


def non_negative(products: Tensor, targets: Tensor) -> Tensor:
    """Least squares (..., K) without negative numbers, from normal equations, by coordinate descent."""
    diagonal = torch.diagonal(products, dim1=-2, dim2=-1)
    safe = diagonal.clamp(min=1e-30)
    found = torch.zeros_like(targets)
    for _ in range(SWEEPS):
        for k in range(targets.shape[-1]):
            slope = targets[..., k] - (products[..., k, :] * found).sum(-1)
            found[..., k] = (found[..., k] + slope / safe[..., k]).clamp(min=0.0)
    return found


def _misfit(products: Tensor, targets: Tensor, weights: Tensor, size: float, scaled: bool) -> Tensor:
    """Sum of squares left; with ``scaled`` after a gain."""
    cross = (targets * weights).sum(-1)
    square = ((products @ weights[..., None])[..., 0] * weights).sum(-1)
    if scaled:
        return size - cross.clamp(min=0) ** 2 / square.clamp(min=1e-30)
    return size - 2 * cross + square
