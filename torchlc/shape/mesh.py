"""Triangle meshes from files (OBJ, STL, PLY)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.errors import InputError, MissingExtraError
from torchlc.shape.mesh_files import MOST_FACES, Faces, read_faces
from torchlc.shape.part import Facets, Part, number
from torchlc.shape.triangulation import FLAT, triangles

FORMATS = {".obj", ".stl", ".ply"}
MOST_BYTES = 100_000_000


class Mesh(Part):
    """One-sided triangles, label "surface"; u along the first edge. The file's coordinates times ``scale``.

    Faces without area are dropped; the inside-out faces of a closed mesh are turned round, a mesh with holes
    is taken as it is, both with a warning.
    """

    kind = "mesh"

    def __init__(self, component: Any, directory: Path) -> None:
        super().__init__(component)
        triangles, warnings = read_mesh(directory / component.file, f"component {component.name!r}")
        self.warnings += warnings
        self._vertices = triangles * number(component.scale)
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        double_area = np.linalg.norm(normal, axis=1)
        edge = triangles[:, 1] - triangles[:, 0]
        self._normal = normal / double_area[:, None]
        self._u = edge / np.linalg.norm(edge, axis=1)[:, None]
        self._area = 0.5 * double_area * number(component.scale) ** 2
        self.faces = ("surface",) * len(triangles)
        self.materials = (component.material,) * len(triangles)

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        model = next(iter(values.values()), torch.zeros((), dtype=torch.float64))
        vertices, normal, u, area = (
            torch.as_tensor(array, dtype=model.dtype, device=model.device)
            for array in (self._vertices, self._normal, self._u, self._area)
        )
        return Facets(vertices, normal, u, area, vertices.mean(dim=1))


def read_mesh(path: Path, place: str) -> tuple[np.ndarray, list[str]]:
    """Triangles (F, 3, 3) counter-clockwise from outside in the file's unit, and what was mended."""
    try:
        import trimesh
    except ImportError as error:
        raise MissingExtraError(
            f"{place}: reading the mesh {path.name} needs an extra: pip install 'torchlc[mesh]'"
        ) from error
    if path.suffix.lower() not in FORMATS:
        raise InputError(path, place, f"mesh format {path.suffix or 'without a suffix'}", "OBJ, STL or PLY")
    if not path.is_file():
        raise InputError(path, place, "no such file", "a mesh beside the scene file")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(
            path, place, f"{path.stat().st_size / 1e6:.0f} MB", f"at most {MOST_BYTES / 1e6:.0f} MB"
        )
    whole, warnings = _cut(read_faces(path, place), path.name)
    mesh = trimesh.Trimesh(whole.corners, whole.faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    if len(faces) > MOST_FACES:
        raise InputError(
            path, place, f"{len(faces)} triangles", f"at most {MOST_FACES}", "Decimate the mesh."
        )
    shown = vertices[faces]
    cross = np.cross(shown[:, 1] - shown[:, 0], shown[:, 2] - shown[:, 0])
    sound = np.linalg.norm(cross, axis=1) > 1e-14 * np.ptp(vertices, axis=0).max() ** 2
    if not sound.any():
        raise InputError(path, place, "a mesh without area", "triangles that are not lines or points")
    if not sound.all():
        warnings.append(f"{path.name}: {np.count_nonzero(~sound)} faces without area dropped")
    if not mesh.is_watertight:
        holes = trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)
        warnings.append(
            f"{path.name}: the mesh has holes ({len(holes)} open edges); light can pass through them"
        )
    else:
        before = mesh.faces.copy()
        mesh.fix_normals(multibody=True)
        flipped = len(before) - _kept(before, mesh.faces)
        if flipped:
            warnings.append(
                f"{path.name}: {flipped} of {len(before)} faces were inside out and have been turned round"
            )
    return np.asarray(mesh.vertices, dtype=float)[np.asarray(mesh.faces)[sound]], warnings


def _cut(mesh: Faces, name: str) -> tuple[Faces, list[str]]:
    """The mesh with its polygons cut into triangles, and what is to be said of them; polygons without area are left
    as a triangle of none, which is counted later."""
    cut: list[list[int]] = []
    bent = again = 0
    seen: set[tuple[int, ...]] = set()
    _, same = np.unique(mesh.corners, axis=0, return_inverse=True)
    same = same.reshape(-1).tolist()
    for face in mesh.faces:
        # the same corners in the same sense, wherever the face begins; the other sense is the back of a sheet
        loop = [same[corner] for corner in face]
        least = loop.index(min(loop))
        key = (*loop[least:], *loop[:least])
        if key in seen:
            again += 1
            continue
        seen.add(key)
        if len(face) == 3:
            cut.append(face)
            continue
        found, bend = triangles(mesh.corners[face])
        bent += bend > FLAT
        cut += [[face[i] for i in three] for three in found] or [[face[0], face[0], face[0]]]
    warnings = []
    if again:
        warnings.append(f"{name}: {again} faces are there twice and count once")
    if bent:
        warnings.append(
            f"{name}: {bent} faces of four corners or more are not flat; they are bent along the cuts into triangles"
        )
    return Faces(mesh.corners, cut), warnings


def _kept(before: np.ndarray, after: np.ndarray) -> int:
    """How many faces run round in the same sense as before."""
    return int(sum((np.roll(before, k, axis=1) == after).all(axis=1).sum() for k in range(3)))
