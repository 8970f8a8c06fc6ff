"""The sections of the benchmark: each gives ratios of torchlc to something else that ran beside it."""

from __future__ import annotations

import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import torch

import torchlc
from benchmarks.cases import EFFECTS, MESH_EPOCHS, WALKERS, draws, many_faces, near_truth, object_1, torus
from benchmarks.numpy_reference import SMALLEST_EXPONENT, Equations, Prepared
from benchmarks.timing import Result, least
from torchlc.inference import likelihood as likelihoods
from torchlc.lightcurve.model import LightCurve

RUNS = 200
LCAS_EPOCHS_PER_S = 4.9
"""Light Curves of Asteroids with Shadows, on such a mesh and one core of such a machine."""
GIB = 2**30


def call() -> Iterator[Result]:
    """One likelihood call for 64 walkers x 840 epochs x (6 + 4) faces, materials free, one thread."""
    likelihood = object_1()
    theta = draws(likelihood)
    sharp = _with_n(likelihood, theta, 1e6)
    equations, prepared = Equations.of(likelihood), Prepared(likelihood)
    with np.errstate(divide="ignore"):
        log_half = torch.as_tensor(np.log(np.maximum(equations.cos_glint[:8], 1e-15)))  # wings share a normal
    n = theta[:, [0, 3]][:, equations.material[:8], None]
    exponents = n * log_half
    pairs = torch.cat(
        [
            (theta[:, 3 * k, None, None] * torch.as_tensor(t[0])).flatten(1)
            for k, t in enumerate(prepared.tables)
        ],
        1,
    )
    walker = theta[0].numpy()
    with torch.no_grad():
        ours = float(likelihood.log_likelihood(theta)[0])
    assert math.isclose(equations.log_likelihood(walker), ours, rel_tol=1e-9)
    assert math.isclose(prepared.log_likelihood(walker), ours, rel_tol=1e-9)
    leaf = theta.clone().requires_grad_()
    best = least(
        {
            "exp": lambda: torch.exp(exponents.clamp(min=SMALLEST_EXPONENT)),
            "exp of pairs": lambda: torch.exp(pairs.clamp(min=SMALLEST_EXPONENT)),
            "value": torch.no_grad()(partial(likelihood.log_prob, theta)),
            "sharp": torch.no_grad()(partial(likelihood.log_prob, sharp)),
            "gradient": lambda: torch.autograd.grad(likelihood.log_prob(leaf).sum(), leaf),
            "equations": partial(equations.log_likelihood, walker),
            "prepared": partial(prepared.log_likelihood, walker),
        },
        RUNS,
    )
    value = best["value"]
    yield Result(
        "call / torch.exp of its exponents, 8 faces (wings count once)", value / best["exp"], "at most 4"
    )
    yield Result("call / torch.exp of the pairs that are lit and seen only", value / best["exp of pairs"])
    yield Result("the same at n = 1e6 / the call", best["sharp"] / value, "at most 2")
    yield Result("value and gradient / the call", best["gradient"] / value, "at most 4")
    yield Result(
        "NumPy, the equations as they stand / the call", WALKERS * best["equations"] / value, "at least 80"
    )
    yield Result(
        "NumPy, everything free of the materials tabulated / the call", WALKERS * best["prepared"] / value
    )


def threads() -> Iterator[Result]:
    """The same call with two threads, elapsed time; run with OMP_NUM_THREADS=2."""
    likelihood = object_1()
    theta = draws(likelihood)

    def limited(count: int) -> None:
        torch.set_num_threads(count)
        with torch.no_grad():
            likelihood.log_prob(theta)

    best = least({"one": partial(limited, 1), "two": partial(limited, 2)}, RUNS, threads=2)
    yield Result("two threads / one, elapsed", best["two"] / best["one"])


