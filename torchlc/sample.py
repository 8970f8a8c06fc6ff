"""The posterior by emcee, with the same module that Adam trained, in batches without gradients.

The ensemble moves in the straight coordinates of :class:`~torchlc.parameters.ParameterSet`: brightness is a
sum over surfaces, so what one surface gives and another takes lies on a line there, and on a thin banana
elsewhere (six times the autocorrelation time for the paper's Object 1). Densities carry the Jacobian, so the
draws are those of the natural parameters; beyond a prior's bounds the density is 0. The chain lives in memory and is put on disk whole, in emcee's HDF5 layout, each time it has grown by a quarter: a
killed run resumes from there with the random state it had, to the same result.
"""

from __future__ import annotations

import io
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np
import torch
from torch import Tensor

from torchlc.errors import InputError
from torchlc.fit import Fit, Progress
from torchlc.likelihood import Likelihood
from torchlc.output import write_whole
from torchlc.redraw import Redraw

BLOCK = 20
"""Steps between looks at the clock."""
FIRST_CHECK = 500
"""Steps after which a chain is first judged; then each time it has grown by a tenth."""
WRITE_EVERY_S = 30.0
LONG_ENOUGH = 50
"""A chain is long enough when it holds this many autocorrelation times."""
BACKEND_NAME = "mcmc"


