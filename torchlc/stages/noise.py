"""What passes through the noise stage: how the rows of a recording err about the model.

Errors are the sum of up to three things, each of which a noise effect may change and all of which may be absent. Every
row has a variance, the quoted one and what is added to it. Its error over the root of that variance follows a ``Law``,
the normal one unless an effect says otherwise. And ``Process`` es add errors that rows of a curve share.

Letters: T rows, n some of them, (...) any batch axes. Numbers of an effect end in an axis of 1 or T.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Hashable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchlc.tensors.normal_tail import HALF_LOG_2PI, log_ndtr

NEAR_CENTRE = 1e-3
"""Deviate below which the weight of a law is that at this deviate: a density with a cusp has none at its centre."""
FARTHEST = 1e8
"""Deviate within which a law's quantiles are looked for; beyond lies less than rounding of any law in use."""
HALVINGS = 80
"""Of the bracket of a quantile: 2e8 / 2^80 is below rounding of the smallest deviate that matters."""
REACH, NODES = 8.0, 513
"""Standard deviations of an uncertain prediction that are integrated over, and nodes on either scale: the trapezoidal
rule then gives ln of the density of a Laplace law to 1e-4, whatever the ratio of the two widths."""


class Law(ABC):
    """The distribution of a row's error over its standard deviation, u: symmetric about 0, with a density of any shape.

    ``name`` is that of the effect that brings it. A subclass gives ``log_density`` and ``log_below``; all else follows
    from them, and may be given in closed form. Its tensors are (..., 1) or (..., T), so that they meet u (..., T).
    """

    name: str

    @abstractmethod
    def log_density(self, u: Tensor) -> Tensor:
        """ln of the density of u, same shape."""

    @abstractmethod
    def log_below(self, u: Tensor) -> Tensor:
        """ln of the probability of a deviate below u, same shape."""

    @property
    def widest(self) -> Tensor | float:
        """How many times wider than the standard deviation of a row the law may be at most, (..., 1)."""
        return 1.0

    def log_mixed(self, u: Tensor, sigma: Tensor) -> Tensor:
        """ln of the density, (..., T), of errors u sigma of standard deviation ``sigma``."""
        return self.log_density(u) - torch.log(sigma)

    def weight(self, u: Tensor) -> Tensor:
        """The weight of a row in least squares, same shape, under which they have the slope of the density:
        -d ln p / du / u (Holland & Welsch 1977, Commun. Stat. A 6, 813)."""
        with torch.enable_grad():
            away = u.detach().abs().clamp(min=NEAR_CENTRE).requires_grad_(True)
            (slope,) = torch.autograd.grad(self.log_density(away).sum(), away)
        return (-slope / away.detach()).clamp(min=0.0)

    def weighted(self, delta: Tensor, sigma: Tensor) -> Tensor:
        """Standard deviation (..., T) that a row of residual delta has in least squares, for its weight there."""
        return sigma / torch.sqrt(self.weight(delta / sigma).clamp(min=1e-12))

    def deviates(self, normal: Tensor, random: np.random.Generator) -> Tensor:
        """Deviates (T,) of the law, made of standard normal ones (T,): the quantile of what lies below each. A law that
        needs further numbers takes them from ``random``."""
        target = log_ndtr(-normal.abs())
        low, high = torch.full_like(normal, -FARTHEST), torch.zeros_like(normal)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            below = self.log_below(middle) < target
            low, high = torch.where(below, middle, low), torch.where(below, high, middle)
        return -torch.sign(normal) * 0.5 * (low + high)

    def blurred(self, left: Tensor, sigma: Tensor, known: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of residuals (N,) of rows of standard deviation ``sigma`` whose prediction is itself normal, of variance
        ``known``: ln of the density, its slope with the prediction, and minus its second derivative, (N,) each.

        The product of the normal and the law is integrated by the trapezoidal rule over nodes that are even on the
        scale of the normal and dense about the law's centre on that of the law.
        """
        root = torch.sqrt(known.clamp(min=1e-300))
        even = torch.linspace(-REACH, REACH, NODES, dtype=left.dtype, device=left.device)
        about = torch.sinh(1.5 * even) / math.sinh(1.5)  # dense about 0, out to 1e4 deviates
        nodes = torch.cat([root[:, None] * even, left[:, None] - sigma[:, None] * about], 1)
        nodes = torch.sort(nodes.clamp(-REACH * root[:, None], REACH * root[:, None]), 1).values
        u = (left[:, None] - nodes) / sigma[:, None]
        log_height = self.log_density(u) - torch.log(sigma)[:, None]
        log_height = log_height - 0.5 * (nodes / root[:, None]) ** 2 - HALF_LOG_2PI - torch.log(root)[:, None]
        gap = torch.diff(nodes, dim=1)
        zero = torch.zeros_like(gap[:, :1])
        share = 0.5 * (torch.cat([gap, zero], 1) + torch.cat([zero, gap], 1))
        log_part = log_height + torch.log(share.clamp(min=1e-300))
        log_row = torch.logsumexp(log_part, 1)
        member = torch.exp(log_part - log_row[:, None])
        mean = (member * nodes).sum(1)
        variance = (member * (nodes - mean[:, None]) ** 2).sum(1)
        return log_row, mean / known, (1 - variance / known) / known


class Normal(Law):
    """Normal errors, as quoted ones are meant."""

    name = "normal"

    def log_density(self, u):
        return -0.5 * u * u - HALF_LOG_2PI

    def log_below(self, u):
        return log_ndtr(u)

    def weight(self, u):
        return torch.ones_like(u)

    def weighted(self, delta, sigma):
        return sigma

    def deviates(self, normal, random):
        return normal


NORMAL = Normal()


class Process(ABC):
    """Errors that rows share: normal, of standard deviation ``sd`` mag (..., 1) or (..., T), and independent between
    curves, or between what ``group`` (T,) numbers, such as objects. ``name`` is that of the effect that brings it."""

    name: str
    sd: Tensor
    group: Tensor | None = None

    def members(self, curve: Tensor) -> Tensor:
        """The number (T,) of the curve, or of what else shares an error, that each row belongs to."""
        return curve if self.group is None else self.group

    @abstractmethod
    def correlation(self, rows: Tensor) -> Tensor:
        """Correlation (..., n, n) between some rows of one curve, given by their numbers (n,); of one with a ``group``
        between rows of several members, (M, n, n) of (M, n), rows of each row of numbers being of one member or 0."""

    @property
    def key(self) -> Hashable:
        """Equal for processes of the same correlation, which a diagnosis then keeps; None: never kept."""
        return None


@dataclass(frozen=True)
class Noise:
    """How rows err: ``variance`` mag^2 (..., 1 or T), added to the quoted one; the ``law`` of errors over their
    standard deviation; the ``processes`` that rows share."""

    variance: Tensor | None = None
    law: Law = NORMAL
    processes: tuple[Process, ...] = ()

    @property
    def normal(self) -> bool:
        return isinstance(self.law, Normal)

    def wider(self, mag: Tensor) -> Noise:
        """With independent errors of standard deviation ``mag`` (..., 1 or T) added in quadrature."""
        return replace(self, variance=mag**2 if self.variance is None else self.variance + mag**2)

    def with_law(self, law: Law) -> Noise:
        return replace(self, law=law)

    def with_process(self, process: Process) -> Noise:
        return replace(self, processes=(*self.processes, process))

    def sigma(self, quoted: Tensor, scale: Tensor) -> Tensor:
        """Standard deviation of each row, (..., T), of the quoted one, (T,) or (..., T); ``scale`` (..., T) turns a
        magnitude into the recording's unit."""
        if self.variance is None:
            return quoted
        return torch.sqrt(quoted**2 + self.variance * scale**2)
