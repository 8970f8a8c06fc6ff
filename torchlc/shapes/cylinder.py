"""A cylinder, also of sectors that differ around it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import AfterValidator
from torch import Tensor

from torchlc.files.numbers import Name, Real, Size, Table, between, problem
from torchlc.shapes.cone import HULL_SIDES, Cone, RoundKeys, ring_about
from torchlc.shapes.curved import Band, Surface
from torchlc.shapes.part import Facets, like
from torchlc.shapes.smooth import joined

NARROWEST_DEG = 1e-6
"""Width of a sector, or of a gap between two, below which it is rounding."""


class Sector(Table):
    """A part of the side, ``width`` deg from the azimuth ``start`` on, right-handed about the axis."""

    start: Annotated[Real, between(-360.0, 360.0)]
    width: Annotated[Real, between(NARROWEST_DEG, 360.0)]
    material: Name


def _are_apart(sectors: tuple[Sector, ...]) -> tuple[Sector, ...]:
    """Sectors that do not overlap."""
    ordered = sorted(sectors, key=lambda sector: sector.start % 360.0)
    for sector, after in zip(ordered, [*ordered[1:], ordered[0]] if ordered else [], strict=True):
        room = 360.0 if sector is after else (after.start - sector.start) % 360.0
        if sector.width > room + NARROWEST_DEG:
            found = f"{sector.width:g} deg from {sector.start:g}, and another from {after.start:g}"
            raise problem(found, "sectors that do not overlap")
    return sectors


class CylinderKeys(RoundKeys):
    """``axis`` points to cap+. ``face_materials`` names faces of other materials, ``sectors`` parts of the side."""

    radius: Size
    length: Size
    sectors: Annotated[tuple[Sector, ...], AfterValidator(_are_apart)] = ()

    def materials(self) -> list[tuple[str, str]]:
        return [
            *super().materials(),
            *((f"sectors[{k}].material", sector.material) for k, sector in enumerate(self.sectors)),
        ]


class Cylinder(Cone):
    """A round body that is closed by two caps, with the faces "side" (cut in sectors: "side 1", "side 2", ...), "cap+" and "cap-".

    On the side u = axis; in the way of others it is as `Cone`. Sectors are numbered in the order of azimuth from that of the first of
    the axes across the axis (for an axis along +X, +Y or +Z the next body axis cyclically), what no sector covers among them; one wider than half a turn is two.
    """

    kind = "cylinder"
    keys = CylinderKeys
    top_key = "radius"

    def cut(self, component: Any, around: int) -> None:
        super().cut(component, around)
        self._arcs: dict[str, tuple[float, float, int]] = {}
        if not component.sectors:
            return
        side = component.face_materials.get("side", component.material)
        pieces = list(_pieces(component.sectors, side))
        for number, (start, width, _) in enumerate(pieces, 1):
            count = max(1, math.ceil(self._around * width / (2 * math.pi)))
            self._arcs[f"side {number}"] = (start, width, count)
        caps = self._around
        counts = [count for _, _, count in self._arcs.values()]
        walls = np.repeat(list(self._arcs), counts).tolist()
        made = np.repeat([material for _, _, material in pieces], counts).tolist()
        self.faces, self.materials = (*walls, *self.faces[caps:]), (*made, *self.materials[caps:])
        self.whole = {
            face: Band.points_of(False) if face in self._arcs else 1 for face in dict.fromkeys(self.faces)
        }

    def surface(self, face: str, values: Mapping[str, Tensor]) -> Surface:
        if face not in self._arcs:
            return super().surface(face, values)
        radius, length = self.sizes(values, "radius", "length")
        start, width, count = self._arcs[face]
        return Band(
            frame=like(self._frame @ self.turn.T, length),
            level=torch.ones_like(length),
            rise=torch.zeros_like(length),
            area=2 * math.pi * radius * length,
            facets=count,
            flared=False,
            arc=(start, width),
        )

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        if not self._arcs:
            return super().at_rest(values)
        radius, length = self.sizes(values, "radius", "length")
        axis = like(self.axis, length)
        low, high = -0.5 * length * axis, 0.5 * length * axis
        first, last = self._edges()
        half = 0.5 * (last - first)
        girth = half / np.sin(half)
        before, after = (
            radius * like(girth[:, None] * self._towards(edge), radius) for edge in (first, last)
        )
        side = torch.stack([before + low, after + low, after + high, before + high], dim=1)
        wall = Facets(
            vertices=side,
            normal=like(self._towards(0.5 * (first + last)), radius),
            u=axis.expand(len(first), 3),
            area=2 * like(half, radius) * radius * length,
            centroid=side.mean(dim=1),
        )
        return joined(wall, self._cap(radius, high, 1.0), self._cap(radius, low, -1.0))

    def hull_corners(self, facets: Facets) -> Tensor:
        if not self._arcs:
            return super().hull_corners(facets)
        first, last = self._edges()
        half = 0.5 * float(last[0] - first[0])
        low, high = facets.vertices[0, 0], facets.vertices[0, 3]
        axis = like(self.turn @ self.axis, low)
        pivot = like(self.pivot, low)
        along_low, along_high = (((end - pivot) @ axis) * axis for end in (low, high))
        radius = torch.linalg.vector_norm(low - pivot - along_low) * (math.sin(half) / half)
        ring = radius * like(ring_about(self._frame, HULL_SIDES) @ self.turn.T, low)
        return torch.cat([ring + pivot + along_low, ring + pivot + along_high])

    def _edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Azimuths, rad, at which facets of the side begin and end (F,)."""
        steps = [start + width * np.arange(count + 1) / count for start, width, count in self._arcs.values()]
        return np.concatenate([edges[:-1] for edges in steps]), np.concatenate([edges[1:] for edges in steps])

    def _towards(self, azimuth: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1) @ self._frame[:2]


def _pieces(sectors: tuple[Sector, ...], rest: str) -> list[tuple[float, float, str]]:
    """All the way round as arcs of at most half a turn: start and width, rad, and material of each, in the order of azimuth from
    that of the first sector."""
    ordered = sorted(sectors, key=lambda sector: sector.start % 360.0)
    pieces: list[tuple[float, float, str]] = []
    for sector, after in zip(ordered, [*ordered[1:], ordered[0]], strict=True):
        room = 360.0 if sector is after else (after.start - sector.start) % 360.0
        width = min(sector.width, room)
        arcs = [(sector.start, width, sector.material), (sector.start + width, room - width, rest)]
        for start, wide, material in arcs:
            if wide < NARROWEST_DEG:
                continue
            halves = 1 + (wide > 180.0)
            pieces += [
                (math.radians(start + k * wide / halves), math.radians(wide / halves), material)
                for k in range(halves)
            ]
    return pieces
