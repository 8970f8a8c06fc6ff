"""The probability that correlated normal variables all lie below their bounds.

Separation of variables (Genz 1992, J. Comput. Graph. Stat. 1, 141) turns it into the mean over a unit cube of a smooth
product, taken at POINTS fixed points of a scrambled Sobol sequence: the same bounds give the same number, and its slopes
are those of that number. The mean's error in ln P is up to 0.008 for 36 variables and 0.03 for 150.

Letters: n variables, S points.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

from torchlc.tensors.autodiff_state import readable
from torchlc.tensors.normal_tail import hazard, hazard_fall, log_ndtr

POINTS = 1024
"""Eight limits in correlated noise: ln P is within 1e-3 of what 8 times as many give."""
FAR_LOG_P = -15.0
"""ln of a probability, 5 standard deviations out, below which its quantile is found from the logarithm."""
LEAST_LOG_P = -600.0
"""ln of a probability whose exponential is no longer told from 0."""
NEWTON, STEP_LENGTHS = 12, 6
"""Steps towards the saddle point, each the best of so many lengths; where it is missed the sum is right but less precise."""
POLISH = 4
"""Newton steps of a quantile: from the tail's leading term to rounding."""


def log_orthant(factor: Tensor, bound: Tensor) -> Tensor:
    """ln P(L z < bound) (...) for standard normal z, lower Cholesky factor L (..., n, n) and bound (..., n)."""
    number = bound.shape[-1]
    points = _points(number).to(bound)
    tilt = exponential_tilt(factor, bound)
    left = bound[..., None, :].expand(*bound.shape[:-1], POINTS, number)
    total = torch.zeros_like(left[..., 0])
    for i in range(number):
        mean = tilt[..., i, None]
        share = log_ndtr(left[..., 0] / factor[..., i, i, None] - mean)
        z = mean + log_quantile(share + torch.log(points[:, i]))
        total = total + share + mean * (0.5 * mean - z)
        left = left[..., 1:] - z[..., None] * factor[..., None, i + 1 :, i]
    return torch.logsumexp(total, -1) - math.log(POINTS)


def exponential_tilt(factor: Tensor, bound: Tensor) -> Tensor:
    """Means (..., n) of the variables z at which the terms of the mean differ least: the saddle point of Botev (2017),
    J. R. Stat. Soc. B 79, 125, by Newton's method with the best of some step lengths. Any means give the
    right probability; those of the saddle point the one of least error. Their slopes are those of the saddle point."""
    scale = torch.diagonal(factor, dim1=-2, dim2=-1)
    identity = torch.eye(bound.shape[-1], dtype=bound.dtype, device=bound.device)
    lower, edge = factor / scale[..., None] - identity, bound / scale

    def unsettled(x: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
        """The two gradients (..., 2 n) and by how much the hazard falls with its argument (..., n)."""
        argument = edge - mean - (lower @ x[..., None])[..., 0]
        ratio = hazard(argument)
        pull = (lower.mT @ ratio[..., None])[..., 0]
        return torch.cat([-mean - pull, mean - x - ratio], -1), hazard_fall(argument)

    def curvature(fall: Tensor) -> Tensor:
        """Jacobian (..., 2 n, 2 n) of the gradients."""
        weighted = fall[..., None] * lower
        top = torch.cat([-lower.mT @ weighted, -identity - weighted.mT], -1)
        return torch.cat([top, torch.cat([-identity - weighted, identity - torch.diag_embed(fall)], -1)], -2)

    both = torch.zeros_like(torch.cat([edge, edge], -1)).detach()
    steps = 0.5 ** torch.arange(STEP_LENGTHS, dtype=bound.dtype, device=bound.device)
    with torch.no_grad():
        for _ in range(NEWTON):
            gradient, fall = unsettled(*both.chunk(2, -1))
            move, _ = torch.linalg.solve_ex(curvature(fall), gradient[..., None])
            trials = both - steps.reshape(-1, *[1] * both.ndim) * torch.nan_to_num(move[..., 0])
            size = torch.stack([unsettled(*trial.chunk(2, -1))[0].square().sum(-1) for trial in trials])
            best = torch.nan_to_num(size, torch.inf).argmin(0)
            both = torch.gather(trials, 0, best[None, ..., None].expand(1, *both.shape))[0]
    gradient, fall = unsettled(*both.chunk(2, -1))
    move, _ = torch.linalg.solve_ex(curvature(fall).detach(), (gradient - gradient.detach())[..., None])
    return (both - torch.nan_to_num(move[..., 0])).chunk(2, -1)[1]


def log_quantile(log_p: Tensor) -> Tensor:
    """The standard normal quantile of probabilities given by their logarithm, with its slope, also far out."""
    with torch.no_grad():
        x = torch.special.ndtri(torch.exp(log_p.clamp(min=LEAST_LOG_P)))
        far = log_p < FAR_LOG_P
        value = log_ndtr(x)
        if not readable(far) or bool(far.any()):
            x = torch.where(far, -torch.sqrt(-2.0 * log_p), x)
            for _ in range(POLISH):
                x = torch.where(far, x + (log_p - log_ndtr(x)) / hazard(x), x)
            value = log_ndtr(x)
        slope = hazard(x)
    return x + (log_p - value) / slope


@lru_cache(maxsize=8)
def _points(number: int) -> Tensor:
    """Points (S, n) in the unit cube, none on its faces."""
    engine = torch.quasirandom.SobolEngine(number, scramble=True, seed=0)
    return engine.draw(POINTS, dtype=torch.float64).clamp(1e-12, 1 - 1e-12)
