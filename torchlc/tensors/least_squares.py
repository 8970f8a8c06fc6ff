"""Levenberg-Marquardt in a box, many starts in one batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

LARGEST_STEP = 0.25
"""Largest step along a bounded coordinate, in units of its range."""
STEP = 1e-6
"""Step by which slopes are taken, in units of a coordinate's scale."""


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

    def replaced(self, starts: Sequence[int], other: Minimum) -> Minimum:
        """With the state of ``starts`` as ``other``, of as many starts, has it, after this."""
        index = torch.tensor(list(starts), device=self.y.device)
        names = ("y", "cost", "jacobian", "residual", "converged")
        parts = {name: getattr(self, name).index_copy(0, index, getattr(other, name)) for name in names}
        return Minimum(**parts, iterations=self.iterations + other.iterations)


def minimise(
    residual: Callable[[Tensor], Tensor],
    start: Tensor,
    low: Tensor,
    high: Tensor,
    *,
    iterations: int = 60,
    tolerance: float = 1e-7,
    colours: Colours | None = None,
    dear: Sequence[int] = (),
    known: Tensor | None = None,
    go_on: Callable[[], bool] = lambda: True,
) -> Minimum:
    """Minimise |residual(y)|^2 from each row of ``start`` (S, P) within the box; ``residual`` maps (B, P) to
    (B, R).

    Steps are damped by the largest diagonal of J'J seen so far, by as much more or less as the last one gained of what was foreseen (Nielsen
    1999, IMM-REP-1999-05, Technical University of Denmark), projected on the box, and kept only where
    they lower the cost, so every start descends monotonically. Only starts that are at work, and slopes where a step was kept, are
    worked out again. A start has converged when a step gains less
    than ``tolerance`` of its cost (plus 1). ``go_on`` is asked before each step, and may end the search.

    Slopes along ``dear`` coordinates, to move which takes much longer than to move the others, are followed from step to step
    (Broyden 1965, Math. Comp. 19, 577, for these columns) and worked out anew where a step with followed slopes fails; those
    that are ``known`` at the starts (S, R, P), about or exactly, where it is not NaN, are followed from there. A start then converges, and the
    Jacobian that is returned is, by followed slopes: the caller sees by exact ones what is left to gain.
    """
    y = torch.minimum(torch.maximum(start, low), high)
    slopes = _Slopes.of(residual, low, high, colours, dear)
    r, jac = slopes.easy(y)
    cost = _finite(r.square().sum(-1))
    jac, copied = slopes.start(y, r, jac, known)
    followed = torch.full_like(cost, copied, dtype=torch.bool)
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
        move = _damped_step(gradient, normal, damping[:, None] * scale, held)
        move = torch.maximum(torch.minimum(move, cap), -cap)
        trial = torch.minimum(torch.maximum(y + move, low), high)
        (working,) = torch.nonzero(~converged, as_tuple=True)
        there, ahead = slopes.easy(trial[working])
        trial_r = r.index_copy(0, working, there)
        trial_cost = _finite(trial_r.square().sum(-1))
        better = (trial_cost < cost) & ~converged
        gain = cost - trial_cost
        step = trial - y
        foreseen = -2 * (gradient * step).sum(-1) - torch.einsum("sp,spq,sq->s", step, normal, step)
        small = gain.abs() <= tolerance * (cost + 1.0)
        last = (small & (damping < 10.0)) | (damping > 1e8)
        doubtful = followed & ~converged & ~better & ~small
        (moved,) = torch.nonzero(better[working], as_tuple=True)
        on = working[moved]
        if slopes.dear and len(on):
            ahead = slopes.follow(jac[on], ahead[moved], step[on], (trial_r - r)[on])
            jac = jac.index_copy(0, on, ahead)
            followed = followed.index_fill(0, on, True)
        y = torch.where(better[:, None], trial, y)
        r = torch.where(better[:, None], trial_r, r)
        cost = torch.where(better, trial_cost, cost)
        converged = converged | (last & ~doubtful)
        kept = torch.where(doubtful, damping, damping * 5)
        damping = torch.where(better, _eased(damping, gain, foreseen), kept)
        (anew,) = torch.nonzero(doubtful if slopes.dear else better, as_tuple=True)
        if len(anew):
            jac = jac.index_copy(0, anew, slopes.rest(y[anew], r[anew], jac[anew]))
            followed = followed.index_fill(0, anew, False)
    return Minimum(y, cost, jac, r, converged, done)


