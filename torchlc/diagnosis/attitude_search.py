"""Where to look for a swing or a jump of the attitude: least squares over what small turns of the body do to the light.

Light changes in proportion to a small turn, so that for one period of a swing, or one instant of a jump, the best axis,
amplitude and phase follow from the light's slopes along three body axes times a wave: sine and cosine, or a step. Only
the period or the instant has to be tried.

Letters: T rows, n rows of the prior, P what a refit absorbs, F periods or instants, W waves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

OVERSAMPLING = 4
"""Periods for each cycle by which they differ over the recording: a wave between two of them loses 5 % of its power at most."""
MOST_PERIODS = 20_000
"""That are tried of a swing, which bounds the time it takes; recordings of more cycles have them farther apart."""
AT_ONCE = 500
"""Of these, so that the waves of all rows take some tens of megabytes."""
STEP_DEG = 0.1
"""Turn, deg, by which the slopes are taken: a twentieth of the width of a lobe of exponent 1000."""
SIGMA_DEG = 1.0
"""Amplitudes beyond which a least-squares solution is not believed."""
SWEEPS = 10
"""Solutions of the wave and of the axis in turn; what they leave is for the refit."""
Axes = tuple[tuple[float, ...], ...]
BODY_AXES: Axes = ((0.0, 0.0), (90.0, 0.0), (0.0, 90.0))
"""Longitude and latitude of the body axes, deg."""
GIVEN_AXIS: Axes = ((),)
"""Of what can turn about one axis only, which has no numbers."""


@dataclass(frozen=True)
class Target:
    """What a turn should mend: the whitened ``residual`` (T + n,) of a refit, off the orthonormal basis ``absorbed``
    (T + n, P) of what it can take up itself; ``change`` gives the whitened change of light (N, T) that parameters
    (N, k) of an effect make."""

    residual: Tensor
    absorbed: Tensor
    change: Callable[[Tensor], Tensor]


def swings(
    target: Target,
    minutes: Tensor,
    cadence: float,
    bounds: tuple[float, float],
    count: int,
    axes: Axes = BODY_AXES,
) -> Tensor:
    """Up to ``count`` swings (count, 5) of deg, period_min, phase_deg, axis_lon and axis_lat, or of the first three (count, 3) where
    the axis is given, best first, of periods within ``bounds``, minutes; ``minutes`` (T,) after the first row, ``cadence`` in minutes."""
    low, high = max(bounds[0], 2 * cadence), bounds[1]
    span = float(minutes.max() - minutes.min())
    if span <= 0 or high <= low:
        return minutes.new_zeros(0, 3 + len(axes[0]))
    slopes = _slopes_of_swings(target.change, minutes, high, axes)
    most = min(MOST_PERIODS, math.ceil(OVERSAMPLING * span * (1 / low - 1 / high)) + 1)
    frequency = torch.linspace(1 / high, 1 / low, most, dtype=minutes.dtype)

    def waves(some: Tensor) -> Tensor:
        turn = 2 * math.pi * some[:, None] * minutes
        return torch.stack([torch.sin(turn), torch.cos(turn)], 1)

    gain, axis, wave = _scanned(target, slopes, frequency, waves)
    chosen = _peaks(gain, frequency, 0.5 / span, count)
    return _as_swings(axis[chosen], wave[chosen], 1 / frequency[chosen])


def jumps(target: Target, hours: Tensor, instants: Tensor, apart: float, count: int) -> Tensor:
    """Up to ``count`` jumps (count, 4) of x, y, z, deg, and time, h, best first, at some of the ``instants`` (F,), at
    least ``apart`` from each other; ``hours`` (T,) after the first row."""
    trials = STEP_DEG * torch.eye(3, dtype=hours.dtype)
    trials = pad(torch.cat([trials, -trials]), (0, 1))
    moved = target.change(trials)
    slopes = (moved[:3] - moved[3:]) / (2 * STEP_DEG)
    gain, axis, _ = _scanned(
        target, slopes, instants, lambda some: (hours > some[:, None]).to(hours)[:, None]
    )
    chosen = _peaks(gain, instants, apart, count)
    return torch.cat([axis[chosen], instants[chosen, None]], 1)


def _slopes_of_swings(
    change: Callable[[Tensor], Tensor], minutes: Tensor, period: float, axes: Axes
) -> Tensor:
    """Whitened change of light per deg of turn about each of A axes, (A, T), from swings of the longest period in four
    phases."""
    phases = (0.0, 90.0, 180.0, 270.0)
    trials = [[STEP_DEG, period, phase, *axis] for axis in axes for phase in phases]
    moved = change(minutes.new_tensor(trials)).unflatten(0, (len(axes), len(phases))) / (2 * STEP_DEG)
    turn = 2 * math.pi * minutes / period
    return (moved[:, 0] - moved[:, 2]) * torch.sin(turn) + (moved[:, 1] - moved[:, 3]) * torch.cos(turn)


def _scanned(
    target: Target, slopes: Tensor, places: Tensor, waves: Callable[[Tensor], Tensor]
) -> tuple[Tensor, Tensor, Tensor]:
    """At each place (F,) of a scan, whose ``waves`` are (F, W, T): what the best turn takes off the sum of squares (F,),
    its axis times its amplitude in deg (F, A), and the share of each wave (F, W), of norm 1."""
    pieces = [_best(target, slopes, waves(some)) for some in torch.split(places, AT_ONCE)]
    gain, axis, wave = (torch.cat(column) for column in zip(*pieces, strict=True))
    return gain, axis, wave


def _best(target: Target, slopes: Tensor, waves: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As :func:`_scanned`, by alternating least squares from the best sum of waves about any axes."""
    count, rows = waves.shape[1:]
    axes = len(slopes)
    columns = (slopes[None, :, None] * waves[:, None]).flatten(1, 2)
    columns = pad(columns, (0, len(target.residual) - rows))
    columns = columns - (columns @ target.absorbed) @ target.absorbed.T
    normal = columns @ columns.mT + torch.eye(axes * count, dtype=columns.dtype) / SIGMA_DEG**2
    right = columns @ target.residual
    free = torch.linalg.solve(normal, right).unflatten(1, (axes, count))
    wave = torch.linalg.svd(free, full_matrices=False)[2][:, 0]
    normal, right = normal.view(-1, axes, count, axes, count), right.view(-1, axes, count)
    axis = free[..., 0]
    for _ in range(SWEEPS):
        axis = torch.linalg.solve(
            torch.einsum("fi,faibj,fj->fab", wave, normal, wave), torch.einsum("fi,fai->fa", wave, right)
        )
        axis, _ = _direction(axis)
        wave = torch.linalg.solve(
            torch.einsum("fa,faibj,fb->fij", axis, normal, axis), torch.einsum("fa,fai->fi", axis, right)
        )
        wave, length = _direction(wave)
        axis = axis * length
    if count == 1:
        axis, wave = axis * wave, wave.abs()
    return torch.einsum("fa,fi,fai->f", axis, wave, right), axis, wave


