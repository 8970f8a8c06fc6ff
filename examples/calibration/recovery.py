"""Do posteriors hold the truth as often as they say? Recordings simulated from the prior, fitted and ranked.

    python examples/calibration/recovery.py [RESULTS.jsonl] [--count 240] [--summary]

Each case draws materials, orbit day and noise anew: Object 1 of the paper with all six material numbers and the
zero point free, one night. If the sampler is right, the rank of the truth among independent draws of its
posterior is uniform, for any choice of cases and parameters that looks at the recording alone, such as
``informed``. A case is one line of the results; those that are there are not done again.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy import stats

import torchlc
from torchlc.fit import fit_map
from torchlc.sample import Posterior, sample

HERE = Path(__file__).parent
RESULTS = HERE / "recovery.jsonl"
SEED = 20_201_017
COUNT = 240
ROWS = 48
NOISE_MAG = 0.02
DRAWS = 199
"""Ranks run from 0 to this."""
BINS = 10

SCENE = """
format = "torchlc-scene/1"
name = "Object 1"
[orbit]
tle = ["1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993",
       "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966"]
[[stations]]
id = "weihai"
latitude = 37.536
longitude = 122.05
height = 110.0
[attitude]
mode = "nadir"
[[components]]
name = "body"
shape = "box"
size = [2.010, 1.712, 2.189]
centre = [0, 0, 0]
material = "body"
[[components]]
name = "panel +Y"
shape = "plate"
size = [1.72, 6.60]
centre = [0, 5.75, 0]
u = [1, 0, 0]
v = [0, 1, 0]
material = "panel"
tracks = { target = "sun", axis = [0, 1, 0] }
[[components]]
name = "panel -Y"
shape = "plate"
size = [1.72, 6.60]
centre = [0, -5.75, 0]
u = [1, 0, 0]
v = [0, 1, 0]
material = "panel"
tracks = { target = "sun", axis = [0, 1, 0] }
[materials.body]
n = { value = 1000.0, low = 1.0, high = 1e6, prior = "loguniform" }
r_spec = { value = 0.3, low = 0.0, high = 1.0 }
r_diff = { value = 0.3, low = 0.0, high = 1.0 }
[materials.panel]
n = { value = 200.0, low = 1.0, high = 1e6, prior = "loguniform" }
r_spec = { value = 0.05, low = 0.0, high = 1.0 }
r_diff = { value = 0.05, low = 0.0, high = 1.0 }
[model]
effects = ["sun_distance", "self_shadowing"]
[model.parameters]
zero_point = { value = 0.0, sigma = 0.02, prior = "normal" }
band_sun_magnitude = -26.7
"""


def simulated(case: int) -> tuple[torchlc.LightCurve, torch.Tensor]:
    """The model of a recording made for this case, and the truth theta (P,) it was made with."""
    rng = np.random.default_rng([SEED, case])
    scene = torchlc.Scene.from_toml(SCENE)
    start = f"2020-10-{rng.integers(10, 21)}T14:00:00"
    grid = torchlc.simulate(scene, start=start, hours=7.0, cadence=7 * 3600.0 / (ROWS - 1)).recording
    model = torchlc.LightCurve(scene, grid)
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    truth = model.parameter_set.sample_prior(1, generator)[0]
    with torch.no_grad():
        mag = model(truth).numpy()
    recording = replace(
        grid, observed=mag + NOISE_MAG * rng.normal(size=ROWS), error=np.full(ROWS, NOISE_MAG)
    )
    return torchlc.LightCurve(scene, recording), truth


def run(case: int, walkers: int = 42, longest: int = 12_000) -> dict[str, Any]:
    """Rank of the truth, and whether the 90 % interval holds it, for every parameter of one case."""
    model, truth = simulated(case)
    found = fit_map(torchlc.Likelihood(model), seed=case)
    posterior = sample(found, walkers=walkers, seed=case, longest=longest)
    draws = thinned(posterior)
    low, high = np.quantile(draws, (0.05, 0.95), axis=0)
    informed = torchlc.FitResult(found, posterior, {}, [], case, {}).parameters()
    rows = {
        name: {
            "truth": float(truth[index]),
            "rank": int((draws[:, index] < float(truth[index])).sum()),
            "within": bool(low[index] <= float(truth[index]) <= high[index]),
            "informed": bool(informed[name]["informed"]),
        }
        for index, name in enumerate(model.names)
    }
    return {
        "case": case,
        "parameters": rows,
        "chi2": found.chi2,
        "steps": posterior.steps,
        "tau": float(np.max(posterior.tau)),
        "converged": posterior.converged,
    }


def thinned(posterior: Posterior) -> np.ndarray:
    """DRAWS draws (DRAWS, P) spread over the chain: as far apart in time as they can be, walkers in turn."""
    walkers, length = posterior.theta.shape[:2]
    step = np.linspace(0, length - 1, DRAWS).round().astype(int)
    return posterior.theta[np.arange(DRAWS) * 7 % walkers, step].numpy()


def read(path: Path) -> dict[int, dict[str, Any]]:
    """Finished cases; a last line cut short by a kill is left out."""
    done = {}
    if path.exists():
        for line in path.read_text().splitlines():
            try:
                one = json.loads(line)
            except json.JSONDecodeError:
                continue
            done[one["case"]] = one
    return done


def summary(cases: dict[int, dict[str, Any]]) -> dict[str, dict[str, float]]:
    """For each parameter where it is informed: how many, chi-square p of the ranks, share of truths within."""
    names = next(iter(cases.values()))["parameters"]
    found = {name: [one["parameters"][name] for one in cases.values()] for name in names}
    found = {name: [row for row in rows if row["informed"]] for name, rows in found.items()}
    found["all informed"] = [row for rows in found.values() for row in rows]
    return {name: judged(rows) for name, rows in found.items() if rows}


def judged(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Counts in bins of equal numbers of ranks against the uniform distribution."""
    count = len(rows)
    bins = max(2, min(BINS, count // 5))
    place = [(row["rank"] + 0.5) / (DRAWS + 1) for row in rows]
    observed = np.histogram(place, bins, (0.0, 1.0))[0]
    expected = count / bins
    p = stats.chi2.sf(((observed - expected) ** 2 / expected).sum(), bins - 1)
    return {"cases": count, "p": float(p), "within": sum(row["within"] for row in rows) / count}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, nargs="?", default=RESULTS)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--summary", action="store_true", help="only say what is there")
    options = parser.parse_args()
    torch.set_num_threads(1)
    done = read(options.results)
    for case in range(0 if options.summary else options.count):
        if case not in done:
            done[case] = run(case)
            with options.results.open("a") as file:
                file.write(json.dumps(done[case]) + "\n")
            last = done[case]
            print(f"case {case}: {last['steps']} steps, tau {last['tau']:.0f}", flush=True)
    converged = sum(one["converged"] for one in done.values())
    print(f"{len(done)} cases, {converged} chains long enough")
    for name, one in summary(done).items():
        spread = 1.96 * math.sqrt(0.09 / one["cases"])
        print(
            f"{name:14} {one['cases']:5.0f} informed, p = {one['p']:.3f}, "
            f"90 % intervals hold {100 * one['within']:.1f} % (90 ± {100 * spread:.1f})"
        )


if __name__ == "__main__":
    main()
