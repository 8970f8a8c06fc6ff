"""Coordinates in which every prior is the standard normal one.

Each parameter is the quantile of its prior at Phi(g), a pair of reflectances that is uniform on its triangle by the
marginal distribution of the first and the conditional one of the second (Rosenblatt 1952, Ann. Math. Stat. 23, 470). A
prior is then one row of unit variance in least squares, whatever its kind, and an evidence the integral of likelihood
times a standard normal density. Where a pair's priors are of another kind, what is missing to its density is
:meth:`NormalScores.correction`.

Letters: P parameters, (...) any batch axes.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchlc.parameters import ParameterSet, Prior

FARTHEST = 7.0
"""Largest coordinate that a value is given: beyond lie 3e-12 of the prior."""


class NormalScores:
    """The map between natural values theta (..., P) of a :class:`ParameterSet` and coordinates g (..., P)."""

    def __init__(self, parameters: ParameterSet) -> None:
        self.parameters = parameters
        self._first = {second: first for first, second in parameters.pairs}
        self._triangles = {
            pair: all(_unit(parameters.free[index].prior) for index in pair) for pair in parameters.pairs
        }
        self._starts = {first for (first, _), whole in self._triangles.items() if whole}

    def theta(self, g: Tensor) -> Tensor:
        """Natural values at coordinates g."""
        columns: list[Tensor] = []
        for index, (entry, value) in enumerate(zip(self.parameters.free, g.unbind(-1), strict=True)):
            first = self._first.get(index)
            if index in self._starts:
                columns.append(1 - torch.sqrt(torch.special.ndtr(-value)))
            elif first is not None:
                share = torch.special.ndtr(value)
                if self._triangles[first, index]:
                    columns.append((1 - columns[first]) * share)
                else:
                    room = cumulative(entry.prior, 1 - columns[first])
                    columns.append(torch.minimum(entry.prior.quantile(room * share), 1 - columns[first]))
            else:
                columns.append(natural(entry.prior, value))
        return torch.stack(columns, -1) if columns else g.clone()

    def scores(self, theta: Tensor) -> Tensor:
        """Coordinates of natural values, those of a bound at +-FARTHEST."""
        columns: list[Tensor] = []
        values = theta.unbind(-1)
        for index, (entry, value) in enumerate(zip(self.parameters.free, values, strict=True)):
            first = self._first.get(index)
            if index in self._starts:
                columns.append(-normal_quantile((1 - value).clamp(0, 1) ** 2))
            elif first is not None:
                room = (1 - values[first]).clamp(min=1e-12)
                if not self._triangles[first, index]:
                    room = cumulative(entry.prior, room).clamp(min=1e-300)
                    value = cumulative(entry.prior, value)
                columns.append(normal_quantile(value / room))
            elif unbounded(entry.prior):
                scale = entry.prior.to_scale(value)
                columns.append((scale - entry.prior.flat_centre) / entry.prior.sigma)
            else:
                columns.append(normal_quantile(cumulative(entry.prior, value)))
        return torch.stack(columns, -1).clamp(-FARTHEST, FARTHEST) if columns else theta.clone()

    def correction(self, g: Tensor) -> Tensor:
        """ln of the prior's density over the standard normal one in g, (...), up to a constant of the scene: 0 but for
        pairs of reflectances that are not uniform on the triangle r_spec + r_diff <= 1."""
        total = torch.zeros_like(g[..., 0]) if g.shape[-1] else g.new_zeros(g.shape[:-1])
        for (first, second), whole in self._triangles.items():
            if not whole:
                value = natural(self.parameters.free[first].prior, g[..., first])
                room = cumulative(self.parameters.free[second].prior, 1 - value)
                total = total + torch.log(room.clamp(min=1e-300))
        return total


def natural(prior: Prior, g: Tensor) -> Tensor:
    """The quantile of a prior at Phi(g), same shape."""
    if unbounded(prior):
        return prior.from_scale(prior.flat_centre + prior.sigma * g)
    return prior.quantile(torch.special.ndtr(g)).clamp(prior.low, prior.high)


def cumulative(prior: Prior, x: Tensor) -> Tensor:
    """The share of a prior that is below x, same shape."""
    y = prior.to_scale(x.clamp(prior.low, prior.high))
    low, high = prior.flat_range()
    if not prior.peaked:
        return ((y - low) / (high - low)).clamp(0, 1)
    root = prior.sigma * math.sqrt(2)
    below, whole = math.erf((low - prior.flat_centre) / root), math.erf((high - prior.flat_centre) / root)
    share = (torch.erf((y - prior.flat_centre) / root) - below) / max(whole - below, 1e-300)
    return share.clamp(0, 1)


def normal_quantile(p: Tensor) -> Tensor:
    """The standard normal deviate that p lies below, same shape, from -FARTHEST to FARTHEST."""
    return torch.special.ndtri(p.clamp(1e-300, 1 - 1e-16)).clamp(-FARTHEST, FARTHEST)


def unbounded(prior: Prior) -> bool:
    """Whether a peaked prior's bounds are so far out that they take nothing off it."""
    if prior.kind not in ("normal", "lognormal"):
        return False
    low, high = prior.flat_range()
    return (
        prior.flat_centre - low > FARTHEST * prior.sigma and high - prior.flat_centre > FARTHEST * prior.sigma
    )


def _unit(prior: Prior) -> bool:
    return prior.kind == "uniform" and prior.low == 0.0 and prior.high == 1.0