def _direction(vector: Tensor) -> tuple[Tensor, Tensor]:
    """Unit vectors (F, n) along vectors (F, n), and lengths (F, 1); along the first axis where nothing is to be explained and
    a vector is 0."""
    length = torch.linalg.vector_norm(vector, dim=1, keepdim=True)
    first = torch.zeros_like(vector).index_fill(1, torch.tensor([0], device=vector.device), 1.0)
    return torch.where(length > 0, vector / length.clamp(min=1e-300), first), length


def _peaks(gain: Tensor, places: Tensor, apart: float, count: int) -> list[int]:
    """Indices of the largest gains (F,), at least ``apart`` from each other in ``places`` (F,)."""
    order = torch.argsort(gain, descending=True)
    order = order[gain[order] > 0]
    return order[spaced(places[order], apart, count)].tolist()


def spaced(places: Tensor, apart: float, count: int) -> list[int]:
    """Indices of up to ``count`` of the places (F,), best first, that are more than ``apart`` from all better ones."""
    chosen: list[int] = []
    for index, place in enumerate(places.tolist()):
        if len(chosen) == count:
            break
        if all(abs(place - float(places[other])) > apart for other in chosen):
            chosen.append(index)
    return chosen


def _as_swings(axis: Tensor, wave: Tensor, period: Tensor) -> Tensor:
    """Axes times amplitudes, deg (N, 3), shares of sine and cosine (N, 2) and periods, min (N,), as deg, period_min,
    phase_deg, axis_lon, axis_lat (N, 5), with the axis on the half of the sphere whose longitudes are -45 to 135; of one given axis (N, 1)
    the first three (N, 3)."""
    deg = torch.linalg.vector_norm(axis, dim=1)
    phase = torch.rad2deg(torch.atan2(wave[:, 1], wave[:, 0]))
    if axis.shape[1] == 1:
        back = torch.where(axis[:, 0] < 0, 180.0, 0.0)
        return torch.stack([deg, period, (phase + back) % 360.0], 1)
    lon = torch.rad2deg(torch.atan2(axis[:, 1], axis[:, 0]))
    far = (lon < -45.0) | (lon > 135.0)
    axis = torch.where(far[:, None], -axis, axis)
    phase = torch.where(far, phase + 180.0, phase) % 360.0
    lon = torch.rad2deg(torch.atan2(axis[:, 1], axis[:, 0]))
    lat = torch.rad2deg(torch.asin((axis[:, 2] / deg.clamp(min=1e-300)).clamp(-1.0, 1.0)))
    return torch.stack([deg, period, phase, lon, lat], 1)
