"""A share of the rows is bad."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect


class Outliers(Effect):
    """A fraction p of the rows errs ``width`` times as much: (1 - p) N(0, s) + p N(0, width s) for every row.

    Neglects that bad rows come in runs and mostly err to one side.
    """

    name = "outliers"
    stage = "noise"
    quantities = (
        Quantity(
            "fraction", "", 0.0, 0.5, "share of the rows that are bad",
            off=0.0, typical=0.03, prior="halfnormal", sigma=0.05,
        ),
        Quantity("width", "", 2.0, 100.0, "their error over the quoted one", typical=8.0, prior="loguniform"),
    )  # fmt: skip

    def noise(self, noise, p, context):
        above_zero = torch.finfo(p["fraction"].dtype).tiny  # where the slope of the mixture's log is finite
        return replace(noise, outliers=p["fraction"] + above_zero, width=p["width"])
