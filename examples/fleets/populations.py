"""Starlink v2 mini by unseen satellites, and where a column divides their population into two."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm
from unseen import fitted, held_out, left, robust
from v2mini import LOW_KM, told_dark, v2mini

LEAST_OBJECTS = 15
"""On either side of a split of the population."""


def log_population(mean: np.ndarray, variance: np.ndarray) -> float:
    """ln of the evidence of objects' means (N,) of variance (N,): normal about a centre, N(0, 1) mag, with a spread, half-normal
    of 0.5 mag. By the trapezoidal rule over the spread, and in closed form over the centre."""
    spread = np.linspace(1e-3, 3.0, 1500)
    total = variance[:, None] + spread**2
    weight = (1 / total).sum(0)
    first = (mean[:, None] / total).sum(0)
    square = (mean[:, None] ** 2 / total).sum(0) - first**2 / (weight + 1)
    log_density = -0.5 * (square + np.log(2 * np.pi * total).sum(0) + np.log1p(weight))
    log_density += np.log(2) + norm.logpdf(spread, scale=0.5)
    top = log_density.max()
    return float(top + np.log(np.trapezoid(np.exp(log_density - top), spread)))


def split(
    delta: np.ndarray, number: np.ndarray, recorded: dict[str, np.ndarray], jitter: float
) -> list[dict[str, Any]]:
    """Where each recorded column divides the population best into two, each with a centre and a spread of its own, and by how much
    ln of the evidence is larger than that of one population, over all places of the cut alike. Best column first."""
    ids = np.unique(number)
    mean = np.array([delta[number == one].mean() for one in ids])
    variance = jitter**2 / np.array([(number == one).sum() for one in ids])
    one = log_population(mean, variance)
    found = []
    for name, column in recorded.items():
        value = np.array([np.median(column[number == k]) for k in ids])
        cuts = np.unique(np.quantile(value, np.linspace(0.05, 0.95, 46)))
        cuts = [cut for cut in cuts if LEAST_OBJECTS <= (value < cut).sum() <= len(ids) - LEAST_OBJECTS]
        if not cuts:
            continue
        gains = np.array(
            [
                log_population(mean[value < cut], variance[value < cut])
                + log_population(mean[value >= cut], variance[value >= cut])
                - one
                for cut in cuts
            ]
        )
        best, low = cuts[int(gains.argmax())], value < cuts[int(gains.argmax())]
        found.append(
            {
                "column": name,
                "log_evidence": float(gains.max() + np.log(np.exp(gains - gains.max()).mean())),
                "cut": float(best),
                "between": [float(value[low].max()), float(value[~low].min())],
                "below": {
                    "objects": int(low.sum()),
                    "median": float(np.median(mean[low])),
                    "sigma": robust(mean[low]),
                },
                "above": {
                    "objects": int((~low).sum()),
                    "median": float(np.median(mean[~low])),
                    "sigma": robust(mean[~low]),
                },
            }
        )
    found.sort(key=lambda row: -row["log_evidence"])
    total = np.logaddexp.reduce([0.0, *(row["log_evidence"] - np.log(len(found)) for row in found)])
    for row in found:
        row["probability"] = float(np.exp(row["log_evidence"] - np.log(len(found)) - total))
    return found


def fleet() -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        dark = told_dark(*v2mini(Path(folder), 0.0)[:3])
        scene, recording, lit, recorded = v2mini(Path(folder))
    lighted = recording.keep(lit, "flagged as not illuminated")
    recorded = {name: column[lit] for name, column in recorded.items() if name != "range"}
    assert lighted.object is not None
    model, theta = fitted(scene, lighted)
    values = dict(zip(model.names, theta.tolist(), strict=True))
    delta = left(scene, lighted, model.names, theta)
    found: dict[str, Any] = {
        "rows": len(lighted),
        "objects": len(lighted.object_ids),
        "together": values,
        "splits": split(delta, lighted.object, recorded, values["jitter.mag"]),
        "dark": dark,
    }
    print(json.dumps(found, indent=1), flush=True)
    height = recorded["height"]
    for name, rows in (("high", height >= LOW_KM), ("low", height < LOW_KM)):
        some = lighted.keep(rows, "of the other class")
        assert some.object is not None
        model, theta = fitted(scene, some)
        unseen = held_out(scene, some, some.object)
        each = np.array([np.median(unseen[some.object == k]) for k in range(len(some.object_ids))])
        found[name] = {
            "rows": len(some),
            "objects": len(some.object_ids),
            "unseen": robust(unseen),
            "unseen_objects": robust(each),
            "unseen_median": float(np.median(unseen)),
            "parameters": dict(zip(model.names, theta.tolist(), strict=True)),
        }
        print(name, found[name], flush=True)
    return found
