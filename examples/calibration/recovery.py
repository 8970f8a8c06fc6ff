"""Do posteriors hold the truth as often as they say? Recordings simulated from the prior, fitted and ranked.

    python examples/calibration/recovery.py [RESULTS.jsonl] [--count 300] [--summary]

Each case draws a kind of object (GEO box-wing in nadir attitude over a night, tumbling box-wing over four
hours, pass of a box-wing in low orbit), its orbit, sizes, station and night, and from the priors all six
material numbers, the zero point and, in low orbit, a jitter. If the sampler is right, the rank of the truth
among independent draws of its posterior is uniform, for any choice of cases and parameters that looks at the
recording alone, such as ``informed``. A case is one line of the results; those that are there are not done
again. At the end a figure and a summary in numbers are written for docs/calibration/.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchlc
from torchlc.inference.optimiser import fit_map
from torchlc.inference.posterior_draws import Posterior
from torchlc.inference.sampler import sample
from torchlc.terminal import quiet_libraries

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "reference"))

import sky  # noqa: E402
from circumstances import geo, leo, tumbler  # noqa: E402
from ranks import draw, read, summary  # noqa: E402
from scene_files import free_material, toml  # noqa: E402

RESULTS = HERE / "recovery.jsonl"
DOCS = HERE.parents[1] / "docs" / "calibration"
SEED = 20_201_017
COUNT = 300
ROWS = 48
NOISE_MAG = 0.02
EFFECTS = ["sun_distance", "self_shadowing"]
WALKERS = 128
"""Many walkers in place of long chains: a batch of three times as many costs a fifth more."""
STEPS = (500, 2000)
"""Of the chain, and of a second one where the first is shorter than ENOUGH autocorrelation times."""
ENOUGH = 6
DRAWS = 199
"""Ranks run from 0 to this."""
PASS_DEG = 20.0
"""Elevation above which a pass is observed."""


def circumstances(rng: np.random.Generator) -> tuple[torchlc.Scene, torchlc.Recording]:
    """A scene with everything about its materials unknown, and the rows at which it is observed."""
    kind = str(rng.choice(["geo", "tumbler", "leo"]))
    while True:
        setup = {"geo": geo, "leo": leo}[kind](rng, 1) if kind != "tumbler" else tumbler(rng, 1, wing=True)
        tree = setup.tree
        tree["materials"] = {"body": free_material(), "panel": free_material()}
        tree["model"]["effects"] = [*EFFECTS, "jitter"] if kind == "leo" else EFFECTS
        tree["model"]["parameters"]["zero_point"] = {"value": 0.0, "sigma": 0.02, "prior": "normal"}
        scene = torchlc.Scene.from_toml(toml(tree))
        start, hours = float(setup.t[0]), float(setup.t[-1] - setup.t[0]) / 3600.0
        if kind == "leo":
            span = sunlit_pass(scene, start)
            if span is None:
                continue
            start, hours = span
        cadence = hours * 3600.0 / (ROWS - 0.999)
        rows = torchlc.simulate(scene, start=sky.iso(start), hours=hours, cadence=cadence).recording
        return scene, replace(rows, error=np.full(len(rows), NOISE_MAG))


def sunlit_pass(scene: torchlc.Scene, start: float) -> tuple[float, float] | None:
    """Start (s) and length (h) of the first sunlit pass above PASS_DEG within ten hours that lasts for four
    minutes; whether the sky is dark is not asked.
    """
    cadence = 30.0
    curve = torchlc.simulate(scene, start=sky.iso(start), hours=10.0, cadence=cadence).columns
    good = (np.asarray(curve["elevation_deg"]) > PASS_DEG) & (np.asarray(curve["eclipse_fraction"]) == 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    for first, after in edges.reshape(-1, 2):
        length = (after - 1 - first) * cadence
        if length >= 240.0:
            return start + first * cadence, length / 3600.0
    return None


def simulated(case: int) -> tuple[torchlc.LightCurve, torch.Tensor]:
    """The model of a recording made for this case, and the truth theta (P,) it was made with. Rows in which no
    lit surface is seen are left out.
    """
    rng = np.random.default_rng([SEED, case])
    scene, grid = circumstances(rng)
    model = torchlc.LightCurve(scene, grid)
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    truth = model.parameter_set.sample_prior(1, generator)[0]
    with torch.no_grad():
        mag = model(truth).numpy()
        quoted = torch.tensor(NOISE_MAG, dtype=truth.dtype)
        spread = float(model.noise(truth).sigma(quoted, torch.ones_like(quoted)))
    observed = mag + spread * rng.normal(size=len(grid))
    recording = replace(grid, observed=observed).keep(np.isfinite(observed), "dark")
    return torchlc.LightCurve(scene, recording), truth


def run(case: int) -> dict[str, Any]:
    """Rank of the truth, and whether the data are called informative, for every parameter of one case."""
    began = time.process_time()
    model, truth = simulated(case)
    found = fit_map(torchlc.Likelihood(model), seed=case)
    posterior = sample(found, walkers=WALKERS, seed=case, steps=STEPS[0])
    if chain_length(posterior) < ENOUGH:
        posterior = sample(found, walkers=WALKERS, seed=case, steps=STEPS[1])
    draws = thinned(posterior)
    informed = torchlc.FitResult(found, posterior, {}, [], case, {}).parameters()
    rows = {
        name: {
            "truth": float(truth[index]),
            "rank": int((draws[:, index] < float(truth[index])).sum()),
            "informed": bool(informed[name]["informed"]),
        }
        for index, name in enumerate(model.names)
    }
    return {
        "case": case,
        "kind": model.scene.name,
        "parameters": rows,
        "chi2": found.chi2,
        "modes": len(found.modes),
        "steps": posterior.steps,
        "tau": float(np.max(posterior.tau)),
        "length": chain_length(posterior),
        "seconds": time.process_time() - began,
    }


def chain_length(posterior: Posterior) -> float:
    """Autocorrelation times kept after burn-in, of the slowest parameter."""
    return (posterior.steps - posterior.burn) / float(np.max(posterior.tau))


def thinned(posterior: Posterior) -> np.ndarray:
    """DRAWS draws (DRAWS, P) spread over the chain: as far apart in time as they can be, walkers in turn."""
    walkers, length = posterior.theta.shape[:2]
    step = np.linspace(0, length - 1, DRAWS).round().astype(int)
    return posterior.theta[np.arange(DRAWS) * 7 % walkers, step].numpy()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, nargs="?", default=RESULTS)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--out", type=Path, default=DOCS, help="where posterior.json and posterior.png go")
    parser.add_argument("--summary", action="store_true", help="only say what is there")
    options = parser.parse_args()
    torch.set_num_threads(1)
    done = read(options.results)
    for case in range(0 if options.summary else options.count):
        if case not in done:
            with quiet_libraries():
                done[case] = run(case)
            with options.results.open("a") as file:
                file.write(json.dumps(done[case]) + "\n")
            last = done[case]
            print(
                f"case {case}: {last['kind']}, {last['steps']} steps, tau {last['tau']:.0f}, "
                f"{last['seconds']:.1f} s",
                flush=True,
            )
    numbers = summary([done[case] for case in sorted(done)], DRAWS)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "posterior.json").write_text(json.dumps(numbers, indent=1) + "\n")
    draw(numbers, options.out / "posterior.png")
    for row in [*numbers["parameters"], numbers["all"]]:
        print(row["name"], *(f"{key}: {said(row[key])}" for key in ("every", "informed")), sep="  ")


def said(found: dict[str, Any]) -> str:
    """Count, chi-square p, and what 90 % intervals hold, in words."""
    if found["p"] is None:
        return f"{found['count']}, too few"
    return f"{found['count']}, p = {found['p']:.3f}, 90 % intervals hold {100 * found['within_90']:.1f} %"


if __name__ == "__main__":
    main()
