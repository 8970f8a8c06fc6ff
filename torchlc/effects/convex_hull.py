"""A mesh with hollows is taken as its convex hull."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import ConvexHull as Hull
from torch import Tensor

from torchlc.shapes import Facets
from torchlc.shapes.part import frame_about
from torchlc.stages.effect import Context, Effect
from torchlc.stages.light import Patch
from torchlc.stages.showing import LABORATORY, TIME, Shown

HOLLOW = 1e-3
"""Share by which the hull has to be larger in volume than the body: less is rounding of a convex mesh's corners."""


def volume(facets: Facets) -> float:
    """Volume, m3, that closed facets enclose, by the divergence theorem."""
    return float((facets.area * (facets.centroid * facets.normal).sum(-1)).sum() / 3)


class ConvexHull(Effect):
    """The hull of a mesh in its place, of one material: without hollows, and without what these hide and shadow: 0.1 to 0.3 mag at
    phase 90 deg of a body that lacks a tenth of its hull.

    What lightcurve inversion finds of a body is the shape of such a hull (Kaasalainen and Torppa 2001), and what is rendered or printed may be
    one. Where a surface is anisotropic its u is any. Neglects what other components hide or shadow of the hull, and the hull of them.
    """

    name = "convex_hull"
    title = "the convex hull in the place of a body with hollows"
    shown = Shown(LABORATORY, TIME, target="block")
    stage = "surface"
    order = -1
    per = "component"
    unable = "no component of this name is a mesh of one material with hollows"

    @classmethod
    def targets(cls, context):
        return [
            part.name
            for part, rest in zip(context.parts, context.rest, strict=True)
            if part.hull is None and not part.thin and part.tracks_axis is None and len(set(part.materials)) == 1
            and (_hull_of(rest).volume > (1 + HOLLOW) * volume(rest))
        ]  # fmt: skip

    def prepared(self, context: Context):
        number = [part.name for part in context.parts].index(str(self.target))
        self._part = number
        self._corners, self._normal, self._area = _triangles(context.rest[number])
        along = np.array([frame_about(axis)[0] for axis in self._normal.cpu().numpy()])
        self._u = torch.as_tensor(along).to(self._normal)
        return self

    def surface(self, patches, view, p, context):
        replaced = next(patch for patch in patches if patch.part == self._part)
        hull = Patch(
            component=replaced.component,
            material=replaced.material,
            model=replaced.model,
            faces=["hull"] * len(self._area),
            normal=self._normal,
            u=self._u,
            area=self._area,
            vertices=self._corners,
        )
        return (*(patch for patch in patches if patch.part != self._part), hull)


def _hull_of(facets: Facets) -> Hull:
    return Hull(facets.vertices.reshape(-1, 3).cpu().numpy())


def _triangles(facets: Facets) -> tuple[Tensor, Tensor, Tensor]:
    """Corners (H, 3, 3), outward normals (H, 3) and areas (H,), m2, of the triangles of the hull."""
    hull = _hull_of(facets)
    corners = hull.points[hull.simplices]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(cross, axis=1)
    kept = twice > 0
    outward = hull.equations[kept, :3]
    tensors = (torch.as_tensor(array).to(facets.area) for array in (corners[kept], outward, twice[kept] / 2))
    corner, normal, area = tensors
    return corner, normal, area
