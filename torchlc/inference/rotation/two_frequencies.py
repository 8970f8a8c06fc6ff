"""The two frequencies of a tumbling body, from its light: two-dimensional Fourier series.

The light of a body that no torque acts on is a series in exp 2 pi i (j f + k g) t, with f the mean turns about the
angular momentum and g those of the angular momentum about the body (Kaasalainen 2001, A&A 376, 302). Each pass has coefficients of
its own, since the geometry differs. A series in f and g is as well one in whole combinations of them, so what the light shows is a
lattice; every pair that spans it may be the body's. A body that looks the same after half a turn about the axis of its mode shows only
even j + k: the lattice of f + g and f - g. Letters: B pairs, C coefficients, T rows of a pass.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.inference.rotation.passes import Rows

FIRST, SECOND = 2, 4
"""Highest orders of the series in the two frequencies of a lattice."""
ROWS_A_COEFFICIENT = 2.5
"""Rows of a pass a coefficient below which the second order is reduced."""
STEPS = 4.0
"""Pairs of a grid over the time of the longest pass."""
MOST_PLACES = 500
"""Frequencies of a grid; if there were more, the search ends at a lower frequency."""
DIRECT = 3000
"""Pairs that are fitted: those whose places in the spectrum hold most."""
RIDGE = 1e-4
AT_ONCE = 64
LATTICES = 3
WHOLE = 3
"""Largest whole number in a combination of the frequencies of a lattice."""
MOST_RATIO = 3.0
"""g over f up to which pairs are looked for: a rod of 1 to 5 whose long axis is 60 deg from the angular momentum has 2.4."""
LEAST_TURNS = 0.7
"""Turns that the longest pass must hold."""


@dataclass(frozen=True)
class FrequencyPair:
    """Mean turns a second of the long axis about the angular momentum and of the latter about the body, in the short or the
    long axis mode; the share of the light's variance that their lattice explains; the sum of the whole numbers they are made with."""

    long: float
    polhode: float
    short_axis_mode: bool
    share: float
    order: int


def frequency_pairs(rows: Rows, low: float, high: float, *, halves: bool, most: int) -> list[FrequencyPair]:
    """Pairs with the first frequency between ``low`` and ``high``, 1/s, the likeliest first; ``halves``: the body looks the
    same after half a turn about each axis."""
    longest = float(rows.span.max())
    found: list[FrequencyPair] = []
    for g1, g2, share in lattices(rows, 4 * high):
        for a, b, c, d in itertools.product(range(-WHOLE, WHOLE + 1), repeat=4):
            if abs(a * d - b * c) != 1:
                continue
            u, v = a * g1 + b * g2, c * g1 + d * g2
            mean, polhode = ((u + v) / 2, (u - v) / 2) if halves else (u, v)
            if not (LEAST_TURNS / longest <= polhode and mean > 0):
                continue
            for short in (True, False):
                long = mean if short else mean - polhode
                if low <= long <= high and polhode <= MOST_RATIO * long:
                    found.append(FrequencyPair(long, polhode, short, share, sum(map(abs, (a, b, c, d)))))
    kept: list[FrequencyPair] = []
    for one in sorted(found, key=lambda one: one.order - 40 * one.share):
        if all(
            one.short_axis_mode != other.short_axis_mode
            or abs(one.long - other.long) > 0.3 / longest
            or abs(one.polhode - other.polhode) > 0.3 / longest
            for other in kept
        ):
            kept.append(one)
    return kept[:most]


def lattices(rows: Rows, highest: float) -> list[tuple[float, float, float]]:
    """Two frequencies below ``highest`` that span a lattice, and the share of the light that it explains, best first."""
    longest = float(rows.span.max())
    step = 1 / (STEPS * longest)
    least = LEAST_TURNS / longest
    places = torch.arange(least, max(highest, 3 * least), step, dtype=torch.float64)[:MOST_PLACES]
    passes = [_light(rows, one) for one in range(rows.passes)]
    passes = [one for one in passes if len(one[0]) >= ROWS_A_COEFFICIENT * 10]
    if not passes:
        return []
    pairs = torch.cartesian_prod(places, places)
    pairs = pairs[(pairs[:, 0] - pairs[:, 1]).abs() > 0.7 / longest]
    if len(pairs) > DIRECT:
        pairs = pairs[torch.topk(_spectral(passes, pairs, step), DIRECT).indices]
    share = explained(passes, pairs)
    kept: list[tuple[float, float, float]] = []
    for place in torch.argsort(share, descending=True).tolist():
        g1, g2 = pairs[place].tolist()
        if float(share[place]) < 0.8 * float(share.max()) or len(kept) == LATTICES:
            break
        if not any(_within(g1, g2, one, 1.5 / longest) for one in kept):
            kept.append(_refined(passes, g1, g2, step))
    return sorted(kept, key=lambda one: -one[2])


