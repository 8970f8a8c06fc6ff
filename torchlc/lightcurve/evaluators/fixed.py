"""Tables of a geometry that no free parameter moves, made once."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchlc.lightcurve.evaluators.contract import Evaluator
from torchlc.lightcurve.pipeline import Pipeline
from torchlc.lightcurve.tables import Tables
from torchlc.stages.light import Brightness, Surface
from torchlc.tensors.autodiff_state import apart


class FixedTables(Evaluator):
    """Every call adds up the same tables. Exact, but for lobes of very many pairs that are tabulated over their exponent."""

    way = "kept"

    def __init__(self, pipeline: Pipeline, kept: dict[bool, Tables] | None = None) -> None:
        super().__init__(pipeline)
        self.kept: dict[bool, Tables] = {} if kept is None else kept

    def tables(self, detail: bool = False) -> Tables:
        """The tables, made on first use; with ``detail`` components of one material stay apart."""
        if detail not in self.kept:
            with apart():
                view = self.pipeline.view(self.values(self.parameters.start()))
                made = self.pipeline.make_tables(view, detail, compact=True)
                self.kept[detail] = replace(made, surfaces=tuple(map(self.condensed, made.surfaces)))
        return self.kept[detail]

    def served(self, theta: Tensor) -> Tensor:
        return torch.ones(theta.shape[:-1], dtype=torch.bool, device=theta.device)

    def tables_at(self, theta: Tensor, detail: bool) -> Tables:
        return self.tables(detail)

    def kept_surfaces(self, detail: bool) -> list[Surface | None]:
        return list(self.tables(detail).surfaces)

    def light(self, theta: Tensor, shares: bool) -> Brightness:
        return self.chunked(theta, self.tables(shares or self.assembly.needs_shares), shares)
