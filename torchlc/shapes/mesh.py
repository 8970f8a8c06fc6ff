"""Triangle meshes from files (OBJ, STL, PLY)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Discriminator, Tag, model_validator
from torch import Tensor

from torchlc.digits import number_of
from torchlc.errors import InputError, MissingExtraError
from torchlc.files.numbers import SIDES, WHOLE, Direction, Real, between, problem
from torchlc.shapes.component import Component, Side
from torchlc.shapes.mesh_files import MOST_FACES, Faces, read_faces
from torchlc.shapes.part import Facets, Part, Surroundings, frame_about, number, unit
from torchlc.shapes.triangulation import FLAT, CrossingError, triangles

AXES_OF_A_MESH = "u = [x, y, z], projected on each facet, or u_around = [x, y, z], an axis that u runs round"
"""What a mesh needs for an anisotropic material."""
FORMATS = {".obj", ".stl", ".ply"}
MOST_BYTES = 100_000_000
"""200,000 faces in text are 20 MB."""
PERPENDICULAR = 1e-3
"""Sine of the angle between a facet's normal and a direction below which the direction gives the facet no axis. Files
in single precision leave up to 1e-4 of it on facets that are meant to be perpendicular."""


def _whole_or_by_side(given: Any) -> str:
    return SIDES if isinstance(given, dict) else WHOLE


class MeshKeys(Component):
    """``file`` is OBJ, STL or PLY, ``scale`` the metres per unit of it. ``u`` or ``u_around`` gives anisotropic materials their axis.

    The axis u of anisotropic materials is the direction ``u`` projected on each facet, or runs round the axis
    ``u_around``; both turn with ``rotation``. ``u`` may be a table of directions by the side that facets face.
    """

    file: str
    scale: Annotated[Real, between(0.0, above=True)] = 1.0
    u: (
        Annotated[
            Annotated[Direction, Tag(WHOLE)] | Annotated[dict[Side, Direction], Tag(SIDES)],
            Discriminator(_whole_or_by_side),
        ]
        | None
    ) = None
    u_around: Direction | None = None

    def files(self) -> dict[str, str]:
        return {"file": self.file}

    @property
    def axes_wanted(self) -> str | None:
        return AXES_OF_A_MESH if self.u is None and self.u_around is None else None

    @model_validator(mode="after")
    def _one_way(self) -> MeshKeys:
        if self.u is not None and self.u_around is not None:
            raise problem("given beside u", "u or u_around", "u_around")
        return self


class Mesh(Part):
    """One-sided triangles of a file, with one face, "surface".

    Its corners are the file's times ``scale``. u is the scene's direction projected on each facet, or runs round its axis. A facet perpendicular to that has the
    axis that a cylinder's cap has, the next body axis cyclically. Without a direction u is the first edge, on
    which no isotropic material depends. Faces without area are dropped; the inside-out faces of a closed mesh are turned round, a mesh with holes
    is taken as it is, both with a warning.
    """

    kind = "mesh"
    keys = MeshKeys

    def __init__(self, component: Any, surroundings: Surroundings) -> None:
        super().__init__(component, surroundings)
        directory = surroundings.directory
        triangles, warnings = read_mesh(directory / component.file, f"component {component.name!r}")
        self.warnings += warnings
        self._vertices = triangles * number(component.scale)
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        double_area = np.linalg.norm(normal, axis=1)
        self._normal = normal / double_area[:, None]
        self._u = self._in_plane_axis(component, directory, triangles)
        self._area = 0.5 * double_area * number(component.scale) ** 2
        self.faces = ("surface",) * len(triangles)
        self.materials = (component.material,) * len(triangles)

    def _in_plane_axis(self, component: Any, directory: Path, triangles: np.ndarray) -> np.ndarray:
        """u (F, 3), perpendicular to the normals and of length 1."""
        if component.u_around is not None:
            along, turned = np.broadcast_to(unit(component.u_around), self._normal.shape), True
        elif component.u is not None:
            along, turned = self._along(component, directory), False
        else:
            along, turned = triangles[:, 1] - triangles[:, 0], False
            along = along / np.linalg.norm(along, axis=1)[:, None]
        across = np.cross(along, self._normal) if turned else _projected(along, self._normal)
        size = np.linalg.norm(across, axis=1)
        lost = size < PERPENDICULAR
        if lost.any():
            self.warnings.append(
                f"{self.name}: {number_of(np.count_nonzero(lost), 'facet')} of {len(lost)} perpendicular to "
                f"{'u_around' if turned else 'u'}; there u is the next body axis cyclically, as on a cylinder's cap"
            )
            across[lost] = _projected(
                np.array([frame_about(axis)[0] for axis in along[lost]]), self._normal[lost]
            )
            size = np.linalg.norm(across, axis=1)
        return across / size[:, None]

    def _along(self, component: Any, directory: Path) -> np.ndarray:
        """The scene's direction for each facet, (F, 3): one for all, or that of the side it faces most."""
        if not isinstance(component.u, Mapping):
            return np.tile(unit(component.u), (len(self._normal), 1))
        nearest = np.argmax(np.abs(self._normal), axis=1)
        ahead = np.take_along_axis(self._normal, nearest[:, None], 1)[:, 0] > 0
        sides = np.array([f"{sign}{axis}" for axis in "XYZ" for sign in "-+"])[2 * nearest + ahead]
        for side in np.unique(sides):
            if side not in component.u:
                count = np.count_nonzero(sides == side)
                place, found = (
                    f"component {self.name!r}.u",
                    f"no direction for {side}, which {number_of(count, 'facet')} {'faces' if count == 1 else 'face'}",
                )
                raise InputError(directory / component.file, place, found, f'"{side}" = [x, y, z] in u')
        return np.array([unit(component.u[side]) for side in sides])

    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        model = next(iter(values.values()), torch.zeros((), dtype=torch.float64))
        vertices, normal, u, area = (
            torch.as_tensor(array, dtype=model.dtype, device=model.device)
            for array in (self._vertices, self._normal, self._u, self._area)
        )
        return Facets(vertices, normal, u, area, vertices.mean(dim=1))


