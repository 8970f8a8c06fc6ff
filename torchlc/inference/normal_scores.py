"""Coordinates in which every prior is the standard normal one.

Each parameter is the quantile of its prior at Phi(g). A pair of reflectances that is uniform on its triangle is given by the
marginal distribution of what the diffuse light is in proportion to, and by the conditional one of the first (Rosenblatt
1952, Ann. Math. Stat. 23, 470): that light is known far better than either, and where it is a coordinate of its own, what the
data leave open is a straight line and no bent one. Of a pair with other priors the first has its marginal distribution, in a table, and the
second the conditional one. A prior is then one row of unit variance in least squares, whatever its kind, and an evidence the integral of likelihood
times a standard normal density.

Letters: P parameters, (...) any batch axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from torchlc.parameters import ParameterSet, Prior

NODES, NEWTON_STEPS = 1025, 12
"""Of the table of ln of a diffuse share, and steps of Newton's method from a guess within a factor of 2 to rounding: eight would do."""
FARTHEST = 7.0
"""Largest coordinate that a value is given: beyond lie 3e-12 of the prior."""
STEPS, BISECTIONS = 4096, 40
"""Of the table of a marginal distribution, whose width of 0.003 resolves a partner known to a thousandth, and halvings of a step in which
its inverse is found."""


class NormalScores:
    """The map between natural values theta (..., P) of a :class:`ParameterSet` and coordinates g (..., P)."""

    def __init__(self, parameters: ParameterSet) -> None:
        self.parameters = parameters
        self._pairs = {index: pair for pair in parameters.pairs for index in pair}
        self._triangles = {
            pair: all(_unit(parameters.free[index].prior) for index in pair) for pair in parameters.pairs
        }
        whole = [pair for pair, uniform in self._triangles.items() if uniform]
        self._alike = {
            coupled: [pair for pair in whole if (pair in parameters.coupled) == coupled]
            for coupled in (False, True)
        }
        self._straight = straight(
            {i: parameter.prior for i, parameter in enumerate(parameters.free) if i not in self._pairs}
        )

    def _apart(
        self, values: Sequence[Tensor], change: Callable[..., tuple[Tensor, Tensor]]
    ) -> dict[int, Tensor]:
        """Columns of all pairs that are uniform on their triangles, by place: those of one kind are worked out together."""
        changed: dict[int, Tensor] = {}
        for coupled, pairs in self._alike.items():
            if pairs:
                both = [torch.stack([values[pair[k]] for pair in pairs], -1) for k in (0, 1)]
                for k, columns in enumerate(change(*both, coupled)):
                    changed.update(zip((pair[k] for pair in pairs), columns.unbind(-1), strict=True))
        return changed

    def theta(self, g: Tensor) -> Tensor:
        """Natural values at coordinates g."""
        values = g.unbind(-1)
        spread = self._apart(values, reflectances)
        for alike in self._straight:
            spread.update(alike.natural(values))
        columns: list[Tensor] = []
        for index, (entry, value) in enumerate(zip(self.parameters.free, values, strict=True)):
            pair = self._pairs.get(index)
            if index in spread:
                columns.append(spread[index])
            elif pair is not None and index == pair[0]:
                columns.append(natural(entry.prior, self._marginal(pair).plain(value)))
            elif pair is not None:
                first = columns[pair[0]]
                room = cumulative(entry.prior, 1 - first)
                share = torch.special.ndtr(value)
                columns.append(torch.minimum(entry.prior.quantile(room * share), 1 - first))
            else:
                columns.append(natural(entry.prior, value))
        return torch.stack(columns, -1) if columns else g.clone()

    def put(self, theta: Tensor, g: Tensor, columns: Sequence[int]) -> Tensor:
        """theta (..., P) with the values of some ``columns`` without partners at coordinates g (..., P)."""
        values = list(theta.unbind(-1))
        for column in columns:
            values[column] = natural(self.parameters.free[column].prior, g[..., column])
        return torch.stack(values, -1)

    def scores(self, theta: Tensor) -> Tensor:
        """Coordinates of natural values, those of a bound at +-FARTHEST."""
        columns: list[Tensor] = []
        values = theta.unbind(-1)
        for index, (entry, value) in enumerate(zip(self.parameters.free, values, strict=True)):
            pair = self._pairs.get(index)
            if pair is not None and self._triangles[pair]:
                scores = reflectance_scores(values[pair[0]], values[pair[1]], pair in self.parameters.coupled)
                columns.append(scores[pair.index(index)])
            elif pair is not None and index == pair[0]:
                columns.append(self._marginal(pair).score(_plain_score(entry.prior, value)))
            elif pair is not None:
                room = (1 - values[pair[0]]).clamp(min=1e-12)
                room = cumulative(entry.prior, room).clamp(min=1e-300)
                columns.append(normal_quantile(cumulative(entry.prior, value) / room))
            else:
                columns.append(_plain_score(entry.prior, value))
        return torch.stack(columns, -1).clamp(-FARTHEST, FARTHEST) if columns else theta.clone()

    def _marginal(self, pair: tuple[int, int]) -> Marginal:
        first, second = (self.parameters.free[index].prior for index in pair)
        return marginal(first, second)


