"""Light between a few values of the one parameter that moves the geometry."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchlc.lightcurve.assembled import Assembly
from torchlc.lightcurve.evaluators.contract import Evaluator, cubic, put
from torchlc.lightcurve.pipeline import Pipeline
from torchlc.lightcurve.tables import Tables
from torchlc.stages.effect import Effect
from torchlc.stages.light import Brightness, Surface
from torchlc.tensors.autodiff_state import apart, readable


class SteppedTables(Evaluator):
    """Tables at the steps of one effect's parameter and cubics of the light between them; 1e-3 mag at most."""

    way = "stepped"
    own_error_mag = 1e-3

    def __init__(self, pipeline: Pipeline, effect: Effect) -> None:
        super().__init__(pipeline)
        self.effect = effect
        self.kept: dict[tuple[bool, int], Tables] = {}

    @classmethod
    def effect_of(cls, assembly: Assembly) -> Effect | None:
        """The effect whose parameter alone moves the geometry, if light can be interpolated over it."""
        able = (
            effect
            for effect in assembly.effects
            if effect.steps
            and effect.quantities
            and list(assembly.moving) == [effect.full_name(effect.quantities[0].name)]
        )
        return next(able, None)

    def kept_surfaces(self, detail: bool) -> list[Surface | None]:
        return list(self.node(self.effect.steps, detail).surfaces)

    def light(self, theta: Tensor, shares: bool) -> Brightness:
        flat = theta[None] if theta.ndim == 1 else theta.flatten(0, -2)
        return self.joined([self._stepped(flat, shares)], theta)

    def _stepped(self, flat: Tensor, shares: bool) -> Brightness:
        """Rows of theta (B, P) by cubics through the light at four of ``effect.steps`` + 1 values of its
        parameter, each of which has its tables once for all. Where a transform hides which four, all are worked
        out."""
        effect = self.effect
        steps, column = effect.steps, self.assembly.geometry_columns[0]
        detail = shares or self.assembly.needs_shares
        position = flat[:, column] / effect.quantities[0].high * steps
        first = (position.detach().floor().long() - 1).clamp(0, steps - 3)
        weights = cubic(position - first)
        flux, light = torch.zeros_like(position[:, None]), torch.zeros_like(position[:, None, None])
        known = readable(first)
        wanted = torch.unique(first[:, None] + torch.arange(4)).tolist() if known else range(steps + 1)
        for step in wanted:
            node = step - first
            inside = (node >= 0) & (node < 4)
            weight = torch.where(inside, weights.gather(0, node.clamp(0, 3)[None])[0], 0.0)[:, None]
            if known:
                rows = torch.nonzero(inside)[:, 0]
                piece = self.chunked(flat[rows], self.node(step, detail), shares)
                piece = put(piece, rows, len(flat))
            else:
                piece = self.shone(self.node(step, detail), flat, shares)
            part = weight * piece.flux
            flux = flux + part
            if shares and piece.shares is not None:
                light = light + part[:, None] * piece.shares
        kept = light / torch.where(flux > 0, flux, 1.0)[:, None] if shares else None
        return Brightness(flux, kept, self.assembly.components)

    def settle(self) -> None:
        super().settle()
        for detail in {self.assembly.needs_shares, True}:
            for step in range(self.effect.steps + 1):
                self.node(step, detail)

    def node(self, step: int, detail: bool) -> Tables:
        """Tables at one of the values of the effect's parameter."""
        if (detail, step) not in self.kept:
            with apart():
                values = self.values(self.parameters.start())
                quantity = self.effect.quantities[0]
                name = self.effect.full_name(quantity.name)
                values[name] = torch.full_like(values[name], quantity.high * step / self.effect.steps)
                made = self.pipeline.make_tables(self.pipeline.view(values), detail, compact=True)
                self.kept[detail, step] = replace(made, surfaces=tuple(map(self.condensed, made.surfaces)))
        return self.kept[detail, step]
