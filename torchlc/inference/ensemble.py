"""The ensemble before its first step: emcee's sampler, the density that it asks for, its moves, and where its walkers start."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from torchlc.digits import number_of
from torchlc.errors import InputError, option
from torchlc.inference.exchange_move import Redraw
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit

if TYPE_CHECKING:
    import emcee  # loads scipy.stats, for 0.5 s, which only a chain is worth


def log_density(likelihood: Likelihood) -> Callable[[np.ndarray], np.ndarray]:
    """What emcee calls: straight coordinates x (W, P) to log posterior densities (W,), batched, without
    gradients, never NaN."""
    parameters = likelihood.model.parameter_set

    def call(x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            point = torch.as_tensor(np.atleast_2d(x), dtype=parameters.dtype, device=parameters.device)
            theta, log_det = parameters.from_straight(point)
            total = likelihood.log_prob(theta) + log_det
            return torch.where(torch.isfinite(total), total, -math.inf).cpu().numpy()

    return call


def initial_walkers(fit: Fit, walkers: int, seed: int) -> Tensor:
    """Starting points x (W, P) from the Laplace covariances of the modes, each mode with a share by its
    Laplace evidence; what a bound holds, within 0.03 of its range from there."""
    likelihood = fit.likelihood
    parameters = likelihood.model.parameter_set
    generator = torch.Generator().manual_seed(seed)
    low, high = parameters.flat_bounds()
    weights = []
    for mode in fit.modes:
        held = mode.at_bound
        block = mode.covariance[~held][:, ~held]
        log_det = float(torch.linalg.slogdet(block)[1]) if len(block) else 0.0
        weights.append(-0.5 * mode.objective + 0.5 * log_det)
    share = torch.softmax(torch.tensor(weights, dtype=torch.float64), 0).clamp(min=0.05)
    counts = torch.multinomial(share, walkers, replacement=True, generator=generator).bincount(
        minlength=len(fit.modes)
    )
    points = []
    for mode, count in zip(fit.modes, counts.tolist(), strict=True):
        y0 = parameters.to_flat(mode.theta)
        values, vectors = torch.linalg.eigh(mode.covariance)
        spread = vectors @ torch.diag(torch.sqrt(values.clamp(min=0)))
        needed, tries = count, 0
        while needed > 0:
            noise = torch.randn(4 * needed + 8, len(parameters), generator=generator, dtype=y0.dtype)
            shrink = 0.7**tries
            y = y0 + shrink * noise @ spread.T
            inward = torch.rand(len(y), len(parameters), generator=generator, dtype=y0.dtype)
            span = torch.where(torch.isfinite(high - low), high - low, 1.0)
            step = 0.03 * torch.where(y0 - low <= high - y0, inward, -inward) * span
            y = torch.where(mode.at_bound, y + step, y)
            inside = y[((y > low) & (y < high)).all(-1)]
            if len(inside):
                theta = parameters.from_flat(inside)
                with torch.no_grad():
                    good = torch.isfinite(likelihood.log_prob(theta))
                points.append(parameters.to_straight(theta)[good][:needed])
                needed -= len(points[-1])
            tries += 1
            if tries > 60:
                raise RuntimeError("no walker with a finite posterior could be placed around the fit")
    return torch.cat(points)


def moves(fit: Fit) -> list[tuple[emcee.moves.Move, float]]:
    """Differential evolution, its jumps between clusters (gamma 1), stretches; where there are reflectances
    the exchange of one explanation for another; and where nothing moves the geometry, so that the regression for reflectances is
    cheap, differential evolution that draws them anew.

    No snooker steps: those of emcee up to 3.1.6 shrink a standard normal's variance by a third.
    """
    import emcee

    from torchlc.inference.evolution_move import CarriedEvolution

    along_all = [
        (emcee.moves.DEMove(), 0.3),
        (emcee.moves.DEMove(gamma0=1.0), 0.1),
        (emcee.moves.StretchMove(), 0.25),
    ]
    redraw = Redraw(fit.likelihood, fit.theta)
    if not redraw.linear:
        return along_all
    exchange = emcee.moves.MHMove(redraw)
    if fit.likelihood.model.geometry_free or not redraw.others:
        return [*along_all, (exchange, 0.35)]
    return [
        *((move, 0.4 * weight) for move, weight in along_all),
        (exchange, 0.25),
        (CarriedEvolution(redraw), 0.4),
        (CarriedEvolution(redraw, whole=True), 0.1),
    ]


def number_of_walkers(wanted: int | None, dimensions: int) -> int:
    """An even number, of which each half spans the parameters; InputError where ``wanted`` is too few for that."""
    count = wanted if wanted is not None else max(32, 6 * dimensions)
    count += count % 2
    if count < 2 * dimensions + 2:
        raise InputError(
            None,
            option("walkers"),
            number_of(count, "walker"),
            f"at least {2 * dimensions + 2} for {number_of(dimensions, 'parameter')}",
        )
    return count


def ensemble_of(fit: Fit, walkers: int) -> emcee.EnsembleSampler:
    """emcee's sampler of a fit's density; its backend is the chain in memory."""
    import emcee

    density = log_density(fit.likelihood)
    sampler = emcee.EnsembleSampler(
        walkers,
        len(fit.likelihood.model.names),
        density,
        moves=moves(fit),
        vectorize=True,
        backend=emcee.backends.Backend(),
    )
    # in place of emcee's wrapper, which prints a traceback of its own at Ctrl-C
    sampler.log_prob_fn = density  # pyright: ignore[reportAttributeAccessIssue]
    return sampler


def first_state(sampler: emcee.EnsembleSampler, walkers: Tensor, seed: int) -> emcee.State:
    """The state before the first step of a new chain, from walkers (W, P)."""
    import emcee

    sampler.backend.reset(*walkers.shape)
    return emcee.State(walkers.numpy(), random_state=np.random.RandomState(seed).get_state())
