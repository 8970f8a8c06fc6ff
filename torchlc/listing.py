"""What the library holds, for people and programs: effects with their parameters."""

from __future__ import annotations

import inspect
import math
from typing import Any

from torchlc.effects import registry
from torchlc.effects.base import Effect
from torchlc.parameters import Quantity


def effects_listing() -> list[dict[str, Any]]:
    """Every effect in the order of its stage: name, one sentence, parameters."""
    return [
        {
            "name": name,
            "sentence": first_sentence(effect),
            "stage": effect.stage,
            "default": effect.known,
            "per": effect.per,
            "parameters": [_told(quantity) for quantity in effect.quantities],
        }
        for name, effect in registry().items()
    ]


def first_sentence(effect: type[Effect]) -> str:
    """The first paragraph of an effect's docstring, up to its first full stop or colon."""
    paragraph = inspect.cleandoc(effect.__doc__ or "").split("\n\n")[0]
    return " ".join(paragraph.split())


def _told(quantity: Quantity) -> dict[str, Any]:
    def finite(value: float | None) -> float | None:
        return value if value is not None and math.isfinite(value) else None

    return {
        "name": quantity.name,
        "unit": quantity.unit,
        "low": finite(quantity.low),
        "high": finite(quantity.high),
        "prior": quantity.prior,
        "mean": finite(quantity.mean),
        "sigma": finite(quantity.sigma),
        "meaning": quantity.meaning,
    }


def effects_lines() -> list[str]:
    """The listing as text: an effect a paragraph, its parameters indented."""
    lines = []
    for effect in effects_listing():
        target = f" [{effect['per']}]" if effect["per"] else ""
        usual = " (in every model unless its scene lists effects)" if effect["default"] else ""
        lines.append(f"{effect['name']}{target}{usual}: {effect['sentence']}")
        for one in effect["parameters"]:
            low, high = (("" if bound is None else f"{bound:g}") for bound in (one["low"], one["high"]))
            unit = f" {one['unit']}" if one["unit"] else ""
            lines.append(f"    {one['name']}{unit} ({low} .. {high}, {_prior(one)}): {one['meaning']}")
    return lines


def _prior(told: dict[str, Any]) -> str:
    short = {"normal": "N", "halfnormal": "H", "uniform": "U", "loguniform": "log U", "lognormal": "log N"}[
        told["prior"]
    ]
    numbers = {"normal": ("mean", "sigma"), "halfnormal": ("sigma",), "lognormal": ("mean", "sigma")}.get(
        told["prior"], ()
    )
    given = [f"{told[key] or 0:g}" for key in numbers]
    return f"{short}({', '.join(given)})" if given else short
