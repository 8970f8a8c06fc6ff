"""The contract of an evaluator: light of many values of theta, by tables that it makes and keeps as it sees fit."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.lightcurve.assembled import Assembly
from torchlc.lightcurve.pipeline import Pipeline
from torchlc.lightcurve.tables import Tables
from torchlc.parameters import ParameterSet
from torchlc.stages.light import Brightness, Surface
from torchlc.tensors.autodiff_state import apart

MOST_SLOTS = 12
"""Pairs a row beyond which a lobe is tabulated over its exponent instead of summed at every call. For a cylinder of
384 facets under a Sun with a disc, the tabulation costs as much as the table of pairs that it replaces, or as 130
calls that sum them."""
TABULATED_MAG, SPREAD_TABULATED_MAG = 7e-5, 1.5e-3
"""What a lobe that is tabulated over its exponent is out by at most: 1e-7 for each unit of the logarithm of a lobe, which is
-600 where there is no light; and where a source has an extent that a narrow lobe takes over, 1.5e-3."""
VALUES_AT_ONCE = 2**17
"""Numbers that a batched call holds in one buffer, 1 MiB: a larger batch is cut, so that what one step writes
is in the cache when the next reads it, and memory does not grow with the batch."""


class Evaluator(ABC):
    """How light is worked out, settled by scene, recording and effects: the same for every theta, alone or in a batch,
    with or without gradients.

    ``way`` names it; ``error_mag`` is the largest error of its interpolations, mag, 0 where there is none; ``tabulated``
    names the materials whose lobes are interpolated over their exponent.
    """

    way: ClassVar[str]
    own_error_mag: float = 0.0
    gridded: bool = False
    """True if geometries of a batch are worked out together, on one grid of a few facets."""

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline

    @property
    def assembly(self) -> Assembly:
        return self.pipeline.assembly

    @property
    def parameters(self) -> ParameterSet:
        return self.assembly.parameters

    @abstractmethod
    def light(self, theta: Tensor, shares: bool) -> Brightness:
        """Flux (..., T), and shares (..., C, T) if asked for, at natural values theta (..., P)."""

    def brightness(self, theta: Tensor, shares: bool) -> Brightness:
        """`light`, whose flux is the same whether or not shares are asked for."""
        brightness = self.light(theta, shares)
        detailed = shares and not self.assembly.needs_shares
        if detailed and (self.materials_tabulated(True) or self.materials_tabulated(False)):
            # a component's lobes are another table than those of all of its material together
            return replace(brightness, flux=self.light(theta, False).flux)
        return brightness

    @property
    def tabulated(self) -> tuple[str, ...]:
        return self.materials_tabulated(self.assembly.needs_shares)

    @property
    def error_mag(self) -> float:
        return self.own_error_mag + self.tabulated_mag

    @property
    def tabulated_mag(self) -> float:
        """The largest error of lobes that are interpolated over their exponent, mag."""
        kept = self.kept_surfaces(self.assembly.needs_shares) if self.tabulated else []
        return max((surface.tabulated_mag for surface in kept if surface is not None), default=0.0)

    def materials_tabulated(self, detail: bool) -> tuple[str, ...]:
        """Materials whose lobes are interpolated over their exponent."""
        if not any(map(self.condensable, self.assembly.models)):
            return ()
        surfaces = (surface for surface in self.kept_surfaces(detail) if surface is not None)
        return tuple(dict.fromkeys(surface.material for surface in surfaces if "lobes" in surface.table))

    def kept_surfaces(self, detail: bool) -> list[Surface | None]:
        """Surfaces whose tables are made once for all theta."""
        return []

    def served(self, theta: Tensor) -> Tensor:
        """For which theta (..., P) there are tables (:meth:`tables_at`), (...)."""
        return torch.zeros(theta.shape[:-1], dtype=torch.bool, device=theta.device)

    def tables_at(self, theta: Tensor, detail: bool) -> Tables | None:
        """Tables that serve theta (..., P) with any other numbers of the materials; None if there are none."""
        return None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What it neglects that a person should know, a sentence each."""
        return ()

    def settle(self) -> None:
        """Makes whatever is worked out on first use and kept."""
        with apart():
            for shares in (False, True):
                self.brightness(self.parameters.start(), shares)

    def forget(self) -> None:  # noqa: B027 - most keep none
        """Drops what it keeps of recent geometries."""

    # ------------------------------------------------------------------ what most evaluators need

    def values(self, theta: Tensor) -> dict[str, Tensor]:
        return self.parameters.values(theta)

    def condensed(self, surface: Surface) -> Surface:
        """A surface of many pairs a row with its lobe sums tabulated over the exponent, where nothing
        reshapes the lobe and there is something to fit."""
        table = surface.table
        pairs = table["log_half"].shape[0] if "log_half" in table else 0
        return condensed(surface) if pairs > MOST_SLOTS and self.condensable(surface.material) else surface

    def condensable(self, material: str) -> bool:
        """Whether there is something to fit, and the material's lobe has one exponent, its own shape and a table."""
        return (
            bool(self.parameters.names)
            and self.assembly.has_number(material, self.assembly.models[material].condensed_over)
            and not any(effect.reshapes_lobe for effect in self.assembly.effects)
        )

    def batch_size(self, tables: Tables) -> int:
        """Values of theta that are worked out at once: VALUES_AT_ONCE over the numbers that one of them needs."""
        return max(1, VALUES_AT_ONCE // self.values_a_call(tables))

    def values_a_call(self, tables: Tables) -> int:
        """Numbers that light at one value of theta needs: its rows or the pairs of its largest surface."""
        sizes = [
            table.numel()
            for surface in tables.surfaces
            for name, table in surface.table.items()
            if name != "lobes"
        ]
        return max([self.assembly.T, *sizes, *(scatter.values for _, scatter in tables.scatter)])

    def chunked(self, theta: Tensor, tables: Tables, shares: bool) -> Brightness:
        """A batch beyond ``batch_size`` is cut along its leading axis."""
        flat = theta.flatten(0, -2) if theta.ndim > 1 else theta
        size = self.batch_size(tables)
        if theta.ndim == 1 or len(flat) <= size:
            return self.shone(tables, theta, shares)
        return self.joined([self.shone(tables, piece, shares) for piece in flat.split(size)], theta)

    def shone(self, tables: Tables, theta: Tensor, shares: bool) -> Brightness:
        """Light of every row of theta (..., P), whether or not it depends on it."""
        brightness = self.pipeline.shine(tables, self.values(theta), shares)
        flux = brightness.flux.expand(*theta.shape[:-1], -1)
        kept = None if brightness.shares is None else brightness.shares.expand(*theta.shape[:-1], -1, -1)
        return replace(brightness, flux=flux, shares=kept)

    def joined(self, pieces: list[Brightness], theta: Tensor) -> Brightness:
        """Pieces of a batch as one, in the shape of theta (..., P)."""
        flux = torch.cat([piece.flux for piece in pieces])
        flux = flux.reshape(*theta.shape[:-1], flux.shape[-1])
        several = [piece.shares for piece in pieces if piece.shares is not None]
        if not several:
            return Brightness(flux, None, self.assembly.components)
        shares = torch.cat(several)
        return Brightness(
            flux, shares.reshape(*theta.shape[:-1], *shares.shape[1:]), self.assembly.components
        )


def condensed(surface: Surface) -> Surface:
    """A surface with a lobe with its sums tabulated over the exponent."""
    if "log_half" not in surface.table:
        return surface
    error = SPREAD_TABULATED_MAG if "spread" in surface.table else TABULATED_MAG
    return replace(surface, table=surface.model.condense(surface.table), tabulated_mag=error)


def put(piece: Brightness, rows: Tensor, batch: int) -> Brightness:
    """Light of some rows of theta among those of all (B, ...), 0 elsewhere."""
    flux = piece.flux.new_zeros(batch, *piece.flux.shape[1:]).index_copy(0, rows, piece.flux)
    if piece.shares is None:
        return replace(piece, flux=flux)
    shares = piece.shares.new_zeros(batch, *piece.shares.shape[1:]).index_copy(0, rows, piece.shares)
    return replace(piece, flux=flux, shares=shares)


def cubic(x: Tensor) -> Tensor:
    """Weights (4, ...) of values at 0, 1, 2 and 3 in the cubic through them at x (...)."""
    return torch.stack(
        [
            -(x - 1) * (x - 2) * (x - 3) / 6,
            x * (x - 2) * (x - 3) / 2,
            -x * (x - 1) * (x - 3) / 2,
            x * (x - 1) * (x - 2) / 6,
        ]
    )
