"""Sphinx: pages in MyST Markdown, the public names from their docstrings, the effects from their registry."""

from __future__ import annotations

import inspect
import json
import math
import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

import torchlc
from torchlc.diagnosis import (
    clock,
    counts,
    discrepancy,
    engine,
    fits,
    gate,
    hypotheses,
    probes,
    promises,
    proof,
    run,
    where,
)
from torchlc.diagnosis import probabilities as odds
from torchlc.diagnosis.unseen import UNSEEN
from torchlc.effects import registry
from torchlc.inference import density, posterior
from torchlc.report.listing import effects_listing

project = "torchlc"
author = "the torchlc authors"
project_copyright = "2026, the torchlc authors"
version = release = torchlc.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "deflist"]
myst_substitutions = {
    "blocks": proof.BLOCKS,
    "runs": proof.RUNS,
    "longest": posterior.LONGEST,
    "clean_p": f"{engine.CLEAN_P:g}",
    "dear": f"{promises.DEAR_FIT_S:g}",
    "slow_fit": f"{promises.SLOW_FIT_S:g}",
    "again": str(probes.AGAIN),
    "grown": str(engine.GROWN),
    "as_likely": f"{100 * counts.AS_LIKELY:g}",
    "linear_near": f"{promises.LINEAR_NEAR:g}",
    "slow_ms": f"{1000 * density.DEAR_S:g}",
    "draws": gate.DRAWS,
    "draws_z": engine.DRAWS,
    "family": f"{100 * odds.FAMILY_SHARE:g} %",
    "law_odds": f"{hypotheses.LAW_ODDS:g}",
    "least_taken": f"{100 * odds.LEAST_TAKEN:g} %",
    "unseen": f"{UNSEEN:g}",
    "told": f"{odds.TOLD:g}",
    "near": f"{promises.NEAR:g}",
    "noise_odds": f"{hypotheses.NOISE_ODDS:g}",
    "odd_odds": f"{discrepancy.ODDS:g}",
    "far": f"{discrepancy.FAR:g}",
    "refitted": str(discrepancy.REFITTED),
    "quick_s": f"{run.QUICK_S:g}",
    "most_s": f"{clock.MOST_S:g}",
    "reach": f"{fits.REACH:g}",
    "few_effects": hypotheses.FEW_EFFECTS,
    "alone_s": f"{run.MOST_ALONE_S:g}",
    "scale_sigma": f"{density.SCALE_SIGMA:g}",
    "seen_sigma": f"{where.SEEN_SIGMA:g}",
    "unknown_odds": f"{odds.UNKNOWN_ODDS:g}",
    "wide_mag": f"{posterior.WIDE_MAG:g}",
}
"""The numbers of the verdict, as the code has them; fill_numbers.py writes them into the pages."""
HERE = Path(__file__).parent


def calibration_of_the_posterior() -> dict[str, str]:
    """What docs/calibration/posterior.md says in numbers, from those that its example wrote."""
    numbers = json.loads((HERE / "calibration" / "posterior.json").read_text(encoding="utf-8"))

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
    numbers = json.loads((HERE / "calibration" / "verdicts.json").read_text(encoding="utf-8"))
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


def evidence_tables() -> dict[str, str]:
    """The tables of docs/evidence."""
    sys.path.insert(0, str(HERE / "evidence"))
    try:
        import overview
        import tumbling
    finally:
        sys.path.pop(0)
    return {**overview.tables(), **tumbling.tables()}


BETTER = {
    "auc": ("AUC", 1), "first": ("first name", 1), "third": ("first three", 1), "family": ("family", 1), "share": ("causes found", 1),
    "verdict_right": ("verdict right", 1), "overlap": ("rows", 1), "gain": ("gain", 1), "calibration_error": ("calibration error", -1),
    "abstained": ("abstained", 1), "seconds": ("CPU s", -1),
}  # fmt: skip
"""Scores of the benchmark by which peers are held against torchlc, and whether more of each is better (1) or less (-1)."""


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


def evidence_of_the_benchmark() -> dict[str, str]:
    """What docs/evidence/concealed.md says in numbers, from those of ``python -m benchmarks.concealed``."""
    numbers = json.loads((HERE / "evidence" / "concealed.json").read_text(encoding="utf-8"))
    toy = json.loads((HERE / "evidence" / "concealed_toy.json").read_text(encoding="utf-8"))
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


