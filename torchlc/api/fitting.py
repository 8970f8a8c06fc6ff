"""The verb fit."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import torch

from torchlc.api.inputs import Columns, Progress, Rows, read_scene, usable
from torchlc.api.outputs import held, input_files, provenance
from torchlc.digits import against_freedom
from torchlc.effects import mending_kind
from torchlc.errors import InputError, option
from torchlc.files.writing import CHAIN_FILE, FIT_FILES, OutputDirectory, write_whole
from torchlc.inference.budget import Budget
from torchlc.inference.chain import check_origin, input_hashes, read_chain
from torchlc.inference.identifiability import limits
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit, fit_map
from torchlc.inference.posterior_draws import Posterior
from torchlc.inference.sampler import sample
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.kind import NoiseKind
from torchlc.readers import Recording
from torchlc.results.fit_result import FitResult
from torchlc.scene import Scene
from torchlc.tensors.moving import on_cpu

DOUBTFUL_P = 1e-3
"""Below this probability of chi-square, quoted errors get a jitter added to them."""
SEARCH_SHARE = 0.4
"""Of what is left of a budget, for a search; the chain has the rest."""


@on_cpu
def fit(
    scene: str | Path | Scene,
    recording: Rows,
    *,
    steps: int | None = None,
    walkers: int | None = None,
    budget: float | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> FitResult:
    """Fit the free numbers of a scene to a recording: Adam from many starts, a polish, then emcee.

    ``steps`` fixes the length of the chain, else it runs until long against its autocorrelation time;
    ``walkers`` defaults to 6 a parameter; ``budget`` is in CPU seconds of search and chain, after which the best so far is the
    answer, with a warning. With ``out`` everything is written there (fit.json, posterior.nc,
    chain.h5, figures, report.html), in place of what an earlier run wrote, and ``resume`` continues the chain
    found there. Nothing free: the model is evaluated and nothing is sampled.
    """
    watch = _Watch()
    scene = read_scene(scene, trust)
    if resume and out is None:
        raise InputError(
            None, option("resume"), "no output directory", "the directory of the run to continue"
        )
    rows = usable(scene, recording, use=use, columns=columns)
    with ExitStack() as stack:
        later = {CHAIN_FILE} if resume else frozenset()
        directory = held(stack, out, FIT_FILES - later, input_files(scene, rows))
        likelihood = Likelihood(LightCurve(scene, rows))
        _check_sampling(len(likelihood.model.names), steps, walkers)
        if resume and directory is not None:
            _check_chain(directory, scene, rows, seed)
        watch.lap("load")
        allowed = Budget(budget)
        fitted, warnings = _search(likelihood, rows, seed, allowed, progress)
        watch.lap("search")
        posterior = None
        if fitted.model.names:
            posterior = sample(
                fitted,
                walkers=walkers,
                steps=steps,
                seed=seed,
                chain_file=None if directory is None else directory.path / CHAIN_FILE,
                resume=resume,
                progress=progress,
                budget=allowed,
                write=write_whole if directory is None else directory.write_path,
            )
        watch.lap("sample")
        remarks = _remarks(fitted, posterior, warnings, kept=directory is not None)
        made = provenance(scene, rows, seed, command)
        result = FitResult(fitted, posterior, watch.seconds(), remarks, seed, made)
        if directory is not None:
            from torchlc.report import fit_page as report

            report.write_fit(result, directory, progress)
    return result


def _check_sampling(parameters: int, steps: int | None, walkers: int | None) -> None:
    if steps is not None and steps < 1:
        raise InputError(None, option("steps"), str(steps), "at least 1")
    if walkers is not None and parameters and walkers < 2 * parameters + 2:
        raise InputError(
            None,
            option("walkers"),
            str(walkers),
            f"at least {2 * parameters + 2} for {parameters} free parameters",
        )


def _check_chain(directory: OutputDirectory, scene: Scene, rows: Recording, seed: int) -> None:
    """InputError where the chain in a directory cannot be continued by a fit of these inputs."""
    chain = directory.path / CHAIN_FILE
    if (stored := read_chain(chain)) is not None:  # says more of what is wrong than the manifest can
        check_origin(chain, stored, {**input_hashes(scene, rows), "seed": seed})
    directory.check(CHAIN_FILE)


def _remarks(fitted: Fit, posterior: Posterior | None, of_search: Sequence[str], kept: bool) -> list[str]:
    """What has to be said of a fit: of its model, its data, its search and its chain, which a run can go on with if it
    is ``kept`` in a directory."""
    said = [*fitted.model.warnings, *fitted.warnings, *limits(fitted.model, fitted.theta), *of_search]
    said += fitted.likelihood.remarks(fitted.theta)
    if posterior is not None and not posterior.converged:
        more = "a longer budget" if posterior.out_of_time else "more steps"
        if kept:
            more = f"a longer {option('budget')}" if posterior.out_of_time else f"more {option('steps')}"
        advice = f"run on with {option('resume', True)} and {more}" if kept else f"fit with {more}"
        said.append(f"the chain is short: {posterior.reason}: {advice}")
    if not fitted.converged:
        said.append(f"the search did not converge: {fitted.reason}")
    return said


class _Watch:
    """Wall-clock seconds of the parts of a run, one after another."""

    def __init__(self) -> None:
        self._began = self._last = time.monotonic()
        self._parts: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """The part ``name`` ends here."""
        now = time.monotonic()
        self._parts[name], self._last = now - self._last, now

    def seconds(self) -> dict[str, float]:
        """Of each part, and their total."""
        return {**self._parts, "total": self._last - self._began}


def _search(
    likelihood: Likelihood, recording: Recording, seed: int, budget: Budget, progress: Progress | None
) -> tuple[Fit, list[str]]:
    """The maximum a posteriori; with the noise that mends it added to the model where chi-square says that the quoted
    errors are too small.
    """
    fitted = fit_map(likelihood, seed=seed, progress=progress, budget=budget.part(SEARCH_SHARE))
    effects = [effect.entry for effect in likelihood.model.effects]
    widened = any(isinstance(effect, NoiseKind) and effect.widens for effect in likelihood.model.effects)
    # chi-square was still falling: it says nothing of the errors yet
    cut = budget.bounded and not fitted.converged
    doubtful = recording.error is not None and fitted.p_value < DOUBTFUL_P and not widened and not cut
    if not doubtful:
        return fitted, []
    said = f"chi2 is {against_freedom(fitted.chi2, fitted.dof)} (p = {fitted.p_value:.1g})"
    if not likelihood.model.names:
        return fitted, [f"{said}: the model as it stands does not fit within the errors"]
    assembly = likelihood.model.assembly
    remedy = mending_kind().name
    mended = assemble(assembly.scene, recording, [*effects, remedy], base=assembly)
    model = LightCurve(assembly.scene, recording, assembly=mended)
    allowed = budget.part(SEARCH_SHARE)
    known = None
    if budget.bounded:  # there may be no time to come as far again
        before = dict(zip(fitted.model.names, fitted.theta, strict=True))
        start = model.parameter_set.start()
        known = torch.stack(
            [before.get(name, value) for name, value in zip(model.names, start, strict=True)]
        )[None]
    fitted = fit_map(Likelihood(model), seed=seed, extra_starts=known, progress=progress, budget=allowed)
    warning = f"{said}: a {remedy} was added to the errors; torchlc diagnose looks for what the model lacks"
    return fitted, [warning]
