"""The posterior by emcee, with the same module that Adam trained, in batches without gradients.

The ensemble moves in the straight coordinates of :class:`~torchlc.parameters.ParameterSet`: brightness is a
sum over surfaces, so what one surface gives and another takes lies on a line there, and on a thin banana
elsewhere (six times the autocorrelation time for the paper's Object 1). Densities carry the Jacobian, so the
draws are those of the natural parameters; beyond a prior's bounds the density is 0. The chain lives in memory and is put on disk whole
(:mod:`torchlc.inference.chain`) each time it has grown by a quarter: a killed run resumes from there with the random
state it had, to the same result.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.files.libraries import arviz_library
from torchlc.files.writing import write_whole
from torchlc.inference.budget import Budget
from torchlc.inference.chain import Write, chain_origin, check_origin, read_chain, write_chain
from torchlc.inference.exchange_move import Redraw
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit, Progress
from torchlc.lightcurve.evaluators.expansion import UnsuitableError

if TYPE_CHECKING:
    import emcee  # loads scipy.stats, for 0.5 s, which only a chain is worth

BLOCK = 20
"""Steps between looks at the clock."""
FIRST_CHECK = 500
"""Steps after which a chain is first judged; then each time it has grown by a tenth."""
WRITE_EVERY_S = 30.0
LONG_ENOUGH = 50
"""A chain is long enough when it holds this many autocorrelation times."""
LEAST_LEFT = 0.5
"""Share of the draws that have to count after they are weighted; with less an exact run of the ensemble is as cheap as one
that is longer by as much."""
MOST_WEIGHED = 2000
"""Draws that are weighed: more than the 1,200 effective ones of 32 walkers that are just long enough. With all default
effects an exact density costs some 15 ms."""
FEW_WEIGHED = 192
"""The same under a budget: 3 s."""
AT_ONCE = 64
"""Draws whose exact densities are worked out at once."""
LEAST_DRAWS = 4
"""Draws of a walker below which ArviZ's diagnostics are not defined: each half needs two."""
GOOD_RHAT = 1.03
"""What R-hat of every parameter must not exceed. For walkers of N draws that are a stationary chain with
autocorrelation time tau, the halves' means alone make it sqrt(1 + 2 tau / N): 1.02 at LONG_ENOUGH. The usual 1.01 is
for a few long chains, and would ask each of some forty walkers for the length of one."""


@dataclass(frozen=True)
class Posterior:
    """Draws after burn-in and thinning, theta (W walkers, N draws, P) natural, with log_prob (W, N).

    ``tau`` (P,) autocorrelation times in steps, ``acceptance`` the mean fraction, ``steps`` run in all,
    ``burn`` and ``thin`` applied.

    R-hat and the effective number of draws are ArviZ's (rank-normalised and split; Vehtari et al. 2021,
    eqs. 4, 13, 14), with a walker as a chain, of the very draws that posterior.nc holds. Walkers are not independent
    chains: each step moves one towards or along others. What they share falls as 1 / W once the ensemble is
    stationary, but an ensemble that is in the wrong place as a whole, as one that has not found a second mode, shows
    in neither number. Walkers that have not yet mixed show in both.
    """

    names: list[str]
    theta: Tensor
    log_prob: Tensor
    tau: np.ndarray
    acceptance: float
    steps: int
    burn: int
    thin: int
    note: str = ""
    """How the densities were worked out, where not exactly at every step, and what ended the chain."""
    out_of_time: bool = False
    """Whether a budget ended the chain."""

    @property
    def flat(self) -> Tensor:
        """Draws of all walkers, (W N, P)."""
        return self.theta.reshape(-1, self.theta.shape[-1])

    @cached_property
    def rhat(self) -> np.ndarray:
        """Rank-normalised split R-hat of each parameter, (P,); NaN of fewer than four draws a walker."""
        return _by_parameter("rhat", self.theta)

    @cached_property
    def ess(self) -> np.ndarray:
        """Effective number of draws of each parameter in the bulk of its posterior, (P,); NaN as above."""
        return _by_parameter("ess", self.theta)

    @property
    def lengths(self) -> float:
        """Autocorrelation times, of the slowest parameter, that were kept."""
        return (self.steps - self.burn) / float(np.max(self.tau))

    @property
    def converged(self) -> bool:
        """Whether the chain is long enough and its walkers agree."""
        return self.lengths >= LONG_ENOUGH * 0.9 and bool((self.rhat <= GOOD_RHAT).all())

    @property
    def reason(self) -> str:
        """Why the chain is trusted, or not."""
        said = (
            f"{number_of(self.steps, 'step')}, {number_of(self.lengths, 'autocorrelation time')} of {number_of(np.max(self.tau), 'step')} "
            "after burn-in"
        )
        worst, least = float(np.max(self.rhat)), float(np.min(self.ess))
        if math.isfinite(worst):
            said += f"; R-hat up to {worst:.3f}, at least {number_of(least, 'effective draw')}"
        else:
            said += "; too few draws, or walkers that have not moved, for an R-hat"
        said += self.note
        if self.converged:
            return said
        return f"{said}; {LONG_ENOUGH} and {GOOD_RHAT} are wanted"