@dataclass(frozen=True)
class Straight:
    """Numbers at ``places`` whose values on their prior's own scale are ``centre`` + ``width`` times their coordinate, or times its share of a
    ``flat`` prior between ``low`` and ``high``: worked out together, for there are many and each alone takes as long. All (K,)."""

    places: tuple[int, ...]
    flat: bool
    logarithmic: bool
    centre: Tensor
    width: Tensor
    low: Tensor
    high: Tensor

    def natural(self, g: Sequence[Tensor]) -> dict[int, Tensor]:
        """Natural values (...) at coordinates, by place."""
        several = torch.stack([g[index] for index in self.places], -1)
        centre, width, low, high = (
            tensor.to(several) for tensor in (self.centre, self.width, self.low, self.high)
        )
        y = centre + width * (torch.special.ndtr(several) if self.flat else several)
        x = torch.exp(y) if self.logarithmic else y
        x = x.clamp(low, high) if self.flat else x
        return dict(zip(self.places, x.unbind(-1), strict=True))


def straight(priors: Mapping[int, Prior]) -> list[Straight]:
    """Of priors by place those that are a straight line on their own scale, in groups."""
    groups: dict[tuple[bool, bool], dict[int, tuple[float, float, float, float]]] = {}
    for index, prior in priors.items():
        low, high = prior.flat_range()
        if unbounded(prior):
            numbers = (prior.flat_centre, prior.sigma, prior.low, prior.high)
        elif not prior.peaked and not prior.isotropic:
            numbers = (low, high - low, prior.low, prior.high)
        else:
            continue
        groups.setdefault((not prior.peaked, prior.logarithmic), {})[index] = numbers
    lines = []
    for (flat, logarithmic), rows in groups.items():
        columns = torch.tensor(list(rows.values()), dtype=torch.float64, device="cpu").unbind(-1)
        lines.append(Straight(tuple(rows), flat, logarithmic, *columns))
    return lines


@dataclass(frozen=True)
class Marginal:
    """The distribution of the first of a pair that is at most 1 together: at coordinates g (K,), ascending, the value is where the first alone
    would be at ``z`` (K,), with ``slope`` dz / dg (K,)."""

    g: Tensor
    z: Tensor
    slope: Tensor

    def plain(self, g: Tensor) -> Tensor:
        """z at coordinates g, same shape: the cubic that has values and slopes of both ends."""
        nodes, z, slope = (tensor.to(g) for tensor in (self.g, self.z, self.slope))
        at = torch.minimum(torch.maximum(g, nodes[0]), nodes[-1])
        k = (torch.searchsorted(nodes, at.detach().contiguous(), right=True) - 1).clamp(0, len(nodes) - 2)
        step = nodes[k + 1] - nodes[k]
        return hermite((at - nodes[k]) / step, z[k], z[k + 1], slope[k] * step, slope[k + 1] * step)

    def score(self, z: Tensor) -> Tensor:
        """g at ``z``, same shape: :meth:`plain` undone."""
        nodes, known = self.g.to(z), self.z.to(z)
        k = (torch.searchsorted(known, z.contiguous(), right=True) - 1).clamp(0, len(known) - 2)
        low, high = nodes[k], nodes[k + 1]
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            below = self.plain(middle) < z
            low, high = torch.where(below, middle, low), torch.where(below, high, middle)
        return 0.5 * (low + high)


