"""The two frequencies of a tumbling body, from its light: two-dimensional Fourier series.

The light of a body that no torque acts on is a series in exp 2 pi i (j f + k g) t, with f the mean turns about the
angular momentum and g those of the angular momentum about the body (Kaasalainen 2001, A&A 376, 302). Each pass has coefficients of
its own, since the geometry differs. A body that looks the same after half a turn about each of its axes shows only even j + k. A
series in f and g is as well one in whole combinations of them, so that several pairs explain the light about as well; that of the body
is among the best, because in its own frequencies the series falls fastest, but need not be the first. Letters: B pairs, C
coefficients, T rows of a pass.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.inference.rotation.passes import Rows

COARSE, FINE = 2, 4
"""Highest orders of the series in both frequencies: all pairs are looked at with both, and the best are told apart with the latter."""
ROWS_A_COEFFICIENT = 2.5
"""Rows of a pass a coefficient below which the order is reduced."""
STEPS = 4.0
"""Pairs of a grid over the time of the longest pass."""
DIRECT = 8000
"""Pairs that are fitted: of more, those whose places in the spectrum hold most."""
LEADING = 80
"""Pairs of each order that are told apart."""
MOST_GRID = 200_000
"""Pairs of a grid; if there were more, its steps are wider."""
RIDGE = 1e-4
"""Of the number of rows, added to the normal equations: a pair whose terms coincide is no error."""
AT_ONCE = 64
"""Pairs whose sums are held together."""
MOST_RATIO = 3.0
"""g over f up to which pairs are looked for: a rod of 1 to 5 whose long axis is 60 deg from the angular momentum has 2.4."""
LEAST_TURNS = 0.7
"""Turns that the longest pass must hold."""
APART = 0.6
"""Turns over the longest pass by which pairs differ that are not one."""


@dataclass(frozen=True)
class FrequencyPair:
    """Mean turns a second of the long axis about the angular momentum and of the latter about the body, in the short or the
    long axis mode; the share of the light's variance that their series explains."""

    long: float
    polhode: float
    short_axis_mode: bool
    share: float


def frequency_pairs(rows: Rows, low: float, high: float, *, halves: bool, most: int) -> list[FrequencyPair]:
    """Pairs with the first frequency between ``low`` and ``high``, 1/s, the likeliest first; ``halves``: the body looks the
    same after half a turn about each axis."""
    longest = float(rows.span.max())
    light = [_light(rows, passed) for passed in range(rows.passes)]
    light = [
        series
        for series in light
        if len(series[0]) >= ROWS_A_COEFFICIENT * (2 * len(_orders(COARSE, halves)) + 1)
    ]
    if not light:
        return []
    candidates, step = _candidates(low, high, longest)
    if len(candidates) > DIRECT:
        candidates = candidates[torch.topk(_spectral(light, _pair(candidates), step, halves), DIRECT).indices]
    # a low order is forgiving between the steps of the grid, a high one sees glints
    kept = [
        _distinct(candidates, explained(light, _pair(candidates), halves, order), longest, LEADING)
        for order in (COARSE, FINE)
    ]
    leading = candidates[sorted(set(itertools.chain.from_iterable(kept)))]
    fine = explained(light, _pair(leading), halves, FINE)
    for part in (2, 4):
        offsets = step / part * torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)
        moves = torch.nn.functional.pad(torch.cartesian_prod(offsets, offsets), (0, 1))
        trials = leading[:, None] + moves
        trials[..., 1].clamp_(min=LEAST_TURNS / longest)
        value, at = (
            explained(light, _pair(trials.flatten(0, 1)), halves, FINE).unflatten(0, trials.shape[:2]).max(1)
        )
        better = value > fine
        leading = torch.where(better[:, None], trials[torch.arange(len(at)), at], leading)
        fine = torch.where(better, value, fine)
    return [
        FrequencyPair(float(leading[k, 0]), float(leading[k, 1]), bool(leading[k, 2]), float(fine[k]))
        for k in _distinct(leading, fine, longest, most)
    ]


def _candidates(low: float, high: float, longest: float) -> tuple[Tensor, float]:
    """Pairs of a grid (B, 3): turns of the long axis, ways round the body, 1 in the short-axis mode and 0 in the other; and its
    step."""
    step = 1 / (STEPS * longest)
    while (high - low) * MOST_RATIO * high > MOST_GRID / 2 * step**2:
        step *= 1.5
    long = torch.arange(low, high + step, step, dtype=torch.float64).clamp(max=high)
    polhode = torch.arange(
        LEAST_TURNS / longest, max(MOST_RATIO * high, 1 / longest), step, dtype=torch.float64
    )
    pairs = torch.cartesian_prod(long, polhode, torch.tensor([1.0, 0.0], dtype=torch.float64))
    return pairs[pairs[:, 1] <= MOST_RATIO * pairs[:, 0]], step


def _pair(candidates: Tensor) -> Tensor:
    """Mean turns about the angular momentum, and ways round the body (B, 2)."""
    long, polhode, short = candidates.unbind(-1)
    return torch.stack([long + (1 - short) * polhode, polhode], -1)


def _distinct(candidates: Tensor, share: Tensor, longest: float, most: int) -> list[int]:
    """Which candidates (B, 3) are the best of those around them, best first."""
    kept: list[int] = []
    for k in torch.argsort(share, descending=True).tolist():
        apart = (candidates[kept] - candidates[k]).abs()
        if not bool(((apart[:, :2] < APART / longest).all(-1) & (apart[:, 2] == 0)).any()):
            kept.append(k)
        if len(kept) == most:
            break
    return kept


def _light(rows: Rows, passed: int) -> tuple[Tensor, Tensor]:
    """Seconds about its middle and magnitudes about a mean and a slope of a pass."""
    here = rows.of(passed)
    seconds = rows.seconds[here] - rows.middle[passed]
    light = -torch.log(rows.flux[here].clamp(min=1e-300))
    design = torch.stack([torch.ones_like(seconds), seconds / seconds.abs().max().clamp(min=1e-9)], 1)
    return seconds, light - design @ torch.linalg.lstsq(design, light[:, None]).solution[:, 0]


def _orders(most: int, halves: bool) -> list[tuple[int, int]]:
    """Orders (j, k) of a series: one of each and its opposite."""
    return [
        (j, k)
        for j in range(most + 1)
        for k in range(-most, most + 1)
        if (j or k > 0) and not (halves and (j + k) % 2)
    ]


def explained(passes: list[tuple[Tensor, Tensor]], pairs: Tensor, halves: bool, most: int) -> Tensor:
    """Share (B,) of the variance that the series of pairs (B, 2) explains, less what so many coefficients explain of noise."""
    shares, total = torch.zeros(len(pairs), dtype=torch.float64), 0.0
    for seconds, light in passes:
        order = most
        while order > COARSE and ROWS_A_COEFFICIENT * (2 * len(_orders(order, halves)) + 1) > len(seconds):
            order -= 1
        orders = torch.tensor(_orders(order, halves), dtype=torch.float64)
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
            shares[start : start + AT_ONCE] += size - left * (len(seconds) - 1) / max(free, 1)
    return shares / max(total, 1e-300)


def _spectral(passes: list[tuple[Tensor, Tensor]], pairs: Tensor, step: float, halves: bool) -> Tensor:
    """Sum (B,) of the power at the places of the series of each pair: what a full fit is worth trying on."""
    orders = torch.tensor(_orders(COARSE, halves), dtype=torch.float64)
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
