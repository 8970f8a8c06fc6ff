"""Ranks of truths among draws: are they uniform, and do intervals hold what they say? In numbers and a figure.

The share of truths in a central interval is read off the ranks: of N draws, the one of probability c holds
those with c (N + 1) of the N + 1 ranks, the middle ones.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

from torchlc.figures.style import DATA, MODEL, style

BINS = 10
LEVELS = (50, 90, 98)
Case = Mapping[str, Any]


def read(path: Path) -> dict[int, Case]:
    """Finished cases by number; a last line cut short by a kill is left out."""
    done = {}
    if path.exists():
        for line in path.read_text().splitlines():
            try:
                one = json.loads(line)
            except json.JSONDecodeError:
                continue
            done[one["case"]] = one
    return done


def summary(cases: Sequence[Case], draws: int) -> dict[str, Any]:
    """What was run, and for each parameter, then for all together, the ranks and what they say."""
    names = list(dict.fromkeys(name for one in cases for name in one["parameters"]))
    rows = {name: [one["parameters"][name] for one in cases if name in one["parameters"]] for name in names}
    every = [row for found in rows.values() for row in found]
    return {
        "cases": len(cases),
        "kinds": dict(Counter(one["kind"] for one in cases)),
        "draws": draws,
        "autocorrelation_time": float(np.median([one["tau"] for one in cases])),
        "least_length": min(one["length"] for one in cases),
        "seconds_per_case": float(np.mean([one["seconds"] for one in cases])),
        "parameters": [judged(name, found, draws) for name, found in rows.items()],
        "all": judged("all together", every, draws),
    }


def judged(name: str, rows: Sequence[Case], draws: int) -> dict[str, Any]:
    """Counts of ranks in bins of equal width, chi-square p, and shares of truths within central intervals, of
    all rows and of the informed ones; None where there are too few.
    """
    ranks = np.array([row["rank"] for row in rows])
    informed = np.array([row["informed"] for row in rows])
    found: dict[str, Any] = {"name": name}
    for key, some in (("every", ranks), ("informed", ranks[informed])):
        enough = len(some) >= 5 * BINS
        counts = np.bincount(some * BINS // (draws + 1), minlength=BINS)
        within = {f"within_{c}": float(held(some, draws, c / 100).mean()) if enough else None for c in LEVELS}
        p = float(stats.chisquare(counts).pvalue) if enough else None
        found[key] = {"count": len(some), "bins": counts.tolist(), "p": p, **within}
    return found


def held(ranks: np.ndarray, draws: int, level: float) -> np.ndarray:
    """Whether each truth lies in the central interval of probability ``level``."""
    outside = 0.5 * (1.0 - level) * (draws + 1)
    return (ranks + 0.5 > outside) & (ranks + 0.5 < draws + 1 - outside)


def draw(numbers: Case, path: Path) -> None:
    """A histogram of ranks for each parameter, with the range that 95 of 100 bars of uniform ranks keep to."""
    shown = numbers["parameters"]
    with plt.rc_context({**style(9), "figure.facecolor": "white"}):
        figure, axes = plt.subplots(2, -(-len(shown) // 2), figsize=(9.0, 4.4), layout="constrained")
        for place, (row, one) in enumerate(zip(shown, axes.flat, strict=False)):
            count, every, informed = row["every"]["count"], row["every"]["bins"], row["informed"]["bins"]
            low, high = stats.binom(count, 1 / BINS).ppf([0.025, 0.975])
            one.axhspan(low, high, color=DATA, alpha=0.3, lw=0, zorder=0, label="95 % of bars, if uniform")
            one.axhline(count / BINS, color=DATA, lw=0.8, zorder=0.5)
            centres, width = (np.arange(BINS) + 0.5) / BINS, 0.9 / BINS
            one.bar(centres, every, width, color=MODEL, alpha=0.3, label="data say nothing of it")
            one.bar(centres, informed, width, color=MODEL, alpha=0.8, label="informed")
            one.set(xlim=(0, 1), xticks=(0, 0.5, 1), ylim=(0, None))
            p = row["every"]["p"]
            one.set_title(row["name"] + ("" if p is None else f", p = {p:.2f}"), fontsize=9)
            one.set_ylabel("recordings" if place % axes.shape[1] == 0 else "")
            one.set_xlabel("rank of the truth" if place >= axes.shape[1] else "")
        for one in axes.flat[len(shown) :]:
            one.set_axis_off()
        handles = axes.flat[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper left", ncols=3, fontsize=9)
        figure.savefig(path, dpi=110)
        plt.close(figure)