def _damped_step(gradient: Tensor, normal: Tensor, damping: Tensor, held: Tensor) -> Tensor:
    """Step (S, P) down a ``gradient`` (S, P) of |r|^2 / 2 with the ``normal`` matrix J'J (S, P, P) and a ``damping`` (S, P)
    on its diagonal; coordinates that are ``held`` (S, P) stay."""
    moving = (~held).to(gradient)
    system = normal * moving[:, :, None] * moving[:, None, :]
    system = system + torch.diag_embed(damping + held.to(gradient))
    return torch.nan_to_num(-torch.linalg.solve(system, (gradient * moving)[..., None])[..., 0])


def _eased(damping: Tensor, gain: Tensor, foreseen: Tensor) -> Tensor:
    """Damping (S,) after a step that gained so much of what was foreseen: by 1/6 at least, where Nielsen has 1/3, for a batch waits
    for its slowest start."""
    ratio = torch.nan_to_num(gain / foreseen.clamp(min=1e-300)).clamp(0.0, 1.0)
    return (damping * (1 - (2 * ratio - 1) ** 3).clamp(min=1 / 6)).clamp(min=1e-9)


@dataclass(frozen=True)
class Colours:
    """Columns of a Jacobian that touch different rows and so share one difference: ``groups`` of column
    indices, and for each column the rows (P, R) that it may touch."""

    groups: tuple[tuple[int, ...], ...]
    touched: Tensor


