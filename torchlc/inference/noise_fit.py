"""The parameters of noise, fitted in turn with all others."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchlc.inference.budget import Budget
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.polish import polish
from torchlc.inference.whitening import noise_columns
from torchlc.noise.orthant import POINTS
from torchlc.tensors.least_squares import Minimum
from torchlc.tensors.second_differences import second_differences

NOISE_VALUES = 10_000_000
"""Elements of the covariances held at once while noise is fitted: 80 MB."""


def fit_noise(likelihood: Likelihood, theta: Tensor, *, search: bool = True, steps: int = 40) -> Tensor:
    """The noise parameters of theta (P,) at their best for the residuals of its other parameters.

    Newton's method in unconstrained coordinates, from theta or, with ``search``, the best of a cloud; by
    differences of one batched call a step, and every step is kept only if it improves.
    """
    index = noise_columns(likelihood)
    if not index:
        return theta
    parameters = likelihood.model.parameter_set
    objective = _noise_objective(likelihood, theta, parameters.to_natural)
    z = parameters.to_unconstrained(theta)
    trials = z[None, index]
    if search:
        first = parameters.to_unconstrained(parameters.start())[index]
        cloud = 8.0 * torch.quasirandom.SobolEngine(len(index)).draw(32, dtype=z.dtype).to(z.device) - 4.0
        trials = torch.cat([trials, first[None], first + cloud])
    values = objective(_with_columns(z, index, trials))
    part, value = trials[values.argmin()], float(values.min())
    damping = 1e-1
    for _ in range(steps):
        gradient, hessian = second_differences(
            lambda cut: objective(_with_columns(z, index, cut)), part, 1e-3
        )
        curvature, axes = torch.linalg.eigh(hessian)
        move = -axes @ ((axes.T @ gradient) / (curvature.abs() + damping))
        trial = part + move.clamp(-1.5, 1.5)
        new = float(objective(_with_columns(z, index, trial[None]))[0])
        done = abs(value - new) < 1e-7 * (abs(value) + 1)
        if new < value:
            part, value, damping = trial, new, damping / 4
        else:
            damping *= 6
        if done or damping > 1e6:
            break
    return parameters.to_natural(_with_columns(z, index, part[None]))[0]


def noise_in_turn(likelihood: Likelihood, theta: Tensor, budget: Budget) -> Minimum:
    """Minima from natural values theta (S, P) with noise and all else fitted in turn.

    So are rows that are there only if their flux is above 0. Costs are -2 ln of the density, less that of rows of
    unit variance, so that minima with different noise compare; the curvature of the noise is among the rows of the
    slopes.
    """
    parameters = likelihood.model.parameter_set
    index = noise_columns(likelihood)
    minima: list[Minimum] = []
    with torch.no_grad():
        for turn in range(4):
            noisy = torch.stack([fit_noise(likelihood, point, search=turn == 0) for point in theta])
            noises = [likelihood.model.noise(point) for point in noisy]
            minima = [
                polish(likelihood, point[None], noise, level_at=point, go_on=budget.left)
                for point, noise in zip(noisy, noises, strict=True)
            ]
            theta = torch.cat([parameters.from_flat(minimum.y) for minimum in minima])
            if not budget.left():
                break
        cost = -2 * likelihood.log_likelihood(theta) - likelihood.rows * math.log(2 * math.pi)
        cost = cost + (parameters.prior_residuals(theta) ** 2).sum(-1)
        jacobian = torch.cat([minimum.jacobian for minimum in minima])
        residual = torch.cat([minimum.residual for minimum in minima])
        extra = jacobian.new_zeros(len(theta), len(index), jacobian.shape[-1])
        for number, start in enumerate(theta if index else ()):
            y = parameters.to_flat(start)
            objective = _noise_objective(likelihood, start, parameters.from_flat)
            part, step = _inside(y[index], *(bound[index] for bound in parameters.flat_bounds()))
            _, hessian = second_differences(lambda cut: objective(_with_columns(y, index, cut)), part, step)  # noqa: B023
            curvature, axes = torch.linalg.eigh(hessian)
            extra[number][:, index] = torch.sqrt(curvature.clamp(min=0))[:, None] * axes.T
    return Minimum(
        torch.cat([minimum.y for minimum in minima]),
        cost,
        torch.cat([jacobian, extra], 1),
        torch.cat([residual, residual.new_zeros(len(theta), len(index))], 1),
        torch.cat([minimum.converged for minimum in minima]),
        max(minimum.iterations for minimum in minima),
    )


def _noise_objective(
    likelihood: Likelihood, theta: Tensor, natural: Callable[[Tensor], Tensor]
) -> Callable[[Tensor], Tensor]:
    """Minus the log posterior (B,) of coordinates (B, P), which ``natural`` turns into theta, with the
    residuals held at those of theta (P,)."""
    parameters = likelihood.model.parameter_set
    with torch.no_grad():
        held = likelihood.residuals(theta)
    limits = int(likelihood.limit.sum())
    size = max(1, NOISE_VALUES // max(len(held.delta) ** 2, POINTS * limits))

    def piece(coordinates: Tensor) -> Tensor:
        whole = natural(coordinates)
        shape = (len(whole), likelihood.rows)
        rows = {name: getattr(held, name).expand(shape) for name in ("delta", "sigma", "scale", "prediction")}
        residuals = replace(held, **rows)
        prior = 0.5 * (parameters.prior_residuals(whole) ** 2).sum(-1)
        value = prior - likelihood.density(residuals, likelihood.model.noise(whole))
        return torch.where(torch.isfinite(value), value, torch.inf)

    @torch.no_grad()
    def objective(coordinates: Tensor) -> Tensor:
        return torch.cat([piece(cut) for cut in coordinates.split(size)])

    return objective


def _with_columns(whole: Tensor, index: Sequence[int], columns: Tensor) -> Tensor:
    """Copies (B, P) of ``whole`` (P,) with some elements from ``columns`` (B, k)."""
    copies = whole.repeat(len(columns), 1)
    copies[:, index] = columns
    return copies


def _inside(y: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """The point (k,) moved off its bounds so far that differences by the step (k,) stay inside."""
    span = torch.where(torch.isfinite(high - low), high - low, 1.0).clamp(max=1.0)
    step = 1e-3 * torch.minimum(span, torch.minimum(y - low, high - y).clamp(min=1e-3 * span))
    return torch.maximum(torch.minimum(y, high - 2 * step), low + 2 * step), step
