"""Maximum a posteriori: Adam on chi-square from many starts in one batch, then a Levenberg-Marquardt polish
of the best.

The maximum is taken in flat coordinates (logarithms of log-scaled parameters), where flat priors add nothing:
it is the least chi-square, peaked priors counted as further rows. The parameters of noise are fitted in turn with the
rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from torchlc.digits import number_of
from torchlc.inference.budget import Budget
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve
from torchlc.noise import Noise, Residuals
from torchlc.noise.correlated import correlated_parts, white_levels
from torchlc.noise.orthant import POINTS
from torchlc.parameters import FRESNEL, LOBE_REFLECTANCE
from torchlc.tensors.least_squares import Minimum, minimise
from torchlc.tensors.normal_tail import hazard

DISTINCT_CHI2 = 10.0
"""Minima within this of the best are kept as modes."""
NOISE_VALUES = 10_000_000
"""Elements of the covariances held at once while noise is fitted: 80 MB."""
LEADERS = 6
LONG_POLISH = 300
ADAM_SHARE = 0.4
"""Of a budget, for the first of the two stages of the search."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Mode:
    """A minimum: natural values theta (P,), its objective (chi-square with the priors' rows, plus 2 ln of the
    noise's scale), and the Laplace covariance (P, P) in flat coordinates; columns at a bound have no
    variance."""

    theta: Tensor
    objective: float
    covariance: Tensor
    at_bound: Tensor


@dataclass(frozen=True)
class Fit:
    """The best mode and what is needed to judge it; ``converged`` with its ``reason`` in words, ``history``
    the best chi-square of Adam."""

    likelihood: Likelihood
    modes: Sequence[Mode]
    chi2: float
    converged: bool
    reason: str
    history: Sequence[float] = field(default_factory=list)
    warnings: Sequence[str] = field(default_factory=list)

    @property
    def model(self) -> LightCurve:
        return self.likelihood.model

    @property
    def theta(self) -> Tensor:
        """Natural values (P,) of the best mode."""
        return self.modes[0].theta

    @property
    def dof(self) -> int:
        return self.likelihood.degrees_of_freedom

    @property
    def p_value(self) -> float:
        """Probability of a larger chi-square if the model and the errors are right."""
        return chi2_tail(self.chi2, max(self.dof, 1))


def chi2_tail(chi2: float, dof: float) -> float:
    """Upper tail of the chi-square distribution."""
    return float(
        torch.special.gammaincc(
            torch.tensor(dof / 2, dtype=torch.float64), torch.tensor(chi2 / 2, dtype=torch.float64)
        )
    )


def find_modes(
    likelihood: Likelihood,
    *,
    starts: int = 24,
    adam_steps: int = 150,
    seed: int = 0,
    extra_starts: Tensor | None = None,
    progress: Progress | None = None,
    budget: Budget | None = None,
) -> tuple[list[Mode], list[float], Minimum | None]:
    """Distinct minima of the objective, best first, with Adam's history; ``extra_starts`` (S, P) are natural
    values added to the scene's own and the prior's draws. Where the ``budget`` ends Adam, only the LEADERS of its last and first points are polished."""
    budget = Budget() if budget is None else budget
    model = likelihood.model
    parameters = model.parameter_set
    if not parameters.names:
        return [_evaluated(likelihood)], [], None
    generator = torch.Generator().manual_seed(seed)
    draws = parameters.sample_prior(max(starts - 1, 0), generator)
    draws = _crowded(parameters.roles, draws, generator)
    points = torch.cat(
        [parameters.start()[None], draws] + ([extra_starts] if extra_starts is not None else [])
    )
    theta, history = adam(likelihood, points, adam_steps, progress, budget=budget.part(ADAM_SHARE))
    if len(history) < adam_steps:
        with torch.no_grad():
            known = torch.cat([theta, points])
            density = likelihood.log_prob(known).nan_to_num(-math.inf)
        theta = known[torch.argsort(density, descending=True)[: LEADERS if budget.left() else 1]]
    noise = model.noise(parameters.start())
    best = polish(likelihood, theta, noise, go_on=budget.left)
    if not bool(best.converged[best.cost.argmin()]) and budget.left():
        leading = best.y[torch.argsort(best.cost)[:LEADERS]]
        best = polish(
            likelihood, parameters.from_flat(leading), noise, iterations=LONG_POLISH, go_on=budget.left
        )
    if model.assembly.stage("noise") or likelihood.fitted_errors or likelihood.selected is not None:
        leaders = parameters.from_flat(best.y[_leaders(best, noise_columns(likelihood))])
        best = _noise_in_turn(likelihood, leaders, budget)
    modes = _distinct(likelihood, best)
    return modes, history, best