@lru_cache(maxsize=256)
def marginal(first: Prior, second: Prior) -> Marginal:
    """Of a pair's first under priors of any kind, given that both together are at most 1."""
    h = 2 * FARTHEST / STEPS
    half = torch.linspace(-FARTHEST, FARTHEST, 2 * STEPS + 1, dtype=torch.float64, device="cpu")
    room = cumulative(second, 1 - natural(first, half))
    density = torch.exp(-0.5 * half**2) / math.sqrt(2 * math.pi) * room
    cells = (density[:-1:2] + 4 * density[1::2] + density[2::2]) * h / 6  # Simpson's rule
    tails = float(torch.special.ndtr(-half[-1])) * room[[0, -1]]
    below = torch.cumsum(torch.cat([tails[:1], cells]), 0)
    above = torch.cumsum(torch.cat([tails[1:], cells.flip(0)]), 0).flip(0)
    whole = below[-1] + tails[1]
    g = torch.where(below < above, normal_quantile(below / whole), -normal_quantile(above / whole))
    kept = torch.cat([torch.ones(1, dtype=torch.bool), torch.diff(g) > 0])
    g, z, density = g[kept], half[::2][kept], density[::2][kept]
    slope = torch.exp(-0.5 * g**2) / math.sqrt(2 * math.pi) * whole / density.clamp(min=1e-300)
    secant = torch.diff(z) / torch.diff(g)
    # within three times the chords the cubic ascends (Fritsch and Carlson 1980, SIAM J. Numer. Anal. 17, 238)
    most = 3 * torch.minimum(torch.cat([secant[:1], secant]), torch.cat([secant, secant[-1:]]))
    return Marginal(g, z, torch.minimum(slope, most))


def hermite(t: Tensor, low: Tensor, high: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """The cubic between ``low`` at t = 0 and ``high`` at 1, of slopes a and b there."""
    return low + t * (a + t * (3 * (high - low) - 2 * a - b + t * (a + b - 2 * (high - low))))


def reflectances(g_first: Tensor, g_second: Tensor, coupled: bool) -> tuple[Tensor, Tensor]:
    """The pair (...) at two coordinates (...). Diffuse light is in proportion to the second, or, ``coupled``, to d = second (1 - first), of which
    the triangle holds d (1 - ln d) below d; above it, the first is below 1 - d^(u/2) in the share u."""
    share = torch.special.ndtr(g_first)
    if not coupled:
        second = 1 - torch.sqrt(torch.special.ndtr(-g_second))
        return (1 - second) * share, second
    log_d = log_diffuse(g_second)
    return -torch.expm1(0.5 * share * log_d), torch.exp(log_d * (1 - 0.5 * share))


def reflectance_scores(first: Tensor, second: Tensor, coupled: bool) -> tuple[Tensor, Tensor]:
    """The coordinates (...) of a pair (...): :func:`reflectances` undone."""
    if not coupled:
        g_second = -normal_quantile((1 - second).clamp(0, 1) ** 2)
        return normal_quantile(first / (1 - second).clamp(min=1e-12)), g_second
    d = (second * (1 - first)).clamp(1e-300, 1.0)
    g_second = normal_quantile(d * (1 - torch.log(d)))
    # of a bound, from where its coordinate ends
    share = 2 * torch.log1p(-first.clamp(max=1 - 1e-12)) / log_diffuse(g_second)
    return normal_quantile(share), g_second


def log_diffuse(g: Tensor) -> Tensor:
    """ln d (...) with d (1 - ln d) = Phi(g): from a table, then a step of Newton's method, which carries the slope."""
    log_share = torch.log(torch.special.ndtr(g))
    with torch.no_grad():
        position = ((g + FARTHEST) * ((NODES - 1) / (2 * FARTHEST))).clamp(0, NODES - 1.001)
        k = position.to(torch.long)
        t = position - k
        a, b, c, d = _table().to(g)[k].unbind(-1)
        known = a + t * (b + t * (c + t * d))
    return _newton(known, log_share)


@lru_cache
def _table() -> Tensor:
    """Cubics (NODES - 1, 4) of ln d over the share of a step from each coordinate to the next, lowest power first."""
    g = torch.linspace(-FARTHEST, FARTHEST, NODES, dtype=torch.float64, device="cpu")
    log_share = torch.log(torch.special.ndtr(g))
    near_one = -torch.sqrt(-2 * log_share)
    w = torch.where(log_share > -0.5, near_one, log_share - torch.log1p(-log_share))
    for _ in range(NEWTON_STEPS):
        w = _newton(w, log_share)
    density = torch.exp(-0.5 * g**2) / math.sqrt(2 * math.pi)
    slope = density / (-w * torch.exp(w)) * float(g[1] - g[0])
    rise, first, last = torch.diff(w), slope[:-1], slope[1:]
    return torch.stack([w[:-1], first, 3 * rise - 2 * first - last, first + last - 2 * rise], -1)


def _newton(w: Tensor, log_share: Tensor) -> Tensor:
    """A step towards w + ln(1 - w) = log_share."""
    return w + (w + torch.log1p(-w) - log_share) * (1 - w) / w


def _plain_score(prior: Prior, value: Tensor) -> Tensor:
    """The coordinate of values of a number without a partner, same shape."""
    if unbounded(prior):
        return (prior.to_scale(value) - prior.flat_centre) / prior.sigma
    return normal_quantile(cumulative(prior, value))


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
