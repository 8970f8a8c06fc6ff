"""A free geometry, worked out anew for every theta."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from torchlc.lightcurve.evaluators.contract import MOST_SLOTS, VALUES_AT_ONCE, Evaluator
from torchlc.lightcurve.pipeline import Pipeline
from torchlc.lightcurve.tables import (
    Key,
    Tables,
    members,
    moves,
    phase_angle_of,
    sorted_patches,
    surface_of,
)
from torchlc.pairs.discs import LEFT_OUT_MAG
from torchlc.pairs.still import StillPairs, still_pairs, turns
from torchlc.stages.light import Brightness, Patch, Surface, View
from torchlc.stages.memory import LARGEST_MEMORY, bytes_of
from torchlc.tensors.autodiff_state import apart, readable, transformed

RECENT_TABLES = 48
"""Tables of past geometries that are kept."""
MOST_GRIDDED = 64
"""Facets and instants together up to which a batch of geometries is worked out on one grid of all pairs, and
beyond which only the pairs that are lit and seen are."""
GRID_AT_ONCE = 2**20
"""Pairs of facet and instant of all geometries that are worked out at once."""


@dataclass(frozen=True)
class Sized:
    """Surfaces of planes that only change their areas, each with the part and the facets of its patches; ``tables`` of one of
    these geometries."""

    kept: Sequence[tuple[Surface | StillPairs | None, Sequence[tuple[int, Tensor]]]]
    tables: Tables

    def at(self, areas: Sequence[Tensor]) -> Tables:
        """Tables for facets of areas (F,) or (B, F) of each part."""
        surfaces: list[Surface] = []
        for surface, patches in self.kept:
            if isinstance(surface, StillPairs):
                pieces = [areas[part][..., select] for part, select in patches]
                if any(piece.ndim > 1 for piece in pieces):
                    batch = max(len(piece) for piece in pieces if piece.ndim > 1)
                    pieces = [piece.expand(batch, piece.shape[-1])[:, None] for piece in pieces]
                surfaces.append(surface.covered(torch.cat(pieces, -1)))
            elif surface is not None:
                surfaces.append(surface)
        return replace(self.tables, surfaces=tuple(surfaces))


class ExactGeometry(Evaluator):
    """Tables for every theta. A batch of small objects is one grid of all pairs of facet and instant; of larger ones rows
    of theta that share their geometry share a table; under a transform each stands alone. On a grid the Sun's disc is spread
    where a lobe is near its glint; elsewhere its middle stands for it, to ``own_error_mag``."""

    way = "anew"

    def __init__(self, pipeline: Pipeline) -> None:
        super().__init__(pipeline)
        if self.gridded and any(effect.widens for effect in self.assembly.effects):
            self.own_error_mag = LEFT_OUT_MAG
        self._recent: dict[tuple[bool, tuple[float, ...]], Tables] = {}
        self._still: dict[bool, dict[Key, Surface | StillPairs | None]] = {}
        self._sized: dict[bool, Sized | None] = {}

    def light(self, theta: Tensor, shares: bool) -> Brightness:
        flat = theta[None] if theta.ndim == 1 else theta.flatten(0, -2)
        brightness = self._sharing(flat, shares)
        if brightness is None and theta.ndim == 1:
            return self._single(theta, shares)
        if brightness is None:
            size = max(1, VALUES_AT_ONCE // max(1, self.assembly.pairs))

            def of_row(row: Tensor) -> tuple[Tensor, ...]:
                result = self._single(row, shares)
                return (result.flux,) if result.shares is None else (result.flux, result.shares)

            flux, *kept = torch.vmap(of_row, chunk_size=size)(flat)
            brightness = Brightness(flux, kept[0] if kept else None, self.assembly.components)
        return self.joined([brightness], theta)

    def _sharing(self, flat: Tensor, shares: bool) -> Brightness | None:
        """Rows of theta (B, P) together, with tables that they have in common; None where each stands alone."""
        if transformed():
            return None
        if self.gridded:
            return self._together(flat, shares)
        if torch.is_grad_enabled() or not readable(flat):
            return None
        return self._grouped(flat, shares)

    @cached_property
    def gridded(self) -> bool:
        """True if geometries of a batch are worked out together: few facets, none of which a size turns, and nothing
        that needs the geometry apart from the facets' angles."""
        a = self.assembly
        sized = {a.origins[name].owner for name, stage in a.moving.items() if stage == "size"}
        turned = [part.name for part in a.shape.parts if part.name in sized and not part.scalable]
        return a.pairs_of_discs <= MOST_GRIDDED * a.T and not turned and not a.stage("scatter")

    def _together(self, flat: Tensor, shares: bool) -> Brightness:
        """Rows of theta (B, P), the geometry of each worked out once, or as often as gradients ask for it."""
        detail = shares or self.assembly.needs_shares
        sized = self._in_proportion(detail)
        pieces = []
        for rows in flat.split(max(1, GRID_AT_ONCE // self.assembly.pairs_of_discs)):
            if sized is not None:
                tables = sized.at(self.pipeline.areas(self.values(rows)))
                pieces.append(self.shone(tables, rows, shares))
                continue
            distinct, member = rows, None
            if not torch.is_grad_enabled() and readable(rows):
                distinct, member = self._geometries(rows)
            still = self.still_surfaces(detail)
            tables = self._on_grid(distinct, detail, still)
            if member is not None and len(distinct) > 1:
                tables = members(tables, member, still.values())
            pieces.append(self.shone(tables, rows, shares))
        return self.joined(pieces, flat)

    def _on_grid(
        self, distinct: Tensor, detail: bool, still: dict[Key, Surface | StillPairs | None]
    ) -> Tables:
        """Tables of geometries (D, P). That of one alone is kept: a descent that leaves the geometry as it is asks for it again."""

        def make() -> Tables:
            view = self.pipeline.view(self.values(distinct), len(distinct), whole_discs=True)
            return self.pipeline.make_tables(view, detail, compact=False, still=still)

        if len(distinct) > 1 or torch.is_grad_enabled() or not readable(distinct):
            return make()
        return self._remembered(detail, distinct[0], make)

    def _remembered(self, detail: bool, theta: Tensor, make: Callable[[], Tables]) -> Tables:
        """Tables of the geometry of theta (P,) as they were made before, or now; the last RECENT_TABLES are kept, or as many as take
        LARGEST_MEMORY: one of a rocket body may take 200 MB."""
        key = (detail, tuple(theta[self.assembly.geometry_columns].tolist()))
        if key not in self._recent:
            self._recent[key] = make()
            most = max(1, min(RECENT_TABLES, LARGEST_MEMORY // max(1, bytes_of(self._recent[key]))))
            while len(self._recent) > most:
                self._recent.pop(next(iter(self._recent)))
        return self._recent[key]

    def _geometries(self, rows: Tensor) -> tuple[Tensor, Tensor | None]:
        """Rows of theta (D, P) with different geometries, and which of them each of ``rows`` (B, P) shares, (B,);
        None if D is B."""
        moving = rows[:, self.assembly.geometry_columns]
        if len(torch.unique(moving[:, 0])) == len(rows):  # a sort of rows takes several times as long
            return rows, None
        distinct, member = torch.unique(moving, dim=0, return_inverse=True)
        if len(distinct) == len(rows):
            return rows, None
        index = torch.arange(len(rows), device=rows.device)
        return rows[member.new_empty(len(distinct)).index_copy(0, member, index)], member

    def _grouped(self, flat: Tensor, shares: bool) -> Brightness | None:
        """Rows of theta (B, P) that share their geometric parameters share one compact table; None where
        almost none do and a few fit into one vectorised call. Recent tables are kept: an optimiser comes back
        to the point it stepped from."""
        distinct, member = self._geometries(flat)
        many = self.assembly.pairs > VALUES_AT_ONCE
        if len(distinct) > 0.6 * len(flat) and not self.assembly.parts_meet and not many:
            return None
        if member is None:
            member = torch.arange(len(flat), device=flat.device)
        detail = shares or self.assembly.needs_shares
        flux = flat.new_empty(len(flat), self.assembly.T)
        kept = flat.new_empty(len(flat), len(self.assembly.components), self.assembly.T) if shares else None
        for index, geometry in enumerate(distinct):
            rows = torch.nonzero(member == index)[:, 0]

            def make(geometry: Tensor = geometry) -> Tables:
                return self.pipeline.make_tables(
                    self.pipeline.view(self.values(geometry)), detail, compact=True
                )

            piece = self.chunked(flat[rows], self._remembered(detail, geometry, make), shares)
            flux[rows] = piece.flux
            if kept is not None and piece.shares is not None:
                kept[rows] = piece.shares
        return Brightness(flux, kept, self.assembly.components)

    def _single(self, theta: Tensor, shares: bool) -> Brightness:
        values = self.values(theta)
        detail = shares or self.assembly.needs_shares
        sized = self._in_proportion(detail)
        if sized is not None:
            return self.pipeline.shine(sized.at(self.pipeline.areas(values)), values, shares)
        still = self.still_surfaces(detail) if self.gridded else None
        view = self.pipeline.view(values, whole_discs=self.gridded)
        tables = self.pipeline.make_tables(view, detail, compact=False, still=still)
        return self.pipeline.shine(tables, values, shares)

    def still_surfaces(self, detail: bool) -> dict[Key, Surface | StillPairs | None]:
        """Surfaces of a free geometry that no free parameter moves, made on first use: those that two values
        of theta have in common, or have in common but for what is lit and seen of them."""
        if detail not in self._still:
            with apart():
                theta = self.parameters.start()
                alone = self.pipeline.view(self.values(theta))
                both = self.pipeline.view(self.values(theta.expand(2, -1)), 2)
                turning = {
                    key: turns(lit_view, patches) for key, lit_view, patches in sorted_patches(both, detail)
                }
                moving = {
                    key for key, lit_view, patches in sorted_patches(both, detail) if moves(lit_view, patches)
                }
                self._still[detail] = {}
                for key, part_view, patches in sorted_patches(alone, detail):
                    if key not in moving:
                        made = surface_of(key, part_view, patches, True, self.assembly.apart)
                        self._still[detail][key] = made and self.condensed(made)
                    elif (
                        not turning[key]
                        and len(part_view.nodes.offset) == 1
                        and self._few_pairs(part_view, patches[0])
                    ):
                        phase = phase_angle_of(part_view, self.assembly.apart)
                        self._still[detail][key] = still_pairs(
                            key, part_view, patches, self.assembly.apart, phase, self.condensed
                        )
        return self._still[detail]

    def _in_proportion(self, detail: bool) -> Sized | None:
        """What is kept of a geometry of which free numbers change the areas of planes and no more; None of another. No effect then
        asks where facets are: none of its stages follows them but those of light, whose lights two geometries had in common."""
        if detail not in self._sized:
            a = self.assembly
            made = None
            if (
                self.gridded
                and set(a.moving.values()) == {"size"}
                and not (a.stage("surface") or a.learns_geometry)
            ):
                with apart():
                    view = self.pipeline.view(self.values(self.parameters.start()))
                    still = self.still_surfaces(detail)
                    patches = sorted_patches(view, detail)
                    if all(key in still for key, _, _ in patches):
                        kept = [
                            (still[key], [_facets_of(patch) for patch in alike]) for key, _, alike in patches
                        ]
                        made = Sized(
                            kept, self.pipeline.make_tables(view, detail, compact=False, still=still)
                        )
            self._sized[detail] = made
        return self._sized[detail]

    @property
    def areas_alone(self) -> bool:
        """True if free numbers change no more than how much area of each plane is lit and seen, and no part stands in the way
        of another at the start: a call then costs hardly more than one of an expansion."""
        if not self.gridded:
            return False
        detail = self.assembly.needs_shares
        still = self.still_surfaces(detail)
        with apart():
            view = self.pipeline.view(self.values(self.parameters.start()))
        shadowed = any(
            share is not None and share.shape[1] > 1
            for patch in view.patches
            for share in (patch.visible, patch.seen)
        )
        return not shadowed and all(key in still for key, _, _ in sorted_patches(view, detail))

    def _few_pairs(self, view: View, patch: Patch) -> bool:
        """Whether a plane in all lights makes few numbers: its lobe is tabulated over its exponent, or there is one light."""
        lights = sum(len(light.direction) for light in view.lights)
        return (
            lights == 1 or patch.model.additive or (lights > MOST_SLOTS and self.condensable(patch.material))
        )

    def kept_surfaces(self, detail: bool) -> list[Surface | None]:
        kept = self.still_surfaces(detail).values() if self.gridded else []
        return [surface.surface if isinstance(surface, StillPairs) else surface for surface in kept]

    def forget(self) -> None:
        """Drops the tables of recent geometries, which an optimiser at work comes back to."""
        self._recent.clear()


def _facets_of(patch: Patch) -> tuple[int, Tensor]:
    """The part that a patch is of, and which of its facets. Patches of no part are made at the stage of surfaces."""
    assert patch.part is not None and patch.select is not None
    return patch.part, patch.select