def adam(
    likelihood: Likelihood,
    theta: Tensor,
    steps: int,
    progress: Progress | None = None,
    rate: float = 0.08,
    budget: Budget | None = None,
) -> tuple[Tensor, list[float]]:
    """Adam on minus the log posterior in unconstrained coordinates from each row of theta (S, P); returns the
    last points and the best chi-square at each step, of which a spent ``budget`` leaves fewer. The rate falls to a tenth along a cosine. Kingma and
    Ba's update, written out: importing ``torch.optim`` costs seconds, for its compiler."""
    parameters = likelihood.model.parameter_set
    z = parameters.to_unconstrained(theta).detach().clone()
    mean, square = torch.zeros_like(z), torch.zeros_like(z)
    history: list[float] = []
    for step in range(1, steps + 1):
        leaf = z.requires_grad_(True)
        natural = parameters.to_natural(leaf)
        loss = 0.5 * (likelihood.normalised(likelihood.residuals(natural)) ** 2).sum(-1)
        loss = loss + 0.5 * (parameters.prior_residuals(natural) ** 2).sum(-1)
        (gradient,) = torch.autograd.grad(torch.where(torch.isfinite(loss), loss, 0.0).sum(), leaf)
        gradient = torch.nan_to_num(gradient, 0.0, 0.0, 0.0)
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.999 * square + 0.001 * gradient**2
        speed = rate * (0.55 + 0.45 * math.cos(math.pi * step / steps))
        slope = (mean / (1 - 0.9**step)) / (torch.sqrt(square / (1 - 0.999**step)) + 1e-12)
        z = leaf.detach() - speed * slope
        history.append(2 * float(loss.detach().nan_to_num(torch.inf).min()))
        if progress is not None and step % 10 == 0:
            progress("Adam", step / steps)
        if budget is not None and not budget.left():
            break
    return parameters.to_natural(z), history


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
        found = minimise(residual, parameters.to_flat(theta), iterations=iterations, dear=dear, **box)
        if not dear:
            return found
        near = _leaders(found, (), most=len(found.y), depth=DISTINCT_CHI2)
        return found.replaced(near, minimise(residual, found.y[near], iterations=iterations, **box))


def whitener(
    likelihood: Likelihood, at: Residuals, noise: Noise | None, *, fitted: bool = False
) -> Callable[[Residuals], Tensor]:
    """A function that turns residuals into rows of unit variance, with the noise and its scale taken at the
    residuals ``at``. With ``fitted`` these are near the minimum: levels of errors that are fitted, what weight the law of
    errors gives to rows, and how far rows are bright because those below a flux of 0 are not there, are taken from them; repeated,
    this is expectation and maximisation (Dempster, Laird & Rubin 1977, J. R. Stat. Soc. B 39, 1). Upper limits among rows
    that err together count one by one here, each given the measured rows."""
    noise = Noise() if noise is None else noise
    sigma = noise.sigma(at.sigma, at.scale).expand(at.delta.shape)
    if likelihood.fitted_errors and fitted:
        levels = (
            white_levels(likelihood, at.delta, noise)
            if noise.processes
            else likelihood.fitted_levels(at.delta)
        )
        sigma = levels[likelihood.curve]
    if noise.processes:
        parts = correlated_parts(likelihood, at, sigma, noise)
        order = torch.argsort(torch.cat([part.rows.flatten() for part in parts]))
        spread = [torch.sqrt(part.limits.square().sum(-1)) for part in parts]

        def correlated(found: Residuals) -> Tensor:
            pieces = []
            for part, sd in zip(parts, spread, strict=True):
                white, left = part.whitened(found.delta)
                pieces.append(torch.cat([white, left / sd], -1).flatten(-2))
            return likelihood.deviance_rows(torch.cat(pieces, -1)[..., order])

        return correlated

    shift = torch.zeros_like(sigma)
    if fitted:
        sigma = noise.law.weighted(at.delta, sigma)
    if fitted and likelihood.selected is not None:
        shift = hazard(likelihood.above_zero(at, sigma))

    def independent(found: Residuals) -> Tensor:
        return likelihood.deviance_rows(found.delta / sigma + shift)

    return independent


