"""The page of the laws of reflection, made from their classes."""

from __future__ import annotations

import inspect

from torchlc.brdf import MODELS, Brdf

INTRODUCTION = """# Laws of reflection

A material of a scene names one as its `model`. f_r is the radiance that a surface sends out over the irradiance that falls on it; mu0 and mu are the
cosines of incidence and reflection, h is the direction halfway between the Sun and the observer. Equation numbers are those of the
[paper](../paper/index.md) unless another source is named. A law of your own is [one class](../adding_an_effect.md#a-law-of-reflection).
"""


def laws() -> str:
    """Every law, by name."""
    return (
        "\n".join([INTRODUCTION, *(line for name in sorted(MODELS) for line in law(MODELS[name]))]).rstrip()
        + "\n"
    )


def law(model: type[Brdf]) -> list[str]:
    """The section of one law: what it is, its numbers, what a diagnosis tries in its place."""
    described = (inspect.getdoc(model) or "").replace("``", "`").replace("*", r"\*").split("\n")
    lines = [
        f"## {model.model}",
        "",
        *described,
        "",
        "| number | unit | from | to | meaning |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| `{one.name}` | {one.unit} | {one.low:g} | {one.high:g} | {one.meaning} |"
        for one in model.quantities
    ]
    if model.simplex:
        lines += ["", f"{' + '.join(f'`{name}`' for name in model.simplex)} is at most 1."]
    if model.rivals:
        others = ", ".join(f"[{name}](#{name})" for name in model.rivals)
        lines += ["", f"A diagnosis tries in its place: {others}."]
    return [*lines, ""]
