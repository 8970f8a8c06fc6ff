"""Maximum a posteriori: Adam on chi-square from many starts in one batch, then a Levenberg-Marquardt polish
of the best.

The maximum is taken in flat coordinates (logarithms of log-scaled parameters), where flat priors add nothing:
it is the least chi-square, peaked priors counted as further rows. The parameters of noise are fitted in turn with the
rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchlc.digits import number_of
from torchlc.inference.budget import Budget
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.noise_fit import noise_in_turn
from torchlc.inference.polish import DISTINCT_CHI2, best_minima, laplace, polish
from torchlc.inference.whitening import noise_columns
from torchlc.lightcurve.model import LightCurve
from torchlc.parameters import FRESNEL, LOBE_REFLECTANCE
from torchlc.tensors.least_squares import Minimum

LEADERS = 6
"""Points that are polished to the end: the best so far may be on the way to a worse minimum than the next."""
LONG_POLISH = 300
"""Iterations; what has not converged by then lies in a flat valley, and is told of."""
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
    values added to the scene's own and the prior's draws; these and the scene's own are also polished as they are. Where the ``budget`` ends Adam, only the LEADERS of its last and first points are polished."""
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
    if len(history) == adam_steps:
        # what a scene or an earlier step has found stands: Adam's steps are longer than some numbers are known, and do not come back
        theta = torch.cat([theta, points[:1], points[1 + len(draws) :]])
    else:
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
        leaders = parameters.from_flat(best.y[best_minima(best, noise_columns(likelihood))])
        best = noise_in_turn(likelihood, leaders, budget)
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


def _crowded(roles: Sequence[str], draws: Tensor, generator: torch.Generator) -> Tensor:
    """Every other start has its lobe reflectances near 0, where the best minimum of a faint lobe lies."""
    columns = [i for i, role in enumerate(roles) if role in (LOBE_REFLECTANCE, FRESNEL)]
    if columns and len(draws):
        shrink = torch.rand(len(draws), len(columns), generator=generator, dtype=draws.dtype) ** 3
        shrink[1::2] = 1.0
        draws[:, columns] = draws[:, columns] * shrink
    return draws


def _distinct(likelihood: Likelihood, minima: Minimum) -> list[Mode]:
    """Minima within DISTINCT_CHI2 of the best that differ by more than 2 standard deviations in some
    parameter."""
    low, high = likelihood.model.parameter_set.flat_bounds()
    modes: list[Mode] = []
    kept: list[Tensor] = []
    for index in torch.argsort(minima.cost).tolist():
        cost = float(minima.cost[index])
        if modes and cost > modes[0].objective + DISTINCT_CHI2:
            break
        y = minima.y[index]
        covariance, held = laplace(minima.jacobian[index], y, low, high)
        sd = torch.sqrt(torch.diagonal(covariance)).clamp(min=1e-9)
        if any(bool((((y - other).abs() / sd)[~held] < 2.0).all()) for other in kept):
            continue
        kept.append(y)
        modes.append(Mode(likelihood.model.parameter_set.from_flat(y), cost, covariance, held))
    return modes


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
    modes, history, minima = find_modes(
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
    if minima is None:
        return Fit(likelihood, modes, chi2, True, "nothing is free: the model was evaluated as it stands")
    cost = minima.cost
    best = int(torch.argmin(cost))
    reached = int((cost < cost[best] + 0.01 * (1 + cost[best].abs())).sum())
    converged = bool(minima.converged[best]) and math.isfinite(chi2)
    reason = (
        f"the best of {number_of(len(cost), 'start')} stopped improving; {reached} reached it"
        if converged
        else f"chi-square was still falling after {number_of(minima.iterations, 'step')} of the polish"
    )
    if not budget.left():
        reason += "; the time allowed for the search was spent, and this is the best so far"
    return Fit(likelihood, modes, chi2, converged, reason, history)
