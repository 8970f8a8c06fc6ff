"""What came out of the cases, for the documentation: numbers, outcomes, power, and what was said of what."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from itertools import groupby, pairwise, product
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from outcomes import OUTCOMES, WORTH, group, judged, ordered, summary

from torchlc.figures.style import BEFORE, GRID, MODEL, style

CLOSE = 0.06
"""Of two probabilities: their numbers, two digits wide, would touch."""
GAINS = (1.0, 2.0, 4.0, 5.0, 8.0, 14.0, 30.0, 300.0)


def publish(rows: Sequence[dict[str, Any]], folder: Path, commit: str) -> None:
    """verdicts.json, verdicts.png and confusion.png of finished cases, that a state of the code gave."""
    numbers = {"commit": commit, **summary(rows)}
    (folder / "verdicts.json").write_text(json.dumps(numbers, indent=1) + "\n")
    draw_outcomes(rows, folder / "verdicts.png")
    draw_confusion(rows, folder / "confusion.png")


def draw_outcomes(rows: Sequence[dict[str, Any]], file: Path) -> None:
    """Outcomes by kind of case, how many effects of which size are found, the global p of clean recordings, and how often an
    answer told with a probability is right."""
    with plt.rc_context(style(9)):
        figure, (left, middle, right, last) = plt.subplots(
            1, 4, figsize=(14, 3.8), width_ratios=(1.5, 1, 1, 1), layout="constrained"
        )
        kinds = ordered(rows)[::-1]
        for place, kind in enumerate(kinds):
            members = [judged(row) for row in rows if group(row) == kind]
            begin = 0.0
            for word, colour in OUTCOMES.items():
                share = members.count(word) / len(members)
                left.barh(
                    place,
                    share,
                    left=begin,
                    color=colour,
                    label=word.replace("_", " ") if place == 0 else None,
                )
                begin += share
            left.text(1.01, place, str(len(members)), va="center")
        left.set_yticks(range(len(kinds)), kinds)
        left.set_xlabel("share of cases")
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5)
        one = [
            row
            for row in rows
            if group(row).startswith(("one effect", "nominal, one effect"))
            and row["truth"]["gain"] is not None
        ]
        gains = np.array([row["truth"]["gain"] for row in one])
        for words, label, colour, mark in (  # where both are the same, the wider one shows behind
            (
                ("right", "in family", "unexplained", "noise_model", "wrong name", "extra name"),
                "not adequate",
                BEFORE,
                10,
            ),
            (("right", "in family"), "named", MODEL, 5),
        ):
            hit = np.array(
                [row["verdict"] != "adequate" and judged(row) in words for row in one], dtype=float
            )
            shares = [hit[(gains >= a) & (gains < b)] for a, b in pairwise(GAINS)]
            centres = [np.sqrt(a * b) for a, b in pairwise(GAINS)]
            kept = [(x, y.mean()) for x, y in zip(centres, shares, strict=True) if len(y)]
            if kept:
                x, y = zip(*kept, strict=True)
                middle.plot(x, y, "o-", color=colour, label=label, markersize=mark, linewidth=mark / 3)
        middle.set_xscale("log")
        middle.set_xticks(
            [1, 2, 5, 10, 20, 50, 100], labels=["1", "2", "5", "10", "20", "50", "100"], minor=False
        )
        middle.minorticks_off()
        middle.set(
            xlabel="size of the effect: root of its chi-square", ylabel="share of recordings", ylim=(0, 1.06)
        )
        middle.legend(loc="lower right")
        clean = np.sort([row["global_p"] for row in rows if group(row) == "nothing missing"])
        right.plot([0, 1], [0, 1], color=GRID)
        right.step(clean, (np.arange(len(clean)) + 1) / max(len(clean), 1), color=MODEL, where="post")
        right.set(xlabel="global p where nothing is missing", ylabel="share below", xlim=(0, 1), ylim=(0, 1))
        bins = summary(rows)["reliability"].get("bins", [])
        last.plot([0, 1], [0, 1], color=GRID)
        told, share = ([one[key] for one in bins] for key in ("told", "right"))
        spread = [math.sqrt(max(p * (1 - p), 0.0) / one["cases"]) for p, one in zip(share, bins, strict=True)]
        last.errorbar(told, share, spread, fmt="o", color=MODEL)
        last.set(
            xlabel="probability of the answer as told\n(numbers: answers of each mark)",
            ylabel="share right",
            xlim=(max(0.0, min([*told, 1.0]) - 0.1), 1.01),
            ylim=(0, 1.06),
        )
        number_marks(last, bins)
        figure.savefig(file, dpi=110, facecolor="white")


def number_marks(axes: Axes, bins: Sequence[dict[str, Any]]) -> None:
    """How many answers each mark stands for, at the foot of the picture below it; where marks stand close, one above the other."""
    level, before = 0, -math.inf
    for one in sorted(bins, key=lambda one: one["told"]):
        level = level + 1 if one["told"] - before < CLOSE else 0
        before = one["told"]
        axes.annotate(
            str(one["cases"]),
            (one["told"], one["right"]),
            (one["told"], 0.04 + 0.06 * level),
            ha="center",
            va="center",
            zorder=1,
            arrowprops={"arrowstyle": "-", "color": GRID, "zorder": 1, "shrinkA": 2, "shrinkB": 3},
        )


def concealed(row: dict[str, Any]) -> str:
    """What a case conceals, in a few words."""
    kind, words = group(row), row["case"].rpartition("/")[2].split("-")
    if words[0] == "nominal":
        words, kind = words[1:], kind.partition(", ")[2]
    if kind == "nothing missing":
        return kind
    if kind == "scene slightly wrong":
        return f"wrong {words[1]}"
    if kind == "outside the library":
        return f"{words[1]}, in no library"
    effects = " + ".join(sorted(row["truth"]["effects"]))
    return f"other law, {effects}" if kind == "other reflection law" else effects


def said(row: dict[str, Any]) -> list[str]:
    """What the verdict says of it: the names, or that there is none."""
    return row["named"] or [row["verdict"]]


def draw_confusion(rows: Sequence[dict[str, Any]], file: Path) -> None:
    """How often what was concealed (down) was called what (across); single effects worth 25 of chi-square and more.
    Where two are named, either has its mark."""
    kept = [row for row in rows if group(row) != f"one effect, {WORTH[-math.inf]}"]
    labels = [
        label
        for _, kinds in groupby(ordered(kept), lambda kind: kind.partition(",")[0])
        for among in [set(kinds)]
        for label in sorted({concealed(row) for row in kept if group(row) in among})
    ]
    labels = list(dict.fromkeys(labels))  # a clean scene may be exact or nominal
    names = sorted({one for row in kept if row["verdict"] != "adequate" for one in said(row)})
    across = ["adequate", "unexplained", *(one for one in names if one != "unexplained")]
    with plt.rc_context(style(8)):
        figure, axes = plt.subplots(
            figsize=(1.8 + 0.27 * len(across), 1.6 + 0.2 * len(labels)), layout="constrained"
        )
        for label, name in product(labels, across):
            members = [row for row in kept if concealed(row) == label]
            hits = [judged(row) for row in members if name in said(row)]
            if hits:
                good = sum(one in ("right", "in family", "part of the set") for one in hits)
                place = (across.index(name), labels.index(label))
                colour = OUTCOMES["right" if good == len(hits) else "in family" if good else "wrong name"]
                axes.add_patch(Rectangle((place[0] - 0.5, place[1] - 0.5), 1, 1, color=colour))
                axes.text(*place, str(len(hits)), ha="center", va="center", color="white")
        axes.set(xlim=(-0.5, len(across) - 0.5), ylim=(len(labels) - 0.5, -0.5))
        axes.set_xticks(range(len(across)), across, rotation=90)
        axes.set_yticks(range(len(labels)), labels)
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        for edge in range(len(labels)):
            axes.axhline(edge + 0.5, color=GRID, linewidth=0.4)
        figure.savefig(file, dpi=110, facecolor="white")
