"""How often a body turned between the parts of a recording: where an effect that drives its phase has to begin.

With a phase for each night, or curve, a model fits whatever turns lie between them. That these phases are whole turns then leaves a
lattice of rates, and of what changes them: from each of its points a descent comes to another minimum, and from none to its
neighbour. Letters: N parts, T rows, P coordinates, C counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.diagnosis.hypotheses import MOST_OBJECTS, Workbench, carried, effect_columns
from torchlc.diagnosis.probes import MOST_S, each_best
from torchlc.effects import effect_class, registry
from torchlc.inference.density import Fitted, Posterior
from torchlc.inference.posterior import WIDE_MAG, descend, fit, likeliest
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.noise import Noise
from torchlc.stages.entry import Entry

WIDTH = 4.0
"""Standard deviations of a phase within which counts are tried."""
MOST = 1500
"""Counts that are kept from part to part."""
MOST_STEPS, PARTS_OF_A_STEP = 8, (1.0, 0.3)
"""Steps of whole turns to where the rows have what changes the turn within a part, and how much of one is tried: a change of the period
by 2 ms a day took six."""
LEADING, STEPS = 12, 6
"""Counts that a few steps are made from, and how many."""
OWN_DEG = 0.2
"""Error of a phase beyond that of the rows, for what is linear here and is not in the light: the drift within a night."""
LEAST_PRECISION = 1e-9
"""Of a phase whose prior is left out, 1/deg2: that a night tells nothing of it leaves nothing that cannot be inverted."""
FLAT = 10.0
"""Standard deviations, in widths of the bounds, of what is believed alike between these: what lies beyond is left out afterwards."""
STEP = 1e-5
"""Of coordinates, for the slopes of natural values: a Cauchy distribution's bend by 1e-5 of themselves over 1e-3."""
COMMON = 0.01
"""Relative difference up to which a number is a phase of all parts in common."""
AS_LIKELY = 0.01
"""Of the likeliest count's probability, that another has to have to be among those that fit."""


@dataclass(frozen=True)
class Counted:
    """What counts of turns leave open: ``starts`` (S, P), values of theta from which a fit of each of the leading ones begins; how many
    ``fit`` the rows; and of each number that they tell, by name, its value at each of them (C,), with their probabilities ``p`` (C,)."""

    starts: Tensor
    fit: int = 0
    values: Mapping[str, Tensor] | None = None
    p: Tensor | None = None

    def spread(self, name: str, value: float) -> float:
        """Root of the mean square by which a number is off from ``value`` over all counts that fit; 0 of one that they do not tell."""
        if self.fit < 2 or self.values is None or self.p is None or name not in self.values:
            return 0.0
        return float(torch.sqrt((self.p * (self.values[name] - value).square()).sum()))


def phase_entry(bench: Workbench) -> str | None:
    """The effect that gives each night, or where these are not told from curves each curve, a phase of its own; None where none
    can, or where there are too many."""
    divisions = [division for division in ("night", "curve") if division in bench.divisions()]
    if not divisions or len(bench.base.row_index[divisions[0]][1]) > MOST_OBJECTS:
        return None
    present = {effect.name for effect in bench.base.effects}
    for name, cls in registry().items():
        if cls.whole_turn and name not in present and cls(None).missing(bench.base.context) is None:
            return Entry(name, None, divisions[0]).plain
    return None


def counted(bench: Workbench, at: Fitted, target: Posterior, loose: Posterior, phase: str) -> Counted:
    """The counts of turns that suit the rows, and where the ``target`` begins from those that do best. ``loose`` is the
    same model with ``phase`` beside it, ``at`` a fit that it is begun from."""
    parameters = loose.model.parameter_set
    theta = carried(parameters, at.theta[None], at.names)
    columns = effect_columns(parameters, phase)
    kinds = [parameter.origin.role for parameter in parameters.free]
    turning = [
        column
        for column in loose.physical
        if column not in columns and kinds[column] in ("attitude", "effects")
    ]
    begin = each_best(bench, at, loose, phase, theta)[0]
    none = Counted(at.theta.new_zeros(0, len(target.model.names)))
    if not turning or begin is None:
        return none
    theta[:, columns] = begin
    bounds = theta.new_tensor(
        [[parameters.free[k].prior.low, parameters.free[k].prior.high] for k in turning]
    )
    whole = effect_class(phase).whole_turn / _alike(bench)
    lattice = _Lattice(columns, turning, whole, bounds, _from_longest(bench, phase))
    first = free = fit(at.hypothesis, loose, loose.coordinates(theta), turns=1, most=1)
    for _ in range(MOST_STEPS):
        stepped = lattice.stepped(free)
        if stepped is None or lattice.told(stepped) < lattice.told(free) + 1.0:
            break
        free = stepped
    points = [pair for fitted in (free, first) if (pair := lattice.points(fitted)) is not None]
    if not points:
        return none
    # a model that cannot have the phases of its parts may do better among the counts of where it was
    starts = [
        _leading(target, carried(target.model.parameter_set, thetas, loose.model.names))
        for thetas, _ in points[: 1 if free is first else 2]
    ]
    begun = (
        torch.cat(starts) if len(starts) == 1 else target.theta(likeliest(target, torch.cat(starts), LEADING))
    )
    theta, p = points[0]
    values = {parameters.free[column].name: theta[:, column] for column in turning}
    return Counted(begun, int((p > AS_LIKELY * p.max()).sum()), values, p)