def noise_columns(likelihood: Likelihood) -> list[int]:
    """Which elements of theta belong to noise effects."""
    owners = {effect.name for effect in likelihood.model.assembly.stage("noise")}
    free = likelihood.model.parameter_set.free
    return [i for i, one in enumerate(free) if one.origin.role == "effects" and one.origin.owner in owners]


def fit_noise(likelihood: Likelihood, theta: Tensor, *, search: bool = True, steps: int = 40) -> Tensor:
    """The noise parameters of theta (P,) at their best for the residuals of its other parameters.

    Newton's method in unconstrained coordinates, from theta or, with ``search``, the best of a cloud; by
    differences of one batched call a step, and every step is kept only if it improves.
    """
    index = noise_columns(likelihood)
    if not index:
        return theta
    parameters = likelihood.model.parameter_set
    objective = _noise_objective(likelihood, theta, parameters.to_natural)
    z = parameters.to_unconstrained(theta)
    trials = z[None, index]
    if search:
        first = parameters.to_unconstrained(parameters.start())[index]
        cloud = 8.0 * torch.quasirandom.SobolEngine(len(index)).draw(32, dtype=z.dtype).to(z.device) - 4.0
        trials = torch.cat([trials, first[None], first + cloud])
    values = objective(_with_columns(z, index, trials))
    part, value = trials[values.argmin()], float(values.min())
    damping = 1e-1
    for _ in range(steps):
        gradient, hessian = second_differences(
            lambda cut: objective(_with_columns(z, index, cut)), part, 1e-3
        )
        curvature, axes = torch.linalg.eigh(hessian)
        move = -axes @ ((axes.T @ gradient) / (curvature.abs() + damping))
        trial = part + move.clamp(-1.5, 1.5)
        new = float(objective(_with_columns(z, index, trial[None]))[0])
        done = abs(value - new) < 1e-7 * (abs(value) + 1)
        if new < value:
            part, value, damping = trial, new, damping / 4
        else:
            damping *= 6
        if done or damping > 1e6:
            break
    return parameters.to_natural(_with_columns(z, index, part[None]))[0]


def _leaders(found: Minimum, noise: Sequence[int], most: int = 4, depth: float = math.inf) -> list[int]:
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


