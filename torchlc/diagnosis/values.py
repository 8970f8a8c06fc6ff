"""Values of surfaces and of effects, with their spread over the draws of the evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch

from torchlc.diagnosis.counts import Counted
from torchlc.diagnosis.hypotheses import effect_columns
from torchlc.inference.density import Fitted
from torchlc.tensors.moving import on_cpu

DRAWS = 4000


@on_cpu
def materials(fits: Sequence[tuple[Fitted, float]]) -> dict[str, dict[str, float]]:
    """Median, sd and 90 % interval of every free material parameter of the first of some fits, over the draws of the evidence of all,
    as many of each as its probability says."""
    first = fits[0][0].model.parameter_set
    names = [free.name for free in first.free if free.origin.role == "materials"]
    total = sum(p for _, p in fits)
    drawn = []
    for at, p in fits:
        count = round(DRAWS * p / total)
        columns = [at.names.index(name) for name in names if name in at.names]
        if count and len(columns) == len(names):
            drawn.append(at.draws(count)[:, columns])
    summaries = {}
    for name, column in zip(names, torch.cat(drawn).T, strict=True):
        q05, q50, q95 = torch.quantile(column, torch.tensor([0.05, 0.5, 0.95], dtype=column.dtype)).tolist()
        summaries[name] = {"median": q50, "sd": float(column.std()), "q05": q05, "q95": q95}
    return summaries


def effect_parameters(at: Fitted, entry: str, turns: Counted) -> dict[str, dict[str, Any]]:
    """Value, sd and unit of the parameters of one effect entry; the sd is over all counts of ``turns`` that fit."""
    parameters = at.model.parameter_set
    columns = effect_columns(parameters, entry)
    if not columns:
        return {}
    sd = at.draws(DRAWS)[:, columns].std(0)
    return {
        parameters.free[column].origin.short: {
            "median": float(at.theta[column]),
            "sd": math.hypot(
                float(sd[index]), turns.spread(parameters.names[column], float(at.theta[column]))
            ),
            "unit": parameters.free[column].unit,
        }
        for index, column in enumerate(columns)
    }
