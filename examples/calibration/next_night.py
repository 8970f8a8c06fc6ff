"""Does the night that a diagnosis advises tell which effect is there? Observes it, and diagnoses again.

    python examples/calibration/next_night.py RESULTS.jsonl --seed 1 [--only medium] [--most 20]

Cases of make_injections.py are drawn one after another. A case is *tied* if the truth is one of several sets that the diagnosis
leaves possible and none has the probability at which a set counts as told (TOLD). Each tied case is observed on the advised night,
and on one drawn from all nights of the list, by the brute-force reference with the same truth and errors of the same law; the rows join the
recording, and what they are is diagnosed anew. A line of the results holds the probability of the truth before and after each.
A stopped run goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))

import observe
from concealed import Rng
from gain import truth_of
from make_injections import Observed, numbered, observed

from torchlc.api import diagnose
from torchlc.diagnosis.plan import LEAST_P, ROWS, TOLD, Option
from torchlc.diagnosis.result import Diagnosis
from torchlc.readers import load_recording
from torchlc.scene import load_scene
from torchlc.stages.entry import Entry
from torchlc.terminal import quiet_libraries


def of_truth(found: Diagnosis, effects: set[str]) -> float:
    """Probability of exactly these effects, whatever they act on; of nothing missing or noise where there are none."""
    odds = found.odds
    if not effects:
        return odds.nothing + odds.noise
    return sum(p for entries, p in odds.sets if {Entry.parse(one).name for one in entries} == effects)


def another_night(case: Observed, night: Option, seed: int, rng: Rng) -> tuple[Any, ...]:
    """Times, magnitudes, errors (T,) and station of that night, from the same truth; what the station cannot see is left out."""
    setup = replace(
        case.setup, t=observe.stamps(night.start, night.hours, ROWS, rng, jitter=0.0), station=night.station
    )
    curve, mag = truth_of(setup, case.physics, seed=seed)
    keep = observe.usable(curve) & np.isfinite(mag) & (mag < 17.0)
    mag, t = mag[keep], setup.t[keep]
    knee = float(np.median(case.mag)) + 1.0
    error = observe.errors(mag, setup.floor, knee)
    recorded = mag + error * rng.standard_normal(len(mag))
    return t, recorded, error * float(np.median(case.quoted / case.error)), np.full(len(t), night.station)


def joined(case: Observed, rows: tuple[Any, ...], folder: Path) -> None:
    """The case with the rows of another night in one recording."""
    first = (
        case.setup.t,
        case.recorded + case.bad,
        case.quoted,
        np.full(len(case.mag), case.setup.station),
    )
    t, mag, error, station = (np.concatenate(pair) for pair in zip(first, rows, strict=True))
    order = np.argsort(t)
    case.write(folder)
    exptime = np.full(len(t), case.setup.exptime)
    observe.write_recording(
        folder / "recording.ecsv", t[order], mag[order], error[order], exptime, station[order]
    )


def diagnosed(folder: Path) -> Diagnosis:
    scene = load_scene(folder / "scene.toml")
    with quiet_libraries():
        return diagnose(scene, load_recording(folder / "recording.ecsv", scene))


def said(found: Diagnosis, effects: set[str]) -> dict[str, Any]:
    return {
        "verdict": found.verdict,
        "named": list(found.named),
        "told": found.odds.told,
        "truth": of_truth(found, effects),
    }


def run(name: str, number: int, seed: int) -> dict[str, Any]:
    """One case: the diagnosis, and where it is tied that after the advised and a random night."""
    began = time.process_time()
    case = observed(name, number, seed)
    effects = set(case.physics)
    row: dict[str, Any] = {"case": name, "seed": seed, "effects": sorted(effects), "tied": False}
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        case.write(folder)
        first = diagnosed(folder)
        row["before"] = said(first, effects)
        if first.nights and LEAST_P <= row["before"]["truth"] < TOLD:
            rng = np.random.default_rng([seed, number])
            row["tied"] = True
            drawn = first.nights[int(rng.integers(len(first.nights)))]
            for label, night in {"advised": first.nights[0], "random": drawn}.items():
                rows = another_night(case, night, seed, rng)
                row[label] = {"night": vars(night), "rows": len(rows[0])}
                if len(rows[0]):
                    joined(case, rows, folder)
                    row[label] |= said(diagnosed(folder), effects)
    return {**row, "cpu_seconds": time.process_time() - began}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """How often the truth is told after each night, and what was forecast."""
    tied = [row for row in rows if row["tied"]]
    content: dict[str, Any] = {"cases": len(rows), "tied": len(tied)}
    for label in ("advised", "random"):
        seen = [row[label] for row in tied if "truth" in row[label]]
        content[label] = {
            "observed": len(seen),
            "told": sum(one["truth"] >= TOLD for one in seen),
            "forecast": float(sum(one["night"]["chance"] for one in seen)),
            "wrong": sum(one["told"] >= TOLD > one["truth"] for one in seen),
        }
    return content


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="medium", help="cases whose name contains this")
    parser.add_argument("--most", type=int, default=20, help="tied cases after which it ends")
    options = parser.parse_args()
    torch.set_num_threads(1)
    lines = options.results.read_text().splitlines() if options.results.exists() else []
    rows = [json.loads(line) for line in lines]
    done = {(row["case"], row["seed"]) for row in rows}
    for number, name in numbered():
        if options.only not in name or (name, options.seed) in done:
            continue
        if sum(row["tied"] for row in rows) >= options.most:
            break
        rows.append(run(name, number, options.seed))
        with options.results.open("a") as file:
            file.write(json.dumps(rows[-1], default=str) + "\n")
        print(rows[-1], flush=True)
    print(json.dumps(summary(rows), indent=1))


if __name__ == "__main__":
    main()