def _by_parameter(name: str, theta: Tensor) -> np.ndarray:
    """A diagnostic of ArviZ by its name, of each parameter (P,) of draws (W, N, P); NaN of fewer draws than it takes."""
    if theta.shape[1] < LEAST_DRAWS:
        return np.full(theta.shape[-1], np.nan)  # as ArviZ gives, which logs a line for each as well
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ArviZ's next version, and of walkers without enough draws
        diagnostic = getattr(arviz_library(), name)
        return np.array([float(diagnostic(draws)) for draws in theta.numpy().transpose(2, 0, 1)])


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


def sample(
    fit: Fit,
    *,
    walkers: int | None = None,
    steps: int | None = None,
    seed: int = 0,
    chain_file: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    longest: int = 12_000,
    write: Write = write_whole,
    exactly: bool = False,
    budget: Budget | None = None,
) -> Posterior:
    """Run the ensemble until it is LONG_ENOUGH against its own autocorrelation time and its walkers agree, or for
    ``steps``, or until the ``budget`` is spent, after one step at least.

    Where the geometry is free, the ensemble moves on its expansion about the best fit (:meth:`LightCurve.expanded`) if that
    is possible and not ``exactly``; kept draws are then weighted by their exact densities and drawn again by weight, and
    where too little is left of them the ensemble starts again, exactly.

    ``walkers`` defaults to 6 a parameter, at least 32. ``write`` puts the chain on disk. Raises InputError if
    ``resume`` finds a chain of another problem, or one that is damaged.
    """
    budget = Budget() if budget is None else budget
    likelihood = fit.likelihood
    count = _number_of_walkers(walkers, len(likelihood.model.names))
    moving = likelihood if exactly or not budget.left() else expanded(fit)
    sampler = _ensemble(replace(fit, likelihood=moving), count)
    file = (
        None if chain_file is None else _ChainFile(chain_file, chain_origin(likelihood, count, seed), write)
    )
    state = file.resumed(sampler) if resume and file is not None else None
    if state is None:
        state = _started(sampler, initial_walkers(fit, count, seed), seed)
    cut = _run(sampler, state, _Goal(likelihood, steps, longest), file, budget, progress)
    posterior = _posterior(likelihood, sampler.backend)
    if cut:
        posterior = replace(
            posterior,
            note=f"; stopped when the {budget.seconds:g} CPU seconds allowed were spent",
            out_of_time=True,
        )
    if moving is likelihood:
        return posterior
    weighted = reweighted(posterior, moving, likelihood, budget)
    if weighted is not None:
        return weighted
    again = sample(
        fit,
        walkers=walkers,
        steps=steps,
        seed=seed,
        chain_file=chain_file,
        progress=progress,
        longest=longest,
        write=write,
        exactly=True,
        budget=budget,
    )
    return replace(
        again,
        note=f"{again.note}; exact at every step, for of draws by an expansion of the geometry too few counted",
    )


def _number_of_walkers(wanted: int | None, dimensions: int) -> int:
    """An even number, of which each half spans the parameters; InputError where ``wanted`` is too few for that."""
    count = wanted if wanted is not None else max(32, 6 * dimensions)
    count += count % 2
    if count < 2 * dimensions + 2:
        raise InputError(
            None,
            "--walkers",
            number_of(count, "walker"),
            f"at least {2 * dimensions + 2} for {number_of(dimensions, 'parameter')}",
        )
    return count