def _noise_in_turn(likelihood: Likelihood, theta: Tensor, budget: Budget) -> Minimum:
    """Minima from natural values theta (S, P) with noise and all else fitted in turn.

    So are rows that are there only if their flux is above 0. Costs are -2 ln of the density, less that of rows of
    unit variance, so that minima with different noise compare; the curvature of the noise is among the rows of the
    slopes.
    """
    parameters = likelihood.model.parameter_set
    index = noise_columns(likelihood)
    found: list[Minimum] = []
    with torch.no_grad():
        for turn in range(4):
            noisy = torch.stack([fit_noise(likelihood, one, search=turn == 0) for one in theta])
            noises = [likelihood.model.noise(one) for one in noisy]
            found = [
                polish(likelihood, one[None], noise, level_at=one, go_on=budget.left)
                for one, noise in zip(noisy, noises, strict=True)
            ]
            theta = torch.cat([parameters.from_flat(one.y) for one in found])
            if not budget.left():
                break
        cost = -2 * likelihood.log_likelihood(theta) - likelihood.rows * math.log(2 * math.pi)
        cost = cost + (parameters.prior_residuals(theta) ** 2).sum(-1)
        jacobian = torch.cat([one.jacobian for one in found])
        residual = torch.cat([one.residual for one in found])
        extra = jacobian.new_zeros(len(theta), len(index), jacobian.shape[-1])
        for number, one in enumerate(theta if index else ()):
            y = parameters.to_flat(one)
            objective = _noise_objective(likelihood, one, parameters.from_flat)
            part, step = _inside(y[index], *(bound[index] for bound in parameters.flat_bounds()))
            _, hessian = second_differences(lambda cut: objective(_with_columns(y, index, cut)), part, step)  # noqa: B023
            curvature, axes = torch.linalg.eigh(hessian)
            extra[number][:, index] = torch.sqrt(curvature.clamp(min=0))[:, None] * axes.T
    return Minimum(
        torch.cat([one.y for one in found]),
        cost,
        torch.cat([jacobian, extra], 1),
        torch.cat([residual, residual.new_zeros(len(theta), len(index))], 1),
        torch.cat([one.converged for one in found]),
        max(one.iterations for one in found),
    )


