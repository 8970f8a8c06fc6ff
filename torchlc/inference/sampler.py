"""The posterior by emcee, with the same module that Adam trained, in batches without gradients.

The ensemble moves in the straight coordinates of :class:`~torchlc.parameters.ParameterSet`: brightness is a
sum over surfaces, so what one surface gives and another takes lies on a line there, and on a thin banana
elsewhere (six times the autocorrelation time for the paper's Object 1). Densities carry the Jacobian, so the
draws are those of the natural parameters; beyond a prior's bounds the density is 0. The chain lives in memory and is put on disk whole
(:mod:`torchlc.inference.chain`) each time it has grown by a quarter: a killed run resumes from there with the random
state it had, to the same result.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from torchlc.files.writing import write_whole
from torchlc.inference.budget import Budget
from torchlc.inference.chain import ChainFile, Write, chain_origin
from torchlc.inference.chain_length import BLOCK, Goal, posterior_of
from torchlc.inference.ensemble import ensemble_of, first_state, initial_walkers, number_of_walkers
from torchlc.inference.exact_weights import expanded, reweighted
from torchlc.inference.optimiser import Fit, Progress
from torchlc.inference.posterior_draws import Posterior

if TYPE_CHECKING:
    import emcee  # loads scipy.stats, for 0.5 s, which only a chain is worth


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
    count = number_of_walkers(walkers, len(likelihood.model.names))
    moving = likelihood if exactly or not budget.left() else expanded(fit)
    sampler = ensemble_of(replace(fit, likelihood=moving), count)
    file = None if chain_file is None else ChainFile(chain_file, chain_origin(likelihood, count, seed), write)
    state = file.resumed(sampler) if resume and file is not None else None
    if state is None:
        state = first_state(sampler, initial_walkers(fit, count, seed), seed)
    cut = _run(sampler, state, Goal(likelihood, steps, longest), file, budget, progress)
    posterior = posterior_of(likelihood, sampler.backend)
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


def _run(
    sampler: emcee.EnsembleSampler,
    state: emcee.State | None,
    goal: Goal,
    file: ChainFile | None,
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
