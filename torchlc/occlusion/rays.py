"""Joint visibility among parts of any shape, by rays through Embree.

A fraction is the share of a facet's sample points whose rays to Sun and observer are both free: a step
function, so its gradient with respect to geometry and directions is zero here, although the true one is not.
Small facets have one point, their middle; large ones 256, one in each cell of a grid (standard error about
0.01 per shadow edge). Embree works in single precision, so everything is scaled to unit size, and rays start
slightly off the surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.errors import MissingExtraError
from torchlc.shapes import Part

LARGE = 0.1  # a facet whose size is more than this of the object's radius gets a grid of points
GRID = 16
"""Along each side of a large facet: 256 rays, of which the edge of a shadow crosses some 16."""
LIFT = 1e-3  # of a facet's size, and of LARGE at most: how far off the surface rays start
RAYS_AT_ONCE = 1_000_000
"""24 MB of directions."""
TENSORS_PER_PART = 3
"""That a part is handed over as, for ``vmap`` takes no objects."""


def ray_fractions(parts: Sequence[Part], still: Sequence[bool], *tensors: Tensor) -> tuple[Tensor, ...]:
    """Fractions (N, F) of each part; tensors: to_sun, to_observer (N, 3), then a part pose, vertices, normal.

    pose (N, 3, 3), vertices (N, F, V, 3), normal (N, F, 3), at rest, or one row for all; ``still`` says which
    parts never turn. Rows that follow one another with the same vertices share an Embree scene.
    """
    rows = len(tensors[0])
    changes = np.zeros(rows, dtype=bool)
    for vertices in tensors[3::TENSORS_PER_PART]:
        if len(vertices) > 1:
            changes[1:] |= (vertices[1:] != vertices[:-1]).flatten(1).any(dim=1).cpu().numpy()
    bounds = [0, *np.flatnonzero(changes), rows]
    fractions = []
    for start, stop in pairwise(bounds):
        chosen = [tensor[start:stop] if len(tensor) > 1 else tensor for tensor in tensors]
        arrays = [tensor.detach().cpu().double().numpy() for tensor in chosen]
        fractions.append(
            _Bodies(parts, still, arrays[3::3], arrays[4::3]).visible(arrays[0], arrays[1], arrays[2::3])
        )
    like = tensors[0]
    return tuple(torch.as_tensor(np.concatenate(piece)).to(like) for piece in zip(*fractions, strict=True))


@dataclass(frozen=True)
class _Points:
    """Where rays start on a part at rest, in unit size: at (Q, 3) on facet (Q,), weight (Q,) 1 a facet."""

    at: np.ndarray
    facet: np.ndarray
    weight: np.ndarray

    @classmethod
    def on(cls, vertices: np.ndarray, normal: np.ndarray) -> _Points:
        cross = np.cross(vertices[:, 2] - vertices[:, 0], vertices[:, -1] - vertices[:, 1])
        if vertices.shape[1] == 3:
            cross = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
        size = np.sqrt(0.5 * np.linalg.norm(cross, axis=1))
        large = size > LARGE
        middle, facet = vertices[~large].mean(axis=1), np.flatnonzero(~large)
        spread, weight = _grid_points(vertices[large])
        at = np.concatenate([middle, spread.reshape(-1, 3)])
        facet = np.concatenate([facet, np.repeat(np.flatnonzero(large), GRID * GRID)])
        weight = np.concatenate([np.ones(len(middle)), weight.ravel()])
        at = at + (LIFT * np.minimum(size, LARGE))[facet, None] * normal[facet]
        return cls(at, facet, weight)


def _grid_points(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Jittered points (F, Q, 3) of facets of three or four corners, and what share (F, Q) each is for."""
    jitter = np.random.default_rng(0).random((2, GRID, GRID))
    cells = np.stack(np.meshgrid(np.arange(GRID), np.arange(GRID), indexing="ij"))
    a, b = ((cells + jitter) / GRID).reshape(2, -1, 1)
    p, q, r, s = (vertices[:, None, min(k, vertices.shape[1] - 1)] for k in range(4))
    at = (1 - a) * (1 - b) * p + a * (1 - b) * q + a * b * r + (1 - a) * b * s
    along_a, along_b = (1 - b) * (q - p) + b * (r - s), (1 - a) * (s - p) + a * (r - q)
    weight = np.linalg.norm(np.cross(along_a, along_b), axis=-1)
    return at, weight / weight.sum(axis=1, keepdims=True)


