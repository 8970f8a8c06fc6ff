"""Tables of a geometry: what the material stage needs of every pair of facet and instant that is lit and seen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import torch
from torch import Tensor

from torchlc.geometry.orbit import State
from torchlc.pairs.discs import DiscSurface
from torchlc.pairs.facet_pairs import disc_pairs, pair_table
from torchlc.pairs.still import CoveredSurface
from torchlc.stages.effect import Effect, Scatter
from torchlc.stages.instants import Columns, Instants, Nodes
from torchlc.stages.light import Light, Patch, Sky, Surface, View

Record = TypeVar("Record", State, Nodes)
Key = tuple[str, str, bool, str | None]
"""Component, material, whether its light is the Sun's, and what scales it: what a surface is of."""


@dataclass(frozen=True)
class Tables:
    """What the material stage needs: a surface per component and material, and effects that scatter further
    light. ``columns`` says which rows and instants the tables hold side by side; None: the rows."""

    surfaces: tuple[Surface, ...]
    scatter: tuple[tuple[Effect, Scatter], ...]
    sky: Sky
    columns: Columns | None = None


def sorted_patches(view: View, detail: bool) -> list[tuple[Key, View, list[Patch]]]:
    """Patches of one material under lights of one kind, with a view of these alone; by component if in
    ``detail``."""
    groups: dict[tuple[str, str], list[Patch]] = {}
    for patch in view.patches:
        groups.setdefault((patch.component if detail else "", patch.material), []).append(patch)
    kinds: dict[tuple[bool, str | None], list[Light]] = {}
    for light in view.lights:
        kinds.setdefault((light.primary, light.scale), []).append(light)
    return [
        ((*group, *kind), replace(view, lights=tuple(lights)), patches)
        for group, patches in groups.items()
        for kind, lights in kinds.items()
    ]


def moves(view: View, patches: Sequence[Patch]) -> bool:
    """Whether patches, or the light on them, differ between the two values of a batch."""
    seen = [view.to_observer, view.range_m, *(light.direction[0] for light in view.lights)]
    of_patches = [
        tensor
        for patch in patches
        for tensor in (patch.pose, patch.visible, patch.seen)
        if tensor is not None
    ]
    of_patches += [
        tensor
        for patch in patches
        for record in (patch.near, patch.response)
        if record
        for tensor in vars(record).values()
        if tensor.shape[-1] != 3
    ]
    return any(len(tensor) > 1 for tensor in (*seen, *of_patches)) or any(
        patch.area.ndim > 1 for patch in patches
    )


def summed(light: Tensor, row: Tensor | None, rows: int) -> Tensor:
    """Light of columns (..., C) that belong to rows ``row`` (C,), by row (..., T)."""
    if row is None:
        return light
    light = light.expand(*light.shape[:-1], len(row))
    return light.new_zeros(*light.shape[:-1], rows).index_add(-1, row, light)


def surface_of(
    key: Key, view: View, patches: Sequence[Patch], compact: bool, columns: Columns | None
) -> Surface | None:
    """Patches of one material with their table; None if they are never lit and seen."""
    table = pair_table(view, patches, compact, columns)
    if table is None:
        return None
    component, material, sunlit, scale = key
    return Surface(component, material, patches[0].model, table, phase_angle_of(view, columns), sunlit, scale)


def surfaces_on_grid(
    key: Key, view: View, patches: Sequence[Patch], columns: Columns | None
) -> list[Surface]:
    """All pairs of patches of one material, those in the light of discs apart from the others."""
    others, pairs = surface_of(key, view, patches, False, columns), disc_pairs(view, patches)
    surfaces: list[Surface] = [] if others is None else [others]
    if pairs is not None:
        surfaces.append(DiscSurface.of(pairs, phase_angle_of(view, columns), key))
    return surfaces


def phase_angle_of(view: View, columns: Columns | None) -> Tensor:
    """Phase angle (T,) at mid-exposure, rad, or (B, T) where it differs within a batch; (..., C) of ``columns``."""
    phase = view.apart(torch.linalg.vector_norm(view.to_sun + view.to_observer, dim=-1) / 2)
    middle = phase[phase.shape[0] // 2]
    middle = middle[0] if len(middle) == 1 else middle
    return 2 * torch.acos((middle if columns is None else middle[..., columns.instant]).clamp(max=1 - 1e-15))


def sky_of(view: View, columns: Columns | None, instants: Instants | None, *, fixed: bool) -> Sky:
    """What the shade stage sees of a view, at the instants that stand for ``columns``."""
    if columns is not None and instants is not None and len(columns.row) < len(columns.of):
        view, instants = view.at(columns.instant), instants.at(columns.instant)
    return Sky(by_value(view, view.state), by_value(view, view.nodes), fixed, instants)


def by_value(view: View, record: Record) -> Record:
    """Places or instants (Q, ...) of a batch with an axis B before the others."""
    if view.batch == 1:
        return record
    apart = {
        field.name: view.apart(value).transpose(0, 1)
        for field in fields(record)
        if (value := getattr(record, field.name)) is not None
    }
    return replace(record, **apart)


def members(tables: Tables, member: Tensor, still: Iterable[object]) -> Tables:
    """Tables of some geometries for rows of theta (B,), each of which has the one that ``member`` (B,) says."""
    kept = {id(surface) for surface in still}
    surfaces = [
        surface if id(surface) in kept else _of_members(surface, member) for surface in tables.surfaces
    ]
    state, nodes = (
        replace(
            record,
            **{
                field.name: value[member]
                for field in fields(record)
                if (value := getattr(record, field.name)) is not None and len(value) > 1
            },
        )
        for record in (tables.sky.state, tables.sky.nodes)
    )
    return replace(tables, surfaces=tuple(surfaces), sky=replace(tables.sky, state=state, nodes=nodes))


def _of_members(surface: Surface, member: Tensor) -> Surface:
    if isinstance(surface, CoveredSurface):
        return surface.of(member)
    table = {name: value[member] if len(value) > 1 else value for name, value in surface.table.items()}
    phase = surface.phase_angle
    chosen = replace(surface, table=table, phase_angle=phase[member] if phase.ndim > 1 else phase)
    return replace(chosen, discs=chosen.discs.picked(member)) if isinstance(chosen, DiscSurface) else chosen