@dataclass(frozen=True)
class _Slopes:
    """Slopes of residuals by one-sided differences, by groups of columns: those ``first``, which are worked out with the
    residuals themselves, and ``late`` ones; with ``dear`` columns these are those, and all of them without."""

    residual: Callable[[Tensor], Tensor]
    low: Tensor
    high: Tensor
    first: tuple[tuple[int, ...], ...]
    late: tuple[tuple[int, ...], ...]
    touched: Tensor | None
    dear: bool

    @classmethod
    def of(
        cls,
        residual: Callable[[Tensor], Tensor],
        low: Tensor,
        high: Tensor,
        colours: Colours | None,
        dear: Sequence[int],
    ) -> _Slopes:
        groups = tuple((column,) for column in range(len(low))) if colours is None else colours.groups
        late = tuple(group for group in groups if not dear or set(group) & set(dear))
        first = tuple(group for group in groups if group not in late)
        touched = None if colours is None else colours.touched
        return cls(residual, low, high, first, late, touched, bool(dear))

    def easy(self, y: Tensor) -> tuple[Tensor, Tensor]:
        """Residuals (S, R) at points y (S, P), and a Jacobian (S, R, P) that has the columns of the first groups."""
        points = y[:, None]
        if self.first:
            points = torch.cat([points, self._moved(y, self.first)], 1)
        there = self.residual(points.flatten(0, 1)).unflatten(0, points.shape[:2])
        at = there[:, 0]
        jacobian = at.new_zeros(*at.shape, y.shape[-1])
        return at, self._filled(jacobian, y, there[:, 1:] - at[:, None], self.first)

    def rest(self, y: Tensor, at: Tensor, jacobian: Tensor) -> Tensor:
        """The Jacobian with the columns of the late groups, at points y (S, P) whose residuals ``at`` (S, R) are known."""
        return self._with(self.late, y, at, jacobian)

    def start(self, y: Tensor, at: Tensor, jacobian: Tensor, known: Tensor | None) -> tuple[Tensor, bool]:
        """The same, dear columns as they are ``known``, as far as they are; and whether any of them is."""
        if known is None or not self.dear:
            return self.rest(y, at, jacobian), False
        given = torch.isfinite(known).all(0).all(0)
        unknown = tuple(group for group in self.late if not bool(given[list(group)].all()))
        index = torch.tensor(sorted({c for group in self.late for c in group if group not in unknown}))
        if len(index):
            jacobian = jacobian.index_copy(2, index, known[:, :, index])
        return self._with(unknown, y, at, jacobian), bool(len(index))

    def _with(self, groups: Sequence[tuple[int, ...]], y: Tensor, at: Tensor, jacobian: Tensor) -> Tensor:
        if not groups:
            return jacobian
        points = self._moved(y, groups)
        there = self.residual(points.flatten(0, 1)).unflatten(0, points.shape[:2])
        return self._filled(jacobian, y, there - at[:, None], groups)

    def follow(self, jacobian: Tensor, ahead: Tensor, step: Tensor, change: Tensor) -> Tensor:
        """The Jacobian (S, R, P) after steps (S, P) that changed the residuals by (S, R), where ``ahead`` has the columns of
        the first groups; the others are turned so that with the mean of these they give the change."""
        easy = torch.zeros(step.shape[-1], dtype=torch.bool, device=step.device)
        easy[[column for group in self.first for column in group]] = True
        middle = torch.where(easy, 0.5 * (jacobian + ahead), jacobian)
        missed = torch.nan_to_num(change) - torch.einsum("srp,sp->sr", middle, step)
        square = step.square().sum(-1)[:, None, None]
        turned = missed[..., None] * step[:, None] / torch.where(square > 0, square, 1.0)
        return torch.where(easy, ahead, jacobian + turned)

    def _steps(self, y: Tensor) -> Tensor:
        """Points (S, P) each of whose coordinates is a step from that of y, backwards at an upper bound."""
        span = torch.where(torch.isfinite(self.high - self.low), self.high - self.low, torch.inf)
        step = STEP * torch.minimum(torch.ones_like(span), span) * torch.ones_like(y)
        return torch.where(y + step <= self.high, y + step, y - step)

    def _moved(self, y: Tensor, groups: Sequence[tuple[int, ...]]) -> Tensor:
        """y (S, P) with the coordinates of each group moved in turn, (S, groups, P)."""
        eye = torch.eye(y.shape[-1], dtype=torch.bool, device=y.device)
        chosen = torch.stack([eye[list(group)].any(0) for group in groups])
        return torch.where(chosen, self._steps(y)[:, None], y[:, None])

    def _filled(
        self, jacobian: Tensor, y: Tensor, change: Tensor, groups: Sequence[tuple[int, ...]]
    ) -> Tensor:
        """The Jacobian (S, R, P) with the columns of groups from what their steps changed, (S, groups, R)."""
        if not groups:
            return jacobian
        columns = [column for group in groups for column in group]
        change = change[:, [number for number, group in enumerate(groups) for _ in group]]
        if self.touched is not None:
            change = torch.where(self.touched[columns], change, 0.0)
        size = (self._steps(y) - y)[:, columns, None]
        slope = torch.where(size == 0, 0.0, change / torch.where(size == 0, 1.0, size))
        index = torch.tensor(columns, device=y.device)
        return jacobian.index_copy(2, index, torch.nan_to_num(slope).transpose(-1, -2))


def differences(
    residual: Callable[[Tensor], Tensor],
    y: Tensor,
    low: Tensor,
    high: Tensor,
    at: Tensor | None = None,
    colours: Colours | None = None,
    dear: Sequence[int] = (),
) -> Tensor:
    """Jacobian (S, R, P) at y (S, P) by one-sided differences, backwards at an upper bound: one batched call,
    no tracing of the model; with ``dear`` coordinates two, the others and these.

    ``at`` (S, R) is residual(y) where it is known already. A coordinate whose bounds are one value is held: its slope is 0,
    whatever rounding differs by between batches. The step is STEP of the coordinate's scale, the
    relative error of a slope of that order as well.
    """
    slopes = _Slopes.of(residual, low, high, colours, dear)
    if at is None or dear:
        at, jacobian = slopes.easy(y)
    else:
        jacobian = at.new_zeros(*at.shape, y.shape[-1])
    return slopes.rest(y, at, jacobian)


def _finite(cost: Tensor) -> Tensor:
    return torch.where(torch.isfinite(cost), cost, torch.inf)
