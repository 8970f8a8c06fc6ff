"""Scenes as users bring them: sizes, rotation and zero point near the true ones, some bad rows, errors that are off."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))

import sky
from circumstances import Setup
from gain import Baseline

SIZE_SHARE = 0.1
ZERO_POINT_MAG = 0.05
SPIN_RATE_REV_PER_HOUR, SPIN_PHASE_DEG = 0.002, 1.5
BAD_SHARE = 0.035
ERROR_SPREAD = 0.25
"""Standard deviation of ln of the quoted errors over the true ones, in every other case."""


def near(value: float, sigma: float, rng: np.random.Generator) -> dict[str, object]:
    """A free number whose prior holds the true value, at most two standard deviations off."""
    return {
        "value": round(value + sigma * float(np.clip(rng.standard_normal(), -2, 2)), 4),
        "sigma": round(sigma, 5),
        "prior": "normal",
    }


def as_brought(setup: Setup, rng: np.random.Generator) -> Setup:
    """The setup with a scene that is only nominal; what is true of it is in ``true_tree``."""
    true, tree = deepcopy(setup.true_tree or setup.tree), deepcopy(setup.tree)
    brought: dict[tuple[float, ...], list[dict[str, object]]] = {}
    for part, true_part in zip(tree["components"], true["components"], strict=True):
        for key in ("size", "radius", "length"):
            if key in part:
                sides = np.atleast_1d(true_part[key])
                sizes = brought.setdefault(
                    tuple(sides), [near(side, SIZE_SHARE * side, rng) for side in sides.tolist()]
                )
                part[key] = sizes if isinstance(true_part[key], list) else sizes[0]
    if "spin_rate" in true["attitude"]:
        rate, phase = (true["attitude"][key] for key in ("spin_rate", "spin_phase"))
        tree["attitude"]["spin_rate"] = near(rate, SPIN_RATE_REV_PER_HOUR, rng)
        tree["attitude"]["spin_phase"] = near(phase, SPIN_PHASE_DEG, rng)
    tree["model"]["parameters"]["zero_point"] = {"value": 0.0, "sigma": ZERO_POINT_MAG, "prior": "normal"}
    true["model"]["parameters"]["zero_point"] = round(ZERO_POINT_MAG * float(rng.standard_normal()), 4)
    return replace(setup, kind=f"{setup.kind}, nominal", tree=tree, true_tree=true)


def mishaps(rows: int, rng: np.random.Generator) -> sky.Array:
    """What bad rows add to the magnitudes (T,): cosmic rays brighten one, clouds dim one to four."""
    added = np.zeros(rows)
    while (added != 0).sum() < BAD_SHARE * rows:
        first = int(rng.integers(0, rows))
        if rng.random() < 0.4:
            added[first] = -rng.uniform(0.2, 1.1)
        else:
            added[first : first + int(rng.integers(1, 5))] = rng.uniform(0.15, 1.1)
    return added


def error_factor(rng: np.random.Generator) -> float:
    """Quoted errors over true ones."""
    return float(np.exp(ERROR_SPREAD * rng.standard_normal())) if rng.random() < 0.5 else 1.0


def loose_numbers(tree: dict[str, Any]) -> Iterator[tuple[list[Any], dict[str, Any]]]:
    """Where each free number of components, attitude and calibration stands in a scene's tree, and its prior."""
    for owner in (
        *(("components", i) for i in range(len(tree["components"]))),
        ("attitude",),
        ("model", "parameters"),
    ):
        table = tree
        for key in owner:
            table = table[key]
        for key, value in table.items():
            for index, one in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(one, dict) and "sigma" in one:
                    yield [*owner, key, *([] if index is None else [index])], one


def loose_tangents(setup: Setup, baseline: Baseline, theta: sky.Array) -> sky.Array:
    """Whitened derivatives (T + P, P) by the materials and, at the true geometry, by all that the scene leaves free."""
    materials = baseline.tangents(theta)
    still = baseline.curve(theta, {})
    columns, precisions = [], []
    for path, prior in loose_numbers(setup.tree):
        tree = deepcopy(baseline.setup.tree)
        table = tree
        for key in path[:-1]:
            table = table[key]
        step = 0.1 * prior["sigma"]
        table[path[-1]] = float(table[path[-1]]) + step
        moved = Baseline(replace(baseline.setup, tree=tree), baseline.sigma).curve(theta, {})
        columns.append((moved - still) / step / baseline.sigma)
        precisions.append(1.0 / prior["sigma"])
    rows, known = len(baseline.sigma), materials.shape[1]
    whole = np.zeros((rows + known + len(columns), known + len(columns)))
    whole[: rows + known, :known] = materials
    whole[:rows, known:] = np.array(columns).T
    whole[rows + known :, known:] = np.diag(precisions)
    return whole