class _Bodies:
    """The parts in rows of equal sizes: one Embree scene of all that never turn, one of each that does."""

    def __init__(
        self,
        parts: Sequence[Part],
        still: Sequence[bool],
        vertices: Sequence[np.ndarray],
        normal: Sequence[np.ndarray],
    ) -> None:
        corners = np.concatenate([array[0].reshape(-1, 3) for array in vertices])
        self.centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        self.scale = np.linalg.norm(corners - self.centre, axis=1).max()
        unit = [self._unit(array[0]) for array in vertices]
        self.points = [_Points.on(scaled, facing[0]) for scaled, facing in zip(unit, normal, strict=True)]
        self.normal = [facing[0] for facing in normal]
        self.turning = [
            None if quiet else self._unit(part.pivot) for part, quiet in zip(parts, still, strict=True)
        ]
        triangles = [
            _triangles(scaled[: len(scaled) // 2] if part.thin else scaled)
            for scaled, part in zip(unit, parts, strict=True)
        ]
        quiet = [mesh for mesh, rests in zip(triangles, still, strict=True) if rests]
        self.scenes: list[tuple[int | None, Any]] = (
            [(None, _embree_scene(np.concatenate(quiet)))] if quiet else []
        )
        self.scenes += [(k, _embree_scene(mesh)) for k, mesh in enumerate(triangles) if not still[k]]

    def _unit(self, points: np.ndarray) -> np.ndarray:
        return (points - self.centre) / self.scale

    def visible(
        self, to_sun: np.ndarray, to_observer: np.ndarray, poses: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        """Fractions (N, F) of each part."""
        rows = max(1, RAYS_AT_ONCE // max(len(points.facet) for points in self.points))
        pieces = []
        for start in range(0, len(to_sun), rows):
            chunk = slice(start, start + rows)
            turns = [pose[chunk] if len(pose) > 1 else pose for pose in poses]
            pieces.append(
                [self._part(k, to_sun[chunk], to_observer[chunk], turns) for k in range(len(poses))]
            )
        return [np.concatenate(piece) for piece in zip(*pieces, strict=True)]

    def _part(
        self, which: int, to_sun: np.ndarray, to_observer: np.ndarray, poses: Sequence[np.ndarray]
    ) -> np.ndarray:
        points, normal, pivot = self.points[which], self.normal[which], self.turning[which]
        sun, observer = to_sun, to_observer
        if pivot is not None:
            sun = np.einsum("nji,nj->ni", poses[which], to_sun)
            observer = np.einsum("nji,nj->ni", poses[which], to_observer)
        upright = (sun @ normal.T > 0) & (observer @ normal.T > 0)
        row, point = np.nonzero(upright[:, points.facet])
        at = points.at[point]
        if pivot is not None:
            at = np.einsum("nij,nj->ni", poses[which][row], at - pivot) + pivot
        for direction in (to_sun, to_observer):
            free = ~self._blocked(at, direction[row], row, poses)
            row, point, at = row[free], point[free], at[free]
        shape = upright.shape
        seen = np.bincount(row * shape[1] + points.facet[point], points.weight[point], shape[0] * shape[1])
        return np.where(upright, seen.reshape(shape), 1.0)

    def _blocked(
        self, at: np.ndarray, direction: np.ndarray, row: np.ndarray, poses: Sequence[np.ndarray]
    ) -> np.ndarray:
        """Which rays (R,) from points along directions (R, 3) in rows (R,) meet anything."""
        hit = np.zeros(len(at), dtype=bool)
        if not len(at):
            return hit
        for part, scene in self.scenes:
            start, ahead = at, direction
            if part is not None:
                pose, pivot = poses[part][row], self.turning[part]
                start = np.einsum("nji,nj->ni", pose, at - pivot) + pivot
                ahead = np.einsum("nji,nj->ni", pose, direction)
            hit |= scene.run(start.astype(np.float32), ahead.astype(np.float32), query="OCCLUDED") >= 0
        return hit


class Traced:
    """Facets (F, V, 3) of one part, one-sided, as an Embree scene: which of them a ray meets first."""

    def __init__(self, vertices: np.ndarray) -> None:
        corners = vertices.reshape(-1, 3)
        self._centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        self._scale = np.linalg.norm(corners - self._centre, axis=1).max()
        self._facets = len(vertices)
        self._scene = _embree_scene(_triangles((vertices - self._centre) / self._scale))

    def first(self, start: np.ndarray, normal: np.ndarray, ahead: np.ndarray) -> np.ndarray:
        """Facet (R,) that rays from ``start`` (R, 3), on facets with ``normal`` (R, 3), meet along ``ahead`` (R, 3);
        -1 for none."""
        at = (start - self._centre) / self._scale + LIFT * LARGE * normal
        met = self._scene.run(at.astype(np.float32), ahead.astype(np.float32), query="INTERSECT")
        return np.where(met >= 0, met % self._facets, -1)


def _triangles(vertices: np.ndarray) -> np.ndarray:
    """Fans (F (V - 2), 3, 3) of convex facets (F, V, 3)."""
    fans = [vertices[:, [0, k, k + 1]] for k in range(1, vertices.shape[1] - 1)]
    return np.concatenate(fans)


def _embree_scene(triangles: np.ndarray) -> Any:
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise MissingExtraError(
            "shadows of meshes and dishes need an extra: pip install 'torchlc[mesh]'"
        ) from error
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(triangles, dtype=np.float32))
    return scene
