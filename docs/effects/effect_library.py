"""The page of every effect, made from its class."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

from torchlc.effects import registry
from torchlc.report.listing import effects_listing

HERE = Path(__file__).parent

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


def library() -> str:
    """Every effect, in the order of the stages."""
    sizes = json.loads((HERE / "sizes.json").read_text(encoding="utf-8"))
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
    if (HERE / "figures" / f"{name}.png").exists():
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
