"""Known materials: presets for a scene, and how well each explains fitted values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchlc.brdf import MODELS
from torchlc.errors import InputError
from torchlc.files.toml import parse_toml

LIBRARY = Path(__file__).parent / "materials.toml"
OTHER = "other"
"""The class of materials that no one has listed."""


@dataclass(frozen=True)
class LibraryMaterial:
    """A known surface: a model's natural values, and one standard deviation between samples of it.

    ``spread`` is in the coordinates of ``coordinate``: of ln n for exponents and widths.
    """

    name: str
    model: str
    values: dict[str, float]
    spread: dict[str, float]
    meaning: str
    source: str


@dataclass(frozen=True)
class Match:
    """How a material explains a posterior; ``distance`` in combined standard deviations, None for "other"."""

    name: str
    probability: float
    distance: float | None


def load_library(path: str | Path = LIBRARY) -> dict[str, LibraryMaterial]:
    """The materials of a TOML file by name, each checked against its model's bounds."""
    path = Path(path)
    try:
        content = parse_toml(path.read_text(encoding="utf-8"), path)
    except OSError as error:
        raise InputError(path, None, f"cannot be read: {error.strerror}") from error
    library: dict[str, LibraryMaterial] = {}
    for number, entry in enumerate(content.get("materials", []), start=1):
        material = _checked(path, f"materials {number}", entry)
        if material.name in library:
            raise InputError(path, material.name, "listed twice")
        library[material.name] = material
    return library


def preset(name: str) -> tuple[str, dict[str, float]]:
    """Model and values of a known material; upper and lower case, ``_``, ``-`` and spaces are the same."""
    known = {_folded(material): material for material in _library()}
    if _folded(name) not in known:
        close = get_close_matches(_folded(name), known, n=1)
        hint = f"Did you mean {known[close[0]]}?" if close else None
        raise InputError(None, "preset", repr(name), f"one of {', '.join(known.values())}", hint)
    material = _library()[known[_folded(name)]]
    return material.model, dict(material.values)


def match(
    samples: Mapping[str, np.ndarray],
    library: Mapping[str, LibraryMaterial] | None = None,
    *,
    model: str = "ashikhmin-shirley",
) -> list[Match]:
    """Probability of each known material of ``model`` and of "other", most probable first.

    ``samples`` holds N draws of each fitted parameter by its short name ("n" or "n_u" and "n_v", "r_spec",
    ...). A material is a Gaussian of its spread about its values, cut at the bounds; "other" is the default
    prior: uniform, in ln n from 1 and over r_spec + r_diff <= 1. The classes are equally probable beforehand,
    and a class's evidence is its density averaged over the draws, exact for draws from a fit under that
    default prior. ``distance`` is Mahalanobis' from the draws' mean to the material, with both covariances.
    Parameters that are not among the samples are not judged.
    """
    names, draws = _coordinates(model, samples)
    known = _library() if library is None else library
    candidates = [material for material in known.values() if material.model == model]
    mean, covariance = draws.mean(0), np.cov(draws, rowvar=False).reshape(len(names), len(names))
    log_evidence, distances = [], []
    for material in candidates:
        centre = np.array([coordinate(model, name, material.values[name]) for name in names])
        width = np.array([material.spread[name] for name in names])
        norm = np.log(width * math.sqrt(2 * math.pi)).sum()
        norm += math.log(_share_in_bounds(model, names, centre, width))
        log_evidence.append(_log_mean(-0.5 * (((draws - centre) / width) ** 2).sum(1) - norm))
        away = mean - centre
        distances.append(float(np.sqrt(away @ np.linalg.solve(covariance + np.diag(width**2), away))))
    log_evidence.append(_log_mean(_log_prior(model, names, draws)))
    probability = np.exp(np.array(log_evidence) - np.logaddexp.reduce(log_evidence))
    matches = [
        Match(name, float(share), distance)
        for name, share, distance in zip(
            [*(material.name for material in candidates), OTHER], probability, [*distances, None], strict=True
        )
    ]
    return sorted(matches, key=lambda entry: -entry.probability)


