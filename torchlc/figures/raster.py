"""A picture of facets lit by the Sun: depth buffers from the camera and from the Sun, in numpy; report.html
has the same in JavaScript.

Orthographic, in the body frame. Shading is Lambert's law in the colour of the component, not the model's
reflection: it shows what is where, lit or in shadow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SHADOW_CELLS = 512
"""Along each side of the picture that the Sun sees: finer than the drawing's own pixels."""
AMBIENT = 0.42
"""Share of light that shadows keep, so that what lies in them is seen."""
EDGE = 1e-9
"""Room for rounding where two triangles meet: no gap between them."""


@dataclass(frozen=True)
class Mesh:
    """Triangles (N, 3, 3), m, counter-clockwise from outside, with their colours (N, 3) from 0 to 1."""

    triangles: np.ndarray
    colours: np.ndarray

    @property
    def normals(self) -> np.ndarray:
        """Unit normals (N, 3)."""
        a, b, c = self.triangles[:, 0], self.triangles[:, 1], self.triangles[:, 2]
        normal = np.cross(b - a, c - a)
        return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)

    @property
    def radius(self) -> float:
        """Of the sphere about the middle of the bounding box that holds everything, m."""
        points = self.triangles.reshape(-1, 3)
        return float(np.linalg.norm(points - self.middle, axis=-1).max())

    @property
    def middle(self) -> np.ndarray:
        points = self.triangles.reshape(-1, 3)
        return (points.min(0) + points.max(0)) / 2


def fan(polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (N, 3, 3) of convex polygons (F, V, 3) padded by their last corner, and the polygon (N,)
    each belongs to.
    """
    corners = polygons.shape[1]
    pieces = np.stack([polygons[:, [0, k, k + 1]] for k in range(1, corners - 1)], axis=1)
    owner = np.repeat(np.arange(len(polygons)), corners - 2)
    pieces = pieces.reshape(-1, 3, 3)
    area = np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=-1)
    keep = area > 1e-12 * max(area.max(initial=0.0), 1e-300)
    return pieces[keep], owner[keep]


def looking_along(direction: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Rows (3, 3) right, up and towards the viewer, for a viewer in ``direction``."""
    towards = direction / np.linalg.norm(direction)
    right = np.cross(up, towards)
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(np.roll(np.eye(3)[np.argmin(np.abs(towards))], 0), towards)
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def render(mesh: Mesh, camera: np.ndarray, to_sun: np.ndarray, pixels: int, span: float) -> np.ndarray:
    """RGBA image (pixels, pixels, 4) of ``span`` m across about the mesh's middle; ``camera`` from
    :func:`looking_along`.
    """
    normals = mesh.normals
    points = mesh.triangles - mesh.middle
    view = points @ camera.T
    seen = normals @ camera[2] > EDGE
    scale = pixels / span
    screen = np.concatenate([view[..., :2] * scale * [1, -1] + pixels / 2, view[..., 2:]], axis=-1)
    index = _nearest(screen[seen], pixels)[1]
    owner = np.where(index >= 0, np.flatnonzero(seen)[index], -1)
    sun_frame = looking_along(to_sun, camera[1])
    radius = mesh.radius
    cells = SHADOW_CELLS / (2.02 * radius)
    lit_points = points @ sun_frame.T
    shadow_screen = np.concatenate(
        [lit_points[..., :2] * cells + SHADOW_CELLS / 2, lit_points[..., 2:]], axis=-1
    )
    nearest_sun = _nearest(shadow_screen[normals @ to_sun > EDGE], SHADOW_CELLS)[0]
    rows, columns = np.nonzero(owner >= 0)
    facet = owner[rows, columns]
    x, y = (columns + 0.5 - pixels / 2) / scale, -(rows + 0.5 - pixels / 2) / scale
    facing = normals[facet] @ camera.T
    anchor = view[facet, 0]
    z = anchor[:, 2] - (facing[:, 0] * (x - anchor[:, 0]) + facing[:, 1] * (y - anchor[:, 1])) / facing[:, 2]
    world = np.stack([x, y, z], -1) @ camera
    cosine = normals[facet] @ to_sun
    seen_from_sun = world @ sun_frame.T
    cell = np.clip((seen_from_sun[:, :2] * cells + SHADOW_CELLS / 2).astype(int), 0, SHADOW_CELLS - 1)
    bias = 3 / cells * (1 + np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, 0.05))
    lit = (cosine > 0) & (nearest_sun[cell[:, 1], cell[:, 0]] <= seen_from_sun[:, 2] + bias)
    shade = AMBIENT * (0.6 + 0.4 * facing[:, 2]) + (1 - AMBIENT) * np.where(lit, cosine, 0.0)
    image = np.zeros((pixels, pixels, 4))
    image[rows, columns, :3] = np.clip(mesh.colours[facet] * shade[:, None], 0, 1)
    image[rows, columns, 3] = 1.0
    return image


def _nearest(screen: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth (size, size), -inf where nothing is, and index of the triangle nearest to the viewer, -1 where
    none.
    """
    depth = np.full((size, size), -np.inf)
    index = np.full((size, size), -1)
    for k, triangle in enumerate(screen):
        low = np.maximum(np.floor(triangle[:, :2].min(0)).astype(int), 0)
        high = np.minimum(np.ceil(triangle[:, :2].max(0)).astype(int), size)
        if (low >= high).any():
            continue
        x = np.arange(low[0], high[0]) + 0.5
        y = np.arange(low[1], high[1])[:, None] + 0.5
        (xa, ya, za), (xb, yb, zb), (xc, yc, zc) = triangle
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if abs(area) < 1e-12:
            continue
        u = ((xb - x) * (yc - y) - (xc - x) * (yb - y)) / area
        v = ((xc - x) * (ya - y) - (xa - x) * (yc - y)) / area
        w = 1 - u - v
        z = u * za + v * zb + w * zc
        here = depth[low[1] : high[1], low[0] : high[0]]
        closer = (u >= -EDGE) & (v >= -EDGE) & (w >= -EDGE) & (z > here)
        here[closer] = z[closer]
        index[low[1] : high[1], low[0] : high[0]][closer] = k
    return depth, index
