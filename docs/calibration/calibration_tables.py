"""What the pages of docs/calibration say in numbers, from those that their examples wrote."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


def calibration_of_the_posterior() -> dict[str, str]:
    """What docs/calibration/posterior.md says in numbers, from those that its example wrote."""
    numbers = json.loads((HERE / "posterior.json").read_text(encoding="utf-8"))

    def cells(found: dict[str, Any]) -> str:
        if found["p"] is None:
            return f"{found['count']} | | | "
        held = (f"{100 * found[key]:.1f} %" for key in ("within_50", "within_90"))
        return " | ".join([str(found["count"]), f"{found['p']:.2f}", *held])

    table = [
        "| parameter | recordings | p | 50 % interval holds | 90 % interval holds "
        "| informed | p | 50 % interval holds | 90 % interval holds |",
        "|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {row['name']} | {cells(row['every'])} | {cells(row['informed'])} |"
            for row in [*numbers["parameters"], numbers["all"]]
        ),
    ]
    return {
        "posterior_cases": str(numbers["cases"]),
        "posterior_draws": str(numbers["draws"]),
        "posterior_kinds": "; ".join(f"{count} of a {kind}" for kind, count in numbers["kinds"].items()),
        "posterior_least": f"{numbers['least_length']:.0f}",
        "posterior_seconds": f"{numbers['seconds_per_case']:.0f}",
        "posterior_spread": f"{196 * math.sqrt(0.09 / numbers['cases']):.1f}",
        "posterior_table": "\n".join(table),
        "posterior_tau": f"{numbers['autocorrelation_time']:.0f}",
    }


def calibration_of_the_verdict() -> dict[str, str]:
    """What docs/calibration/verdict.md says in numbers, from those that its example wrote."""
    numbers = json.loads((HERE / "verdicts.json").read_text(encoding="utf-8"))
    outcomes: dict[str, dict[str, int]] = numbers["outcomes"]
    words = list(dict.fromkeys(word for counts in outcomes.values() for word in counts))
    table = [
        "| what was concealed | cases | " + " | ".join(words) + " |",
        "|---|---|" + "---|" * len(words),
        *(
            f"| {kind} | {sum(counts.values())} | "
            + " | ".join(str(counts.get(word, "")) for word in words)
            + " |"
            for kind, counts in outcomes.items()
        ),
    ]

    def percent(share: float) -> str:
        return f"{100 * share:.0f} %"

    return {
        "verdict_after": percent(numbers["materials_inside_90"]["after"]),
        "verdict_before": percent(numbers["materials_inside_90"]["before"]),
        "verdict_cases": str(numbers["cases"]),
        "verdict_longest": f"{numbers['processor_seconds']['longest']:.0f}",
        "verdict_overlap": f"{numbers['median_overlap']:.2f}",
        "verdict_seconds": f"{numbers['processor_seconds_exact']['median']:.0f}",
        "verdict_nominal_seconds": f"{numbers['processor_seconds_nominal']['median']:.0f}",
        "verdict_nominal_most": f"{numbers['processor_seconds_nominal']['most']:.0f}",
        "verdict_commit": numbers["commit"],
        "verdict_error": f"{numbers['reliability']['error']:.2f}",
        "verdict_brier": f"{numbers['reliability']['brier']:.2f}",
        "verdict_table": "\n".join(table),
    }
