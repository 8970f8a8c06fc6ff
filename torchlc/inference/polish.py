"""A Levenberg-Marquardt polish in flat coordinates with the noise held, and the covariance at what it reaches."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from torchlc.inference.likelihood import Likelihood
from torchlc.inference.whitening import noise_columns, whitener
from torchlc.noise import Noise
from torchlc.tensors.least_squares import Minimum, minimise

DISTINCT_CHI2 = 10.0
"""Minima within this of the best are kept as modes."""


def polish(
    likelihood: Likelihood,
    theta: Tensor,
    noise: Noise | None,
    *,
    level_at: Tensor | None = None,
    iterations: int = 60,
    held: Sequence[int] = (),
    go_on: Callable[[], bool] = lambda: True,
) -> Minimum:
    """Levenberg-Marquardt from natural values theta (S, P) with the noise held, and the columns ``held`` at the
    values of the first row: the noise's covariance whitens the rows, prior rows follow. Noise levels of curves
    without errors are those of the residuals at ``level_at`` (P,), where noise parameters then stay. ``go_on`` may end it.

    Where parts shade each other, slopes along numbers that move the geometry are followed from step to step, for each is a
    geometry to work out anew; then every distinct minimum near the best is polished once more by exact slopes."""
    model = likelihood.model
    parameters = model.parameter_set
    low, high = parameters.flat_bounds()
    with torch.no_grad():
        if held:
            index = list(held)
            low[index] = high[index] = parameters.to_flat(theta[0])[index]
        reference = parameters.start() if level_at is None else level_at
        if level_at is not None:
            stay, index = parameters.to_flat(level_at), noise_columns(likelihood)
            low[index] = high[index] = stay[index]
        whiten = whitener(likelihood, likelihood.residuals(reference), noise, fitted=level_at is not None)

        def residual(y: Tensor) -> Tensor:
            natural = parameters.from_flat(y)
            return torch.cat([whiten(likelihood.residuals(natural)), parameters.prior_residuals(natural)], -1)

        colours = likelihood.colours(prior_rows=True)
        dear = model.assembly.geometry_columns if model.assembly.parts_meet else ()
        box: dict[str, Any] = {"low": low, "high": high, "colours": colours, "go_on": go_on}
        minimum = minimise(residual, parameters.to_flat(theta), iterations=iterations, dear=dear, **box)
        if not dear:
            return minimum
        near = best_minima(minimum, (), most=len(minimum.y), depth=DISTINCT_CHI2)
        return minimum.replaced(near, minimise(residual, minimum.y[near], iterations=iterations, **box))


def best_minima(found: Minimum, noise: Sequence[int], most: int = 4, depth: float = math.inf) -> list[int]:
    """Which starts (S,) are the best minima, within ``depth`` of the first, that differ by more than a thousandth in what is
    not ``noise``."""
    kept: list[int] = []
    apart = torch.ones(found.y.shape[-1], dtype=torch.bool, device=found.y.device)
    apart[list(noise)] = False
    for index in torch.argsort(found.cost).tolist():
        y = found.y[index]
        if kept and not bool(found.cost[index] <= found.cost[kept[0]] + depth):
            break
        if all(bool(((y - other).abs() > 1e-3 * (1 + y.abs()))[apart].any()) for other in found.y[kept]):
            kept.append(index)
        if len(kept) == most:
            break
    return kept


def laplace(jacobian: Tensor, y: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Covariance (P, P) in flat coordinates from the Jacobian (R, P) of the normalised rows, and which
    coordinates are held by a bound.

    A flat direction gets the variance of its bounded range, so that the covariance is that of likelihood and
    prior together.
    """
    span = torch.where(torch.isfinite(high - low), high - low, torch.inf)
    near = 1e-6 * torch.where(torch.isfinite(span), span, 0.0)
    held = (y <= low + near) | (y >= high - near)
    precision = jacobian.T @ jacobian + torch.diag(torch.where(torch.isfinite(span), 12 / span**2, 0.0))
    keep = torch.nonzero(~held)[:, 0]
    covariance = torch.zeros_like(precision)
    if len(keep):
        block = precision[keep][:, keep]
        scale = torch.sqrt(torch.diagonal(block).clamp(min=1e-30))
        inverse = torch.linalg.pinv(block / scale[:, None] / scale[None], hermitian=True)
        covariance[keep[:, None], keep[None]] = inverse / scale[:, None] / scale[None]
    return covariance, held
