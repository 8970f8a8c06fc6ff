"""States of free rotation on a grid: directions of the angular momentum, moments of inertia, and both phases of each pass.

For a direction of the angular momentum L, light depends on where L points in the body and on the turn about it. It is worked out once, for
directions in the body and as a Fourier series in the turn; each state is a path among these, and all pairs of phases follow from one
correlation on the torus of both. Letters: D directions of L, V directions in the body, N instants of a pass, W steps of the way
round the body, H harmonics of the turn, S turns, G nutations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.geometry.rotation.rigid_body import free_rotation, frequencies
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.pole_grid import directions, frame_of, instants, spread
from torchlc.inference.rotation.two_frequencies import FrequencyPair

WAY_STEPS, TURN_STEPS, HARMONICS = 36, 48, 16
"""Steps of the torus, and harmonics of the turn that are kept: features of less than 20 deg are smoothed."""
POLES, BODY = 110, 400
"""Directions of L in space, 20 deg apart, and in the body, 10 deg apart."""
EXPONENT = 20.0
"""Of every lobe: as wide as the grid of directions is fine."""
MASSES = 9
"""Steps of the triangle of the second moments of mass about the planes of the body: 45 bodies."""
NUTATIONS = 64
"""Angles of nutation at which the two periods are worked out, 1.4 deg apart."""
POLES_AT_ONCE = 22
"""Directions of L whose light is held at once: 120 MB a pass for each instant."""
KEPT = 6
"""Places of a state that are kept, of different directions of L."""
MOST_PASSES = 3
"""The longest: a pass more takes as long as each before it, and the rest is joined afterwards."""
DARK, ALONG = 0.1, 0.01
"""Share of the mean square of a column below which it is dark, and square of the sine between columns below which they are one: a
series cut at its HARMONICS swings by so much beside a glint."""


@dataclass(frozen=True)
class TumbleState:
    """Unit vector of L (GCRS); mean turns of the long axis, 1/s; moments (3,), the third 1; nutation, rad; phases of the
    turn and of the way round the body at the middle of each pass, in turns as of :func:`free_rotation`; the misfit."""

    pole: Tensor
    long: float
    moments: Tensor
    nutation: float
    phases: tuple[float, ...]
    ways: tuple[float, ...]
    misfit: float


def bodies(count: int = MASSES) -> Tensor:
    """Moments of inertia (Q, 3), the third 1, over all possible ones: shares of the second moments of mass on a triangle."""
    shares = [
        [i + 1 / 3, j + 1 / 3, count - 1 - i - j + 1 / 3] for i in range(count) for j in range(count - i)
    ]
    mass = torch.tensor(shares, dtype=torch.float64)
    moments = mass.sum(-1, keepdim=True) - mass
    return moments / moments[:, 2:]


def nutation_of(moments: Tensor, pair: FrequencyPair) -> float | None:
    """The nutation, rad, with which a body of these moments (3,) has a pair's ratio of frequencies in its mode; None if
    none has."""
    angle = (torch.arange(NUTATIONS, dtype=torch.float64) + 0.5) * (math.pi / 2 / NUTATIONS)
    motion = frequencies(moments.expand(NUTATIONS, 3), angle, torch.ones_like(angle))
    ratio = motion.polhode / motion.precession_long - pair.polhode / pair.long
    inside = motion.short_axis_mode == pair.short_axis_mode
    crossing = torch.nonzero(inside[:-1] & inside[1:] & (ratio[:-1] * ratio[1:] <= 0))
    if not len(crossing):
        return None
    k = int(crossing[0])
    share = float(ratio[k] / (ratio[k] - ratio[k + 1])) if float(ratio[k] - ratio[k + 1]) else 0.5
    return float(angle[k]) + share * float(angle[1] - angle[0])


def search(
    rows: Rows,
    body: FacetLight,
    pairs: Sequence[FrequencyPair],
    moments: Tensor,
    *,
    kept: int = KEPT,
    progress: Callable[[float], None] | None = None,
) -> list[TumbleState]:
    """The best places of each pair and body, ``kept`` of each, of different directions of L; best first."""
    ways = directions(BODY)
    passes = torch.argsort(rows.span, descending=True)[:MOST_PASSES].tolist()
    paths = []
    for pair in pairs:
        data = [_binned(rows, rows.of(passed), rows.middle[passed], pair) for passed in passes]
        for inertia in moments:
            nutation = nutation_of(inertia, pair)
            if nutation is not None:
                paths.append((pair, inertia, nutation, data, *_path(inertia, nutation, ways)))
    best: list[list[TumbleState]] = [[] for _ in paths]
    if not paths:
        return []
    used, places = torch.unique(torch.stack([path[4] for path in paths]), return_inverse=True)
    paths = [(*path[:4], place, *path[5:]) for path, place in zip(paths, places, strict=True)]
    parts = directions(POLES).split(POLES_AT_ONCE)
    for number, poles in enumerate(parts):
        tables = [_table(rows, body, poles, ways[used], rows.of(passed)) for passed in passes]
        for k, path in enumerate(paths):
            best[k] += _states(rows, passes, tables, poles, kept, *path)
            if progress is not None:
                progress((number + (k + 1) / len(paths)) / len(parts))
    leading = [sorted(states, key=lambda state: state.misfit)[:kept] for states in best]
    return sorted((state for states in leading for state in states), key=lambda state: state.misfit)


def _table(rows: Rows, body: FacetLight, poles: Tensor, ways: Tensor, here: Tensor) -> Tensor:
    """Harmonics (V, D, N, 5, H) of squares and columns of light: diffuse and lobe, at L along directions in the body, over the turn."""
    nodes = here[instants(rows, here)]
    frame = frame_of(poles)
    angle = torch.arange(TURN_STEPS, dtype=torch.float64) * (2 * math.pi / TURN_STEPS)
    cos, sin = torch.cos(angle), torch.sin(angle)

    def turned(way: Tensor) -> Tensor:
        x, y, z = (part[..., None] for part in torch.einsum("dij,nj->dni", frame, way).unbind(-1))
        return torch.stack([cos * x + sin * y, cos * y - sin * x, z.expand(*z.shape[:-1], TURN_STEPS)], -1)

    sun, observer = turned(rows.to_sun[nodes]), turned(rows.to_observer[nodes])
    lobes = sum(body.lobed)
    exponent = torch.full((lobes,), EXPONENT, dtype=torch.float64)
    harmonics = []
    for gauge in _gauge(ways):  # body from the frame with z along L, which points along the way in the body
        light = body.light(sun @ gauge, observer @ gauge, exponent)
        plain = light[..., : len(body.names)].sum(-1)
        shiny = light[..., len(body.names) :].sum(-1)
        columns = torch.stack([plain * plain, plain * shiny, shiny * shiny, plain, shiny], -2)
        harmonics.append(torch.fft.rfft(columns)[..., :HARMONICS].to(torch.complex64))
    return torch.stack(harmonics)


def _gauge(ways: Tensor) -> Tensor:
    """Rotations (..., 3, 3) that take unit vectors (..., 3) to z."""
    return frame_of(ways)


def _binned(rows: Rows, here: Tensor, middle: Tensor, pair: FrequencyPair) -> tuple[Tensor, float]:
    """Spectra (2, N, W, H) of the weights and of weights times light of a pass on the torus of a pair, and the square of the light."""
    seconds = rows.seconds[here] - middle
    chosen = instants(rows, here)
    nearest = (seconds[:, None] - seconds[chosen]).abs().argmin(-1)
    weight = 1 / spread(rows.flux[here], rows.error[here])
    mean = pair.long if pair.short_axis_mode else pair.long + pair.polhode
    way = (seconds * pair.polhode * WAY_STEPS).round().long() % WAY_STEPS
    turn = (seconds * mean * TURN_STEPS).round().long() % TURN_STEPS
    at = (nearest * WAY_STEPS + way) * TURN_STEPS + turn
    binned = weight.new_zeros(2, len(chosen) * WAY_STEPS * TURN_STEPS)
    for index, value in enumerate((weight**2, weight**2 * rows.flux[here])):
        binned[index].scatter_add_(0, at, value)
    spectrum = torch.fft.fft(
        torch.fft.rfft(binned.unflatten(-1, (len(chosen), WAY_STEPS, TURN_STEPS)))[..., :HARMONICS], dim=-2
    )
    return spectrum.conj().to(torch.complex64), float((weight * rows.flux[here]).square().sum())


def _path(moments: Tensor, nutation: float, ways: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of a body's rotation, at each step of the way: which direction in the body L has, the angle (W,) by which the body is
    then turned about L against the grid, rad, and the part of that which the way itself brings."""
    steps = torch.arange(WAY_STEPS, dtype=torch.float64) / WAY_STEPS
    zero = torch.zeros(1, dtype=torch.float64)
    nutation_ = torch.tensor([nutation], dtype=torch.float64)
    path = free_rotation(zero.expand(WAY_STEPS, 1), moments, nutation_, zero + 1, zero, steps[:, None])[:, 0]
    own = wander(moments.expand(WAY_STEPS, 3), nutation_.expand(WAY_STEPS), steps) * (2 * math.pi)
    nearest = (path[:, 2] @ ways.T).argmax(-1)  # z of the frame is L
    # R = Rz(angle) gauge: the angle that is left, with a direction off by half a step of the grid
    between = path @ _gauge(ways[nearest]).mT
    angle = torch.atan2(between[:, 1, 0] - between[:, 0, 1], between[:, 0, 0] + between[:, 1, 1]) + own
    return nearest, angle, own


