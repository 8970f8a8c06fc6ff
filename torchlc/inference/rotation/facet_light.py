"""Light of a body as flat facets without shadows: what grids over thousands of attitudes can afford.

Facets that face the same way and are of one material are one, so a convex body is its areas by direction (its extended
Gaussian image). Light is linear in the reflectances: a diffuse one and one a lobe for each material. Neglects shadows of
parts on others, parts that follow the Sun, and Fresnel's factor at grazing angles: tenths of a magnitude, which the
model itself, at the end of a search, has all of. Letters: ... poses, F facets, M materials, K columns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, coupled_diffuse, lambert
from torchlc.lightcurve.assembled import Assembly
from torchlc.parameters import EXPONENT, REFLECTANCE, WIDTH
from torchlc.tensors.vectors import unit

SAME_WAY = 1e-6
"""Distance of unit normals that count as one."""
MOST_FACETS = 400
"""Directions beyond which normals are gathered on a coarser grid."""
AT_ONCE = 100_000
"""Pairs of facet and direction worked out together: arrays that stay in the cache of a core, in half the time of twelve times as many."""
ROUND = 12
"""The symmetry up to which bodies are told; one of more is round."""


@dataclass(frozen=True)
class FacetLight:
    """normal (F, 3) in the body; area (F, M) of each material, m2; which materials have a lobe."""

    normal: Tensor
    area: Tensor
    names: tuple[str, ...]
    lobed: tuple[bool, ...]
    coupled: tuple[bool, ...]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, assembly: Assembly) -> FacetLight:
        """The light of an assembled scene, at the starting values of sizes."""
        normals, areas, materials, notes = [], [], [], []
        for part, facets in zip(assembly.shape.parts, assembly.context.rest, strict=True):
            normals.append(facets.normal.detach())
            areas.append(facets.area.detach())
            materials += part.materials
            if part.tracks_axis is not None:
                notes.append(f"{part.name} follows the Sun: the search for poles takes it at rest")
        names = tuple(dict.fromkeys(materials))
        normal = torch.cat(normals)
        places = _directions(normal)
        area = normal.new_zeros(int(places.max()) + 1, len(names))
        of = torch.tensor([names.index(name) for name in materials])
        area.index_put_((places, of), torch.cat(areas), accumulate=True)
        mean = normal.new_zeros(len(area), 3).index_add(0, places, normal * torch.cat(areas)[:, None])
        models = assembly.models
        lobed = tuple(
            any(quantity.role in (EXPONENT, WIDTH) for quantity in models[name].quantities) for name in names
        )
        coupled = tuple(
            any(
                quantity.role == REFLECTANCE and quantity.name in models[name].simplex
                for quantity in models[name].quantities
            )
            for name in names
        )
        return cls(unit(mean), area, names, lobed, coupled, tuple(notes))

    def turned(self, rotation: Tensor) -> FacetLight:
        """The body turned by a rotation (3, 3)."""
        return replace(self, normal=self.normal @ rotation.T)

    def unlike_halves(self) -> FacetLight:
        """The body with paint of its own for what faces each way along body z's turn: a material is one where the normal's
        azimuth from x towards y is from -45 to 135 deg, and another half a turn from there. Names of materials come twice."""
        azimuth = torch.atan2(self.normal[:, 1], self.normal[:, 0])
        level = self.normal[:, :2].norm(dim=-1) < SAME_WAY
        first = level | ((azimuth >= -math.pi / 4) & (azimuth < 3 * math.pi / 4))
        area = torch.cat([self.area * first[:, None], self.area * ~first[:, None]], -1)
        return replace(self, area=area, names=self.names * 2, lobed=self.lobed * 2, coupled=self.coupled * 2)

    @property
    def columns(self) -> int:
        """Reflectances: diffuse ones, then those of the lobes."""
        return len(self.names) + sum(self.lobed)

    @cached_property
    def _painted(self) -> tuple[Tensor | None, ...]:
        """Of each material the facets that have it, None for all: a lobe costs an exponential a facet."""
        facets = [torch.nonzero(area)[:, 0] for area in self.area.T]
        return tuple(None if len(chosen) == len(self.normal) else chosen for chosen in facets)

    def light(self, to_sun: Tensor, to_observer: Tensor, exponent: Tensor) -> Tensor:
        """Light (..., K) at unit directions (..., 3) in the body, times the square of the range, for one of each
        reflectance; ``exponent`` (..., L) of the materials with a lobe."""
        size = max(1, AT_ONCE // (len(self.normal) * math.prod(to_sun.shape[1:-1])))
        if to_sun.dim() < 3 or len(to_sun) <= size:
            return self._light(to_sun, to_observer, exponent)
        exponents = exponent.expand(*to_sun.shape[:-2], 1, exponent.shape[-1])
        pieces = zip(to_sun.split(size), to_observer.split(size), exponents.split(size), strict=True)
        return torch.cat([self._light(*piece) for piece in pieces])

    def _light(self, to_sun: Tensor, to_observer: Tensor, exponent: Tensor) -> Tensor:
        cos_i, cos_r = to_sun @ self.normal.T, to_observer @ self.normal.T
        bisector = to_sun + to_observer
        length = torch.linalg.vector_norm(bisector, dim=-1, keepdim=True).clamp(min=1e-9)
        half = bisector / length
        log_half = torch.log((half @ self.normal.T).clamp(min=1e-6))
        seen = ((cos_i > 0) & (cos_r > 0)).to(cos_i)
        angles = Incidence(cos_i, cos_r, length / 2, log_half, torch.zeros_like(log_half))
        plain, joined = (lambert(angles), None) if not any(self.coupled) else (None, coupled_diffuse(angles))
        if not all(self.coupled) and plain is None:
            plain = lambert(angles)
        columns = []
        for k, coupled in enumerate(self.coupled):
            shape = joined if coupled else plain
            assert shape is not None
            columns.append((shape * seen) @ self.area[:, k])
        base = torch.minimum(cos_i, cos_r) * seen / (4 * math.pi * length)
        number = 0
        for lobed, on, area in zip(self.lobed, self._painted, self.area.T, strict=True):
            if not lobed:
                continue
            n = exponent[..., number, None]
            strength, steep = (base, log_half) if on is None else (base[..., on], log_half[..., on])
            columns.append(
                (strength * (n + 1) * torch.exp((n * steep).clamp(min=-80.0)))
                @ (area if on is None else area[on])
            )
            number += 1
        return torch.stack(columns, -1)

    def symmetry(self, axis: Tensor) -> int:
        """The largest m up to ROUND for which a turn by 1/m about ``axis`` (3,) leaves the light as it is."""
        from torchlc.geometry.rotation.matrices import rotation_about

        generator = torch.Generator().manual_seed(0)
        ways = unit(torch.randn(2, 40, 3, generator=generator, dtype=axis.dtype))
        exponent = axis.new_full((40, sum(self.lobed)), 3.0)
        start = self.light(ways[0], ways[1], exponent)
        for m in range(ROUND, 1, -1):
            turn = rotation_about(axis, axis.new_tensor(2 * math.pi / m))
            moved = self.turned(turn).light(ways[0], ways[1], exponent)
            if bool(((moved - start).abs() <= 1e-3 * start.abs().amax(0)).all()):
                return m
        return 1


def _directions(normal: Tensor) -> Tensor:
    """For each of the normals (F, 3) the number of its direction."""
    step = SAME_WAY
    while True:
        _, places = torch.unique(torch.round(normal / step), dim=0, return_inverse=True)
        if int(places.max()) < MOST_FACETS:
            return places
        step = max(4 * step, 1e-2)
