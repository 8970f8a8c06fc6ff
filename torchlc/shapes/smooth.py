"""What smooth shapes share: cylinder, cone, dish, sphere.

A curved side shines at points that follow Sun and observer (:mod:`torchlc.shapes.curved`), of lobes of any sharpness
alike. It is also cut into facets, N of them a turn: of each what others hide of it is known, and laws without a
lobe are summed over them. Each facet has the area of the true surface it stands for and the true normal at its
middle: areas are exact, and a smooth phase curve is a midpoint rule, off by less than (2 pi/N)^2/12 of its maximum:
8e-4 (0.9 mmag) at N = 64.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from torchlc.shapes.part import Facets, Part, Surroundings, like

LEAST_AROUND = 64
"""Facets stand in for a round surface where it shades others: their outline is within 1.2e-3 of the circle's."""
Around = Annotated[int, Field(strict=True, ge=3, le=100_000)]
"""Least number of facets around, as a scene may ask for."""


class Smooth(Part):
    """A part with a curved side: ``around`` facets a turn, what the scene wants or an uneven lobe needs, up to
    ``most_around``. One that is curved about two axes (``curved_twice``) shines facet by facet where its material is
    wider along u than along v."""

    most_around: ClassVar[int] = 4096
    curved_twice: ClassVar[bool] = False

    def __init__(self, component: Any, surroundings: Surroundings) -> None:
        super().__init__(component, surroundings)
        uneven = component.material in surroundings.uneven_n and self.curved_twice
        n = surroundings.uneven_n[component.material] if uneven else 0.0
        wanted = max(
            LEAST_AROUND,
            math.ceil(2 * math.pi * math.sqrt(n)),
            getattr(component, "facets", None) or 0,
        )
        if wanted > self.most_around:
            self.warnings.append(
                f"{component.name}: {wanted} facets around are wanted, {self.most_around} are used"
                + ("; narrow glints of it may come out as spikes" if n > 0 else "")
            )
        self.cut(component, min(wanted, self.most_around))
        if uneven:
            self.whole = {}

    def cut(self, component: Any, around: int) -> None:
        """Set what depends on the number of facets around: faces, materials, whole."""
        raise NotImplementedError


class Patches:
    """Rings between steps of a coordinate (polar angle, fraction of a radius), each cut evenly in azimuth.

    polar, azimuth, width (F,): the middle of a patch and its extent in azimuth, rad; edges (F, 2): from and
    to.
    """

    def __init__(self, edges: np.ndarray, azimuth: np.ndarray, width: np.ndarray) -> None:
        self.edges, self.azimuth, self.width = edges, azimuth, width
        self.polar = edges.mean(axis=1)

    @classmethod
    def of(cls, steps: np.ndarray, around: Callable[[float], float]) -> Patches:
        """``around`` says how many patches a ring needs at the given middle."""
        edges, azimuth, width = [], [], []
        for low, high in pairwise(steps):
            count = max(6, math.ceil(around(max(low, high, key=lambda step: around(step)))))
            edges += [(low, high)] * count
            azimuth += list(2 * math.pi * (np.arange(count) + 0.5) / count)
            width += [2 * math.pi / count] * count
        return cls(np.array(edges), np.array(azimuth), np.array(width))

    def find(self, coordinate: Tensor, azimuth: Tensor) -> Tensor:
        """Which patch points (...) lie in; the outermost ring for a coordinate beyond it."""
        starts, first = np.unique(self.edges[:, 0], return_index=True)
        ring = torch.bucketize(coordinate, like(starts[1:], coordinate))
        count = torch.as_tensor(np.diff([*first, len(self.polar)]), device=ring.device)[ring]
        turn = azimuth / (2 * math.pi)
        number = ((turn - turn.floor()) * count).long().clamp(max=count - 1)
        return torch.as_tensor(first, device=ring.device)[ring] + number

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinate and azimuth (F, 4) of the corners, counter-clockwise about (coordinate, azimuth)."""
        low, high = self.edges.T
        left, right = self.azimuth - self.width / 2, self.azimuth + self.width / 2
        return np.stack([low, high, high, low], axis=1), np.stack([left, left, right, right], axis=1)

    @staticmethod
    def direction(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        sine = np.sin(polar)
        return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=-1)


def joined(*pieces: Facets) -> Facets:
    return Facets(
        vertices=torch.cat([piece.vertices for piece in pieces]),
        normal=torch.cat([piece.normal for piece in pieces]),
        u=torch.cat([piece.u for piece in pieces]),
        area=torch.cat([piece.area for piece in pieces]),
        centroid=torch.cat([piece.centroid for piece in pieces]),
    )