@dataclass(frozen=True)
class _Lattice:
    """Where the phases of the parts are whole turns: columns of theta of these ``phases`` (N), and of what else is ``turning`` (K) with its
    ``bounds`` (K, 2), degrees after which the body looks the same, and the ``order`` in which parts are joined."""

    phases: list[int]
    turning: list[int]
    whole: float
    bounds: Tensor
    order: list[int]

    def shared(self, spread: Tensor) -> tuple[Tensor, Tensor, int, bool]:
        """How much of each number a part's phase takes with it (N, K), by a covariance (N + K, N + K); how the numbers change with a whole turn of all parts
        (K,); which of them changes most; and whether that is a phase of all parts in common."""
        among = spread[: len(self.phases), : len(self.phases)]
        pull = torch.linalg.solve(among, spread[: len(self.phases), len(self.phases) :])
        shift = self.whole * pull.sum(0)
        most = int((shift.abs() / (self.bounds[:, 1] - self.bounds[:, 0])).argmax())
        return pull, shift, most, bool((shift[most].abs() / self.whole - 1).abs() < COMMON)

    def points(self, free: Fitted) -> tuple[Tensor, Tensor] | None:
        """Values of theta (C, P) at the counts of turns that suit the phases of a fit, inside the bounds, with their probabilities (C,); None
        where there are none."""
        spread = _by_the_rows(free, self.phases, self.turning)[1]
        if not bool(torch.isfinite(spread).all()):
            return None
        pull, shift, most, common = self.shared(spread)
        deg, among = free.theta[self.phases], spread[: len(self.phases), : len(self.phases)]
        counts, distance = _counts(deg / self.whole, among / self.whole**2, self.order, common)
        numbers = free.theta[self.turning] + (self.whole * counts - deg) @ pull
        low, high = self.bounds.unbind(1)
        if common:
            numbers = numbers + shift * ((0.5 * (low + high) - numbers)[:, [most]] / shift[most]).round()
        inside = ((numbers >= low) & (numbers <= high)).all(1)
        if not bool(inside.any()):
            return None
        theta = free.theta.repeat(int(inside.sum()), 1)
        theta[:, self.turning] = numbers[inside]
        return theta, torch.softmax(-0.5 * distance[inside], 0)

    def stepped(self, free: Fitted) -> Fitted | None:
        """A fit from where the slopes of another point, or a part of the way there, with all phases within half a turn: what changes the
        turn within a part is whole turns of other parts away, where no descent comes to. None where the rows tell too little."""
        values, spread = _by_the_rows(free, self.phases, self.turning)
        if not bool(torch.isfinite(spread).all()):
            return None
        _, shift, most, common = self.shared(spread)
        step = values - free.theta[[*self.phases, *self.turning]]
        of_phases, of_turning = step[: len(self.phases)], step[len(self.phases) :]
        if common:  # what all parts have in common stays where it is
            of_phases = of_phases - of_turning[most] * torch.sign(shift[most])
            of_turning[most] = 0.0
        low, high = self.bounds.unbind(1)
        stepped = free
        for part in PARTS_OF_A_STEP:
            theta = free.theta.clone()
            deg = theta[self.phases] + part * of_phases
            theta[self.phases] = deg - self.whole * (deg / self.whole).round()
            moved = theta[self.turning] + part * of_turning
            theta[self.turning] = torch.minimum(torch.maximum(moved, low), high)
            posterior = free.posterior
            stepped = fit(free.hypothesis, posterior, posterior.coordinates(theta[None]), turns=1, most=1)
            if self.told(stepped) > self.told(free):
                break
        return stepped

    def told(self, at: Fitted) -> float:
        """Log density at a fit but for the prior of the phases, of which any is as good here."""
        return at.peak + 0.5 * float(at.g[self.phases].square().sum())


