"""Scenes as trees and as files: elements, materials and parts, with what is known of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

Tree = dict[str, Any]


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return repr(round(float(value), 6)) if isinstance(value, float) else str(value)


def toml(tree: Tree) -> str:
    """A scene tree as TOML text; tables of the top level, arrays of tables, materials one table each."""
    lines = [f"{k} = {_value(v)}" for k, v in tree.items() if not isinstance(v, dict | list)]
    for name, table in tree.items():
        if isinstance(table, list):
            for entry in table:
                lines += ["", f"[[{name}]]", *(f"{k} = {_value(v)}" for k, v in entry.items())]
        elif name == "materials":
            for material, entry in table.items():
                lines += ["", f"[materials.{material}]", *(f"{k} = {_value(v)}" for k, v in entry.items())]
        elif isinstance(table, dict):
            inner = {k: v for k, v in table.items() if k == "parameters"}
            lines += ["", f"[{name}]", *(f"{k} = {_value(v)}" for k, v in table.items() if k not in inner)]
            for key, entry in inner.items():
                lines += ["", f"[{name}.{key}]"]
                lines += [
                    f'"{k}" = {_value(v)}' if "." in k else f"{k} = {_value(v)}" for k, v in entry.items()
                ]
    return "\n".join(lines) + "\n"


def tle(epoch: str, inclination: float, node: float, eccentricity: float, perigee: float, anomaly: float,
        revs_per_day: float, number: int) -> list[str]:  # fmt: skip
    """Two-line elements (deg, rev/day) at an ISO date, with checksums."""
    date = np.datetime64(epoch, "s")
    year = date.astype("datetime64[Y]")
    day = 1.0 + (date - year.astype("datetime64[s]")) / np.timedelta64(86400, "s")
    two = int(str(year)) % 100
    lines = [
        f"1 {number:05d}U {two:02d}001A   {two:02d}{day:012.8f}  .00000000  00000-0  00000+0 0  999",
        f"2 {number:05d} {inclination:8.4f} {node % 360:8.4f} {round(eccentricity * 1e7):07d} "
        f"{perigee % 360:8.4f} {anomaly % 360:8.4f} {revs_per_day:11.8f}    1",
    ]
    total = [sum(int(c) if c.isdigit() else c == "-" for c in line) % 10 for line in lines]
    return [f"{line}{check}" for line, check in zip(lines, total, strict=True)]


def uniform_prior(value: float) -> Tree:
    return {"value": value, "low": 0.0, "high": 1.0}


def free_material(n: float = 100.0, r: float = 0.3) -> Tree:
    """Knowing nothing: n log-uniform, both reflectances anywhere."""
    return {
        "model": "ashikhmin-shirley",
        "n": {"value": n, "low": 1.0, "high": 1e6, "prior": "loguniform"},
        "r_spec": uniform_prior(r),
        "r_diff": uniform_prior(r),
    }


def tight_material(truth: Mapping[str, float], spread: float, rng: np.random.Generator) -> Tree:
    """Knowing it to ``spread``: normal priors whose means miss the truth by their own sigma."""
    out: Tree = {"model": "ashikhmin-shirley"}
    for key, value in truth.items():
        sigma = spread * value
        mean = float(np.clip(value + sigma * rng.standard_normal(), value - 2 * sigma, value + 2 * sigma))
        high = 1e6 if key == "n" else 1.0
        out[key] = {
            "value": mean,
            "sigma": sigma,
            "prior": "normal",
            "low": 1.0 if key == "n" else 0.0,
            "high": high,
        }
    return out


def box(size: list[float]) -> Tree:
    return {"name": "body", "shape": "box", "size": size, "centre": [0.0, 0.0, 0.0], "material": "body"}


def wings(size: tuple[float, float], reach: float, tracks: bool) -> list[Tree]:
    """Two plates along +-Y with centres at ``reach``."""
    out = []
    for sign in (1.0, -1.0):
        wing: Tree = {
            "name": f"panel {'+' if sign > 0 else '-'}Y",
            "shape": "plate",
            "size": list(size),
            "centre": [0.0, sign * reach, 0.0],
            "u": [1, 0, 0],
            "v": [0, 1, 0],
            "material": "panel",
        }
        if tracks:
            wing["tracks"] = {"target": "sun", "axis": [0, 1, 0]}
        out.append(wing)
    return out
