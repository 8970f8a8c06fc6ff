"""Scores of answers: plain functions of numbers, then the summary of a run."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from benchmarks.concealed.answer import Answer
from benchmarks.concealed.case import Array, Case

ALARMS = (0.01, 0.05)
BINS = 10


def auc(positive: Sequence[float], negative: Sequence[float]) -> float | None:
    """Probability that a value of ``positive`` is above one of ``negative``, ties counted half (Mann and Whitney)."""
    if not len(positive) or not len(negative):
        return None
    above = np.sign(np.subtract.outer(np.asarray(positive, float), np.asarray(negative, float)))
    return float((0.5 + 0.5 * above).mean())


def overlap(found: Array | None, true: Array | None) -> float | None:
    """Intersection over union of rows (T,); None where there is none to find or the method does not say."""
    if found is None or true is None or not true.any():
        return None
    return float((found & true).sum() / (found | true).sum())


def reliability(
    confidence: Sequence[float], right: Sequence[bool], bins: int = BINS
) -> list[dict[str, float]]:
    """By bin of equal width of the confidence: how many, the mean confidence, and the share that was right."""
    c, r = np.asarray(confidence, float), np.asarray(right, float)
    place = np.minimum((c * bins).astype(int), bins - 1)
    return [
        {
            "count": int((place == k).sum()),
            "confidence": float(c[place == k].mean()),
            "right": float(r[place == k].mean()),
        }
        for k in range(bins)
        if (place == k).any()
    ]


def calibration_error(confidence: Sequence[float], right: Sequence[bool], bins: int = BINS) -> float | None:
    """Expected calibration error (Naeini, Cooper & Hauskrecht 2015): mean of |confidence - share right| over the bins,
    weighted by their counts."""
    if not len(confidence):
        return None
    table = reliability(confidence, right, bins)
    return sum(one["count"] * abs(one["confidence"] - one["right"]) for one in table) / len(confidence)


# ------------------------------------------------------------------------------------------ one answer


def in_families(families: Sequence[Sequence[str]], accepted: Collection[frozenset[str]]) -> bool:
    """Whether some choice of one name from each family is an accepted set."""
    return bool(families) and any(frozenset(one) in accepted for one in product(*families))


def found_share(sets: Sequence[Sequence[str]], accepted: Collection[frozenset[str]]) -> float:
    """Of the causes of an accepted set, how many are among the first so many names; the best accepted set counts."""
    names = list(dict.fromkeys(name for one in sets for name in one))
    return max(len(one & set(names[: len(one)])) / len(one) for one in accepted)


def judged(case: Case, answer: Answer) -> dict[str, Any]:
    """What an answer is worth on a case, ready for JSON."""
    accepted = case.accepted
    ranked = [frozenset(one) for one in answer.sets[:3]]
    first = bool(ranked) and ranked[0] in accepted
    family = first or in_families(answer.families, accepted)
    right = {
        "none": case.kind == "none" or case.too_weak,
        "named": bool(accepted) and family,
        "unlisted": case.kind in ("unlisted", "nominal scene"),
        "missing": None,
    }[answer.verdict]
    named = bool(accepted) and bool(answer.sets)
    return {
        "p": answer.p,
        "verdict": answer.verdict,
        "sets": [sorted(one) for one in ranked],
        "families": [list(one) for one in answer.families],
        "confidence": answer.confidence,
        "right": right,
        "first": first if named else None,
        "third": any(one in accepted for one in ranked) if named else None,
        "family": family if named else None,
        "share": found_share(answer.sets, accepted) if named else None,
        "overlap": overlap(answer.rows, case.true_rows),
        "gain": answer.gain,
    }


# ------------------------------------------------------------------------------------------ a run


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Scores by method, over all classes and by class; ``rows`` are those of the results that did not fail."""
    methods = sorted({row["method"] for row in rows})
    kinds = sorted({row["class"] for row in rows})
    return {
        name: {
            "all": _scores([row for row in rows if row["method"] == name]),
            **{
                kind: _scores(
                    [row for row in rows if row["method"] == name and row["class"] in (kind, "none")], kind
                )
                for kind in kinds
            },
        }
        for name in methods
    }


def overview(rows: Sequence[Mapping[str, Any]], method: str, command: str) -> list[dict[str, Any]]:
    """One line for each class, of one method: what is concealed, what was named, with which probability, and how often that
    was right."""
    lines = []
    for kind in dict.fromkeys(row["class"] for row in rows):
        asked = [
            row for row in rows if row["class"] == kind and row["method"] == method and not row["without"]
        ]
        if not asked:
            continue
        said = [" + ".join(row["sets"][0]) if row["verdict"] == "named" else row["verdict"] for row in asked]
        lines.append(
            {
                "recording": f"concealed causes, class {kind} ({len(asked)} cases)",
                "cause": "known to the generator",
                "named": ", ".join(f"{one} ({said.count(one)})" for one in dict.fromkeys(said)),
                "probability": _median(row["confidence"] for row in asked),
                "right": f"{sum(bool(row['right']) for row in asked)} of {len(asked)}",
                "command": command,
            }
        )
    return lines


def _scores(rows: Sequence[Mapping[str, Any]], kind: str | None = None) -> dict[str, Any]:
    whole = [row for row in rows if not row["without"]]
    none = [row for row in whole if row["class"] == "none"]
    asked = whole if kind is None else [row for row in whole if row["class"] == kind]
    some = [row for row in asked if row["class"] != "none"]
    sure = [row for row in asked if row["confidence"] is not None and row["right"] is not None]
    removed = [row for row in rows if row["without"] and (kind is None or row["class"] == kind)]
    return {
        "cases": len(asked),
        "auc": auc([-row["p"] for row in some], [-row["p"] for row in none]),
        "detected": {str(level): _mean(row["p"] <= level for row in some) for level in ALARMS},
        "false_alarms": {str(level): _mean(row["p"] <= level for row in none) for level in ALARMS},
        **{key: _mean(row[key] for row in some) for key in ("first", "third", "family", "share")},
        "verdict_right": _mean(row["right"] for row in asked) if any(row["sets"] for row in rows) else None,
        "overlap": _median(row["overlap"] for row in some),
        "gain": _median(row["gain"] for row in some),
        "calibration_error": calibration_error(
            [row["confidence"] for row in sure], [row["right"] for row in sure]
        ),
        "reliability": reliability([row["confidence"] for row in sure], [row["right"] for row in sure]),
        "abstained": _mean(row["verdict"] != "named" for row in removed if row["verdict"] != "missing"),
        "removed": len(removed),
        "seconds": _median(row["seconds"] for row in asked),
    }


def _mean(values: Iterable[float | bool | None]) -> float | None:
    kept = [float(one) for one in values if one is not None]
    return float(np.mean(kept)) if kept else None


def _median(values: Iterable[float | None]) -> float | None:
    kept = [one for one in values if one is not None]
    return float(np.median(kept)) if kept else None