def coordinate(model: str, name: str, value: np.ndarray | float) -> np.ndarray:
    """A parameter on the scale its spread is given on: ln for exponents and widths, from 1e-3 upwards."""
    if MODELS[model].quantity(name).prior == "loguniform":
        return np.log(np.maximum(value, 1e-3))
    return np.asarray(value, dtype=float)


def _coordinates(model: str, samples: Mapping[str, np.ndarray]) -> tuple[list[str], np.ndarray]:
    """Names and draws (N, P); the exponents of an anisotropic lobe count as their geometric mean."""
    given = {name: coordinate(model, name, np.asarray(draws, dtype=float)) for name, draws in samples.items()}
    for short, long in MODELS[model].shared.items():
        if all(name in given for name in long):
            given[short] = np.mean([given.pop(name) for name in long], axis=0)
    return list(given), np.stack(list(given.values()), axis=1)


def _log_prior(model: str, names: list[str], draws: np.ndarray) -> np.ndarray:
    """Log density of the default prior (N,), marginal over what is not among ``names``."""
    kind, total = MODELS[model], np.zeros(len(draws))
    for name in names:
        quantity = kind.quantity(name)
        if name in kind.simplex:
            continue
        low = quantity.low
        if quantity.prior == "loguniform":
            low = low or 1.0
            total -= math.log(math.log(quantity.high / low))
        else:
            total -= math.log(quantity.high - low)
    judged = [name for name in names if name in kind.simplex]
    free = len(kind.simplex) - len(judged)
    rest = 1 - draws[:, [names.index(name) for name in judged]].sum(1)
    volume = math.lgamma(free + 1) - math.lgamma(len(kind.simplex) + 1)
    return total - volume + free * np.log(np.maximum(rest, 1e-12))


def _share_in_bounds(model: str, names: list[str], centre: np.ndarray, width: np.ndarray) -> float:
    """Share of a material's Gaussian that lies within the bounds and the simplex, from 20000 fixed draws."""
    kind = MODELS[model]
    draws = centre + width * np.random.default_rng(0).standard_normal((20_000, len(names)))
    inside = np.ones(len(draws), dtype=bool)
    for column, name in zip(draws.T, names, strict=True):
        bounds = kind.quantity(name).low, kind.quantity(name).high
        low, high = (coordinate(model, name, bound) for bound in bounds)
        inside &= (column >= low) & (column <= high)
    judged = [names.index(name) for name in names if name in kind.simplex]
    return max(float((inside & (draws[:, judged].sum(1) <= 1)).mean()), 1e-4)


def _log_mean(log_density: np.ndarray) -> float:
    return float(np.logaddexp.reduce(log_density) - math.log(len(log_density)))


def _checked(path: Path, place: str, entry: Mapping[str, Any]) -> LibraryMaterial:
    for key in ("name", "model", "values", "spread", "meaning", "source"):
        if key not in entry:
            raise InputError(path, place, f"no {key}")
    name, model = entry["name"], entry["model"]
    if model not in MODELS:
        raise InputError(path, f"{name}.model", repr(model), f"one of {', '.join(MODELS)}")
    try:
        MODELS[model].check(
            {key: torch.tensor(float(value), dtype=torch.float64) for key, value in entry["values"].items()}
        )
    except InputError as error:
        raise InputError(path, f"{name}: {error}", "not a surface") from error
    if set(entry["spread"]) != set(entry["values"]) or min(entry["spread"].values()) <= 0:
        raise InputError(path, f"{name}.spread", str(entry["spread"]), "a positive spread for each value")
    return LibraryMaterial(**{key: entry[key] for key in LibraryMaterial.__dataclass_fields__})


@cache
def _library() -> dict[str, LibraryMaterial]:
    return load_library()


def _folded(name: str) -> str:
    return name.casefold().replace("_", "-").replace(" ", "-")
