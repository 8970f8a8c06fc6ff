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
import math
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from astropy.time import Time
from scipy import stats

from torchlc.api import diagnose
from torchlc.recording import load_recording
from torchlc.scene import load_scene
from torchlc.style import BEFORE, GRID, MODEL, style
from torchlc.terminal import quiet_libraries

SIZES = ("small", "medium", "large", "as_is")
WORTH = {100.0: "chi-square over 100", 25.0: "chi-square 25 to 100", -math.inf: "chi-square below 25"}
"""Effects by how much chi-square the true model gains over the best refit without it."""
KINDS = (
    "nothing missing", *(f"one effect, {words}" for words in WORTH.values()), "two effects", "other noise",
    "scene slightly wrong", "other reflection law", "outside the library",
)  # fmt: skip
GAINS = (1.0, 2.0, 4.0, 5.0, 8.0, 14.0, 30.0, 300.0)
OUTCOMES = {
    "right": "#3f9b5c",
    "in family": "#9cc9a5",
    "one of two": "#c9dcae",
    "extra name": "#e0b23c",
    "missed": "#c9ced6",
    "unexplained": "#8a94a6",
    "noise_model": "#8a63b8",
    "false alarm": "#d9772b",
    "wrong name": "#c2410c",
}
"""What may come out, with its colour."""


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
            for key in ("kind", "verdict", "verdicts_accepted", "effects", "family", "gain", "chi2")
        },
        "verdict": content["verdict"],
        "named": content["named"],
        "families": content["families"],
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


def judged(row: dict[str, Any]) -> str:
    """One of OUTCOMES."""
    truth, named = row["truth"], set(row["named"])
    sets = [set(one) for one in truth["family"] or []] or [set(truth["effects"])]
    if row["verdict"] not in truth["verdicts_accepted"]:
        if row["verdict"] == "adequate":
            return "missed"
        if truth["verdict"] == "adequate":
            return "false alarm"
        return "wrong name" if row["verdict"] == "missing_physics" else row["verdict"]
    if row["verdict"] != "missing_physics" or named == set(truth["effects"]):
        return "right"
    if named in sets:
        return "in family"
    if any(one <= named | set(family) for one in sets for family in row["families"]):
        return "in family"
    if any(one < named for one in sets):
        return "extra name"
    if any(named < one for one in sets):
        return "one of two"
    return "wrong name"


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


def group(row: dict[str, Any]) -> str:
    """The kind of case, by its name."""
    head, _, rest = row["case"].rpartition("/")[2].partition("-")
    size = rest.partition("-")[0]
    if head.startswith("control"):
        return "nothing missing"
    if row["truth"]["verdict"] == "noise_model":
        return "other noise"
    if size in SIZES:
        refit = row["truth"]["chi2"]["baseline_refit"]
        if row["verdict"] == "adequate":  # no prior is strained: this chi-square is a refit's own
            refit = min(refit, row["improvement"]["chi2_before"])
        worth = refit - row["truth"]["chi2"]["truth"]
        return "one effect, " + next(words for least, words in WORTH.items() if worth >= least)
    known: dict[str, str] = {
        "two": "two effects",
        "wrong": "scene slightly wrong",
        "ggx": "other reflection law",
        "outside": "outside the library",
    }
    return known.get(head, head)