def _states(
    rows: Rows,
    passes: Sequence[int],
    tables: Sequence[Tensor],
    poles: Tensor,
    kept: int,
    pair: FrequencyPair,
    moments: Tensor,
    nutation: float,
    data: Sequence[tuple[Tensor, float]],
    nearest: Tensor,
    angle: Tensor,
    own: Tensor,
) -> list[TumbleState]:
    """The best places of one body in one pair's rotation."""
    harmonic = torch.arange(HARMONICS, dtype=torch.float64)
    shift = torch.exp(1j * harmonic * angle[:, None]).to(torch.complex64)  # (W, H)
    total = torch.zeros(len(poles), dtype=torch.float64)
    places = []
    for table, (spectrum, size) in zip(tables, data, strict=True):
        columns = table[nearest] * shift[:, None, None, None]  # (W, D, N, 5, H)
        columns = torch.fft.fft(columns, dim=0)
        products = torch.einsum("nwh,wdnch->dcwh", spectrum[0], columns[:, :, :, :3])
        targets = torch.einsum("nwh,wdnch->dcwh", spectrum[1], columns[:, :, :, 3:])
        both = torch.cat([products, targets], 1)
        whole = torch.fft.irfft(torch.fft.ifft(both, dim=-2), n=TURN_STEPS, dim=-1)  # (D, 5, W, S)
        gain = _gain(*whole.unbind(1))
        least, at = (size - torch.where(gain < size, gain, 0.0)).flatten(1).min(-1)
        total += least
        places.append(at)
    states = []
    for k in torch.argsort(total)[:kept].tolist():
        phases, around = [0.0] * rows.passes, [0.0] * rows.passes
        for passed, at in zip(passes, places, strict=True):
            way, turn = divmod(int(at[k]), TURN_STEPS)
            around[passed] = way / WAY_STEPS
            phases[passed] = (turn / TURN_STEPS + float(own[way]) / (2 * math.pi)) % 1.0
        states.append(
            TumbleState(poles[k], pair.long, moments, nutation, tuple(phases), tuple(around), float(total[k]))
        )
    return states


