"""The minima of a posterior, from starts to fits, and their evidence.

Minus the log density of a row is half the square of a deviance residual, so that a minimum is one of least squares
whatever the law of errors, outliers included; noise is fitted in turn with the rest by Newton's method.

Letters: S starts, T rows, P coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchlc.inference.density import (
    AT_ONCE,
    Fitted,
    Linear,
    Posterior,
    deviance_rows,
    mixture_of,
)
from torchlc.inference.evidence import StudentMixture, importance
from torchlc.inference.normal_scores import FARTHEST
from torchlc.inference.reflectances import linear_columns
from torchlc.inference.starts import regressed
from torchlc.noise import Noise, Residuals
from torchlc.tensors.least_squares import Colours, differences, minimise
from torchlc.tensors.normal_tail import HALF_LOG_2PI
from torchlc.tensors.second_differences import second_differences

LEAST_PRECISION = 0.3
"""Of a coordinate in a Laplace approximation; the prior alone has 1, a likelihood that bends away may take some."""
WIDE_MAG = 0.1
"""Standard deviation, mag, that errors are given on the way from a start, where residuals are of the order of a
magnitude: at the quoted errors every row would be an outlier there, and pull at nothing."""
APART = 2.0
"""Standard deviations between minima that count as two."""
UNLIKE = 0.5
"""Standard deviations of the prior between points on their way that count as two."""
DEPTH = 8.0
"""Log density below the best within which a minimum is kept: 1/3000 of the mass, if it is as wide."""
TOLERANCE = 1e-4
"""Share of the cost that a step has to gain: some 0.02 in log density."""
LEFT = 0.02
"""Log density that a fit may leave to be gained: a fiftieth of what one standard deviation costs twice over."""
FARTHER = 5.0
"""How many times DEPTH a fit may lie behind the best as long as the nominal geometry stays where it is."""
LONGEST = 4.0
"""How many times what slopes promise a fit is believed to gain at most, on its way from where it was begun."""
MOST_POLISHED = 2
"""Turns of noise and descent beyond those that are asked for, while there is more than LEFT to gain."""
NOISE_STEPS = 8
"""At residuals that are held; the noise is found again at every turn."""
FIRST_STEPS, STEPS, LAST_STEPS = 6, 25, 8
"""Iterations of a descent: of many starts, of the few that are left of these, and where slopes are dear or a fit is near its end."""
MOST_MINIMA = 4
"""That are integrated together: each has slopes of its own, which take as long as its fit."""
PRIOR_SHARE = 0.1
"""Of the draws of a proposal: a plateau of a posterior is found, at the cost of a tenth of the others."""
MOST_TOGETHER = 400
"""Rows that err together, up to which 1,000 covariances are factorised in some 5 s."""
DEAR_SHARE = 2
"""What draws are divided by where each is a geometry or a covariance of its own, which takes a hundred times as long."""
LEAST_EFFECTIVE = 5.0
"""Draws on which an evidence rests at least; with fewer Laplace's method is the better guess."""


