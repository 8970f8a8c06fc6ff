"""Light that goes by two surfaces: rays sent back from the second to find the first."""

from __future__ import annotations

import numpy as np
from body import Face, Part, Scene, blocked
from numpy.typing import NDArray
from sampling import additive_sequence
from sky import Array
from surface import reflected

Rows = NDArray[np.intp]


def two_bounces(
    faces: list[Face],
    parts: list[Part],
    poses: list[Array | None],
    scene: Scene,
    to_sun: Array,
    to_observer: Array,
    rays: int,
    rng: np.random.Generator,
) -> Array:
    """Light by way of Sun, another face, face j, observer, (B, faces j); directions (B, 3), poses (B, 3, 3).

    From points of face j rays go out by the cosine law; what they meet first shines as the Sun makes it.
    Parts are convex, so that a ray never meets its own. Third bounces are left out (albedo times view factor
    of these).
    """
    rows = len(to_sun)
    out = np.zeros((rows, len(faces)))
    base = additive_sequence(rays, 4)

    def turned(part: int, vectors: Array, row: Rows) -> Array:
        pose = poses[part]
        vectors = np.broadcast_to(vectors, (len(row), 3))
        return vectors if pose is None else np.einsum("nij,nj->ni", pose[row], vectors)

    def at_rest(part: int, vectors: Array, row: Rows) -> Array:
        pose = poses[part]
        return vectors if pose is None else np.einsum("nji,nj->ni", pose[row], vectors)

    for j, face in enumerate(faces):
        every = np.arange(rows)
        active = np.flatnonzero((turned(face.part, face.normal, every) * to_observer).sum(-1) > 0)
        if active.size == 0:
            continue
        row = np.repeat(active, rays)
        q = np.mod(base + rng.random((active.size, 1, 4)), 1.0).reshape(-1, 4)
        centre = parts[face.part].centre
        start = centre + turned(face.part, face.points(q[:, 0], q[:, 1]) - centre, row)
        normal, u = turned(face.part, face.normal, row), turned(face.part, face.u, row)
        v = np.cross(normal, u)
        sine, angle = np.sqrt(q[:, 2:3]), 2.0 * np.pi * q[:, 3:4]
        cosine = np.sqrt(1.0 - q[:, 2:3])
        way = sine * (np.cos(angle) * u + np.sin(angle) * v) + cosine * normal

        nearest, met = np.full(len(row), np.inf), np.full(len(row), -1)
        for index, part in enumerate(parts):
            if index == face.part:
                continue
            origin = part.centre + at_rest(index, start - part.centre, row)
            along = at_rest(index, way, row)
            for i, other in enumerate(faces):
                if other.part == index:
                    reach = other.reach(origin, along)
                    met = np.where(reach < nearest, i, met)
                    nearest = np.minimum(reach, nearest)

        for i in np.unique(met[met >= 0]):
            other, use = faces[i], np.flatnonzero(met == i)
            normal_1 = turned(other.part, other.normal, row[use])
            use = use[(normal_1 * to_sun[row[use]]).sum(-1) > 0]
            source, target = to_sun[row[use]], to_observer[row[use]]
            held = [None if pose is None else pose[row[use]] for pose in poses]
            place = start[use] + nearest[use, None] * way[use]
            dark = blocked(parts, held, other.part, place, source)
            dark |= blocked(parts, held, face.part, start[use], target)
            use, source, target = use[~dark], source[~dark], target[~dark]
            normal_1, u_1 = (turned(other.part, x, row[use]) for x in (other.normal, other.u))
            back = -way[use]
            material = scene.materials[other.material]
            one = reflected(material, {}, normal_1, u_1, np.cross(normal_1, u_1), source, back)
            radiance = one / np.maximum((normal_1 * back).sum(-1), 1e-9)
            material = scene.materials[face.material]
            two = reflected(material, {}, normal[use], u[use], v[use], way[use], target)
            light = face.area / rays * np.pi * radiance * two / cosine[use, 0]
            out[:, j] += np.bincount(row[use], light, rows)
    return out
