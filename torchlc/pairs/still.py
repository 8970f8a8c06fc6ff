"""Pairs whose angles no free number changes, while what is lit and seen of their planes may change: sizes, and shadows of
parts that move.

Light of a plane is then its area that is lit and seen times a number that the material alone changes, whose table is made once.

Letters: P planes, F facets, B batch, Q instants, T rows, C columns, S slots of the column in which most planes are lit and seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from torchlc.pairs.facet_pairs import packed, tabulated
from torchlc.pairs.planes import cover_of
from torchlc.pairs.slots import EMPTY
from torchlc.shapes.curved import Plane
from torchlc.stages.instants import Columns
from torchlc.stages.light import Patch, Surface, View


@dataclass(frozen=True)
class CoveredSurface(Surface):
    """Patches whose table has a column for every slot and column of rows, as if of 1 m2; ``cover`` (B or 1, S, C) is what
    of each is lit and seen, m2."""

    cover: Tensor = field(kw_only=True)

    def summed(self, light: Tensor, batched: bool) -> Tensor:
        """Light (..., C) of what is there, from that of 1 m2 (..., S C); a batch even of one value of theta if ``batched``."""
        total = (light.unflatten(-1, self.cover.shape[-2:]) * self.cover).sum(-2)
        return total if batched else total[0]

    def of(self, member: Tensor) -> CoveredSurface:
        """That of the geometries that ``member`` (B,) names."""
        return replace(self, cover=self.cover[member]) if len(self.cover) > 1 else self


@dataclass(frozen=True)
class StillPairs:
    """What stays of some patches: the ``surface`` with its table, the ``plane`` of each slot and column (S, C), P where there is
    none, which facets are of each plane (F, P + 1), and the ``instant`` of each column (C,)."""

    surface: Surface
    plane: Tensor
    facets: Tensor
    instant: Tensor

    def at(self, view: View, patches: Sequence[Patch]) -> CoveredSurface:
        """The surface with what of its planes is lit and seen in a view."""
        covers = [cover_of(view, patch, self.surface.sunlit) for patch in patches]
        rows = covers[0].shape[:-1]
        if any(cover.shape[:-1] != rows for cover in covers):
            rows = np.broadcast_shapes(*(cover.shape[:-1] for cover in covers))
            covers = [cover.expand(*rows, cover.shape[-1]) for cover in covers]
        return self.covered(torch.cat(covers, -1))

    def covered(self, counted: Tensor) -> CoveredSurface:
        """The surface of whose facets that much counts, m2, (F,), or (B, T or 1, F)."""
        by_plane = counted @ self.facets if counted.ndim > 1 else (counted @ self.facets)[None, None]
        if by_plane.shape[1] == 1:
            cover = by_plane[:, 0].index_select(1, self.plane.flatten()).unflatten(1, self.plane.shape)
        else:
            cover = by_plane[:, self.instant, self.plane]
        return CoveredSurface(**vars(self.surface), cover=cover)


def turns(view: View, patches: Sequence[Patch]) -> bool:
    """Whether anything but area and shadows of patches differs between the two values of a batch, or patches are no planes
    that their normals describe."""
    seen = [view.to_observer, view.range_m, view.nodes.weight]
    for light in view.lights:
        seen += [
            light.direction[0],
            light.irradiance[0],
            *([] if light.spread is None else [light.spread[0]]),
        ]
    seen += [patch.pose for patch in patches if patch.pose is not None]
    shaped = any(
        patch.by_facet
        or patch.normal.ndim > 2
        or not (patch.surface is None or isinstance(patch.surface, Plane))
        for patch in patches
    )
    return shaped or any(len(tensor) > 1 for tensor in seen)


def still_pairs(
    key: tuple[str, str, bool, str | None],
    view: View,
    patches: Sequence[Patch],
    columns: Columns | None,
    phase_angle: Tensor,
    condensed: Callable[[Surface], Surface],
) -> StillPairs | None:
    """Patches of a view of one value of the parameters; None if they are never lit and seen. ``phase_angle`` (C,)."""
    instants = view.to_observer.shape[1]
    every = torch.arange(instants, device=phase_angle.device)
    columns = Columns(every, every, every, every) if columns is None else columns
    planes: dict[tuple[int, bytes], list[int]] = {}
    facets = [(patch, number) for patch in patches for number in range(len(patch.normal))]
    for index, (patch, number) in enumerate(facets):
        axes = torch.stack([patch.normal[number], patch.u[number]]) + 0.0
        planes.setdefault((id(patch.pose), axes.cpu().numpy().tobytes()), []).append(index)
    tables = []
    for members in planes.values():
        patch, number = facets[members[0]]
        only = slice(number, number + 1)
        plane = replace(
            patch,
            normal=patch.normal[only],
            u=patch.u[only],
            area=patch.area.new_ones(1),
            visible=None,
            seen=None,
            surface=None,
        )
        tables.append(packed(view, [plane], slice(None), columns.of))
    most = max(len(table[-1]) for table in tables)
    if not most:
        return None
    whole = [
        torch.stack(
            [
                torch.cat([piece, piece.new_full((most - len(piece), piece.shape[1]), blank)])
                for piece in column
            ]
        )
        for column, blank in zip(zip(*tables, strict=True), EMPTY, strict=False)
    ]
    lit = (whole[-1] > 0).any(1)
    slots = int(lit.sum(0).max())
    there, plane = torch.sort(lit.to(torch.uint8), dim=0, descending=True, stable=True)
    plane = plane[:slots]
    column = torch.arange(lit.shape[1], device=plane.device).expand_as(plane)
    pairs = [tensor.movedim(1, -1)[plane, column].movedim(-1, 0).flatten(1) for tensor in whole]
    facet_of_plane = phase_angle.new_zeros(len(facets), len(planes) + 1)
    for number, members in enumerate(planes.values()):
        facet_of_plane[members, number] = 1.0
    component, material, sunlit, scale = key
    model = patches[0].model
    table = tabulated(model, tuple(pairs))
    surface = Surface(component, material, model, table, phase_angle.repeat(slots), sunlit, scale)
    plane = torch.where(there[:slots] > 0, plane, len(planes))
    return StillPairs(condensed(surface), plane, facet_of_plane, columns.instant)