def _ensemble(fit: Fit, walkers: int) -> emcee.EnsembleSampler:
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


def _started(sampler: emcee.EnsembleSampler, walkers: Tensor, seed: int) -> emcee.State:
    """The state before the first step of a new chain, from walkers (W, P)."""
    import emcee

    sampler.backend.reset(*walkers.shape)
    return emcee.State(walkers.numpy(), random_state=np.random.RandomState(seed).get_state())


class _Goal:
    """How far a chain has to go: ``steps`` of them, or until it is long enough and its walkers agree, at most ``longest``.
    ``share`` is how much of the latter the chain had when it was last judged."""

    def __init__(self, likelihood: Likelihood, steps: int | None, longest: int) -> None:
        self.likelihood = likelihood
        self.fixed = steps is not None
        self.limit = longest if steps is None else steps
        self.share = 0.0
        self._due: int | None = None

    def reached(self, chain: emcee.backends.Backend) -> bool:
        """Whether the chain need not go on. Its autocorrelation is looked at only at the lengths of :func:`_next_check`."""
        length = chain.iteration
        if not self.fixed:
            due = _next_check(length) if self._due is None else self._due
            if length >= due:
                self.share = _progress(self.likelihood, chain)
                due = _next_check(length + 1)
            self._due = due
        return length >= self.limit or self.share >= 1


