"""What the library holds, for people and programs: effects with their parameters, materials, and fits of
materials.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchlc.digits import number_of
from torchlc.effects import registry, unlisted
from torchlc.errors import InputError
from torchlc.materials.goniometer import ReflectanceFit
from torchlc.materials.known import load_library
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect, first_sentence

LOOKED_FOR = "Not in the library, but looked for by a diagnosis, which then says that something unknown is missing and what it is like"
LEAST_PROBABILITY = 1e-3
"""Matches below this are not printed."""


def effects_listing(classes: Mapping[str, type[Effect]] | None = None) -> list[dict[str, Any]]:
    """Every effect in the order of its stage, or each of some ``classes`` by name: name, title, one sentence, parameters."""
    return [
        {
            "name": name,
            "title": effect.title,
            "sentence": first_sentence(effect),
            "stage": effect.stage,
            "default": effect.known,
            "per": effect.per,
            "parameters": [_told(quantity) for quantity in effect.quantities],
        }
        for name, effect in (registry() if classes is None else classes).items()
    ]


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
        "unless_set": finite(quantity.unless_set),
        "meaning": quantity.meaning,
    }


def effects_lines() -> list[str]:
    """The listing as text: an effect a paragraph, its parameters indented; then what is no effect of the library, but looked for."""
    lines = _paragraphs(effects_listing())
    return [*lines, "", f"{LOOKED_FOR}:", *_paragraphs(effects_listing(unlisted()))]


def _paragraphs(effects: Sequence[dict[str, Any]]) -> list[str]:
    lines = []
    for effect in effects:
        target = f" [{effect['per']}]" if effect["per"] else ""
        usual = " (in every model unless its scene lists effects)" if effect["default"] else ""
        lines.append(f"{effect['name']}{target}{usual}: {effect['title']}. {effect['sentence']}")
        for parameter in effect["parameters"]:
            low, high = (
                ("" if bound is None else f"{bound:g}") for bound in (parameter["low"], parameter["high"])
            )
            unit = f" {parameter['unit']}" if parameter["unit"] else ""
            lines.append(
                f"    {parameter['name']}{unit} ({low} .. {high}, {_prior(parameter)}): {parameter['meaning']}"
            )
    return lines


def materials_listing() -> list[dict[str, Any]]:
    """Every known material: name, model, values with their spread, meaning, source."""
    return [vars(material) for material in load_library().values()]


def materials_lines() -> list[str]:
    """The known materials as text."""
    lines = []
    for material in load_library().values():
        values = ", ".join(f"{name} = {value:g}" for name, value in material.values.items())
        lines += [
            f"{material.name} ({material.model}): {values}",
            f"    {material.meaning}",
            f"    {material.source}",
        ]
    return lines


def matches_of(directory: Path) -> dict[str, list[dict[str, Any]]]:
    """Matches by material from the fit.json of a directory."""
    path = directory / "fit.json" if directory.is_dir() else directory
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        matches = content["materials"]
    except OSError:
        raise InputError(path, None, "cannot be read", "the directory of a finished fit") from None
    except (ValueError, KeyError, TypeError):
        raise InputError(path, None, "no fit in it", "the directory of a finished fit") from None
    return matches


def matches_lines(found: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Matches as text, those below 0.1 % left out."""
    lines = []
    for material, matches in found.items():
        lines.append(material)
        for match in matches:
            if match["probability"] >= LEAST_PROBABILITY:
                away = "" if match["distance"] is None else f"  {match['distance']:.1f} sigma away"
                lines.append(f"    {match['name']:20} {100 * match['probability']:5.1f} %{away}")
    return lines


def reflectance_told(found: ReflectanceFit, dropped: Mapping[str, int]) -> dict[str, Any]:
    """A fit to a laboratory table, for programs."""
    return {
        "schema": "torchlc-material/1",
        "model": found.model,
        "parameters": {name: {"value": value, "sd": found.sd[name]} for name, value in found.values.items()},
        "rms_dex": found.rms_dex,
        "median_dex": found.median_dex,
        "rows": found.rows,
        "dropped": dict(dropped),
        "converged": found.converged,
        "reason": found.reason,
    }


def reflectance_lines(found: ReflectanceFit, dropped: Mapping[str, int]) -> list[str]:
    """A fit to a laboratory table, as the lines of a scene."""
    lost = "".join(f", {count} {reason}" for reason, count in dropped.items())
    return [
        f"# {number_of(found.rows, 'row')}{lost}; rms {found.rms_dex:.3f} dex, median {found.median_dex:.3f} dex; "
        f"{found.reason}",
        "[materials.measured]",
        f'model = "{found.model}"',
        *(f"{name} = {value:.6g}   # ± {found.sd[name]:.2g}" for name, value in found.values.items()),
    ]


def _prior(told: dict[str, Any]) -> str:
    if told["unless_set"] is not None:
        return f"{told['unless_set']:g} unless the scene sets it"
    short = {
        "normal": "N", "halfnormal": "H", "uniform": "U", "loguniform": "log U", "lognormal": "log N", "cauchy": "C",
        "isotropic": "uniform on the sphere",
    }[told["prior"]]  # fmt: skip
    numbers = {
        "normal": ("mean", "sigma"),
        "halfnormal": ("sigma",),
        "lognormal": ("mean", "sigma"),
        "cauchy": ("mean", "sigma"),
    }.get(told["prior"], ())
    given = [f"{told[key] or 0:g}" for key in numbers]
    return f"{short}({', '.join(given)})" if given else short