def descend(
    posterior: Posterior,
    starts: Tensor,
    iterations: int,
    noise: Noise | None = None,
    *,
    held: Sequence[int] = (),
    slopes: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Levenberg-Marquardt from coordinates (S, P), the noise at that of the first if none is given: points, best first, and
    their costs. Columns ``held`` stay at their values in the first start. ``slopes`` (S, T, P) are d residual / d g about the starts, as far as they are known, NaN elsewhere: they spare those of
    a free geometry."""
    if not posterior.physical:
        return starts[:1], starts.new_zeros(1)
    chosen = [column for column in posterior.physical if column not in held]
    if not chosen:
        return starts[:1], starts.new_zeros(1)
    columns = torch.tensor(chosen)
    stay = starts[0]
    low = torch.full_like(stay[columns], -FARTHEST)
    at = posterior.residuals(stay)
    rows = deviance_rows(posterior.likelihood, posterior.noise(stay) if noise is None else noise, at)

    def residual(part: Tensor) -> Tensor:
        whole = stay.repeat(len(part), 1).index_copy(1, columns, part)
        return torch.cat([rows(posterior.residuals(whole)), part], -1)

    dear = posterior.turning(chosen)
    known = None
    if dear and slopes is not None:
        known = _row_slopes(rows, posterior.residuals(starts), slopes[..., columns])
    reached = minimise(
        residual,
        starts[:, columns],
        low,
        -low,
        iterations=iterations,
        tolerance=TOLERANCE,
        colours=posterior.colours() if chosen == posterior.physical else None,
        dear=dear,
        known=known,
    )
    order = torch.argsort(reached.cost)
    points = stay.repeat(len(order), 1).index_copy(1, columns, reached.y[order])
    return points, reached.cost[order]


def _row_slopes(rows: Callable[[Residuals], Tensor], residuals: Residuals, slopes: Tensor) -> Tensor:
    """Slopes (S, T + K, K) of rows and of the prior's rows at residuals (S, T) whose own are (S, T, K), some NaN."""
    starts, _, count = slopes.shape
    shape = (starts, count, slopes.shape[1])

    def each(tensor: Tensor) -> Tensor:
        return tensor.expand(residuals.delta.shape)[:, None].expand(shape).flatten(0, 1)

    step = torch.nan_to_num(slopes).transpose(1, 2).reshape(-1, shape[-1])
    held = residuals.each(each)
    size = 1e-6 / step.abs().amax(-1, keepdim=True).clamp(min=1.0)
    change = (rows(replace(held, delta=held.delta + size * step)) - rows(held)) / size
    change = change.reshape(*shape[:2], -1).transpose(1, 2)
    priors = torch.eye(count, dtype=slopes.dtype).expand(starts, -1, -1)
    whole = torch.cat([change, priors], 1)
    return torch.where(torch.isfinite(slopes).all(1)[:, None], whole, torch.nan)


def fit_noise(posterior: Posterior, g: Tensor, found: Residuals) -> Tensor:
    """g (P,) with the noise's coordinates at their best for the residuals ``found`` there, by Newton's method."""
    index = posterior.noise_columns
    if not index:
        return g
    objective = _noise_objective(posterior, g, found)
    part = g[index]
    value, damping = float(objective(part[None])[0]), 1e-2
    for _ in range(NOISE_STEPS):
        gradient, hessian = second_differences(objective, part, 1e-3)
        curvature, axes = torch.linalg.eigh(hessian)
        move = -axes @ ((axes.T @ gradient) / (curvature.abs() + damping))
        trial = (part + move.clamp(-1.5, 1.5)).clamp(-FARTHEST, FARTHEST)
        new = float(objective(trial[None])[0])
        done = abs(value - new) < 1e-4
        if new < value:
            part, value, damping = trial, new, damping / 4
        else:
            damping = max(10 * damping, 0.1)
        if done or damping > 1e4:
            break
    return g.index_copy(0, torch.tensor(index), part)


def material_starts(posterior: Posterior, theta: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """``count`` natural values (count, P) like theta (P,) with the scene's materials drawn from their priors, and as many
    with their reflectances from a regression, in which light is linear."""
    parameters = posterior.model.parameter_set
    columns = [i for i, free in enumerate(parameters.free) if free.origin.role == "materials"]
    if not columns:
        return theta[None]
    draws = theta.repeat(count, 1)
    draws[:, columns] = parameters.sample_prior(count, generator)[:, columns]
    with torch.no_grad():
        return (
            torch.cat([draws, regressed(posterior.likelihood, draws)])
            if linear_columns(posterior.model)
            else draws
        )


def likeliest(posterior: Posterior, theta: Tensor, count: int) -> Tensor:
    """Coordinates of the ``count`` natural values of theta (S, P) that describe the rows best, with errors so wide that what is a little off
    counts little."""
    g = posterior.coordinates(theta)
    wide = Noise().wider(g.new_tensor([WIDE_MAG]))
    with torch.no_grad():
        density = torch.cat(
            [posterior.likelihood.density(posterior.residuals(some), wide) for some in g.split(AT_ONCE)]
        )
    return g[torch.argsort(torch.nan_to_num(density, nan=-math.inf), descending=True)[:count]]


def _noise_objective(posterior: Posterior, g: Tensor, residuals: Residuals) -> Callable[[Tensor], Tensor]:
    """Minus the log density (B,) at noise coordinates (B, k), the ``residuals`` held at those found at g (P,)."""
    index = torch.tensor(posterior.noise_columns)
    plain = residuals.sigma / posterior.factor(g)

    def objective(part: Tensor) -> Tensor:
        whole = g.repeat(len(part), 1).index_copy(1, index, part)
        shape = (len(part), len(residuals.delta))
        rows = {name: getattr(residuals, name).expand(shape) for name in ("delta", "scale", "prediction")}
        held = replace(residuals, sigma=(plain * posterior.factor(whole)).expand(shape), **rows)
        value = -posterior.held_density(held, whole)
        return torch.where(torch.isfinite(value), value, 1e12)

    return objective


@torch.no_grad()
def fit(
    hypothesis: Any,
    posterior: Posterior,
    starts: Tensor,
    *,
    steps: int = STEPS,
    turns: int = 2,
    most: int = MOST_MINIMA,
    floor: float = -math.inf,
    nominal: Sequence[int] = (),
    slopes: Tensor | None = None,
) -> Fitted:
    """The minima that starts (S, P), the first of which gives the noise, lead to: the one of most mass with the others.

    Columns of a ``nominal`` geometry, of which each value is worked out anew and which the light follows almost in proportion, are first left
    where each start has them. What their slopes promise from there tells whether the log evidence can come near ``floor``;
    if not, the fit ends there; and so does, once its noise is fitted, any fit that stays below. ``slopes`` (S, T, P) are d residual / d g about the starts, if they are known.
    """
    g, known = starts, slopes
    if len(starts) > most:
        wide = Noise().wider(starts.new_tensor([WIDE_MAG]))
        held = _common(posterior, starts, nominal)
        reached = descend(posterior, starts, FIRST_STEPS, wide, held=held)[0]
        # the first start is a minimum of a part of this model, which wide errors may leave for good
        reached = torch.cat([starts[:1], reached])
        g = reached[1:2] if posterior.dear else _unlike(reached, 2 * most)
    if nominal:
        first = _fits_as_they_stand(hypothesis, posterior, g, nominal, turns)[:most]
        within = [minimum for minimum in first if minimum.laplace + LONGEST * minimum.left > floor]
        if not within:
            return merged([replace(minimum, covariance=_covariance(minimum)) for minimum in first])
        g = torch.stack([minimum.g for minimum in within])
        known = torch.stack([minimum.slopes for minimum in within])
    g, cost = descend(posterior, g, LAST_STEPS if posterior.dear else steps, slopes=known)
    leading = g[cost < cost[0] + 2 * DEPTH]
    chosen: list[Tensor] = []
    for point in leading:
        if all(float((point - other).abs().max()) > 0.1 for other in chosen):
            chosen.append(point)
    return merged(
        [polished(_sloped(hypothesis, posterior, start), turns, floor) for start in chosen[:most]], most
    )


def _common(posterior: Posterior, starts: Tensor, nominal: Sequence[int]) -> Sequence[int]:
    """The columns of the geometry, or of the ``nominal`` one, if all starts (S, P) have it in common: left there, it is worked out
    once for all of them."""
    geometry = posterior.model.assembly.geometry_columns
    for held in (geometry, nominal):
        if set(posterior.physical) - set(held) and bool((starts[:, held] == starts[0, held]).all()):
            return held
    return ()


def _fits_as_they_stand(
    hypothesis: Any, posterior: Posterior, starts: Tensor, nominal: Sequence[int], turns: int
) -> list[Fitted]:
    """Fits from starts (S, P) that leave the ``nominal`` columns of each as they are, noise and the rest in turn; best first,
    those alike once."""
    points, costs = [], []
    for values in torch.unique(starts[:, nominal], dim=0):
        alike = starts[(starts[:, nominal] == values).all(-1)]
        reached, cost = descend(posterior, alike, LAST_STEPS, held=nominal)
        points.append(reached)
        costs.append(cost)
    cost, order = torch.sort(torch.cat(costs))
    near = torch.cat(points)[order][cost < cost[0] + 2 * FARTHER * DEPTH]
    fits = []
    for g in _unlike(near, MOST_MINIMA):
        for _ in range(turns if posterior.noise_columns else 0):
            g = fit_noise(posterior, g, posterior.residuals(g))
            g = descend(posterior, g[None], LAST_STEPS, held=nominal)[0][0]
        fits.append(_sloped(hypothesis, posterior, g))
    return sorted(fits, key=lambda minimum: -minimum.peak)


def polished(at: Fitted, turns: int, floor: float = -math.inf) -> Fitted:
    """A fit with noise and the rest fitted in turn, then until the slopes there promise no more than LEFT in log density, or so little that
    its log evidence stays below ``floor``."""
    posterior = at.posterior
    levels = posterior.likelihood.fitted_errors
    turns = turns if posterior.noise_columns or levels else 0
    for turn in range(turns + MOST_POLISHED):
        if turns:  # after the last step as well: the noise's own slopes are in no `left`
            g = fit_noise(posterior, at.g, at.found)
            at = _at(at.hypothesis, posterior, g, posterior.under(at.found, at.g, g), at.slopes)
        # a coordinate's prior has unit variance, which the data can hardly widen
        if at.peak + HALF_LOG_2PI * posterior.size + LONGEST * at.left < floor:
            break
        if at.left > LEFT or (levels and turn < turns):
            new = _moved(at)
            gain, at = new.peak - at.peak, max(at, new, key=lambda minimum: minimum.peak)
            if gain < LEFT and turn >= turns:
                break
        elif turn >= turns:
            break
    return replace(at, covariance=_covariance(at))


def _moved(at: Fitted) -> Fitted:
    """A fit after a step to the best of its linear form, noise and all, where its geometries are slow and that is better; else after
    a few steps from where it is."""
    if at.posterior.slow:
        g = fit(at.hypothesis, Linear(at), at.g[None], most=1).g
        new = _sloped(at.hypothesis, at.posterior, g)
        if new.peak > at.peak:
            return new
    g = descend(at.posterior, at.g[None], LAST_STEPS, slopes=at.slopes[None])[0][0]
    return _sloped(at.hypothesis, at.posterior, g)


def _unlike(points: Tensor, count: int) -> Tensor:
    """The first ``count`` of points (N, P), best first, that are not within UNLIKE of a better one: many starts may be on
    their way to one minimum."""
    chosen: list[int] = []
    for number, point in enumerate(points):
        if all(float((point - points[other]).abs().max()) > UNLIKE for other in chosen):
            chosen.append(number)
    return points[chosen[:count]]


def merged(minima: Sequence[Fitted], most: int = MOST_MINIMA) -> Fitted:
    """Minima of one hypothesis as one, led by that of most mass, at ``most`` so many; those within APART of a better one are left out."""
    order = sorted(minima, key=lambda minimum: -minimum.laplace)
    kept: list[Fitted] = []
    for candidate in order:
        if candidate.peak < max(other.peak for other in order) - DEPTH:
            continue
        if all(_distance(candidate, other) > APART for other in kept):
            kept.append(replace(candidate, others=(), evidence=None, missed=0.0))
    return replace(kept[0], others=tuple(kept[1:most]))


def _distance(first: Fitted, second: Fitted) -> float:
    """Standard deviations of the narrower of two minima between them, along the axis where they are farthest apart: a narrow
    one within a wide one's reach is another."""
    if not first.posterior.size:
        return 0.0
    spread = torch.minimum(torch.diagonal(first.covariance), torch.diagonal(second.covariance)).sqrt()
    return float(((first.g - second.g).abs() / spread).max())


@torch.no_grad()
def fitted_at(hypothesis: Any, posterior: Posterior, g: Tensor) -> Fitted:
    """Residuals, slopes and curvature at coordinates g (P,)."""
    at = _sloped(hypothesis, posterior, g)
    return replace(at, covariance=_covariance(at))


def _sloped(hypothesis: Any, posterior: Posterior, g: Tensor) -> Fitted:
    """Residuals and slopes at coordinates g (P,), as yet without their curvature."""
    residuals = posterior.residuals(g)
    shape = residuals.delta.shape
    residuals = replace(residuals, sigma=residuals.sigma.expand(shape), scale=residuals.scale.expand(shape))
    columns = torch.tensor(posterior.physical, dtype=torch.long)
    far = torch.full_like(g[columns], FARTHEST + 1.0)
    colours = posterior.colours()
    if colours is not None:
        colours = Colours(colours.groups, colours.touched[:, : len(residuals.delta)])

    def delta(part: Tensor) -> Tensor:
        return posterior.residuals(g.repeat(len(part), 1).index_copy(1, columns, part)).delta

    slopes = residuals.delta.new_zeros(len(residuals.delta), posterior.size)
    if posterior.physical:
        dear = posterior.turning(posterior.physical)
        slopes[:, columns] = differences(
            delta, g[None, columns], -far, far, residuals.delta[None], colours, dear
        )[0]
    return _at(hypothesis, posterior, g, residuals, slopes)


def _at(hypothesis: Any, posterior: Posterior, g: Tensor, residuals: Residuals, slopes: Tensor) -> Fitted:
    peak = float(posterior.held_density(residuals, g))
    unknown = torch.eye(len(g), dtype=g.dtype)
    return Fitted(hypothesis, posterior, g, residuals, posterior.noise(g), slopes, peak, unknown)


def _covariance(at: Fitted) -> Tensor:
    """Inverse of minus the second derivatives of the log density, its eigenvalues at least LEAST_PRECISION."""
    posterior, index = at.posterior, at.posterior.noise_columns
    hessian = at.tangent.T @ at.tangent
    if index:
        objective = _noise_objective(posterior, at.g, at.found)
        block = second_differences(objective, at.g[index], 1e-3)[1]
        hessian[torch.tensor(index)[:, None], torch.tensor(index)] = block
        if not at.noise.processes:
            cross = at.slopes.T @ _score_changes(at)
            cross[index] = 0.0
            hessian[:, index] += cross
            hessian[index] += cross.T
    values, vectors = torch.linalg.eigh(0.5 * (hessian + hessian.T))
    return (vectors / values.clamp(min=LEAST_PRECISION)) @ vectors.T


def _score_changes(at: Fitted) -> Tensor:
    """How minus the slope of each row's log density changes with the noise's coordinates, (T, k)."""
    posterior, index = at.posterior, at.posterior.noise_columns
    step = 1e-3
    axes = torch.eye(posterior.size, dtype=at.g.dtype)[index] * step
    g = torch.cat([at.g + axes, at.g - axes])
    plain = at.found.sigma / posterior.factor(at.g)
    with torch.enable_grad():
        delta = at.delta.repeat(len(g), 1).requires_grad_(True)
        held = replace(
            at.found,
            delta=delta,
            sigma=(plain * posterior.factor(g)).expand(delta.shape),
            scale=at.scale.expand(delta.shape),
            prediction=at.prediction.expand(delta.shape),
        )
        (slope,) = torch.autograd.grad(posterior.likelihood.density(held, posterior.noise(g)).sum(), delta)
    return ((slope[len(index) :] - slope[: len(index)]) / (2 * step)).T


def _defensive(minima: Sequence[Fitted]) -> StudentMixture:
    """The normal approximations, and a share PRIOR_SHARE of what the prior allows: a posterior may have a plateau that no
    curvature at a maximum tells of."""
    near = mixture_of(minima)
    g = minima[0].g
    return StudentMixture(
        torch.cat([near.mean, torch.zeros_like(g)[None]]),
        torch.cat([near.covariance, torch.eye(len(g), dtype=g.dtype)[None]]),
        torch.cat([near.log_share + math.log1p(-PRIOR_SHARE), g.new_tensor([math.log(PRIOR_SHARE)])]),
    )


@torch.no_grad()
def integrated(at: Fitted, draws: int, seed: int, linear: bool = False, moving: bool = True) -> Fitted:
    """The hypothesis with its evidence by importance sampling and, where weights are not to be trusted and draws may be ``moving``, a tempered sequence;
    from the ``linear`` form of each of its minima if so asked, and where a geometry is dear from that of the first alone. The sequence takes some 10,000 densities and more: it is left out where each
    draw has a geometry of its own, or where rows err together and each has a covariance of its own to factorise; the latter by
    Laplace's method alone for curves of over MOST_TOGETHER rows."""
    posterior, likelihood = at.posterior, at.likelihood
    together = bool(at.noise.processes)
    if not posterior.size or (together and int(torch.bincount(likelihood.curve).max()) > MOST_TOGETHER):
        return at
    linear = linear or posterior.dear
    free = posterior.model.geometry_free and not linear
    density = Linear(at).log_density if linear else posterior.log_density
    minima = (at,) if linear else at.minima
    generator = torch.Generator().manual_seed(seed)
    count = draws // DEAR_SHARE if free or together else draws
    evidence = importance(
        density, _defensive(minima), count, generator, moving=moving and not together and not free
    )
    evidence = replace(evidence, linear=linear)
    if linear and not posterior.dear:
        # the other minima have the mass beside the first that they have by Laplace's method
        others = torch.tensor([minimum.laplace for minimum in at.minima]).logsumexp(0) - at.laplace
        evidence = replace(evidence, log_z=evidence.log_z + float(others))
    return replace(at, evidence=evidence) if evidence.effective > LEAST_EFFECTIVE else at
