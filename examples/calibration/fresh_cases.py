"""Cases never seen before, each made, diagnosed and compared with its answer, until the time is up.

    python examples/calibration/fresh_cases.py CASES RESULTS.jsonl --seed 1 [--minutes 150]

Kind and surfaces of each are drawn: half have surfaces such as spacecraft have, half all that the scene's priors allow.
A run that was stopped goes on where it was; ``verdicts.py CASES RESULTS.jsonl --summary`` says what came out.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from cases import kind
from make_injections import numbered, write_case
from outcomes import judged
from verdicts import read, run

SHARES = {
    "nothing missing": 4.0, "one effect": 5.0, "two effects": 2.0, "three effects": 2.0, "other noise": 1.0,
    "scene slightly wrong": 0.5, "other reflection law": 1.5, "outside the library": 1.0, "nominal, nothing missing": 4.0,
    "nominal, one effect": 5.0, "nominal, outside the library": 1.0,
}  # fmt: skip
"""How often each kind is drawn, over the others."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", type=Path, help="folder to write the cases to")
    parser.add_argument("results", type=Path)
    parser.add_argument("--seed", type=int, default=1, help="of the draws; case k has seed 1000 * SEED + k")
    parser.add_argument("--minutes", type=float, default=150.0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    numbers = {name: number for number, name in numbered()}
    groups = {words: [name for name in numbers if kind(name) == words] for words in SHARES}
    chances = np.array([SHARES[words] for words in groups])
    done, rng = read(options.results), np.random.default_rng(options.seed)
    end, seed = time.monotonic() + 60.0 * options.minutes, 1000 * options.seed
    while time.monotonic() < end:
        words = str(rng.choice(list(groups), p=chances / chances.sum()))
        name, from_their_priors, seed = str(rng.choice(groups[words])), bool(rng.random() < 0.5), seed + 1
        key = f"n{seed}/{name}"
        if key in done:
            continue
        folder = options.cases / key
        if not (folder / "answer.json").exists():
            try:
                write_case(name, folder, numbers[name], seed, from_their_priors)
            except RuntimeError as error:  # the effect cannot have its size there, or nothing is seen
                print(f"{key}: not made: {error}", flush=True)
                continue
        try:
            row = {**run(folder, quick=False), "case": key}
        except (
            Exception
        ) as error:  # one that cannot be diagnosed is a fault to be told, and no end of the others
            print(f"{key}: no verdict: {error!r}", flush=True)
            continue
        with options.results.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(
            f"{key}: {judged(row)}, {row['verdict']} {row['named']}, told {row['told']:.2f}, gain {row['truth']['gain']}, "
            f"{row['cpu_seconds']:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
