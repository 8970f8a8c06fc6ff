"""The vector of the free parameters, its prior density, and the coordinates in which it is searched and sampled.

A :class:`ParameterSet` turns the scene's numbers (fixed or free) into one flat vector theta (..., P) of
natural values and back, knows the prior density of theta, and maps theta to unconstrained coordinates z (...,
P) by ``torch.distributions`` transforms. The two reflectances of one material are kept on the triangle r_spec
+ r_diff <= 1: the second is mapped to what the first leaves.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchlc.naming import NOBODY, Origin
from torchlc.parameters.prior import Prior


@dataclass(frozen=True)
class Free:
    """A free parameter: its full name, its prior and the value to start from; ``origin`` says whose it is, ``role`` is its quantity's."""

    name: str
    prior: Prior
    start: float
    unit: str = ""
    meaning: str = ""
    origin: Origin = NOBODY
    role: str = ""


class ParameterSet:
    """The free parameters in order, the fixed ones beside them.

    ``simplex`` lists pairs (first, second) of names whose sum may not exceed 1; a pair with one member fixed
    narrows the other. Of those that are ``coupled`` light is in proportion to second (1 - first).
    """

    def __init__(
        self,
        free: Sequence[Free],
        fixed: Mapping[str, float],
        simplex: Iterable[tuple[str, str]] = (),
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
        coupled: Collection[tuple[str, str]] = (),
    ) -> None:
        self.fixed = dict(fixed)
        self.dtype, self.device = dtype, torch.device(device)
        entries = {parameter.name: parameter for parameter in free}
        self.pairs: list[tuple[int, int]] = []
        self.coupled: set[tuple[int, int]] = set()
        order = [parameter.name for parameter in free]
        for first, second in simplex:
            for name, other in ((first, second), (second, first)):
                if name in entries and other in self.fixed:
                    entries[name] = _narrowed(entries[name], 1.0 - self.fixed[other])
            if first in entries and second in entries:
                entries[first] = _narrowed(entries[first], 1.0 - max(entries[second].prior.low, 0.0))
                entries[second] = _narrowed(entries[second], 1.0 - max(entries[first].prior.low, 0.0))
                self.pairs.append((order.index(first), order.index(second)))
                if (first, second) in coupled:
                    self.coupled.add(self.pairs[-1])
        self.free = [entries[name] for name in order]
        self.names = order
        self.quantities = [parameter.origin.quantity for parameter in self.free]
        self.roles = [parameter.role for parameter in self.free]
        self._transforms = [parameter.prior.transform() for parameter in self.free]
        self._second = {second: first for first, second in self.pairs}
        self._triangle = {(a, b): self._log_triangle(a, b) for a, b in self.pairs}
        self._fixed = {name: torch.tensor(value, dtype=dtype, device=device) for name, value in fixed.items()}
        priors = [entry.prior for entry in self.free]
        self._bounds = self._row([prior.low for prior in priors]), self._row([prior.high for prior in priors])
        self._logarithmic = torch.tensor(
            [prior.logarithmic for prior in priors], dtype=torch.bool, device=device
        )
        self._bent = [
            index for index, prior in enumerate(priors) if prior.isotropic or prior.kind == "cauchy"
        ]
        self._centre = self._row([prior.flat_centre if prior.peaked else 0.0 for prior in priors])
        straight = [prior.peaked and prior.kind != "cauchy" for prior in priors]
        precision = [
            1 / prior.sigma**2 if plain else 0.0 for prior, plain in zip(priors, straight, strict=True)
        ]
        self._precision = self._row(precision)
        self._constant = self._row([prior.log_constant for prior in priors])

    def _row(self, numbers: Sequence[float]) -> Tensor:
        return torch.tensor(numbers, dtype=self.dtype, device=self.device)

    def __len__(self) -> int:
        return len(self.free)

    def start(self) -> Tensor:
        """Natural starting values, (P,)."""
        return torch.tensor([p.start for p in self.free], dtype=self.dtype, device=self.device)

    def values(self, theta: Tensor) -> dict[str, Tensor]:
        """Every number by its full name: free ones (...) from theta (..., P), fixed ones as scalars."""
        values = {name: value.to(theta) for name, value in self._fixed.items()}
        values.update(zip(self.names, self._columns(theta), strict=True))
        return values

    def _columns(self, theta: Tensor) -> tuple[Tensor, ...]:
        """The free parameters (...) of theta (..., P); ValueError if P is another."""
        columns = theta.unbind(-1) if theta.ndim else ()
        if len(columns) != len(self.free):
            raise ValueError(
                f"theta of shape {tuple(theta.shape)}: its last axis has to hold the {len(self.free)} free "
                f"parameters {', '.join(self.names)}"
            )
        return columns

    def to_natural(self, z: Tensor) -> Tensor:
        """Natural values theta (..., P) of unconstrained coordinates z (..., P)."""
        columns: list[Tensor] = []
        for index, (entry, column) in enumerate(zip(self.free, z.unbind(-1), strict=True)):
            value: Tensor = self._transforms[index](column)  # pyright: ignore[reportAssignmentType]
            if index in self._second:
                room = torch.clamp(1.0 - columns[self._second[index]], max=entry.prior.high) - entry.prior.low
                value = entry.prior.low + (value - entry.prior.low) * room / (
                    entry.prior.high - entry.prior.low
                )
            columns.append(value)
        return torch.stack(columns, -1) if columns else z.clone()

    def to_unconstrained(self, theta: Tensor) -> Tensor:
        """Inverse of :meth:`to_natural`; values on a bound are taken a billionth of the range inside."""
        columns: list[Tensor] = []
        natural = self._columns(theta)
        for index, (entry, column) in enumerate(zip(self.free, natural, strict=True)):
            value = column
            if index in self._second:
                value = self._unsqueeze(entry.prior, value, natural[self._second[index]])
            value = entry.prior.inside(value)
            columns.append(self._transforms[index].inv(value))  # pyright: ignore[reportArgumentType]
        return torch.stack(columns, -1) if columns else theta.clone()

    def log_prior(self, theta: Tensor) -> Tensor:
        """Log prior density (...) of natural theta (..., P); -inf outside the bounds or the triangle;
        normalised on each pair's triangle where both are uniform, else up to the constant that the triangle
        cuts off."""
        low, high = self._bounds
        inside = (theta >= low) & (theta <= high)
        safe = torch.where(inside, theta, self.start())
        y = torch.where(self._logarithmic, torch.log(torch.where(self._logarithmic, safe, 1.0)), safe)
        density = self._constant - 0.5 * self._precision * (y - self._centre) ** 2
        density = density - torch.where(self._logarithmic, y, 0.0)
        total = torch.where(inside, density, -math.inf).sum(-1)
        for index in self._bent:
            prior = self.free[index].prior
            y = prior.to_scale(safe[..., index])
            total = total - prior.log_slope(y)
            if prior.peaked:
                total = total - 0.5 * ((y - prior.flat_centre) / prior.sigma) ** 2
        for first, second in self.pairs:
            total = total + self._triangle[first, second]
            total = torch.where(theta[..., first] + theta[..., second] <= 1.0, total, -math.inf)
        return total

    def flat_bounds(self) -> tuple[Tensor, Tensor]:
        """Lower and upper bounds (P,) of the flat coordinates y; infinite where there is none."""
        low, high = [], []
        for index, entry in enumerate(self.free):
            a, b = (0.0, 1.0) if index in self._second else entry.prior.flat_range()
            low.append(a)
            high.append(b)
        return self.start().new_tensor(low), self.start().new_tensor(high)

    def to_flat(self, theta: Tensor) -> Tensor:
        """Coordinates y (..., P) in which flat priors are flat and all bounds are a box: each on its prior's own
        scale, and the second reflectance of a pair as its share of what the first leaves."""
        columns = []
        natural = theta.unbind(-1)
        for index, (entry, value) in enumerate(zip(self.free, natural, strict=True)):
            prior = entry.prior
            if index in self._second:
                room = torch.clamp(1.0 - natural[self._second[index]], max=prior.high) - prior.low
                columns.append(((value - prior.low) / room.clamp(min=1e-12)).clamp(0.0, 1.0))
            else:
                columns.append(prior.to_scale(value))
        return torch.stack(columns, -1) if columns else theta.clone()

    def from_flat(self, y: Tensor) -> Tensor:
        """Inverse of :meth:`to_flat`."""
        columns: list[Tensor] = []
        for index, (entry, value) in enumerate(zip(self.free, y.unbind(-1), strict=True)):
            prior = entry.prior
            if index in self._second:
                room = torch.clamp(1.0 - columns[self._second[index]], max=prior.high) - prior.low
                columns.append(prior.low + room * value)
            else:
                columns.append(prior.from_scale(value))
        return torch.stack(columns, -1) if columns else y.clone()

    def to_straight(self, theta: Tensor) -> Tensor:
        """Coordinates x (..., P) in which light is nearly linear and posteriors are straight: each on its
        prior's own scale, and r_diff (1 - r_spec), the share that leaves diffusely, for the second of a pair.
        """
        columns = []
        natural = theta.unbind(-1)
        for index, (entry, value) in enumerate(zip(self.free, natural, strict=True)):
            if index in self._second:
                columns.append(value * (1.0 - natural[self._second[index]]))
            else:
                columns.append(entry.prior.to_scale(value))
        return torch.stack(columns, -1) if columns else theta.clone()

    def from_straight(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Natural values theta (..., P) and log |d theta / d x| (...); theta may lie outside the priors."""
        columns: list[Tensor] = []
        log_det = torch.zeros(x.shape[:-1], dtype=x.dtype, device=x.device)
        for index, (entry, value) in enumerate(zip(self.free, x.unbind(-1), strict=True)):
            if index in self._second:
                room = (1.0 - columns[self._second[index]]).clamp(min=1e-12)
                columns.append(value / room)
                log_det = log_det - torch.log(room)
            else:
                columns.append(entry.prior.from_scale(value))
                log_det = log_det + entry.prior.log_slope(value)
        return (torch.stack(columns, -1) if columns else x.clone()), log_det

    def prior_residuals(self, theta: Tensor) -> Tensor:
        """Peaked priors as rows of a least-squares problem: (..., number of peaked priors), zero at each
        prior's centre."""
        rows = []
        for entry, value in zip(self.free, theta.unbind(-1), strict=True):
            prior = entry.prior
            if prior.kind == "lognormal":
                rows.append((torch.log(value.clamp(min=1e-300)) - math.log(prior.centre)) / prior.sigma)
            elif prior.peaked:
                value = prior.to_scale(value) if prior.kind == "cauchy" else value
                rows.append((value - prior.centre) / prior.sigma)
        return torch.stack(rows, -1) if rows else theta.new_zeros(*theta.shape[:-1], 0)

    def sample_prior(self, count: int, generator: torch.Generator | None = None) -> Tensor:
        """Independent draws (count, P) from the prior, pairs rejected until inside their triangle."""
        if not self.free:
            return torch.zeros(count, 0, dtype=self.dtype, device=self.device)

        def draw(number: int) -> Tensor:
            u = torch.rand(number, len(self.free), generator=generator, dtype=self.dtype, device=self.device)
            return torch.stack(
                [e.prior.quantile(c) for e, c in zip(self.free, u.unbind(-1), strict=True)], -1
            )

        theta = draw(count)
        for first, second in self.pairs:
            outside = theta[:, first] + theta[:, second] > 1.0
            while bool(outside.any()):
                again = draw(int(outside.sum()))
                theta[outside, first], theta[outside, second] = again[:, first], again[:, second]
                outside = theta[:, first] + theta[:, second] > 1.0
        return theta

    def _unsqueeze(self, prior: Prior, value: Tensor, first: Tensor) -> Tensor:
        room = torch.clamp(1.0 - first, max=prior.high) - prior.low
        return prior.low + (value - prior.low) * (prior.high - prior.low) / room.clamp(min=1e-12)

    def _log_triangle(self, first: int, second: int) -> float:
        """Minus the log of the share of the pair's rectangle that lies under the line sum = 1 (0 unless both
        are uniform)."""
        a, b = self.free[first].prior, self.free[second].prior
        if a.kind != "uniform" or b.kind != "uniform":
            return 0.0
        x = torch.linspace(a.low, a.high, 4001, dtype=torch.float64)
        room = (torch.clamp(1.0 - x, max=b.high) - b.low).clamp(min=0.0)
        return -math.log(float(torch.trapezoid(room, x)) / ((a.high - a.low) * (b.high - b.low)))


def _narrowed(entry: Free, high: float) -> Free:
    prior = entry.prior
    if high >= prior.high:
        return entry
    room = max(high, prior.low + 1e-9)
    return replace(entry, prior=replace(prior, high=room), start=min(entry.start, room))