@dataclass(frozen=True)
class Posterior:
    """Draws after burn-in and thinning, theta (W walkers, N draws, P) natural, with log_prob (W, N).

    ``tau`` (P,) autocorrelation times in steps, ``acceptance`` the mean fraction, ``steps`` run in all,
    ``burn`` and ``thin`` applied; ``converged`` with its ``reason`` in words.
    """

    names: list[str]
    theta: Tensor
    log_prob: Tensor
    tau: np.ndarray
    acceptance: float
    steps: int
    burn: int
    thin: int
    converged: bool
    reason: str

    @property
    def flat(self) -> Tensor:
        """Draws of all walkers, (W N, P)."""
        return self.theta.reshape(-1, self.theta.shape[-1])

    def effective(self) -> np.ndarray:
        """Effective number of draws of each parameter, (P,): walkers x steps kept / tau."""
        kept = self.theta.shape[0] * self.theta.shape[1] * self.thin
        return kept / np.maximum(self.tau, 1.0)

    def rhat(self) -> np.ndarray:
        """Split R-hat of each parameter over four groups of walkers, halved in time: near 1 if groups and
        halves agree.

        Single walkers are too short to be chains of their own, and an ensemble's walkers lean on one another.
        """
        walkers, draws, _ = self.theta.shape
        half = draws // 2
        if half < 2:
            return np.full(len(self.names), np.nan)
        groups = []
        for part in np.array_split(np.arange(walkers), 4):
            halves = (self.theta[part, :half], self.theta[part, half : 2 * half])
            groups += [piece.reshape(-1, len(self.names)).numpy() for piece in halves]
        means = np.array([g.mean(0) for g in groups])
        within = np.array([g.var(0, ddof=1) for g in groups]).mean(0)
        effective = np.maximum(self.effective() / len(groups), 2.0)
        between = means.var(0, ddof=1)
        return np.sqrt(1.0 + np.maximum(between - within / effective, 0.0) / np.maximum(within, 1e-300))


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
            step = torch.where(y0 - low <= high - y0, 0.03, -0.03) * inward * span
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
    """Differential evolution, its jumps between clusters (gamma 1), stretches; and where there are reflectances
    the exchange of one explanation for another.

    No snooker steps: those of emcee up to 3.1.6 shrink a standard normal's variance by a third.
    """
    chosen: list[tuple[emcee.moves.Move, float]] = [
        (emcee.moves.DEMove(), 0.3),
        (emcee.moves.DEMove(gamma0=1.0), 0.1),
        (emcee.moves.StretchMove(), 0.25),
    ]
    redraw = Redraw(fit.likelihood, fit.theta)
    return [*chosen, (emcee.moves.MHMove(redraw), 0.35)] if redraw.linear else chosen


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
) -> Posterior:
    """Run the ensemble until it is LONG_ENOUGH against its own autocorrelation time, or for ``steps``.

    ``walkers`` defaults to 6 a parameter, at least 32. Raises InputError if ``resume`` finds a chain of
    another problem.
    """
    likelihood = fit.likelihood
    names = likelihood.model.names
    dimensions = len(names)
    count = walkers if walkers is not None else max(32, 6 * dimensions)
    count += count % 2
    if count < 2 * dimensions + 2:
        raise InputError(
            None,
            "--walkers",
            f"{count} walkers",
            f"at least {2 * dimensions + 2} for {dimensions} parameters",
        )
    backend = emcee.backends.Backend()
    density = log_density(likelihood)
    sampler = emcee.EnsembleSampler(
        count, dimensions, density, moves=moves(fit), vectorize=True, backend=backend
    )
    # in place of emcee's wrapper, which prints a traceback of its own at Ctrl-C
    sampler.log_prob_fn = density  # pyright: ignore[reportAttributeAccessIssue]
    state = None
    if resume and chain_file is not None:
        state = _resumed(chain_file, backend, names, count, seed, density)
    if state is None:
        start = initial_walkers(fit, count, seed)
        state = emcee.State(start.numpy(), random_state=np.random.RandomState(seed).get_state())
        backend.reset(count, dimensions)
    limit = steps if steps is not None else longest
    due = _next_check(backend.iteration)
    finished = backend.iteration >= limit
    if steps is None and backend.iteration == due:
        finished = finished or _long_enough(backend)
    written, clock = backend.iteration, time.monotonic()
    share = 0.0
    while not finished:
        block = min(BLOCK, limit - backend.iteration)
        state = sampler.run_mcmc(state, block, skip_initial_state_check=True)
        finished = backend.iteration >= limit
        if steps is not None:
            share = backend.iteration / limit
        elif backend.iteration >= due:
            share = 0.75 * backend.iteration / (LONG_ENOUGH * float(np.max(_tau(backend))))
            finished = finished or share > 1
            due = _next_check(backend.iteration + 1)
        if progress is not None:
            progress("emcee", min(max(share, backend.iteration / limit), 0.99))
        grown = backend.iteration >= written + max(200, written // 4)
        if chain_file is not None and (grown or time.monotonic() > clock + WRITE_EVERY_S or finished):
            write_chain(chain_file, backend, names, seed)
            written, clock = backend.iteration, time.monotonic()
    return _posterior(likelihood, backend, names, steps)


def _next_check(iteration: int) -> int:
    """The first length from ``iteration`` on at which a chain is judged; resumed runs have the same."""
    due = FIRST_CHECK
    while due < iteration:
        due += BLOCK * max(1, due // (10 * BLOCK))
    return due


def write_chain(path: Path, backend: emcee.backends.Backend, names: list[str], seed: int) -> None:
    """The chain so far in emcee's HDF5 layout (straight coordinates), whole or not at all."""
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        group = file.create_group(BACKEND_NAME)
        walkers, dimensions = backend.shape
        group.attrs.update(
            version=emcee.__version__, nwalkers=walkers, ndim=dimensions, has_blobs=False,
            iteration=backend.iteration, parameters=names, seed=seed,
        )  # fmt: skip
        for index, part in enumerate(backend.random_state or ()):
            group.attrs[f"random_state_{index}"] = part
        group["accepted"] = backend.accepted
        for name in ("chain", "log_prob"):
            data = getattr(backend, name)[: backend.iteration]
            group.create_dataset(name, data=data, maxshape=(None, *data.shape[1:]))
    write_whole(path, lambda partial: partial.write_bytes(stream.getbuffer()))


def _resumed(
    path: Path,
    backend: emcee.backends.Backend,
    names: list[str],
    walkers: int,
    seed: int,
    density: Callable[[np.ndarray], np.ndarray],
) -> emcee.State | None:
    """Fill the in-memory backend from a chain on disk; None if there is none."""
    if not path.exists():
        return None
    try:
        disk: Any = emcee.backends.HDFBackend(str(path), name=BACKEND_NAME, read_only=True)
        with h5py.File(path, "r") as file:
            attributes: Any = file[BACKEND_NAME].attrs
            stored = list(attributes["parameters"])
            begun = int(attributes.get("seed", seed))
        shape = disk.shape
    except (OSError, KeyError) as error:
        raise InputError(
            path, None, f"cannot be read as a chain ({error})", hint="Remove it to start anew"
        ) from error
    if stored != names or shape != (walkers, len(names)):
        raise InputError(
            path,
            None,
            f"a chain of {shape[0]} walkers over {', '.join(stored)}",
            f"{walkers} walkers over {', '.join(names)}",
            "Remove it to start anew, or give the scene and --walkers it was made with",
        )
    if begun != seed:
        hint = f"Remove it to start anew, or go on with --seed {begun}"
        raise InputError(path, None, f"a chain of seed {begun}", f"one of seed {seed}", hint)
    backend.reset(*shape)
    backend.grow(disk.iteration, None)
    backend.chain[:] = disk.get_chain()
    backend.log_prob[:] = disk.get_log_prob()
    backend.accepted[:] = disk.accepted
    backend.iteration = int(disk.iteration)
    backend.random_state = disk.random_state
    last: Any = backend.get_last_sample()
    if not np.allclose(density(last.coords), last.log_prob, rtol=1e-6, atol=1e-6):
        raise InputError(
            path,
            None,
            "a chain of other data, another scene or other priors",
            "the chain of this fit",
            "Remove it to start anew, or give the files it was made with",
        )
    return last


def _tau(backend: emcee.backends.Backend) -> np.ndarray:
    chain = backend.get_chain(discard=backend.iteration // 4)
    with np.errstate(invalid="ignore"):  # a walker that has not moved has no autocorrelation
        tau = emcee.autocorr.integrated_time(chain, tol=0, quiet=True)
    return np.nan_to_num(tau, nan=float(backend.iteration))


def _long_enough(backend: emcee.backends.Backend) -> bool:
    return 0.75 * backend.iteration > LONG_ENOUGH * float(np.max(_tau(backend)))


def _posterior(likelihood: Likelihood, backend: Any, names: list[str], steps: int | None) -> Posterior:
    tau = _tau(backend)
    longest = float(np.max(tau))
    burn = min(int(max(3 * longest, backend.iteration // 4)), backend.iteration // 2)
    thin = max(1, int(longest / 4))
    chain = torch.as_tensor(backend.get_chain(discard=burn, thin=thin).copy())
    log_prob = torch.as_tensor(backend.get_log_prob(discard=burn, thin=thin).copy())
    kept = (backend.iteration - burn) / longest
    converged = kept >= LONG_ENOUGH * 0.9
    reason = (
        f"{backend.iteration} steps, {kept:.0f} autocorrelation times of {longest:.0f} steps after burn-in"
    )
    if not converged:
        reason += f"; {LONG_ENOUGH} are wanted: run on with --resume and more --steps"
    accepted = float(np.mean(backend.accepted / max(backend.iteration, 1)))
    with torch.no_grad():
        theta = likelihood.model.parameter_set.from_straight(chain)[0].transpose(0, 1).contiguous()
    return Posterior(
        names, theta, log_prob.T, tau, accepted, backend.iteration, burn, thin, converged, reason
    )
