"""The standard normal distribution far below its centre, with slopes that hold there.

PyTorch works out the slope of ``log_ndtr`` as exp(-x^2 / 2 - ln Phi(x)) less a constant, two large numbers that cancel: it is off
by 1e-8 at x = -1e4 and is 0 or infinite from -1e8. The scaled complementary error function has no such loss.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

ROOT_HALF = math.sqrt(0.5)
HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)
BELOW = -1.0
"""From where down the scaled function serves: it is 1e-16 exact at any negative argument, and overflows at +37."""
ASYMPTOTIC = -1e3
"""From where down the slope of the hazard is 1 - 1 / x^2, to 1e-12."""


def log_ndtr(x: Tensor) -> Tensor:
    """ln Phi(x), same shape."""
    far = x < BELOW
    low, high = torch.where(far, x, BELOW), torch.where(far, BELOW, x)
    tail = torch.log(0.5 * torch.special.erfcx(-ROOT_HALF * low)) - 0.5 * low * low
    return torch.where(far, tail, torch.special.log_ndtr(high))


def hazard(x: Tensor) -> Tensor:
    """phi(x) / Phi(x), same shape: the slope of ln Phi, and by how much the mean of a normal cut off x below its centre is
    above it, in standard deviations. At least 1e-300."""
    far = x < BELOW
    low, high = torch.where(far, x, BELOW), torch.where(far, BELOW, x)
    tail = 1 / (math.sqrt(0.5 * math.pi) * torch.special.erfcx(-ROOT_HALF * low))
    near = torch.exp(-0.5 * high * high - HALF_LOG_2PI - torch.special.log_ndtr(high))
    return torch.where(far, tail, near.clamp(min=1e-300))


def hazard_fall(x: Tensor) -> Tensor:
    """Minus the slope of :func:`hazard`, hazard (hazard + x), 0 to 1, same shape."""
    far = x < ASYMPTOTIC
    low, high = torch.where(far, x, ASYMPTOTIC), torch.where(far, ASYMPTOTIC, x)
    ratio = hazard(high)
    return torch.where(far, 1 - 1 / low**2, ratio * (ratio + high))
