"""What docs/evidence/concealed.md says in numbers: torchlc and its peers on cases in which something is concealed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent

BETTER = {
    "auc": ("AUC", 1), "first": ("first name", 1), "third": ("first three", 1), "family": ("family", 1), "share": ("causes found", 1),
    "verdict_right": ("verdict right", 1), "overlap": ("rows", 1), "gain": ("gain", 1), "calibration_error": ("calibration error", -1),
    "abstained": ("abstained", 1), "seconds": ("CPU s", -1),
}  # fmt: skip
"""Scores of the benchmark by which peers are held against torchlc, and whether more of each is better (1) or less (-1)."""


def evidence_of_the_benchmark() -> dict[str, str]:
    """What docs/evidence/concealed.md says in numbers, from those of ``python -m benchmarks.concealed``."""
    numbers = json.loads((HERE / "concealed.json").read_text(encoding="utf-8"))
    toy = json.loads((HERE / "concealed_toy.json").read_text(encoding="utf-8"))
    order = ["diagnosis", *sorted(name for name in numbers["titles"] if name != "diagnosis")]
    missing = [kind for kind, count in numbers["classes"].items() if count and kind != "none"]
    few = f"Of the 300 cases of a whole run {numbers['cases']} are done. So few say little of false alarms, of calibration and of abstention."
    return {
        "concealed_cases": str(numbers["cases"]),
        "concealed_classes": ", ".join(
            f"{count} of {kind}" for kind, count in numbers["classes"].items() if count
        ),
        "concealed_generators": ", ".join(
            f"{count} by {name}" for name, count in numbers["generators"].items()
        ),
        "concealed_commit": numbers["commit"],
        "concealed_seed": str(numbers["seed"]),
        "concealed_machine": numbers["machine"],
        "concealed_failed": str(numbers["failed"]),
        "concealed_share": "" if numbers["cases"] >= 300 else few,
        "concealed_table": table_of_methods(numbers, order),
        "concealed_better": better_peers(numbers, order, missing),
        **{
            f"concealed_{key}": table_by_class(numbers, order, missing, key)
            for key in ("auc", "family", "gain")
        },
        "concealed_toy": table_of_the_toy(toy["detected"]),
    }


def better_peers(numbers: dict, order: list[str], kinds: list[str]) -> str:
    """A line for each class and score in which a peer does better than torchlc on the cases that it was asked: the best such peer."""
    lines = ["| class | score | torchlc | best peer | its score |", "|---|---|---|---|---|"]
    for kind in ["all", *kinds]:
        ours = numbers["scores"]["diagnosis"].get(kind, {})
        for key, (title, sign) in BETTER.items():
            theirs = {
                name: one[key]
                for name in order[1:]
                if (one := numbers["scores"][name].get(kind, {})).get(key) is not None
                and one["cases"] == ours.get("cases")
            }
            if ours.get(key) is None or not theirs:
                continue
            best = max(theirs, key=lambda name: sign * theirs[name])
            if sign * theirs[best] > sign * ours[key] + 5e-3:
                lines.append(
                    f"| {kind} | {title} | {ours[key]:.2f} | {numbers['titles'][best]} | {theirs[best]:.2f} |"
                )
    return "\n".join(lines) if len(lines) > 2 else "In none of the scores."


def table_of_methods(numbers: dict[str, Any], order: list[str]) -> str:
    """Scores of all cases, a row a method, and what was not installed."""
    heads = ["method", "cases", "AUC", "seen at 1 %", "at 5 %", "false at 1 %", "at 5 %", "first name", "first three", "family",
             "causes found", "verdict right", "rows", "gain", "calibration error", "abstained", "CPU s"]  # fmt: skip
    rows = [
        [
            numbers["titles"][name],
            str(one["cases"]),
            shown(one["auc"]),
            *(shown(one["detected"][level]) for level in ("0.01", "0.05")),
            *(shown(one["false_alarms"][level]) for level in ("0.01", "0.05")),
            *(shown(one[key]) for key in ("first", "third", "family", "share", "verdict_right", "overlap")),
            shown(one["gain"], ".1f"),
            *(shown(one[key]) for key in ("calibration_error", "abstained")),
            shown(one["seconds"], ".1f"),
        ]
        for name in order
        for one in [numbers["scores"][name]["all"]]
    ]
    for title, modules in numbers.get("left_out", {}).items():
        rows.append([title, "0", f"not installed: {', '.join(modules)}", *["–"] * (len(heads) - 3)])
    return table(heads, rows)


def table_by_class(numbers: dict[str, Any], order: list[str], kinds: list[str], key: str) -> str:
    """One score of each class, a row a method."""
    scores = numbers["scores"]
    return table(
        ["method", *kinds],
        [
            [numbers["titles"][name], *(shown(scores[name].get(kind, {}).get(key)) for kind in kinds)]
            for name in order
        ],
    )


def table_of_the_toy(detected: dict[str, dict[str, dict[str, float]]]) -> str:
    """Shares detected in the toy problem, by strength and by level of false alarms."""
    strengths = next(iter(detected.values()))
    return table(
        ["statistic", *(f"{one} sigma, {level}" for one in strengths for level in ("1 %", "5 %"))],
        [
            [name, *(shown(by_level[level]) for by_level in found.values() for level in ("0.01", "0.05"))]
            for name, found in detected.items()
        ],
    )


def shown(value: float | None, form: str = ".2f") -> str:
    return "–" if value is None else format(value, form)


def table(heads: list[str], rows: list[list[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
