"""What came out of the cases: each judged by its answer, all of them counted."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from cases import kind
from scipy import stats

WORTH = {100.0: "chi-square over 100", 25.0: "chi-square 25 to 100", -math.inf: "chi-square below 25"}
"""Effects by how much chi-square the true model gains over the best refit without it."""
KINDS = (
    "nothing missing", *(f"one effect, {words}" for words in WORTH.values()), "two effects", "three effects", "other noise",
    "scene slightly wrong", "other reflection law", "outside the library", "nominal, nothing missing", "nominal, one effect",
    "nominal, outside the library",
)  # fmt: skip
OUTCOMES = {
    "right": "#3f9b5c",
    "in family": "#9cc9a5",
    "part of the set": "#c9dcae",
    "extra name": "#e0b23c",
    "missed": "#c9ced6",
    "unexplained": "#8a94a6",
    "noise_model": "#8a63b8",
    "false alarm": "#d9772b",
    "wrong name": "#c2410c",
}
"""What may come out, with its colour."""
GOOD = ("right", "in family")
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Edges of the probabilities of answers that are counted together."""


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
        return "part of the set"
    return "wrong name"


def group(row: dict[str, Any]) -> str:
    """The kind of case, by its name; of one effect in an exact scene with what it is worth."""
    found = kind(row["case"].rpartition("/")[2])
    if found != "one effect":
        return found
    refit = row["truth"]["chi2"]["baseline_refit"]
    if row["verdict"] == "adequate":  # no prior is strained: this chi-square is a refit's own
        refit = min(refit, row["improvement"]["chi2_before"])
    worth = refit - row["truth"]["chi2"]["truth"]
    return f"{found}, " + next(words for least, words in WORTH.items() if worth >= least)


def ordered(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The kinds of case that there are, in the order in which they are told."""
    there = {group(row) for row in rows}
    return [one for one in KINDS if one in there] + sorted(there - set(KINDS))


def reliability(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of answers told with a probability: by bins of it their number, its mean and the share that was right; the expected
    calibration error, which weighs the bins' differences by their numbers; and Brier's score."""
    told = np.array([row["told"] for row in rows if row.get("told") is not None])
    right = np.array([judged(row) in GOOD for row in rows if row.get("told") is not None], dtype=float)
    if not len(told):
        return {}
    place = np.clip(np.digitize(told, BINS) - 1, 0, len(BINS) - 2)
    bins = [
        {"cases": int(inside.sum()), "told": float(told[inside].mean()), "right": float(right[inside].mean())}
        for inside in (place == one for one in range(len(BINS) - 1))
        if inside.any()
    ]
    error = sum(one["cases"] * abs(one["told"] - one["right"]) for one in bins) / len(told)
    return {"bins": bins, "error": float(error), "brier": float(np.mean((told - right) ** 2))}


def spent(seconds: Sequence[float]) -> dict[str, float]:
    """Median, 95th percentile and longest."""
    if not seconds:
        return {}
    return {
        "median": float(np.median(seconds)),
        "most": float(np.percentile(seconds, 95)),
        "longest": max(seconds),
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Counts of each outcome by kind of case, and the measures over all of them."""
    counts = {
        kind: {word: n for word in OUTCOMES if (n := found[word])}
        for kind in ordered(rows)
        for found in [Counter(judged(row) for row in rows if group(row) == kind)]
    }
    clean = [row["global_p"] for row in rows if group(row) == "nothing missing"]
    named = [row for row in rows if row["verdict"] == "missing_physics"]
    right = [row for row in named if judged(row) in GOOD]
    # surfaces of another law than the scene's have no numbers of its law to be compared with, and where all that is drawn lies
    # in a corner of the priors, intervals that are right need not hold it
    own = [
        row
        for row in right
        if group(row) != "other reflection law" and row["truth"].get("materials_from_their_priors")
    ]
    held = {when: np.sum([row["materials"][when] for row in own], axis=0) for when in ("before", "after")}
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
        "reliability": reliability(rows),
        "median_overlap": float(np.median(overlaps)) if overlaps else None,
        "materials_inside_90": {
            when: float(inside / whole) if whole else None for when, (inside, whole) in held.items()
        }
        if own
        else {},
        "chi2_within_3_sigma": float(np.mean(np.array(fitting) < 3.0)) if fitting else None,
        "processor_seconds": spent(seconds),
        "processor_seconds_exact": spent(
            [row["cpu_seconds"] for row in rows if not group(row).startswith("nominal")]
        ),
        "processor_seconds_nominal": spent(
            [row["cpu_seconds"] for row in rows if group(row).startswith("nominal")]
        ),
    }