def _projected(vectors: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return vectors - (vectors * normal).sum(axis=1, keepdims=True) * normal


def read_mesh(path: Path, place: str) -> tuple[np.ndarray, list[str]]:
    """Triangles (F, 3, 3) counter-clockwise from outside in the file's unit, and what was mended."""
    try:
        import trimesh  # noqa: F401 - whether it is there
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
    whole, warnings = _cut(read_faces(path, place), path, place)
    try:
        return _repaired(path, place, whole, warnings)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # trimesh and what it calls raise anything where a mesh is strange enough
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(path, place, f"trimesh cannot use it ({said})", "a mesh of one body") from None


def _repaired(path: Path, place: str, whole: Faces, warnings: list[str]) -> tuple[np.ndarray, list[str]]:
    """Corners of the triangles (F, 3, 3) that have an area, facing outwards where the mesh is closed, and what was done."""
    import trimesh

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
        warnings.append(f"{path.name}: {number_of(np.count_nonzero(~sound), 'face')} without area dropped")
    if not mesh.is_watertight:
        warnings += _faults_of_edges(mesh.edges_sorted[np.repeat(sound, 3)], path.name)
    else:
        before = mesh.faces.copy()
        mesh.fix_normals(multibody=True)
        flipped = len(before) - _kept(before, mesh.faces)
        if flipped:
            warnings.append(
                f"{path.name}: {number_of(flipped, 'face')} of {len(before)} turned round, from inside out"
            )
    return np.asarray(mesh.vertices, dtype=float)[np.asarray(mesh.faces)[sound]], warnings


def _cut(mesh: Faces, path: Path, place: str) -> tuple[Faces, list[str]]:
    """The mesh with its polygons cut into triangles, and what is to be said of them; polygons without area are left
    as a triangle of none, which is counted later."""
    cut: list[list[int]] = []
    bent = again = 0
    seen: set[tuple[int, ...]] = set()
    _, same = np.unique(mesh.corners, axis=0, return_inverse=True)
    same = same.reshape(-1).tolist()
    for number_of_face, face in enumerate(mesh.faces, 1):
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
        try:
            pieces, bend = triangles(mesh.corners[face])
        except CrossingError:
            fault = f"face {number_of_face}, of {len(face)} corners, has an outline that crosses itself"
            hint = "Put its corners in the order of its outline, or cut it into triangles."
            raise InputError(path, place, fault, "faces that do not", hint) from None
        bent += bend > FLAT
        cut += [[face[i] for i in three] for three in pieces] or [[face[0], face[0], face[0]]]
    warnings = []
    if again:
        warnings.append(f"{path.name}: {number_of(again, 'face')} there twice, counted once")
    if bent:
        warnings.append(
            f"{path.name}: {number_of(bent, 'face')} of four corners or more not flat, but bent along the cuts into triangles"
        )
    return Faces(mesh.corners, cut), warnings


def _kept(before: np.ndarray, after: np.ndarray) -> int:
    """How many faces run round in the same sense as before."""
    return int(sum((np.roll(before, k, axis=1) == after).all(axis=1).sum() for k in range(3)))


def _faults_of_edges(edges: np.ndarray, name: str) -> list[str]:
    """Of the edges (3 a face, two corners each) of a mesh that is not closed: what is wrong, in words."""
    faces_at = np.unique(edges, axis=0, return_counts=True)[1]
    holes, crowded = np.count_nonzero(faces_at % 2), np.count_nonzero(faces_at > 2)
    faults = []
    if holes:
        faults.append(f"{name}: the mesh has holes ({holes} open edges); light can pass through them")
    if crowded:
        faults.append(
            f"{name}: more than two faces meet at {crowded} edges; faces that lie on one another, or inside another body, "
            "count each for itself unless one hides the other (self_shadowing)"
        )
    return faults