def ordered(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The kinds of case that there are, in the order in which they are told."""
    there = {group(row) for row in rows}
    return [kind for kind in KINDS if kind in there] + sorted(there - set(KINDS))


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Counts of each outcome by kind of case, and the measures over all of them."""
    counts = {
        kind: {word: n for word in OUTCOMES if (n := found[word])}
        for kind in ordered(rows)
        for found in [Counter(judged(row) for row in rows if group(row) == kind)]
    }
    clean = [row["global_p"] for row in rows if group(row) == "nothing missing"]
    named = [row for row in rows if row["verdict"] == "missing_physics"]
    right = [row for row in named if judged(row) in ("right", "in family")]
    held = {when: np.sum([row["materials"][when] for row in right], axis=0) for when in ("before", "after")}
    overlaps = [row["overlap"] for row in right if row["overlap"] is not None]
    fitting = [
        abs(row["improvement"]["chi2_after"] / row["improvement"]["dof"] - 1)
        * np.sqrt(row["improvement"]["dof"] / 2)
        for row in right
    ]
    seconds = [row["cpu_seconds"] for row in rows]
    return {
        "cases": len(rows),
        "outcomes": counts,
        "clean_p_uniform_ks_p": float(stats.kstest(clean, "uniform").pvalue) if len(clean) > 4 else None,
        "median_overlap": float(np.median(overlaps)) if overlaps else None,
        "materials_inside_90": {
            when: float(inside / whole) if len(right) and whole else None
            for when, (inside, whole) in held.items()
        }
        if right
        else {},
        "chi2_within_3_sigma": float(np.mean(np.array(fitting) < 3.0)) if fitting else None,
        "processor_seconds": {"median": float(np.median(seconds)), "longest": max(seconds)}
        if seconds
        else {},
    }


def publish(rows: Sequence[dict[str, Any]], folder: Path) -> None:
    """verdicts.json and verdicts.png of finished cases, for the documentation."""
    (folder / "verdicts.json").write_text(json.dumps(summary(rows), indent=1) + "\n")
    with plt.rc_context(style(9)):
        figure, (left, middle, right) = plt.subplots(
            1, 3, figsize=(11, 3.8), width_ratios=(1.5, 1, 1), layout="constrained"
        )
        kinds = ordered(rows)[::-1]
        for place, kind in enumerate(kinds):
            members = [judged(row) for row in rows if group(row) == kind]
            begin = 0.0
            for word, colour in OUTCOMES.items():
                share = members.count(word) / len(members)
                left.barh(place, share, left=begin, color=colour, label=word if place == 0 else None)
                begin += share
            left.text(1.01, place, str(len(members)), va="center")
        left.set_yticks(range(len(kinds)), kinds)
        left.set_xlabel("share of cases")
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5)
        one = [
            row for row in rows if group(row).startswith("one effect") and row["truth"]["gain"] is not None
        ]
        gains = np.array([row["truth"]["gain"] for row in one])
        for words, label, colour in (
            (("right", "in family"), "named", MODEL),
            (
                ("right", "in family", "unexplained", "noise_model", "wrong name", "extra name"),
                "not adequate",
                BEFORE,
            ),
        ):
            hit = np.array(
                [row["verdict"] != "adequate" and judged(row) in words for row in one], dtype=float
            )
            shares = [hit[(gains >= a) & (gains < b)] for a, b in pairwise(GAINS)]
            centres = [np.sqrt(a * b) for a, b in pairwise(GAINS)]
            kept = [(x, y.mean()) for x, y in zip(centres, shares, strict=True) if len(y)]
            if kept:
                x, y = zip(*kept, strict=True)
                middle.plot(x, y, "o-", color=colour, label=label)
        middle.set_xscale("log")
        middle.set(
            xlabel="size of the effect: root of its chi-square", ylabel="share of recordings", ylim=(0, 1.02)
        )
        middle.legend()
        clean = np.sort([row["global_p"] for row in rows if group(row) == "nothing missing"])
        right.plot([0, 1], [0, 1], color=GRID)
        right.step(clean, (np.arange(len(clean)) + 1) / max(len(clean), 1), color=MODEL, where="post")
        right.set(xlabel="global p where nothing is missing", ylabel="share below", xlim=(0, 1), ylim=(0, 1))
        figure.savefig(folder / "verdicts.png", dpi=110, facecolor="white")


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
        publish(list(rows.values()), options.publish)
    outcomes = Counter(judged(row) for row in rows.values())
    good = outcomes["right"] + outcomes["in family"]
    if good < options.least * len(rows) or (options.least and outcomes["false alarm"]):
        sys.exit(
            f"{good} of {len(rows)} right, {outcomes['false alarm']} false alarms; expected {options.least:.0%}, none"
        )


if __name__ == "__main__":
    main()
