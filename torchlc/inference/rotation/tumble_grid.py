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
MASSES = 7
"""Steps of the triangle of the second moments of mass about the planes of the body: 28 bodies."""
NUTATIONS = 64
KEPT = 6
"""Places of a state that are kept, of different directions of L."""
MOST_PASSES = 3


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
    progress: Callable[[float], None] | None = None,
) -> list[TumbleState]:
    """The best places of each pair and body, best first."""
    poles, ways = directions(POLES), directions(BODY)
    passes = torch.argsort(rows.span, descending=True)[:MOST_PASSES].tolist()
    tables = [_table(rows, body, poles, ways, rows.of(one)) for one in passes]
    found: list[TumbleState] = []
    for number, pair in enumerate(pairs):
        data = [_binned(rows, rows.of(one), rows.middle[one], pair) for one in passes]
        for place, one in enumerate(moments):
            nutation = nutation_of(one, pair)
            if nutation is not None:
                found += _states(rows, passes, tables, data, poles, ways, pair, one, nutation)
            if progress is not None:
                progress((number + (place + 1) / len(moments)) / len(pairs))
    return sorted(found, key=lambda one: one.misfit)


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
    found = []
    for gauge in _gauge(ways):  # body from the frame with z along L, which points along the way in the body
        light = body.light(sun @ gauge, observer @ gauge, exponent)
        plain = light[..., : len(body.names)].sum(-1)
        shiny = light[..., len(body.names) :].sum(-1)
        columns = torch.stack([plain * plain, plain * shiny, shiny * shiny, plain, shiny], -2)
        found.append(torch.fft.rfft(columns)[..., :HARMONICS].to(torch.complex64))
    return torch.stack(found)


def _gauge(ways: Tensor) -> Tensor:
    """Rotations (..., 3, 3) that take unit vectors (..., 3) to z."""
    return frame_of(ways)


def _binned(rows: Rows, here: Tensor, middle: Tensor, pair: FrequencyPair) -> tuple[Tensor, float]:
    """Spectra (2, N, W, H) of the weights and of weights times light of a pass on the torus of a pair, and the square of the light."""
    seconds = rows.seconds[here] - middle
    place = instants(rows, here)
    nearest = (seconds[:, None] - seconds[place]).abs().argmin(-1)
    weight = 1 / spread(rows.flux[here], rows.error[here])
    mean = pair.long if pair.short_axis_mode else pair.long + pair.polhode
    way = (seconds * pair.polhode * WAY_STEPS).round().long() % WAY_STEPS
    turn = (seconds * mean * TURN_STEPS).round().long() % TURN_STEPS
    at = (nearest * WAY_STEPS + way) * TURN_STEPS + turn
    binned = weight.new_zeros(2, len(place) * WAY_STEPS * TURN_STEPS)
    for one, value in enumerate((weight**2, weight**2 * rows.flux[here])):
        binned[one].scatter_add_(0, at, value)
    spectrum = torch.fft.fft(
        torch.fft.rfft(binned.unflatten(-1, (len(place), WAY_STEPS, TURN_STEPS)))[..., :HARMONICS], dim=-2
    )
    return spectrum.conj().to(torch.complex64), float((weight * rows.flux[here]).square().sum())


