"""Levenberg-Marquardt in a box, many starts in one batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

LARGEST_STEP = 0.25
"""Largest step along a bounded coordinate, in units of its range."""


@dataclass(frozen=True)
class Minimum:
    """State of S starts: points y (S, P), costs |r|^2 (S,), Jacobians (S, R, P), residuals (S, R), which have
    converged (S,)."""

    y: Tensor
    cost: Tensor
    jacobian: Tensor
    residual: Tensor
    converged: Tensor
    iterations: int


def minimise(
    residual: Callable[[Tensor], Tensor],
    start: Tensor,
    low: Tensor,
    high: Tensor,
    *,
    iterations: int = 60,
    tolerance: float = 1e-7,
    colours: Colours | None = None,
    go_on: Callable[[], bool] = lambda: True,
) -> Minimum:
    """Minimise |residual(y)|^2 from each row of ``start`` (S, P) within the box; ``residual`` maps (B, P) to
    (B, R).

    Steps are damped by the largest diagonal of J'J seen so far, projected on the box, and kept only where
    they lower the cost, so every start descends monotonically. Only starts that are at work, and slopes where a step was kept, are
    worked out again. A start has converged when a step gains less
    than ``tolerance`` of its cost (plus 1). ``go_on`` is asked before each step, and may end the search.
    """
    y = torch.minimum(torch.maximum(start, low), high)
    r = residual(y)
    cost = _finite(r.square().sum(-1))
    jac = differences(residual, y, low, high, r, colours)
    damping = torch.full_like(cost, 1e-2)
    scale = torch.zeros_like(y)
    converged = torch.zeros_like(cost, dtype=torch.bool)
    cap = torch.where(torch.isfinite(high - low), LARGEST_STEP * (high - low), torch.inf)
    margin = torch.where(torch.isfinite(high - low), 1e-12 * (high - low), 0.0)
    done = 0
    while done < iterations and not bool(converged.all()) and go_on():
        done += 1
        gradient = torch.einsum("srp,sr->sp", jac, torch.nan_to_num(r))
        normal = torch.einsum("srp,srq->spq", jac, jac)
        scale = torch.maximum(scale * 0.9, torch.diagonal(normal, dim1=-2, dim2=-1).clamp(min=1e-12))
        held = ((y <= low + margin) & (gradient > 0)) | ((y >= high - margin) & (gradient < 0))
        moving = (~held).to(y)
        system = normal * moving[:, :, None] * moving[:, None, :]
        system = system + torch.diag_embed(damping[:, None] * scale + held.to(y))
        move = -torch.linalg.solve(system, (gradient * moving)[..., None])[..., 0]
        move = torch.maximum(torch.minimum(torch.nan_to_num(move), cap), -cap)
        trial = torch.minimum(torch.maximum(y + move, low), high)
        (working,) = torch.nonzero(~converged, as_tuple=True)
        trial_r = r.index_copy(0, working, residual(trial[working]))
        trial_cost = _finite(trial_r.square().sum(-1))
        better = (trial_cost < cost) & ~converged
        gain = cost - trial_cost
        small = gain.abs() <= tolerance * (cost + 1.0)
        stuck = damping > 1e8
        y = torch.where(better[:, None], trial, y)
        r = torch.where(better[:, None], trial_r, r)
        cost = torch.where(better, trial_cost, cost)
        converged = (
            converged | (better & small & (damping < 10.0)) | stuck | (~better & small & (damping < 10.0))
        )
        damping = torch.where(better, (damping / 6).clamp(min=1e-9), damping * 5)
        (moved,) = torch.nonzero(better, as_tuple=True)
        if len(moved):
            jac = jac.index_copy(0, moved, differences(residual, y[moved], low, high, r[moved], colours))
    return Minimum(y, cost, jac, r, converged, done)


@dataclass(frozen=True)
class Colours:
    """Columns of a Jacobian that touch different rows and so share one difference: ``groups`` of column
    indices, and for each column the rows (P, R) that it may touch."""

    groups: tuple[tuple[int, ...], ...]
    touched: Tensor


def differences(
    residual: Callable[[Tensor], Tensor],
    y: Tensor,
    low: Tensor,
    high: Tensor,
    at: Tensor | None = None,
    colours: Colours | None = None,
) -> Tensor:
    """Jacobian (S, R, P) at y (S, P) by one-sided differences, backwards at an upper bound: one batched call,
    no tracing of the model.

    ``at`` (S, R) is residual(y) where it is known already. A coordinate whose bounds are one value is held: its slope is 0,
    whatever rounding differs by between batches. The step is 1e-6 of the coordinate's scale, the
    relative error of a slope of the order of 1e-6 as well.
    """
    starts, dimensions = y.shape
    base = residual(y) if at is None else at
    if not dimensions:
        return base[..., None].expand(*base.shape, 0)
    span = torch.where(torch.isfinite(high - low), high - low, torch.inf)
    step = 1e-6 * torch.minimum(torch.ones_like(span), span) * torch.ones_like(y)
    moved = torch.where(y + step <= high, y + step, y - step)
    eye = torch.eye(dimensions, dtype=torch.bool, device=y.device)
    if colours is not None:
        eye = torch.stack([eye[list(group)].any(0) for group in colours.groups])
    points = torch.where(eye, moved[:, None], y[:, None]).reshape(-1, dimensions)
    change = residual(points).reshape(starts, len(eye), -1) - base[:, None]
    if colours is not None:
        group = torch.empty(dimensions, dtype=torch.long)
        for number, members in enumerate(colours.groups):
            group[list(members)] = number
        change = torch.where(colours.touched, change[:, group], 0.0)
    size = (moved - y)[..., None]
    slope = torch.where(size == 0, 0.0, change / torch.where(size == 0, 1.0, size))
    return torch.nan_to_num(slope).transpose(-1, -2)


def _finite(cost: Tensor) -> Tensor:
    return torch.where(torch.isfinite(cost), cost, torch.inf)