def shown(value: float | None, form: str = ".2f") -> str:
    return "–" if value is None else format(value, form)


def table(heads: list[str], rows: list[list[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


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


def evidence_of_the_peak() -> dict[str, str]:
    """What docs/evidence/paper_story.md says in numbers, from those of its example."""
    found = json.loads((HERE / "evidence" / "paper_story.json").read_text(encoding="utf-8"))
    rows = ["| cause | size | changes, mag | uneven over the peak, mag | refit leaves, mag | chi, refit | steepest, mag/h | refit's |"
            " global p | verdict | named, with its family | probability |", "|" + "---|" * 12]  # fmt: skip
    for name, one in found.items():
        if name == "overview" or "verdict" not in one:
            continue
        family = "; ".join(" or ".join(members) for members in one["families"]) or "nothing"
        size = "wings at the wall" if "gap_m" in one else ", ".join(
            f"{key} = {value:.3g}"
            for values in one["parameters"].values()
            for key, value in values.items()
            if not isinstance(value, str)
        )  # fmt: skip
        cells = [name, size, f"{one['largest_change_mag']:.3f}", f"{one['uneven_at_peak_mag']:.4f}",
                 f"{one['left_by_refit_mag']:.4f}", f"{one['gain']:.1f}", f"{one['slope_with']:.3f}",
                 f"{one['slope_refit']:.3f}", f"{one['global_p']:.2g}", one["verdict"], family, f"{one['told']:.2f}"]  # fmt: skip
        rows.append("| " + " | ".join(cells) + " |")
    occlusion = found["occlusion"]
    return {
        "story_plain": f"{found['lobe tail, plain']['left_at_peak_mag']:.2f}",
        "story_told": f"{found['lobe tail, plain']['told']:.2f}",
        "story_table": "\n".join(rows),
        "story_error": f"{occlusion['error_to_be_seen_mag']:.4f}",
        "story_change": f"{occlusion['largest_change_mag']:.3f}",
        "story_uneven": f"{occlusion['uneven_at_peak_mag']:.4f}",
        "story_left": f"{occlusion['left_by_refit_mag']:.4f}",
        "story_gap": f"{found['occlusion as published']['gap_m']:.2f}",
    }


def hostile_files() -> dict[str, str]:
    """What docs/how_to/files_from_strangers.md says in numbers, from those that ``python -m tests.hostile_files`` wrote."""
    numbers = json.loads((HERE / "how_to" / "hostile_files.json").read_text(encoding="utf-8"))

    def table(heads: list[str], rows: list[tuple[list[str], dict[str, Any]]]) -> str:
        total = {key: sum(found[key] for _, found in rows) for key in ("done", "refused", "else")}
        lines = [
            [*heads, "files", "read", "refused in one line", "anything else"],
            ["---"] * (len(heads) + 4),
        ]
        for names, found in [*rows, (["all", *[""] * (len(heads) - 1)], total)]:
            counts = [found["done"], found["refused"], found["else"]]
            lines.append([*names, str(sum(counts)), *map(str, counts)])
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    files, damages = numbers["files"], numbers["damages"]
    return {
        "hostile_files": table(
            ["file", "command"], [([name, f"`{found['command']}`"], found) for name, found in files.items()]
        ),
        "hostile_damages": table(["damage"], [([name], found) for name, found in damages.items()]),
        "by_hand": str(sum(numbers["by_hand"].values())),
        "by_hand_scenes": str(numbers["by_hand"]["scenes"]),
        "by_hand_recordings": str(numbers["by_hand"]["recordings"]),
    }


myst_substitutions |= hostile_files()
myst_substitutions |= calibration_of_the_posterior() | calibration_of_the_verdict()
myst_substitutions |= evidence_of_the_benchmark() | evidence_of_the_peak() | evidence_tables()
myst_heading_anchors = 3
exclude_patterns = ["_build"]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_typehints_description_target = "documented_params"
html_theme = "furo"
html_title = f"torchlc {version}"

BOLD = re.compile(r'<mi mathvariant="bold">([a-z])</mi>')
STAGES = {
    "clock": "When light is taken",
    "orbit": "Where it is taken",
    "spin": "Rotation",
    "attitude": "Attitude",
    "pointing": "Panels",
    "light": "Sources of light",
    "surface": "Shape and surfaces",
    "shade": "Shadow on the whole object",
    "scatter": "Light between surfaces",
    "material": "Reflection",
    "detector": "Calibration and detector",
    "noise": "Noise",
}


def write_library() -> None:
    """effects/library.md, by fill_numbers.py."""
    (HERE / "effects" / "library.md").write_text(library(), encoding="utf-8")


def library() -> str:
    """Every effect, in the order of the stages."""
    sizes = json.loads((HERE / "effects" / "sizes.json").read_text(encoding="utf-8"))
    lines = ["# Every effect", "", *sizes_and_costs(sizes)]
    stage = ""
    for effect in effects_listing():
        if effect["stage"] != stage:
            stage = effect["stage"]
            lines += [f"## {STAGES[stage]}", "", f"Stage `{stage}`.", ""]
        lines += section(effect)
    return "\n".join(lines).rstrip() + "\n"


def sizes_and_costs(sizes: dict[str, dict[str, Any]]) -> list[str]:
    """The table of what each effect leaves behind and what it costs, from what make_figures.py measured."""
    lines = [
        "## Sizes and costs",
        "",
        "| effect | scene | left out, rms mag | materials refitted, rms mag | at most | cost |",
        "|---|---|---|---|---|---|",
    ]
    for name, one in sizes.items():
        refitted = "" if one["refitted_rms_mag"] is None else f"{one['refitted_rms_mag']:.2g}"
        lines.append(
            f"| [{name}](#{name}) | {one['setting']} | {one['rms_mag']:.2g} | {refitted} | "
            f"{one['refitted_most_mag']:.2g} | {one['cost']:.2g} |"
        )
    return [*lines, ""]


def section(effect: dict[str, Any]) -> list[str]:
    """One effect: what it is, what it neglects, its parameters, and its figure where there is one."""
    name = effect["name"]
    target = f", one set of parameters for each {effect['per']}" if effect["per"] else ""
    usual = ", on unless the scene lists its effects" if effect["default"] else ""
    lines = [f"### {name}", "", f"{effect['title'].capitalize()}.", ""]
    if target or usual:
        lines += [f"*{(target + usual).removeprefix(', ').capitalize()}.*", ""]
    lines += [inspect.cleandoc(registry()[name].__doc__ or ""), ""]
    if effect["parameters"]:
        lines += ["| parameter | unit | bounds | prior | meaning |", "|---|---|---|---|---|"]
        lines += [
            f"| `{name}.{one['name']}` | {one['unit']} | {bounds(one)} | {prior(one)} | {one['meaning']} |"
            for one in effect["parameters"]
        ]
        lines.append("")
    if (HERE / "effects" / "figures" / f"{name}.png").exists():
        lines += [f"![What {name} leaves if it is left out](figures/{name}.png)", ""]
    return lines


def bounds(one: dict[str, Any]) -> str:
    low, high = ("" if one[key] is None else f"{one[key]:g}" for key in ("low", "high"))
    return f"{low} .. {high}"


def prior(one: dict[str, Any]) -> str:
    if one["unless_set"] is not None:
        return f"fixed at {one['unless_set']:g} unless set"
    mean, sigma = one["mean"] or 0.0, one["sigma"]
    if one["prior"] in ("normal", "lognormal"):
        return f"{one['prior']}({mean:g}, {sigma:g})"
    return f"{one['prior']}({sigma:g})" if one["prior"] == "halfnormal" else one["prior"]


def write_formula(page: Any, node: nodes.math | nodes.math_block) -> None:
    """As MathML, which a browser shows by itself, offline; bold letters as characters of their own, as browsers
    want them."""
    block = isinstance(node, nodes.math_block)
    formula = convert(node.astext(), display="block" if block else "inline")
    formula = BOLD.sub(lambda letter: f"<mi>{chr(ord('𝐚') + ord(letter[1]) - ord('a'))}</mi>", formula)
    page.body.append(f'<div style="padding: 0.6em 0">{formula}</div>' if block else formula)
    raise nodes.SkipNode


def setup(app: Any) -> None:
    app.add_html_math_renderer("mathml", (write_formula, None), (write_formula, None))