def _states(
    rows: Rows,
    passes: Sequence[int],
    tables: Sequence[Tensor],
    data: Sequence[tuple[Tensor, float]],
    poles: Tensor,
    ways: Tensor,
    pair: FrequencyPair,
    moments: Tensor,
    nutation: float,
) -> list[TumbleState]:
    """The best places of one body in one pair's rotation."""
    steps = torch.arange(WAY_STEPS, dtype=torch.float64) / WAY_STEPS
    zero = torch.zeros(1, dtype=torch.float64)
    nutation_ = torch.tensor([nutation], dtype=torch.float64)
    # at each step of the way, with no turn about L but what the way itself brings
    path = free_rotation(zero.expand(WAY_STEPS, 1), moments, nutation_, zero + 1, zero, steps[:, None])[:, 0]
    wander = _wander(moments, nutation, steps)
    direction = path[:, 2]  # L in the body: z of the frame
    nearest = (direction @ ways.T).argmax(-1)
    gauge = _gauge(ways[nearest])
    # R = Rz(angle) gauge: the angle that is left, with a direction off by half a step of the grid
    between = path @ gauge.mT
    angle = torch.atan2(between[:, 1, 0] - between[:, 0, 1], between[:, 0, 0] + between[:, 1, 1]) + wander
    harmonic = torch.arange(HARMONICS, dtype=torch.float64)
    shift = torch.exp(1j * harmonic * angle[:, None]).to(torch.complex64)  # (W, H)
    total = torch.zeros(len(poles))
    places = []
    for table, (spectrum, size) in zip(tables, data, strict=True):
        columns = table[nearest] * shift[:, None, None, None]  # (W, D, N, 5, H)
        columns = torch.fft.fft(columns, dim=0)
        products = torch.einsum("nwh,wdnch->dcwh", spectrum[0], columns[:, :, :, :3])
        targets = torch.einsum("nwh,wdnch->dcwh", spectrum[1], columns[:, :, :, 3:])
        both = torch.cat([products, targets], 1)
        whole = torch.fft.irfft(torch.fft.ifft(both, dim=-2), n=TURN_STEPS, dim=-1)  # (D, 5, W, S)
        misfit = size - _gain(*whole.unbind(1))
        flat = misfit.flatten(1)
        least, at = flat.min(-1)
        total += least
        places.append(at)
    best = torch.argsort(total)[:KEPT].tolist()
    found = []
    for k in best:
        way = [int(at[k]) // TURN_STEPS for at in places]
        turn = [int(at[k]) % TURN_STEPS for at in places]
        phases, around = [0.0] * rows.passes, [0.0] * rows.passes
        for one, w, t in zip(passes, way, turn, strict=True):
            around[one] = w / WAY_STEPS
            phases[one] = (t / TURN_STEPS + float(wander[w]) / (2 * math.pi)) % 1.0
        found.append(
            TumbleState(poles[k], pair.long, moments, nutation, tuple(phases), tuple(around), float(total[k]))
        )
    return found


def _wander(moments: Tensor, nutation: float, steps: Tensor) -> Tensor:
    """The periodic part (W,) of the turn about L, rad, over the way round the body."""
    motion = frequencies(
        moments, torch.tensor(nutation, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)
    )
    elapsed = steps / motion.polhode
    mean = motion.precession_long + torch.where(motion.short_axis_mode, 0.0, motion.polhode)
    zero = torch.zeros(1, dtype=torch.float64)
    nutation_ = torch.tensor([nutation], dtype=torch.float64)
    with_it = free_rotation(elapsed, moments, nutation_, zero + 1, zero, zero)
    without = free_rotation(zero.expand(len(steps), 1), moments, nutation_, zero + 1, zero, steps[:, None])[
        :, 0
    ]
    between = with_it @ without.mT
    angle = torch.atan2(between[:, 1, 0], between[:, 0, 0]) - 2 * math.pi * mean * elapsed
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def _gain(aa: Tensor, ab: Tensor, bb: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """By how much two columns, neither less than 0, lower the sum of squares, from their products and targets."""
    aa, bb = aa.clamp(min=1e-20), bb.clamp(min=1e-20)
    determinant = (aa * bb - ab * ab).clamp(min=1e-6 * aa * bb)
    x, y = (bb * a - ab * b) / determinant, (aa * b - ab * a) / determinant
    both = torch.where((x > 0) & (y > 0), a * x + b * y, 0.0)
    single = torch.maximum(a.clamp(min=0) ** 2 / aa, b.clamp(min=0) ** 2 / bb)
    return torch.maximum(both, single)