def wander(moments: Tensor, nutation: Tensor, way: Tensor) -> Tensor:
    """The periodic part (B,) of the turn about L, in turns, at phases (B,) of the way; 0 at 0."""
    motion = frequencies(moments, nutation, torch.ones_like(nutation))
    share = way - torch.floor(way.detach())
    elapsed = share / motion.polhode
    mean = motion.precession_long + torch.where(motion.short_axis_mode, 0.0, motion.polhode)
    zero = torch.zeros_like(way)[:, None]
    period = torch.ones_like(zero)
    moved = free_rotation(elapsed[:, None], moments, nutation[:, None], period, zero, zero)[:, 0]
    still = free_rotation(zero, moments, nutation[:, None], period, zero, share[:, None])[:, 0]
    between = moved @ still.mT
    angle = torch.atan2(between[:, 1, 0], between[:, 0, 0]) / (2 * math.pi) - mean * elapsed
    return angle - torch.round(angle.detach())


def _gain(aa: Tensor, ab: Tensor, bb: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """By how much two columns, neither less than 0, lower the sum of squares, from their products and targets. Where a column is
    dark its product is what the harmonics that are left out make of the bright ones."""
    aa, bb = (square.clamp(min=max(DARK * float(square.mean()), 1e-30)) for square in (aa, bb))
    determinant = (aa * bb - ab * ab).clamp(min=ALONG * aa * bb)
    x, y = (bb * a - ab * b) / determinant, (aa * b - ab * a) / determinant
    both = torch.where((x > 0) & (y > 0), a * x + b * y, 0.0)
    single = torch.maximum(a.clamp(min=0) ** 2 / aa, b.clamp(min=0) ** 2 / bb)
    return torch.maximum(both, single)