def _noise_objective(
    likelihood: Likelihood, theta: Tensor, natural: Callable[[Tensor], Tensor]
) -> Callable[[Tensor], Tensor]:
    """Minus the log posterior (B,) of coordinates (B, P), which ``natural`` turns into theta, with the
    residuals held at those of theta (P,)."""
    parameters = likelihood.model.parameter_set
    with torch.no_grad():
        held = likelihood.residuals(theta)
    limits = int(likelihood.limit.sum())
    size = max(1, NOISE_VALUES // max(len(held.delta) ** 2, POINTS * limits))

    def piece(coordinates: Tensor) -> Tensor:
        whole = natural(coordinates)
        shape = (len(whole), likelihood.rows)
        rows = {name: getattr(held, name).expand(shape) for name in ("delta", "sigma", "scale", "prediction")}
        found = replace(held, **rows)
        prior = 0.5 * (parameters.prior_residuals(whole) ** 2).sum(-1)
        value = prior - likelihood.density(found, likelihood.model.noise(whole))
        return torch.where(torch.isfinite(value), value, torch.inf)

    @torch.no_grad()
    def objective(coordinates: Tensor) -> Tensor:
        return torch.cat([piece(cut) for cut in coordinates.split(size)])

    return objective


def _with_columns(whole: Tensor, index: Sequence[int], columns: Tensor) -> Tensor:
    """Copies (B, P) of ``whole`` (P,) with some elements from ``columns`` (B, k)."""
    copies = whole.repeat(len(columns), 1)
    copies[:, index] = columns
    return copies


def _inside(y: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """The point (k,) moved off its bounds so far that differences by the step (k,) stay inside."""
    span = torch.where(torch.isfinite(high - low), high - low, 1.0).clamp(max=1.0)
    step = 1e-3 * torch.minimum(span, torch.minimum(y - low, high - y).clamp(min=1e-3 * span))
    return torch.maximum(torch.minimum(y, high - 2 * step), low + 2 * step), step


def second_differences(
    function: Callable[[Tensor], Tensor], at: Tensor, step: Tensor | float
) -> tuple[Tensor, Tensor]:
    """Gradient (k,) and Hessian (k, k) at a point (k,) by central differences, all in one call of (B, k) ->
    (B,)."""
    k = len(at)
    axes = torch.eye(k, dtype=at.dtype, device=at.device) * step
    pairs = [(i, j) for i in range(k) for j in range(i)]
    corners = [sign * (axes[i] + axes[j]) for i, j in pairs for sign in (1.0, -1.0)]
    values = function(at + torch.stack([torch.zeros_like(at), *axes, *-axes, *corners]))
    size = torch.diagonal(axes)
    middle, up, down, both = values[0], values[1 : k + 1], values[k + 1 : 2 * k + 1], values[2 * k + 1 :]
    second = up + down - 2 * middle
    hessian = torch.diag(second)
    for (i, j), corner in zip(pairs, both.reshape(-1, 2).sum(-1), strict=True):
        hessian[i, j] = hessian[j, i] = 0.5 * (corner - 2 * middle - second[i] - second[j])
    return torch.nan_to_num((up - down) / (2 * size)), torch.nan_to_num(hessian / size[:, None] / size)


def _crowded(roles: Sequence[str], draws: Tensor, generator: torch.Generator) -> Tensor:
    """Every other start has its lobe reflectances near 0, where the best minimum of a faint lobe lies."""
    columns = [i for i, role in enumerate(roles) if role in (LOBE_REFLECTANCE, FRESNEL)]
    if columns and len(draws):
        shrink = torch.rand(len(draws), len(columns), generator=generator, dtype=draws.dtype) ** 3
        shrink[1::2] = 1.0
        draws[:, columns] = draws[:, columns] * shrink
    return draws


def _distinct(likelihood: Likelihood, found: Minimum) -> list[Mode]:
    """Minima within DISTINCT_CHI2 of the best that differ by more than 2 standard deviations in some
    parameter."""
    low, high = likelihood.model.parameter_set.flat_bounds()
    modes: list[Mode] = []
    kept: list[Tensor] = []
    for index in torch.argsort(found.cost).tolist():
        cost = float(found.cost[index])
        if modes and cost > modes[0].objective + DISTINCT_CHI2:
            break
        y = found.y[index]
        covariance, held = laplace(found.jacobian[index], y, low, high)
        sd = torch.sqrt(torch.diagonal(covariance)).clamp(min=1e-9)
        if any(bool((((y - other).abs() / sd)[~held] < 2.0).all()) for other in kept):
            continue
        kept.append(y)
        modes.append(Mode(likelihood.model.parameter_set.from_flat(y), cost, covariance, held))
    return modes


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


def _evaluated(likelihood: Likelihood) -> Mode:
    theta = likelihood.model.parameter_set.start()
    with torch.no_grad():
        return Mode(
            theta, float(likelihood.chi2(theta)), theta.new_zeros(0, 0), torch.zeros(0, dtype=torch.bool)
        )


def fit_map(
    likelihood: Likelihood,
    *,
    starts: int = 24,
    adam_steps: int = 150,
    seed: int = 0,
    extra_starts: Tensor | None = None,
    progress: Progress | None = None,
    budget: Budget | None = None,
) -> Fit:
    """The maximum a posteriori of a likelihood, its modes, and whether the search converged; the best so far where the
    ``budget`` is spent."""
    budget = Budget() if budget is None else budget
    modes, history, found = find_modes(
        likelihood,
        starts=starts,
        adam_steps=adam_steps,
        seed=seed,
        extra_starts=extra_starts,
        progress=progress,
        budget=budget,
    )
    with torch.no_grad():
        chi2 = float(likelihood.chi2(modes[0].theta))
    if found is None:
        return Fit(likelihood, modes, chi2, True, "nothing is free: the model was evaluated as it stands")
    cost = found.cost
    best = int(torch.argmin(cost))
    reached = int((cost < cost[best] + 0.01 * (1 + cost[best].abs())).sum())
    converged = bool(found.converged[best]) and math.isfinite(chi2)
    reason = (
        f"the best of {number_of(len(cost), 'start')} stopped improving; {reached} reached it"
        if converged
        else f"chi-square was still falling after {number_of(found.iterations, 'step')} of the polish"
    )
    if not budget.left():
        reason += "; the time allowed for the search was spent, and this is the best so far"
    return Fit(likelihood, modes, chi2, converged, reason, history)
