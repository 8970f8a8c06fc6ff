"""Joint visibility by brute force: jittered points on every facet, straight lines to Sun and observer.

Plain numpy on arrays of corners; knows nothing of torchlc. A point of a facet counts when neither line meets
a polygon of another group. Points are one per cell of a regular grid on the facet, jittered in the cell: only
the cells that an edge of the shadow crosses add noise, about 2 sqrt(M) of M for an edge from side to side and
at most half a cell each, so e edges give the fraction a standard error of at most sqrt(e/2) M^(-3/4): 3e-5
for two edges and M = 1e6.
"""

from __future__ import annotations

import numpy as np


def triangles_of(polygon):
    """Fan (V - 2, 3, 3) of a convex polygon (V, 3)."""
    polygon = np.asarray(polygon)
    return np.stack([np.stack([polygon[0], polygon[k], polygon[k + 1]]) for k in range(1, len(polygon) - 1)])


def jittered_points(parallelogram, count, generator):
    """About ``count`` points (M, 3) on a parallelogram (4, 3), one in each near-square cell of a grid."""
    origin, along, across = (
        parallelogram[0],
        parallelogram[1] - parallelogram[0],
        parallelogram[3] - parallelogram[0],
    )
    ratio = np.linalg.norm(along) / np.linalg.norm(across)
    columns = max(1, round(np.sqrt(count * ratio)))
    rows = max(1, round(count / columns))
    i, j = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    a = (i.ravel() + generator.random(i.size)) / columns
    b = (j.ravel() + generator.random(j.size)) / rows
    return origin + a[:, None] * along + b[:, None] * across


def blocked(points, direction, triangles):
    """Which lines (M,) from points (M, 3) along a direction, (3,) or (M, 3), meet a triangle of (K, 3, 3)."""
    hit = np.zeros(len(points), dtype=bool)
    for a, b, c in triangles:
        e1, e2 = b - a, c - a
        p = np.cross(direction, e2)
        determinant = p @ e1
        level = np.abs(determinant) < 1e-14
        determinant = np.where(level, 1.0, determinant)
        offset = points - a
        u = (offset * p).sum(-1) / determinant
        q = np.cross(offset, e1)
        v = (q * direction).sum(-1) / determinant
        distance = q @ e2 / determinant
        hit |= (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 1e-9) & ~level
    return hit


def fraction_lit_and_seen(parallelogram, obstacles, to_sun, to_observer, count, generator):
    """Share of a facet that is lit and seen; obstacles (K, 3, 3) are the triangles that may be in the way."""
    points = jittered_points(np.asarray(parallelogram), count, generator)
    lit = ~blocked(points, np.asarray(to_sun), obstacles)
    seen = ~blocked(points[lit], np.asarray(to_observer), obstacles)
    return seen.sum() / len(points)