def _within(g1: float, g2: float, lattice: tuple[float, float, float], near: float) -> bool:
    """Whether two frequencies span no more than a lattice does."""
    whole = [
        abs(j * lattice[0] + k * lattice[1])
        for j, k in itertools.product(range(-WHOLE, WHOLE + 1), repeat=2)
        if j or k
    ]
    return all(min(abs(g - one) for one in whole) < near for g in (g1, g2))


def _light(rows: Rows, one: int) -> tuple[Tensor, Tensor]:
    """Seconds about its middle and magnitudes about a mean and a slope of a pass."""
    here = rows.of(one)
    seconds = rows.seconds[here] - rows.middle[one]
    light = -torch.log(rows.flux[here].clamp(min=1e-300))
    design = torch.stack([torch.ones_like(seconds), seconds / seconds.abs().max().clamp(min=1e-9)], 1)
    return seconds, light - design @ torch.linalg.lstsq(design, light[:, None]).solution[:, 0]


def _orders(count: int) -> list[tuple[int, int]]:
    """Orders (j, k) of a series for a pass of so many rows: one of each and its opposite."""
    ways = SECOND
    while ways > 1 and ROWS_A_COEFFICIENT * (2 * (ways + FIRST * (2 * ways + 1)) + 1) > count:
        ways -= 1
    return [(0, k) for k in range(1, ways + 1)] + [
        (j, k) for j in range(1, FIRST + 1) for k in range(-ways, ways + 1)
    ]


def explained(passes: list[tuple[Tensor, Tensor]], pairs: Tensor) -> Tensor:
    """Share (B,) of the variance that the series of pairs (B, 2) explains, less what so many coefficients explain of noise."""
    found, total = torch.zeros(len(pairs), dtype=torch.float64), 0.0
    for seconds, light in passes:
        orders = torch.tensor(_orders(len(seconds)), dtype=torch.float64)
        size = float((light**2).sum())
        total += size
        free = len(seconds) - 2 * len(orders) - 1
        for start in range(0, len(pairs), AT_ONCE):
            angle = 2 * math.pi * (pairs[start : start + AT_ONCE] @ orders.T)[:, None] * seconds[:, None]
            design = torch.cat([torch.cos(angle), torch.sin(angle), torch.ones_like(angle[..., :1])], -1)
            normal = design.mT @ design
            normal.diagonal(dim1=-2, dim2=-1).add_(RIDGE * len(seconds))
            target = (design.mT @ light[:, None])[..., 0]
            solved = torch.linalg.solve(normal, target[..., None])[..., 0]
            left = (light - (design @ solved[..., None])[..., 0]).square().sum(-1)
            found[start : start + AT_ONCE] += size - left * (len(seconds) - 1) / max(free, 1)
    return found / max(total, 1e-300)


def _spectral(passes: list[tuple[Tensor, Tensor]], pairs: Tensor, step: float) -> Tensor:
    """Sum (B,) of the power at the places of the series of each pair: what a full fit is worth trying on."""
    orders = torch.tensor([*_orders(1000)], dtype=torch.float64)
    places = pairs @ orders.T
    top = float(places.abs().max())
    grid = torch.arange(0.0, top + 2 * step, step / 2, dtype=torch.float64)
    total = torch.zeros(len(pairs), dtype=torch.float64)
    for seconds, light in passes:
        power = torch.cat(
            [
                torch.hypot(torch.cos(angle) @ light, torch.sin(angle) @ light) ** 2
                for angle in (2 * math.pi * part[:, None] * seconds for part in grid.split(2000))
            ]
        )
        total += power[(places.abs() / (step / 2)).round().long()].sum(-1) / len(seconds)
    return total


def _refined(
    passes: list[tuple[Tensor, Tensor]], f: float, g: float, step: float
) -> tuple[float, float, float]:
    """The maximum near a place of the grid, to a hundredth of a step, and its share."""
    share = 0.0
    for _ in range(4):
        offsets = step * torch.tensor([-1.0, -0.5, 0.0, 0.5, 1.0], dtype=torch.float64)
        trial = torch.cartesian_prod(f + offsets, (g + offsets).clamp(min=step / 10))
        value = explained(passes, trial)
        best = int(value.argmax())
        (f, g), share = trial[best].tolist(), float(value[best])
        step /= 3
    return f, g, share
