"""Are verdicts right? Diagnoses every case that make_injections.py wrote and compares it with its answer.

    python examples/calibration/make_injections.py CASES/1 --seed 1
    for seed in $(seq 2 15); do
        python examples/calibration/make_injections.py CASES/$seed --seed $seed --only control_
    done
    python examples/calibration/verdicts.py CASES RESULTS.jsonl [--only TEXT] [--part K/N] [--quick] [--summary]
        [--least SHARE]
    python examples/calibration/verdicts.py CASES RESULTS.jsonl --summary --publish docs/calibration

A case is one line of the results; those that are there are not done again, so a stopped run goes on where it
was.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from astropy.time import Time
from outcomes import judged, summary
from published import publish

from torchlc.api import diagnose
from torchlc.readers import load_recording
from torchlc.scene import load_scene
from torchlc.terminal import quiet_libraries


def run(case: Path, quick: bool) -> dict[str, Any]:
    """Verdict, names and measures of one case beside its answer."""
    answer = json.loads((case / "answer.json").read_text())
    scene = load_scene(case / "scene.toml")
    recording = load_recording(case / "recording.ecsv", scene)
    began, cpu = time.monotonic(), time.process_time()
    with quiet_libraries():
        found = diagnose(scene, recording, quick=quick)
    content = found.to_json()
    return {
        "case": case.name,
        "truth": {
            key: answer.get(key)
            for key in (
                "kind",
                "verdict",
                "verdicts_accepted",
                "effects",
                "family",
                "gain",
                "chi2",
                "materials_from_their_priors",
            )
        },
        "verdict": content["verdict"],
        "named": content["named"],
        "families": content["families"],
        "told": content["probabilities"]["told"],
        "global_p": content["global_p"],
        "improvement": content["improvement"],
        "remaining_p": content["remaining"]["global_p"],
        "overlap": overlap(content, answer, recording.time),
        "materials": {
            when: within(content["materials"][when], answer.get("materials", {}))
            for when in ("before", "after")
        },
        "candidates": [
            [one["effect"], one["target"], one["delta_log_evidence"], one["heldout_delta_log_likelihood"]]
            for one in content["candidates"][:6]
        ],
        "seconds": time.monotonic() - began,
        "cpu_seconds": time.process_time() - cpu,
    }


def overlap(content: dict[str, Any], answer: dict[str, Any], times: Time) -> float | None:
    """Rows in the located and the true intervals, over rows in either; None where there is none to locate."""
    where = content["where"]
    if where is None or not answer.get("where"):
        return None
    true = marked(times, answer["where"]["intervals"])
    if not true.any():
        return None
    found = marked(times, [(one["start"], one["end"]) for one in where["intervals"]])
    return float((true & found).sum() / (true | found).sum())


def marked(times: Time, intervals: Iterable[Sequence[str]]) -> np.ndarray:
    """Rows (T,) inside any of the intervals, ends included to half a second."""
    jd = np.asarray(times.utc.jd)
    rows = np.zeros(len(jd), dtype=bool)
    for start, end in intervals:
        rows |= (jd >= Time(start).jd - 5e-6) & (jd <= Time(end).jd + 5e-6)
    return rows


def within(found: dict[str, dict[str, float]], truth: dict[str, dict[str, Any]]) -> list[int]:
    """How many true material numbers lie inside the 90 % intervals, and of how many."""
    held = [
        row["q05"] <= truth[owner][short] <= row["q95"]
        for name, row in found.items()
        for owner, _, short in [name.rpartition(".")]
        if isinstance(truth.get(owner, {}).get(short), int | float)
    ]
    return [sum(held), len(held)]


def read(path: Path) -> dict[str, dict[str, Any]]:
    """Finished cases by name; a last line cut short by a kill is left out."""
    rows = {}
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        rows[row["case"]] = row
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument(
        "--part", default="0/1", help="K/N: every Nth case from the Kth, for several processes"
    )
    parser.add_argument("--quick", action="store_true", help="diagnose with quick=True")
    parser.add_argument("--summary", action="store_true", help="only say what is there")
    parser.add_argument(
        "--least",
        type=float,
        default=0.0,
        help="fail if fewer than this share are right, or any alarm is false",
    )
    parser.add_argument("--commit", default="not told", help="state of the code, to publish")
    parser.add_argument("--publish", type=Path, help="folder for verdicts.json and verdicts.png")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = read(options.results)
    answers = [one for one in sorted(options.cases.rglob("answer.json")) if options.only in one.parent.name]
    first, step = map(int, options.part.split("/"))
    for answer in [] if options.summary else answers[first::step]:
        name = answer.parent.relative_to(options.cases).as_posix()
        if name not in rows:
            rows[name] = {**run(answer.parent, options.quick), "case": name}
            with options.results.open("a") as file:
                file.write(json.dumps(rows[name]) + "\n")
            row = rows[name]
            print(f"{name}: {row['verdict']} {row['named']}: {judged(row)}", flush=True)
    print(json.dumps(summary(list(rows.values())), indent=1))
    if options.publish is not None:
        publish(list(rows.values()), options.publish, options.commit)
    outcomes = Counter(judged(row) for row in rows.values())
    good = outcomes["right"] + outcomes["in family"]
    if good < options.least * len(rows) or (options.least and outcomes["false alarm"]):
        sys.exit(
            f"{good} of {len(rows)} right, {outcomes['false alarm']} false alarms; expected {options.least:.0%}, none"
        )


if __name__ == "__main__":
    main()
