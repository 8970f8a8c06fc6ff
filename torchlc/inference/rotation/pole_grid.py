"""Uniform spin on a grid: every pole, period and phase, with reflectances of their own least squares.

Each pass has its phase, and a frequency within what it may have changed since the longest pass; all share pole and
reflectances, so that neither a change of the period nor the count of turns between passes matters here. Letters: D
poles, N passes, G frequencies, H phases, K reflectances, T rows of a pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import Rows
from torchlc.tensors.non_negative import non_negative

STEPS = 120
"""Angles of a turn, 3 deg apart, at which light is worked out; phases are every other one."""
NODES = 10
NODE_STEP = 0.08
"""Most instants of a pass at which the directions of Sun and observer are taken, and how far these may move between, rad."""
EXPONENTS = (6.0, 60.0)
"""Of the lobe of each material, one wide and one narrow: their mixture is like most lobes between."""
FLOOR = 0.15
"""Error, as a share of the light, that a grid of these steps has of itself."""
TYPICAL = 0.1
"""Of the light that is typical: dim rows do not outweigh all others."""
ROUNDING = 1e-12
"""Share of the largest sum below which a correlation by FFT, which errs by 1e-16 to 1e-15 of it, says nothing."""
POLES_AT_ONCE = 8
"""Whose light is held together."""
DRIFT_SD = 2.0
"""Standard deviations by which the frequency of a pass may differ from that of the longest."""


@dataclass(frozen=True)
class GridState:
    """A place of the grid: pole as a unit vector in GCRS; turns a second in each pass, and its phase in turns at its middle; the misfit."""

    pole: Tensor
    frequencies: tuple[float, ...]
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
    states: list[GridState] = []
    for start in range(0, len(poles), POLES_AT_ONCE):
        states += _some(rows, body, poles[start : start + POLES_AT_ONCE], frequencies, symmetry)
        if progress is not None:
            progress(min(1.0, (start + POLES_AT_ONCE) / len(poles)))
    return sorted(states, key=lambda state: state.misfit)


def _some(rows: Rows, body: FacetLight, poles: Tensor, frequencies: Tensor, symmetry: int) -> list[GridState]:
    frame = frame_of(poles)
    products, targets, sizes = [], [], []
    for passed in range(rows.passes):
        normal, target, size = _normal_equations(
            rows, body, frame, frequencies, rows.of(passed), rows.middle[passed], symmetry
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
    allowed = [
        DRIFT_SD * float(drift) * frequencies[:, None] >= (frequencies - frequencies[:, None]).abs()
        for drift in rows.drift
    ]
    weights = torch.zeros(0, dtype=torch.float64)
    for turn in range(4):
        by_frequency = [misfit.amin(-1) for misfit in misfits]
        least = [_least(misfit, near) for misfit, near in zip(by_frequency, allowed, strict=True)]
        total, best = torch.stack([value for value, _ in least]).sum(0).min(-1)
        turning = [at[poles_index, best] for _, at in least]
        phases = [misfit[poles_index, at].argmin(-1) for misfit, at in zip(misfits, turning, strict=True)]
        if turn == 3:
            break
        chosen = [(poles_index, at, phase) for at, phase in zip(turning, phases, strict=True)]
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
    return [
        GridState(
            poles[k],
            tuple(float(frequencies[at[k]]) for at in turning),
            tuple(float(phase[k]) * 2 / STEPS for phase in phases),
            float(total[k]),
            weights[k],
        )
        for k in range(len(poles))
    ]


def _least(misfit: Tensor, allowed: Tensor) -> tuple[Tensor, Tensor]:
    """The least of misfits (D, G) among the frequencies allowed (G, G) with each of G, and which it is."""
    if int(allowed.sum()) == len(allowed):
        return misfit, torch.arange(len(allowed)).expand_as(misfit)
    return torch.where(allowed, misfit[:, None], torch.inf).min(-1)


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
    the light, all over errors. Rows are put on steps of a turn, and all phases follow by one correlation."""
    seconds = rows.seconds[here] - middle
    chosen = instants(rows, here)
    nodes = here[chosen]
    nearest = (seconds[:, None] - seconds[chosen]).abs().argmin(-1)
    sun, observer = (
        torch.einsum("dij,nj->dni", frame, vectors[nodes]) for vectors in (rows.to_sun, rows.to_observer)
    )
    angle = torch.arange(STEPS, dtype=torch.float64) * (2 * math.pi / STEPS)
    cos, sin = torch.cos(angle), torch.sin(angle)

    def turned(way: Tensor) -> Tensor:
        x, y, z = (part[..., None] for part in way.unbind(-1))
        return torch.stack([cos * x + sin * y, cos * y - sin * x, z.expand(*z.shape[:-1], STEPS)], -1)

    table = columns_of(body, turned(sun), turned(observer))  # (D, nodes, STEPS, K)
    weight = 1 / spread(rows.flux[here], rows.error[here])
    target = rows.flux[here] * weight
    shift = (seconds * frequencies[:, None] * STEPS).round().long() % STEPS  # (G, T)
    at = nearest * STEPS + shift
    binned = table.new_zeros(2, len(frequencies), len(chosen) * STEPS)
    for index, value in enumerate((weight**2, weight * target)):
        binned[index].scatter_add_(1, at, value.expand_as(at))
    binned = binned.unflatten(-1, (len(chosen), STEPS))
    phase = torch.arange(0, STEPS // symmetry, 2)
    first, second = torch.triu_indices(table.shape[-1], table.shape[-1])
    squares = _correlated(table[..., first] * table[..., second], binned[0])
    # a column that is dark at a phase keeps the rounding of the correlation, which is of its brightest phase
    least = ROUNDING * squares.amax(2, keepdim=True)
    squares = torch.where(squares > least, squares, 0.0)[:, :, phase]
    products = squares.new_empty(*squares.shape[:-1], table.shape[-1], table.shape[-1])
    products[..., first, second] = products[..., second, first] = squares
    return products, _correlated(table, binned[1])[:, :, phase], float((target**2).sum())


def columns_of(body: FacetLight, to_sun: Tensor, to_observer: Tensor) -> Tensor:
    """Light (..., K) of each reflectance at directions (..., 3) in the body, with a wide and a narrow lobe for each that has
    one."""
    lobes = sum(body.lobed)
    wide, narrow = (torch.full((lobes,), exponent, dtype=torch.float64) for exponent in EXPONENTS)
    first = body.light(to_sun, to_observer, wide)
    if not lobes:
        return first
    return torch.cat([first, body.light(to_sun, to_observer, narrow)[..., len(body.names) :]], -1)


def instants(rows: Rows, here: Tensor) -> Tensor:
    """Which of the rows of a pass stand for the directions of all: as many as the directions move."""
    moved = max(
        float(torch.linalg.vector_norm(vectors[here].diff(dim=0), dim=-1).sum())
        for vectors in (rows.to_sun, rows.to_observer)
    )
    count = max(2, min(NODES, len(here), math.ceil(moved / NODE_STEP) + 1))
    return torch.linspace(0, len(here) - 1, count, dtype=torch.float64).round().long()


def _correlated(table: Tensor, binned: Tensor) -> Tensor:
    """(D, G, STEPS, K): sums over instants and steps s of ``binned`` (G, nodes, STEPS) times ``table`` (D, nodes, STEPS, K)
    at s + p, for each p."""
    spectrum = torch.fft.rfft(table, dim=2)
    weights = torch.fft.rfft(binned, dim=-1).conj()
    return torch.fft.irfft(torch.einsum("gns,dnsk->dgsk", weights, spectrum), n=STEPS, dim=2)


def spread(flux: Tensor, error: Tensor) -> Tensor:
    """Error (T,) that the light of a grid has at rows of a pass: a share of it, a share of the typical light, and half of what
    changes from row to row, which a phase that is a step off does."""
    change = torch.zeros_like(flux)
    if len(flux) > 2:
        change[1:-1] = (flux[2:] - flux[:-2]).abs() / 4
    typical = flux.abs().median()
    return torch.sqrt((error**2 + FLOOR**2) * flux**2 + change**2 + (TYPICAL * typical) ** 2)


def _misfit(products: Tensor, targets: Tensor, weights: Tensor, size: float, scaled: bool) -> Tensor:
    """Sum of squares left; with ``scaled`` after a gain."""
    cross = (targets * weights).sum(-1)
    square = ((products @ weights[..., None])[..., 0] * weights).sum(-1)
    if scaled:
        return size - cross.clamp(min=0) ** 2 / square.clamp(min=1e-30)
    return size - 2 * cross + square