class _ChainFile:
    """Where a chain is put on disk, whole, each time it has grown by a quarter or WRITE_EVERY_S have passed, and at its end."""

    def __init__(self, path: Path, origin: Mapping[str, Any], write: Write) -> None:
        self.path, self.origin, self.write = path, origin, write
        self._length, self._clock = 0, time.monotonic()

    def resumed(self, sampler: emcee.EnsembleSampler) -> emcee.State | None:
        """The last state of the chain on disk, with which the sampler's backend is filled; None if there is none."""
        stored = read_chain(self.path)
        if stored is None:
            return None
        check_origin(self.path, stored, self.origin)
        backend = sampler.backend
        backend.reset(*stored.steps.shape[1:])
        backend.grow(len(stored.steps), None)
        backend.chain[:] = stored.steps
        backend.log_prob[:] = stored.log_prob
        backend.accepted[:] = stored.accepted
        backend.iteration = len(stored.steps)
        backend.random_state = stored.random_state
        last: Any = backend.get_last_sample()
        if not np.allclose(sampler.log_prob_fn(last.coords), last.log_prob, rtol=1e-6, atol=1e-6):
            raise InputError(
                self.path,
                None,
                "densities that this version of torchlc does not give for its last step",
                "the chain of this version",
                "Remove it to start anew",
            )
        self._length = backend.iteration
        return last

    def keep(self, chain: emcee.backends.Backend, *, finished: bool) -> None:
        """Write the chain if it is due."""
        grown = chain.iteration >= self._length + max(200, self._length // 4)
        if grown or finished or time.monotonic() > self._clock + WRITE_EVERY_S:
            write_chain(self.path, chain, self.origin, self.write)
            self._length, self._clock = chain.iteration, time.monotonic()


def _run(
    sampler: emcee.EnsembleSampler,
    state: emcee.State | None,
    goal: _Goal,
    file: _ChainFile | None,
    budget: Budget,
    progress: Progress | None,
) -> bool:
    """Move the ensemble until its chain reaches the goal; True where the budget was spent before."""
    chain = sampler.backend
    finished, cut = goal.reached(chain), False
    while not finished:
        block = 1 if budget.bounded else min(BLOCK, goal.limit - chain.iteration)
        state = sampler.run_mcmc(state, block, skip_initial_state_check=True)
        finished = goal.reached(chain)
        cut = not finished and not budget.left()
        finished = finished or cut
        if progress is not None:
            spent = budget.spent / (budget.spent + budget.remaining)
            progress("emcee", min(max(goal.share, chain.iteration / goal.limit, spent), 0.99))
        if file is not None:
            file.keep(chain, finished=finished)
    return cut


def expanded(fit: Fit) -> Likelihood:
    """The likelihood by an expansion of its free geometry about the best mode, with the posterior's covariance there; the
    likelihood itself where there is no such expansion."""
    likelihood, mode = fit.likelihood, fit.modes[0]
    model = likelihood.model
    if not model.geometry_free or mode.covariance.numel() == 0:
        return likelihood
    parameters = model.parameter_set
    y = parameters.to_flat(mode.theta)
    slope = torch.func.jacrev(parameters.from_flat)(y)
    covariance = slope @ mode.covariance @ slope.mT
    try:
        return likelihood.expanded(mode.theta, covariance)
    except UnsuitableError:
        return likelihood


def reweighted(
    posterior: Posterior, moving: Likelihood, likelihood: Likelihood, budget: Budget
) -> Posterior | None:
    """Draws of the posterior of ``moving``, drawn again by what the exact densities over its own weigh (systematic
    resampling, in their order); None where fewer than LEAST_LEFT of them count and the ``budget`` allows to start again.

    An error of d mag in rows of error s shifts a log density by about d / s times the root of the rows' number: at 1e-4, 0.02
    and 400 rows by 0.1, which leaves 0.99 of the draws.
    """
    step = -(-posterior.log_prob.numel() // (FEW_WEIGHED if budget.bounded else MOST_WEIGHED))
    posterior = replace(
        posterior,
        theta=posterior.theta[:, ::step],
        log_prob=posterior.log_prob[:, ::step],
        thin=posterior.thin * step,
    )
    draws = posterior.flat
    with torch.no_grad():
        exact, own = (
            torch.cat([one.log_prob(piece) for piece in draws.split(AT_ONCE)]) for one in (likelihood, moving)
        )
    log_weight = torch.where(torch.isfinite(exact), exact, -math.inf) - own
    weight = torch.softmax(log_weight, 0)
    left = float(1 / (len(draws) * weight.square().sum()))
    if not left >= LEAST_LEFT and (budget.left() or not math.isfinite(left)):
        return None
    share = (torch.arange(len(draws), dtype=weight.dtype) + 0.5) / len(draws)
    chosen = torch.searchsorted(weight.cumsum(0), share).clamp(max=len(draws) - 1)
    return replace(
        posterior,
        theta=draws[chosen].reshape(posterior.theta.shape),
        log_prob=exact[chosen].reshape(posterior.log_prob.shape),
        note=f"{posterior.note}; the ensemble moved on an expansion of the geometry, and {left:.0%} of its draws count by their exact "
        "densities",
    )


def _next_check(iteration: int) -> int:
    """The first length from ``iteration`` on at which a chain is judged; resumed runs have the same."""
    due = FIRST_CHECK
    while due < iteration:
        due += BLOCK * max(1, due // (10 * BLOCK))
    return due


def _tau(backend: emcee.backends.Backend) -> np.ndarray:
    import emcee

    chain = backend.get_chain(discard=backend.iteration // 4)
    with np.errstate(invalid="ignore"):  # a walker that has not moved has no autocorrelation
        tau = emcee.autocorr.integrated_time(chain, tol=0, quiet=True)
    return np.nan_to_num(tau, nan=float(backend.iteration))


def _progress(likelihood: Likelihood, backend: emcee.backends.Backend) -> float:
    """Share of the wanted length that the chain has after burn-in; below 1 while its walkers do not agree.

    R-hat, which takes longer than the autocorrelation time, is worked out for chains of that length only.
    """
    share = 0.75 * backend.iteration / (LONG_ENOUGH * float(np.max(_tau(backend))))
    if share > 1 and _posterior(likelihood, backend).converged:
        return share
    return min(share, 0.99)


def _posterior(likelihood: Likelihood, backend: Any) -> Posterior:
    tau = _tau(backend)
    longest = float(np.max(tau))
    burn = min(int(max(3 * longest, backend.iteration // 4)), backend.iteration // 2)
    thin = max(1, int(longest / 4))
    chain = torch.as_tensor(backend.get_chain(discard=burn, thin=thin).copy())
    log_prob = torch.as_tensor(backend.get_log_prob(discard=burn, thin=thin).copy())
    accepted = float(np.mean(backend.accepted / max(backend.iteration, 1)))
    with torch.no_grad():
        theta = likelihood.model.parameter_set.from_straight(chain)[0].transpose(0, 1).contiguous()
    return Posterior(likelihood.model.names, theta, log_prob.T, tau, accepted, backend.iteration, burn, thin)
