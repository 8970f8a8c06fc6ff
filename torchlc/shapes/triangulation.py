"""Triangles of a polygon in space by cutting off ears: right for concave ones too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

FLAT = 1e-6
"""Distance of corners from their plane, over the polygon's size, up to which it counts as flat: the rounding of single
precision, which most files have."""
BACKWARDS = 1e-9
"""Area of a triangle that turns against its polygon, over the square of the polygon's size, from which that crosses itself:
above what rounding leaves of corners in a line."""


class CrossingError(ValueError):
    """A polygon whose outline crosses itself has no one area."""


def triangles(corners: np.ndarray) -> tuple[list[tuple[int, int, int]], float]:
    """Indices of triangles that cover a simple polygon of corners (N, 3), turning as it does, and how far the corners lie
    from their plane, over its size; empty for a polygon without area. Raises CrossingError for one that crosses itself.

    The plane is normal to Newell's sum of cross products, so that the area is that of the polygon. Ears are cut where
    no other corner lies inside (Meisters 1975); where none is left, as of corners in a line, the rest is a fan.
    """
    edge = np.roll(corners, -1, axis=0)
    newell = np.cross(corners - corners[0], edge - corners[0]).sum(0)
    size = float(np.ptp(corners, axis=0).max())
    length = float(np.linalg.norm(newell))
    if not length > 1e-14 * size**2:
        if len(np.unique(corners, axis=0)) == len(corners) and _wide(corners, size):
            raise CrossingError
        return [], 0.0
    normal = newell / length
    bend = float(np.abs((corners - corners.mean(0)) @ normal).max()) / size
    if len(corners) == 3:
        return [(0, 1, 2)], bend
    first = np.eye(3)[int(np.argmin(np.abs(normal)))]
    u = np.cross(first, normal)
    u /= np.linalg.norm(u)
    flat = np.stack([corners @ u, corners @ np.cross(normal, u)], -1)
    left, pieces = list(range(len(corners))), []
    while len(left) > 3:
        ear = next((k for k in range(len(left)) if _is_ear(flat, left, k)), None)
        if ear is None:
            break
        pieces.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        left.pop(ear)
    pieces += [(left[0], left[k], left[k + 1]) for k in range(1, len(left) - 1)]
    if any(_cross(flat[b] - flat[a], flat[c] - flat[b]) < -BACKWARDS * size**2 for a, b, c in pieces):
        raise CrossingError
    return pieces, bend


def _wide(corners: np.ndarray, size: float) -> bool:
    """Whether corners (N, 3) do not lie in a line."""
    return float(np.linalg.svd(corners - corners.mean(0), compute_uv=False)[1]) > FLAT * size


def _is_ear(flat: np.ndarray, left: Sequence[int], k: int) -> bool:
    """Whether corner k turns left and the triangle with its neighbours holds no other corner."""
    a, b, c = (flat[left[i % len(left)]] for i in (k - 1, k, k + 1))
    if not _cross(b - a, c - b) > 0:
        return False
    others = flat[
        [index for index in left if not any(np.array_equal(flat[index], corner) for corner in (a, b, c))]
    ]
    if not len(others):
        return True
    inside = np.ones(len(others), dtype=bool)
    for start, end in ((a, b), (b, c), (c, a)):
        along, to = end - start, others - start
        inside &= along[0] * to[:, 1] - along[1] * to[:, 0] >= 0
    return not inside.any()


def _cross(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])
