"""Lamp and camera stand at distances that are not large beside the object."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.light import Near, Patch
from torchlc.stages.showing import LABORATORY, TIME, Shown

CLOSE = 0.1
"""Radius of the object over a distance for which pieces of facets are made fine enough."""
ACROSS_RADIUS = 0.25
"""Largest facet, in radii of the object, that one point stands for: 1.4 deg at CLOSE, whose light is within 1e-4 of an integral's."""
ACROSS_LOBE = 0.3
"""Largest angle of such a facet as the source sees it, in standard deviations of the sharpest lobe."""
WIDER = 5.0
"""How much wider a triangle of seven points may be."""
FINEST = 12
"""Triangles along a side of a facet at most."""
_NEAR, _FAR = (6 - math.sqrt(15)) / 21, (6 + math.sqrt(15)) / 21
BARYCENTRIC = torch.tensor(
    [[1 / 3] * 3]
    + [[1 - 2 * at if k == corner else at for k in range(3)] for at in (_NEAR, _FAR) for corner in range(3)],
    dtype=torch.float64,
)
WEIGHTS = torch.tensor(
    [9 / 40] + [(155 - math.sqrt(15)) / 1200] * 3 + [(155 + math.sqrt(15)) / 1200] * 3, dtype=torch.float64
)
"""Radon's rule of degree 5 on a triangle (1948; Stroud 1971, T2 5-1): seven points and their shares of its area."""


def pieces(vertices: torch.Tensor, longest: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points (N, 3) that stand for polygons (F, V, 3): the share of its polygon's area of each (N,), and which polygon it is
    of (N,). A triangle no wider than ``longest`` has one, else each of its triangles no wider than WIDER times that has seven."""
    if vertices.shape[1] == 3:
        sides = torch.linalg.vector_norm(vertices - vertices.roll(1, 1), dim=-1)
        if float(sides.max()) <= longest:
            return vertices.mean(1), vertices.new_ones(len(vertices)), torch.arange(len(vertices))
    points, shares, parents = [], [], []
    rule, weights = BARYCENTRIC.to(vertices), WEIGHTS.to(vertices)
    for number, polygon in enumerate(vertices):
        areas, places = [], []
        for k in range(1, len(polygon) - 1):
            corner, first, second = polygon[0], polygon[k] - polygon[0], polygon[k + 1] - polygon[0]
            area = float(torch.linalg.vector_norm(torch.linalg.cross(first, second)) / 2)
            if area == 0:
                continue
            widest = max(float(torch.linalg.vector_norm(side)) for side in (first, second, second - first))
            if widest <= longest:
                places.append((corner + (first + second) / 3)[None])
                areas.append(polygon.new_full((1,), area))
                continue
            many = min(max(1, math.ceil(widest / (WIDER * longest))), FINEST)
            grid = torch.cartesian_prod(torch.arange(many), torch.arange(many)).reshape(-1, 2)
            upright, hanging = (grid[grid.sum(1) < most].to(polygon)[:, None] for most in (many, many - 1))
            at = torch.cat([upright + rule[:, 1:], hanging + 1 - rule[:, 1:]]).reshape(-1, 2) / many
            places.append(corner + at[:, :1] * first + at[:, 1:] * second)
            areas.append((area / many**2 * weights).repeat(many**2))
        whole = torch.cat(areas)
        points.append(torch.cat(places))
        shares.append(whole / whole.sum())
        parents.append(torch.full((len(whole),), number))
    return torch.cat(points), torch.cat(shares), torch.cat(parents)


class NearField(Effect):
    """Each piece of the surface has its own directions to lamp and camera, and light falls by inverse squares from both: 0.2 mag
    for a camera at ten radii of the object.

    Distances are from the body's origin, as the object's radius over them; light is counted relative to that at the origin. Facets wider
    than a quarter of the radius, or than a sharp lobe, are summed over points. Neglects perspective
    in shadows: each edge is off by up to the radius over the distance. Neglects also the camera's own fall-off from its axis (cos^4), and the
    size of lamp and lens.
    """

    name = "near_field"
    title = "a lamp or camera that is close to the object"
    shown = Shown(LABORATORY, TIME, {"lamp": 0.05, "camera": 0.1})
    stage = "surface"
    order = 2
    quantities = (
        Quantity(
            "lamp", "", 0.0, 0.8, "radius of the object over the distance of the lamp",
            off=0.0, typical=CLOSE, prior="halfnormal", sigma=0.1,
        ),
        Quantity(
            "camera", "", 0.0, 0.8, "radius of the object over the distance of the camera",
            off=0.0, typical=CLOSE, prior="halfnormal", sigma=0.1,
        ),
    )  # fmt: skip

    def missing(self, context):
        if context.curved:
            return "a surface that is curved: give it as a mesh"
        if any(part.tracks_axis is not None for part in context.parts):
            return "a part tracks the Sun"
        return context.a_point

    def prepared(self, context):
        widest = max(context.lobes.values(), default=1.0)
        longest = context.radius * min(ACROSS_RADIUS, ACROSS_LOBE / (CLOSE * math.sqrt(max(widest, 1.0))))
        self._longest, self._radius = longest, context.radius
        self._pieces = {
            (number, material): pieces(
                facets.vertices[[i for i, name in enumerate(part.materials) if name == material]], longest
            )
            for number, (part, facets) in enumerate(zip(context.shape.parts, context.rest, strict=True))
            for material in dict.fromkeys(part.materials)
        }
        self._further: list[tuple[torch.Tensor, tuple[torch.Tensor, ...]]] = []
        return self

    def surface(self, patches, view, p, context):
        lamp, camera = (view.every(p[name]) / self._radius for name in ("lamp", "camera"))
        return tuple(self._cut(patch, lamp, camera) for patch in patches)

    def _cut(self, patch: Patch, lamp: torch.Tensor, camera: torch.Tensor) -> Patch:
        """A patch as pieces, each with its place; one that has no place stays at the body's origin."""
        if patch.vertices is not None:
            middle, share, which = self._of_others(patch.vertices)
        elif patch.part is not None and patch.select is not None:
            middle, share, which = self._pieces[patch.part, patch.material]
        else:
            return patch
        visible, seen = (
            None if fraction is None else fraction[..., which] for fraction in (patch.visible, patch.seen)
        )
        return replace(
            patch,
            normal=patch.normal[..., which, :],
            u=patch.u[..., which, :],
            area=patch.area[..., which] * share.to(patch.area),
            visible=visible,
            seen=seen,
            select=None if patch.select is None else patch.select[which],
            surface=None,
            vertices=None,
            near=Near(middle.to(patch.normal), lamp, camera),
        )

    def _of_others(self, vertices: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """`pieces` of a surface that is no part of the object, kept for as long as its corners are the same tensor."""
        for corners, cut in self._further:
            if corners is vertices:
                return cut
        self._further.append((vertices, pieces(vertices, self._longest)))
        return self._further[-1][1]
