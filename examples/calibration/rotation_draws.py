"""Is the rotation found? Bodies that turn, drawn at random, looked for by ``torchlc rotation`` and scored.

    python examples/calibration/rotation_draws.py [RESULTS.jsonl] [--kind steady|changing|tumbling] [--first SEED] [--count 7]
    python examples/calibration/rotation_draws.py RESULTS.jsonl --summary

The light is that of examples/reference: its orbit, Sun, station, faces and law of reflection, none of which torchlc shares; the
rotation is Euler's equations integrated by scipy. Three kinds are drawn:

- steady: boxes and cylinders (half of them with three sectors of other paint) about body z, seen in three passes of a low or a
  middle orbit over one to eight days, errors of 0.03 to 0.15 mag. The search knows the shape and that the period is within a
  factor of ten.
- changing: the same bodies over eight to ten days, the period known to 3 per cent; it grows or shrinks by 0.1 to 5 ms a day.
- tumbling: boxes about no fixed axis, in the short- or the long-axis mode, seen in two passes of a middle orbit. The period of the
  long axis is known to 3 per cent, as a periodogram tells it; body, angular momentum and the other period are not.

A draw is one line of the results, and those that are there are not done again.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rotation_cases import steady, tumbling, write
from rotation_score import score

RESULTS = Path(__file__).parent / "rotation_draws.jsonl"
KINDS = ("steady", "changing", "tumbling")


def run(kind: str, seed: int, folder: Path) -> dict[str, Any]:
    """One draw: its truth, score, verdict, processor time and memory."""
    case = {"steady": steady, "changing": lambda one: steady(one, True), "tumbling": tumbling}[kind](seed)
    scene, recording = write(case, folder)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "torchlc", "rotation", str(scene), str(recording), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    result = {"kind": kind, "seed": seed, "truth": case.truth,
              "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
              "largest_memory_gb": after.ru_maxrss / 1e6}  # fmt: skip
    if done.returncode:
        return result | {"right": False, "error": done.stderr.strip()[-300:]}
    answer = json.loads(done.stdout)
    best = answer["modes"][0]
    also = {
        "chi2": best["chi2"],
        "dof": answer["dof"],
        "verdict": answer["verdict"],
        "warnings": answer["warnings"],
    }
    return result | score(case.truth, answer) | also


def summary(results: list[dict[str, Any]]) -> str:
    """A table in Markdown, a row a kind."""
    lines = [
        "| kind | draws | right | pole or L deg, median | decided | decided and wrong | CPU s, median and most |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        some = [one for one in results if one["kind"] == kind]
        if not some:
            continue
        right = [one for one in some if one["right"]]
        cpu = [one["cpu_s"] for one in some]
        pole = np.median([one["pole_deg"] for one in right]) if right else np.nan
        lines.append(
            f"| {kind} | {len(some)} | {len(right)} | {pole:.2f} | {sum(one.get('decided', False) for one in some)} "
            f"| {sum(one.get('confidently_wrong', False) for one in some)} | {np.median(cpu):.0f}, {max(cpu):.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", nargs="?", type=Path, default=RESULTS)
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--count", type=int, default=7)
    parser.add_argument("--keep", type=Path, help="where to put the files of each draw")
    parser.add_argument("--summary", action="store_true")
    given = parser.parse_args()
    known = (
        [json.loads(line) for line in given.results.read_text().splitlines()]
        if given.results.exists()
        else []
    )
    if not given.summary:
        kinds = [given.kind] if given.kind else KINDS
        for seed in range(given.first, given.first + given.count):
            for kind in kinds:
                if any((one["kind"], one["seed"]) == (kind, seed) for one in known):
                    continue
                began = time.monotonic()
                with tempfile.TemporaryDirectory() as scratch:
                    folder = given.keep / f"{kind}{seed}" if given.keep else Path(scratch)
                    folder.mkdir(parents=True, exist_ok=True)
                    known.append(run(kind, seed, folder))
                with given.results.open("a") as file:
                    file.write(json.dumps(known[-1]) + "\n")
                print(
                    kind,
                    seed,
                    "right" if known[-1]["right"] else "not right",
                    f"{time.monotonic() - began:.0f} s",
                    flush=True,
                )
    print(summary(known))


if __name__ == "__main__":
    main()