def _by_the_rows(free: Fitted, phases: list[int], turning: list[int]) -> tuple[Tensor, Tensor]:
    """What the rows, and all priors but those of the ``phases``, say of these and of the numbers ``turning``: natural values (N + K,) at the
    minimum and their covariance. In natural values the light is linear over as many turns as there may be."""
    columns = [*phases, *turning]
    rest = [column for column in free.posterior.physical if column not in columns]
    step = torch.zeros_like(free.g)
    step[columns] = STEP
    apart = free.posterior.theta(free.g + step) - free.posterior.theta(free.g - step)
    slope = torch.cat([apart[columns].clamp(min=1e-12) / (2 * STEP), step.new_ones(len(rest))])
    slopes = free.whitened(free.slopes[:, [*columns, *rest]]) / slope
    believed, pulled = 1 / slope**2, free.g[[*columns, *rest]] / slope
    believed[: len(phases)], pulled[: len(phases)] = LEAST_PRECISION, 0.0
    for index, column in enumerate(turning, len(phases)):
        prior = free.model.parameter_set.free[column].prior
        if not prior.peaked:
            believed[index], pulled[index] = 1 / (FLAT * (prior.high - prior.low)) ** 2, 0.0
    left = slopes.T @ free.whitened(free.delta[:, None])[:, 0] + pulled
    precision = slopes.T @ slopes + torch.diag(believed)
    scale = torch.diagonal(precision).sqrt()  # hours and degrees: unscaled, digits are lost
    covariance = torch.linalg.inv_ex(precision / scale[:, None] / scale).inverse / scale[:, None] / scale
    values = free.theta[columns] - (covariance @ left)[: len(columns)]
    covariance = covariance[: len(columns), : len(columns)]
    diagonal = torch.arange(len(phases))
    covariance[diagonal, diagonal] += OWN_DEG**2
    return values, covariance


def _alike(bench: Workbench) -> int:
    """Turns within one after each of which the body looks the same."""
    return FacetLight.of(bench.base).symmetry(bench.base.attitude.about_spin_axis[-1])


def _from_longest(bench: Workbench, phase: str) -> list[int]:
    """The parts, the one of most time first, others as they are farther from it."""
    part, names = bench.base.row_index[str(Entry.parse(phase).per)]
    seconds = bench.base.context.seconds
    each = [seconds[part == number] for number in range(len(names))]
    middle = torch.stack([0.5 * (times.max() + times.min()) for times in each])
    longest = int(torch.stack([times.max() - times.min() for times in each]).argmax())
    return torch.argsort((middle - middle[longest]).abs(), stable=True).tolist()


def _counts(off: Tensor, spread: Tensor, order: list[int], common: bool) -> tuple[Tensor, Tensor]:
    """Whole numbers (C, N) near ``off`` (N,) by its covariance, nearest first, part by part in ``order``, and the squares (C,) of how far
    they are in standard deviations. ``common``: those that differ by the same in all parts are one."""
    # from a number far from its own the others would be sought along what the rows hardly tell
    counts, distance = off[order[: int(common)]].round()[None], off.new_zeros(1)
    for k, part in list(enumerate(order))[int(common) :]:
        known = order[:k]
        pull = torch.linalg.solve(spread[known][:, known], spread[known, part])
        sd = float((spread[part, part] - pull @ spread[known, part]).clamp(min=0).sqrt())
        expected = off[part] + (counts - off[known]) @ pull
        reach = min(math.ceil(WIDTH * sd), MOST // 2)
        steps = torch.arange(-reach, reach + 1, dtype=off.dtype)
        tried = expected.round()[:, None] + steps
        total = distance[:, None] + ((tried - expected[:, None]) / max(sd, 1e-9)).square()
        nearest = torch.argsort(total.flatten())[:MOST]
        of = nearest // len(steps)
        counts = torch.cat([counts[of], tried.flatten()[nearest, None]], 1)
        distance = total.flatten()[nearest]
    return counts[:, torch.argsort(torch.tensor(order))], distance


def _leading(target: Posterior, theta: Tensor) -> Tensor:
    """The best of values (C, P) by the rows, as far as there is time to look at them, after a few steps from each: with errors so
    wide that a phase that is a little off counts little."""
    affordable = max(LEADING, int(MOST_S / max(target.seconds_each, 1e-9)))
    best = likeliest(target, theta[:affordable], LEADING)
    wide = Noise().wider(best.new_tensor([WIDE_MAG]))
    return target.theta(descend(target, best, STEPS, wide)[0])