def compiled() -> Iterator[Result]:
    """The same call through ``torch.compile``, where there is a C++ compiler."""
    likelihood = object_1()
    theta = draws(likelihood)
    prepared, walker = Prepared(likelihood), theta[0].numpy()
    equations = Equations.of(likelihood)
    with torch.no_grad():
        start = time.process_time()
        fast = likelihoods.compiled(likelihood, theta)
        torch.testing.assert_close(fast(theta), likelihood.log_prob(theta), rtol=1e-9, atol=1e-9)
        compiling = time.process_time() - start
        best = least(
            {
                "compiled": partial(fast, theta),
                "eager": partial(likelihood.log_prob, theta),
                "equations": partial(equations.log_likelihood, walker),
                "prepared": partial(prepared.log_likelihood, walker),
            },
            RUNS,
        )
    quick = best["compiled"]
    yield Result("eager call / compiled call", best["eager"] / quick)
    yield Result(
        "NumPy, the equations as they stand / the compiled call",
        WALKERS * best["equations"] / quick,
        "at least 200",
    )
    yield Result(
        "NumPy, everything free of the materials tabulated / the compiled call",
        WALKERS * best["prepared"] / quick,
    )
    yield Result("eager calls that compiling costs", compiling / best["eager"])


def effects() -> Iterator[Result]:
    """Known physics in the model: shadows, the Sun's disc, the Earth's shadow, the exposure; h0 is free."""
    bare = object_1()
    calls = {"bare": torch.no_grad()(partial(bare.log_prob, draws(bare)))}
    for name, chosen in {**{one: [one] for one in EFFECTS}, "all four": EFFECTS}.items():
        likelihood = object_1(chosen)
        calls[name] = torch.no_grad()(partial(likelihood.log_prob, draws(likelihood)))
    best = least(calls, RUNS // 2)
    for name in [*EFFECTS, "all four"]:
        bar = "at most 1.5" if name == "all four" else None
        yield Result(f"geometry fixed, with {name} / the bare model", best[name] / best["bare"], bar)


def geometry() -> Iterator[Result]:
    """A free geometric parameter; new values at every call."""
    bare = object_1()
    calls: dict[str, Callable[[], object]] = {"bare": torch.no_grad()(partial(bare.log_prob, draws(bare)))}
    for name in ("panel_offset", "time_offset"):
        likelihood = object_1([name])
        points = iter([near_truth(likelihood, seed=seed) for seed in range(12)])
        calls[name] = torch.no_grad()(
            lambda likelihood=likelihood, points=points: likelihood.log_prob(next(points))
        )
    best = least(calls, 10)
    for name in ("panel_offset", "time_offset"):
        yield Result(f"{name} free / the bare model", best[name] / best["bare"], "at most 15")


def memory() -> Iterator[Result]:
    """A batch of 1,024 walkers x 10,000 epochs x 20 faces."""
    seconds = {}
    for walkers, epochs in ((1024, 5000), (512, 10_000), (1024, 10_000)):
        likelihood = many_faces(epochs)
        theta = draws(likelihood, walkers)
        call = torch.no_grad()(partial(likelihood.log_prob, theta))
        seconds[walkers, epochs] = least({"call": call}, 2)["call"]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / GIB
    full = seconds[1024, 10_000]
    yield Result("peak memory of the process, PyTorch included", peak, "under 1.5", " GiB")
    yield Result("time for twice the walkers", full / seconds[512, 10_000], "linear: 2")
    yield Result("time for twice the epochs", full / seconds[1024, 5000], "linear: 2")


def mesh() -> Iterator[Result]:
    """A light curve of a mesh of 3,840 facets with shadows, from scene and recording to magnitudes."""
    with tempfile.TemporaryDirectory() as folder:
        scene, recording = torus(Path(folder))

        def curve() -> None:
            with torch.no_grad():
                LightCurve(scene, recording, effects=["self_shadowing"])()

        seconds = least({"curve": curve}, 3)["curve"]
    yield Result("epochs a second / those of LCAS", MESH_EPOCHS / seconds / LCAS_EPOCHS_PER_S, "at least 100")


def start() -> Iterator[Result]:
    """CPU seconds of a new process, the least of six; absolute, for it is people who wait."""
    calls = {
        "torch": ("-c", "import torch"),
        "both": ("-c", "import torch, torchlc"),
        "help": ("-c", "from torchlc.cli import main; main()", "--help"),
    }
    best = dict.fromkeys(calls, math.inf)
    for _ in range(6):
        for name, arguments in calls.items():
            best[name] = min(best[name], _process(*arguments))
    yield Result("import torch, torchlc less import torch", best["both"] - best["torch"], "at most 0.3", " s")
    yield Result("torchlc --help", best["help"], "under 0.6", " s")


def _process(*arguments: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _with_n(likelihood: torchlc.Likelihood, theta: torch.Tensor, n: float) -> torch.Tensor:
    changed = theta.clone()
    changed[:, [name.endswith(".n") for name in likelihood.model.names]] = n
    return changed
