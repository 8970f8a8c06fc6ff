"""The posterior of Object 1: where the time of a run goes, and effective draws a second beside NumPyro's NUTS."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import arviz
import emcee
import numpy as np

import torchlc
from benchmarks.cases import WALKERS, object_1
from benchmarks.numpy_reference import Prepared
from benchmarks.timing import Result
from torchlc.inference import chain, ensemble
from torchlc.inference.exchange_move import Redraw
from torchlc.inference.optimiser import fit_map
from torchlc.inference.posterior_draws import Posterior
from torchlc.inference.sampler import sample

NUTS = "benchmarks.nuts"
DEMO = Path(torchlc.__file__).parent / "demo"
SIZES = "[{ value = 1.72, sigma = 0.1, prior = 'normal', low = 1.0, high = 3.0 }, { value = 6.6, sigma = 0.4, prior = 'normal', low = 4.0, high = 9.0 }]"
"""Of a wing, within some 6 %."""
FLAT = 400
"""Steps of the run whose likelihood costs nothing."""


class Watch:
    """CPU seconds spent inside a callable."""

    def __init__(self, inner: Callable[..., Any]) -> None:
        self.inner, self.seconds = inner, 0.0

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        start = time.process_time()
        try:
            return self.inner(*arguments, **keywords)
        finally:
            self.seconds += time.process_time() - start


def whole() -> Iterator[Result]:
    """CPU seconds of whole answers: a fit, and a diagnosis of the demonstration as it is and with its sizes free."""
    start = time.process_time()
    found = sample(fit_map(object_1()), walkers=WALKERS)
    seconds = time.process_time() - start
    yield Result("fit of Object 1, 64 walkers, to 50 autocorrelation times", seconds, "at most 8", " s")
    yield Result("effective draws a CPU second", _least_effective(found.theta.numpy(), found.names) / seconds)
    exact, recording = torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")
    nominal = torchlc.Scene.from_toml(exact.to_toml().replace("[1.72, 6.6]", SIZES))
    for what, scene, bar in (("as it is", exact, 10), ("with sizes free", nominal, 40)):
        start = time.process_time()
        told = torchlc.diagnose(scene, recording)
        seconds = time.process_time() - start
        print(f"  {told.lines()[0]}")
        yield Result(f"diagnosis of the demonstration, {what}", seconds, f"at most {bar}", " s")


def posterior() -> Iterator[Result]:
    """64 walkers, to 50 autocorrelation times: the model's time, emcee's own, that of the file; then NUTS."""
    likelihood = object_1()
    fit = fit_map(likelihood)
    density = Watch(ensemble.log_density(likelihood))
    proposals, writing = Watch(Redraw.__call__), Watch(chain.write_chain)
    with tempfile.TemporaryDirectory() as folder, _replaced(density, proposals, writing):
        start = time.process_time()
        found = sample(fit, walkers=WALKERS, chain_file=Path(folder) / "chain.h5")
        seconds = time.process_time() - start
    own = _own(fit, found)
    run = seconds - writing.seconds
    print(f"  {found.reason}; {seconds:.0f} s of CPU time")
    yield Result(
        "likelihood calls / emcee's own time (same moves, a likelihood of no cost)",
        density.seconds / own,
        "at most 1.5",
    )
    yield Result("proposals that solve for the reflectances / emcee's own time", proposals.seconds / own)
    yield Result("HDF5, written in blocks / the run without it", writing.seconds / run, "at most 0.2")
    theta = found.theta.numpy()
    ours = _least_effective(theta, found.names) / run
    if importlib.util.find_spec("numpyro") is None:
        print("  NumPyro is not installed (pip install numpyro): no comparison with NUTS")
        return
    theirs = _nuts(likelihood, fit)
    yield Result(
        "effective draws a second / NUTS, warm-up included, compilation not",
        ours / theirs["ess_per_s"],
        "at least 1",
    )
    yield Result("the same with NUTS's compilation", ours / theirs["ess_per_s_compiled"])


class _replaced:
    """The sampler's parts under watch."""

    def __init__(self, density: Watch, proposals: Watch, writing: Watch) -> None:
        self.parts = density, proposals, writing

    def __enter__(self) -> None:
        density, proposals, writing = self.parts
        self.kept = ensemble.log_density, Redraw.__call__, chain.write_chain
        ensemble.log_density = lambda likelihood: density
        Redraw.__call__ = lambda self, coords, random: proposals(self, coords, random)
        chain.write_chain = writing

    def __exit__(self, *_: object) -> None:
        ensemble.log_density, Redraw.__call__, chain.write_chain = self.kept


def _own(fit: Any, found: Posterior) -> float:
    """CPU seconds that emcee takes for as many steps with a normal density of no cost, proposals apart."""
    likelihood = fit.likelihood
    parameters = likelihood.model.parameter_set
    x = parameters.to_straight(found.flat).numpy()
    centre, precision = x.mean(0), np.linalg.pinv(np.cov(x.T))

    def flat(coords: np.ndarray) -> np.ndarray:
        away = coords - centre
        return -0.5 * ((away @ precision) * away).sum(-1)

    proposals = Watch(Redraw.__call__)
    kept, Redraw.__call__ = Redraw.__call__, lambda self, coords, random: proposals(self, coords, random)
    sampler = emcee.EnsembleSampler(WALKERS, x.shape[1], flat, moves=ensemble.moves(fit), vectorize=True)
    begin = emcee.State(
        x[:: max(1, len(x) // WALKERS)][:WALKERS], random_state=np.random.RandomState(0).get_state()
    )
    start = time.process_time()
    sampler.run_mcmc(begin, FLAT, skip_initial_state_check=True)
    spent = time.process_time() - start - proposals.seconds
    Redraw.__call__ = kept
    return spent * found.steps / FLAT


def _least_effective(theta: np.ndarray, names: list[str]) -> float:
    """Smallest bulk effective sample size of theta (chains, draws, P), exponents by their logarithm."""
    columns = {name: theta[..., i] for i, name in enumerate(names)}
    scaled = {name: np.log(one) if name.endswith(".n") else one for name, one in columns.items()}
    return min(float(arviz.ess(one)) for one in scaled.values())


def _nuts(likelihood: Any, fit: Any) -> dict[str, float]:
    """NumPyro on the same tables, in a process of its own: its effective draws a second."""
    prepared = Prepared(likelihood)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tables.npz"
        arrays = {
            f"{key}_{k}": table[i]
            for k, table in enumerate(prepared.tables)
            for i, key in enumerate(("log_half", "normal", "grazing", "diffuse"))
        }
        np.savez(path, observed=prepared.observed, error=prepared.error, start=fit.theta.numpy(), **arrays)
        done = subprocess.run(
            [sys.executable, "-m", NUTS, str(path)], capture_output=True, text=True, check=True
        )
    report = json.loads(done.stdout.splitlines()[-1])
    draws = np.array(report["draws"])
    effective = _least_effective(draws, likelihood.model.names)
    return {
        "ess_per_s": effective / report["seconds"],
        "ess_per_s_compiled": effective / (report["seconds"] + report["compiling"]),
    }
