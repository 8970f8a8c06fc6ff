"""Mesh files: concave faces, indices of every form, broken files; areas and volumes against closed forms and trimesh."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from torchlc.errors import InputError
from torchlc.shapes.mesh import read_mesh
from torchlc.shapes.triangulation import triangles

CASES = Path(__file__).parents[2] / "shared" / "cases" / "mesh"
CUBE = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
QUADS = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]


def measured(path: Path) -> tuple[float, float, list[str]]:
    """Area, enclosed volume (divergence theorem) and warnings."""
    found, warnings = read_mesh(path, "component 'rock'")
    cross = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
    return 0.5 * np.linalg.norm(cross, axis=1).sum(), float((found[:, 0] * cross).sum()) / 6, warnings


def obj(corners, faces, extra="") -> str:
    lines = [f"v {' '.join(f'{x:.17g}' for x in corner)}" for corner in corners]
    return "\n".join([*lines, extra, *(f"f {' '.join(map(str, face))}" for face in faces)]) + "\n"


def prism(outline) -> str:
    """A straight prism of height 1 over an outline (N, 2), counter-clockwise, its caps one face each."""
    n = len(outline)
    corners = [(*point, z) for z in (0.0, 1.0) for point in outline]
    walls = [(k + 1, (k + 1) % n + 1, (k + 1) % n + n + 1, k + n + 1) for k in range(n)]
    return obj(corners, [tuple(range(n, 0, -1)), tuple(range(n + 1, 2 * n + 1)), *walls])


OUTLINES = {
    "C": [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (3, 2), (3, 3), (0, 3)],
    "dart": [(0, 0), (2, -1), (0.5, 0), (2, 1)],
    "star": [
        (r * math.cos(k * math.pi / 7), r * math.sin(k * math.pi / 7)) for k, r in enumerate([2.0, 0.4] * 7)
    ],
    "square with points on its sides": [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)],
    "comb": [(0, 0), (9, 0), *[(9 - k, 3 if k % 2 else 1) for k in range(10)], (0, 1)],
}


def shoelace(outline) -> tuple[float, float]:
    """Area and length of an outline."""
    points = np.array(outline, dtype=float)
    after = np.roll(points, -1, axis=0)
    area = 0.5 * float((points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]).sum())
    return area, float(np.linalg.norm(after - points, axis=1).sum())


@pytest.mark.parametrize("start", [0, 1, 3])
@pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES)
def test_a_prism_over_a_concave_outline(tmp_path, outline, start):
    """2 A + L and A, wherever the outline begins; the sums of a dozen products are exact to 1e-12."""
    path = tmp_path / "prism.obj"
    path.write_text(prism(outline[start:] + outline[:start]))
    area, length = shoelace(outline)
    found_area, volume, _ = measured(path)
    assert found_area == pytest.approx(2 * area + length, rel=1e-12)
    assert volume == pytest.approx(area, rel=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    radii=st.lists(st.floats(0.2, 3.0), min_size=4, max_size=15),
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-50, 50)] * 3),
)
def test_polygons_in_any_plane_have_the_area_of_their_outline(radii, turn, shift):
    """A star-shaped polygon with any radii. Coordinates up to 50 leave 1e-12 of an area of 1."""
    angle = np.arange(len(radii)) * 2 * math.pi / len(radii)
    outline = np.stack([radii * np.cos(angle), radii * np.sin(angle)], -1)
    corners = Rotation.from_rotvec(turn).apply(np.pad(outline, ((0, 0), (0, 1)))) + shift
    found, bend = triangles(corners)
    cut = corners[np.array(found)]
    cross = np.cross(cut[:, 1] - cut[:, 0], cut[:, 2] - cut[:, 0])
    area, _ = shoelace(outline)
    assert bend < 1e-12
    assert 0.5 * np.linalg.norm(cross, axis=1).sum() == pytest.approx(area, rel=1e-9)
    normal = Rotation.from_rotvec(turn).apply([0, 0, 1])
    assert (cross @ normal > -1e-9).all()


def test_a_face_that_is_not_flat_is_told_of(tmp_path):
    corners = [*CUBE[:7], (1.1, 1.1, 1.2)]
    (tmp_path / "bent.obj").write_text(obj(corners, QUADS))
    assert any("3 faces" in text and "not flat" in text for text in measured(tmp_path / "bent.obj")[2])


@pytest.mark.parametrize(
    "outline",
    [
        [(0, 0), (1, 0), (0, 1), (1, 1)],
        [(0, 0), (2, 1), (2, 0), (0, 3)],
        [(math.cos(0.8 * k * math.pi), math.sin(0.8 * k * math.pi)) for k in range(5)],
    ],
    ids=["equal halves", "unequal halves", "pentagram"],
)
def test_a_face_that_crosses_itself_is_refused(tmp_path, outline):
    """The areas of its halves cancel, or count twice: 4.0 for 2.0 of the second."""
    square = [(5, 5, 0), (6, 5, 0), (6, 6, 0), (5, 6, 0)]
    corners = [*square, *((*point, 0) for point in outline)]
    faces = [(1, 2, 3, 4), tuple(range(5, 5 + len(outline)))]
    (tmp_path / "a.obj").write_text(obj(corners, faces))
    with pytest.raises(
        InputError, match=f"face 2, of {len(outline)} corners, has an outline that crosses itself"
    ):
        measured(tmp_path / "a.obj")


def test_an_outline_that_runs_round_a_hole_keeps_its_area(tmp_path):
    """A square of 3 m with a square hole of 1 m, to which a cut leads and back: 8 m2."""
    corners = [(0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 0), (1, 1, 0), (1, 2, 0), (2, 2, 0), (2, 1, 0)]
    (tmp_path / "a.obj").write_text(obj(corners, [(1, 2, 3, 4, 1, 5, 6, 7, 8, 5)]))
    assert measured(tmp_path / "a.obj")[0] == pytest.approx(8, rel=1e-12)


FORMS = {
    "texture": lambda k: f"{k}/1", "normal": lambda k: f"{k}//1", "both": lambda k: f"{k}/1/1",
    "negative": lambda k: str(k - 9), "negative both": lambda k: f"{k - 9}/-1/-1", "plus": lambda k: f"+{k}",
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_corners_of_every_form_and_lines_of_every_kind(tmp_path, form):
    """Groups, objects, materials, comments, colours, CRLF, a continued line, lines and points change nothing."""
    corners = "\n".join(f"v {x} {y} {z} 1.0 0.5 0.25 # a corner" for x, y, z in CUBE)
    faces = "\n".join("f " + " \\\n ".join(form(k) for k in face) for face in QUADS)
    text = f"# box\nmtllib a.mtl\no box\n{corners}\nvt 0 0\nvn 0 0 1\ng side\nusemtl x\ns off\n{faces}\nl 1 2 3\np 4\n"
    (tmp_path / "box.obj").write_bytes(text.replace("\n", "\r\n").encode())
    assert measured(tmp_path / "box.obj") == (pytest.approx(6), pytest.approx(1), [])


def test_negative_indices_count_from_the_corners_so_far(tmp_path):
    """A cube of 1 m and one of 3 m: 60 m2 and 28 m3."""
    small = obj(CUBE, [[k - 9 for k in face] for face in QUADS])
    large = obj([(5 + 3 * x, 3 * y, 3 * z) for x, y, z in CUBE], [[k - 9 for k in face] for face in QUADS])
    (tmp_path / "two.obj").write_text(small + large)
    assert measured(tmp_path / "two.obj") == (pytest.approx(60), pytest.approx(28), [])


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_faces_that_are_there_twice_count_once(tmp_path, turn):
    """Wherever the second copy begins, and with corners of its own."""
    again = [(*face[turn:], *face[:turn]) for face in QUADS]
    own = [[k + 8 for k in face] for face in again]
    for faces, corners in ((again, CUBE), (own, CUBE + CUBE)):
        (tmp_path / "twice.obj").write_text(obj(corners, [*QUADS, *faces]))
        area, volume, warnings = measured(tmp_path / "twice.obj")
        assert (area, volume) == (pytest.approx(6), pytest.approx(1))
        assert warnings == ["twice.obj: 6 faces there twice, counted once"]


def test_faces_of_both_sides_and_in_another_division_are_told_of(tmp_path):
    """A cube of quadrilaterals has no open edge if each is there from inside, too, or with its other diagonal. Two
    quadrilaterals of the cube have 8 edges, their diagonals not counted, at which three faces meet or more."""
    path = tmp_path / "rock.obj"
    path.write_text(obj(CUBE, [*QUADS, *(tuple(reversed(face)) for face in QUADS)]))
    area, volume, warnings = measured(path)
    assert (area, volume) == pytest.approx((12.0, 0.0))
    assert len(warnings) == 1 and "more than two faces meet at 12 edges" in warnings[0]
    halves = [half for quad in QUADS[:2] for half in (quad[:3], quad[2:] + quad[:1])]
    others = [half for quad in QUADS[:2] for half in (quad[1:], quad[3:] + quad[:2])]
    path.write_text(obj(CUBE, [*QUADS[2:], *halves, *others]))
    area, _, warnings = measured(path)
    assert area == pytest.approx(8.0)
    assert any("more than two faces meet at 8 edges" in text for text in warnings)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
@pytest.mark.parametrize("shape", ["icosphere", "cylinder", "annulus", "capsule"])
def test_clean_files_measure_what_trimesh_does(tmp_path, suffix, shape):
    """Single precision in STL and PLY: 1e-6."""
    make = {
        "icosphere": lambda: trimesh.creation.icosphere(2), "cylinder": lambda: trimesh.creation.cylinder(1.0, 2.0),
        "annulus": lambda: trimesh.creation.annulus(0.5, 1.0, 1.0), "capsule": lambda: trimesh.creation.capsule(),
    }  # fmt: skip
    mesh = make[shape]()
    mesh.export(tmp_path / f"a.{suffix}")
    area, volume, warnings = measured(tmp_path / f"a.{suffix}")
    assert (area, volume) == (pytest.approx(mesh.area, rel=1e-6), pytest.approx(mesh.volume, rel=1e-6))
    assert not [text for text in warnings if "without area" not in text]


def stl_bytes(header: bytes, count: int | None = None) -> bytes:
    box = trimesh.creation.box()
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *np.array(three, dtype=float).ravel(), 0) for three in box.triangles
    )
    return header.ljust(80, b" ") + struct.pack("<I", 12 if count is None else count) + body


def test_a_binary_stl_may_begin_with_solid(tmp_path):
    (tmp_path / "a.stl").write_bytes(stl_bytes(b"solid made by somebody"))
    assert measured(tmp_path / "a.stl")[:2] == (pytest.approx(6), pytest.approx(1))


def test_a_text_stl_and_ply_of_concave_faces(tmp_path):
    (tmp_path / "a.stl").write_text(trimesh.creation.box().export(file_type="stl_ascii"))
    assert measured(tmp_path / "a.stl")[:2] == (pytest.approx(6), pytest.approx(1))
    lines = prism(OUTLINES["C"]).splitlines()
    corners = [line[2:] for line in lines if line.startswith("v ")]
    faces = [[int(k) - 1 for k in line[2:].split()] for line in lines if line.startswith("f ")]
    header = (
        "ply\nformat {} 1.0\ncomment x\nelement vertex 16\nproperty double x\nproperty double y\nproperty double z\n"
        "element face 10\nproperty list uchar int vertex_indices\nend_header\n"
    )
    text = "\n".join([*corners, *(f"{len(face)} {' '.join(map(str, face))}" for face in faces)])
    (tmp_path / "a.ply").write_text(header.format("ascii") + text + "\n")
    for order, kind in (("<", "binary_little_endian"), (">", "binary_big_endian")):
        body = b"".join(struct.pack(order + "3d", *map(float, corner.split())) for corner in corners)
        body += b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
        (tmp_path / f"{kind}.ply").write_bytes(header.format(kind).encode() + body)
    for name in ("a", "binary_little_endian", "binary_big_endian"):
        assert measured(tmp_path / f"{name}.ply")[:2] == (pytest.approx(30), pytest.approx(7))


PLY = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n"
PLY += "property list uchar int vertex_indices\nend_header\n"
CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.obj", CORNERS + "f 0 1 2\n", "line 4: a face with corner 0"),
        ("a.obj", CORNERS + "f 1 2 4\n", "line 4: a face with corner 4, of 3"),
        ("a.obj", CORNERS + "f -4 2 3\n", "line 4: a face with corner -4, of 3 so far"),
        ("a.obj", CORNERS + "f 1 2\n", "line 4: a face of 2 corners"),
        ("a.obj", CORNERS + "f 1 2 x\n", "line 4: 'x' in a face"),
        ("a.obj", CORNERS + "f 1.5 2 3\n", "line 4: '1.5' in a face"),
        ("a.obj", "v 0 0\n" + CORNERS + "f 1 2 3\n", "line 1: a corner of 2 numbers"),
        (
            "a.obj",
            "v nan 0 0\n" + CORNERS + "f 1 2 3\n",
            "corner 1 has a coordinate that is no finite number",
        ),
        ("a.obj", "v 1_0 0 0\n" + CORNERS + "f 1 2 3\n", "line 1: '1_0 0 0'; expected numbers"),
        ("a.obj", "v \uff11 0 0\n" + CORNERS + "f 1 2 3\n", "line 1: '\uff11 0 0'; expected numbers"),
        ("a.obj", CORNERS, "a mesh without faces"),
        ("a.obj", CORNERS + "f 1 1 2\n", "a mesh without area"),
        ("a.obj", "", "a mesh without faces"),
        ("a.stl", stl_bytes(b"")[:-30], "654 bytes, where 12 faces would take 684"),
        ("a.stl", stl_bytes(b"", 11), "50 bytes after the 11 faces declared"),
        ("a.stl", stl_bytes(b"", 2**32 - 1), "where 4294967295 faces would take 214748364834"),
        ("a.stl", b"short", "5 bytes"),
        ("a.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "no endsolid"),
        ("a.stl", "solid a\nfacet\nouter loop\nvertex 0 0 x\nendsolid", "line 4: '0 0 x'"),
        ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "face 1 has corners 0, 1, 3"),
        ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "ends before its last row"),
        (
            "a.ply",
            PLY.format(1_900_000, 1) + "0 0 0\n",
            "a header for 1900000 rows of vertex, with 6 bytes below it",
        ),
        ("a.ply", PLY.format(3, 10**9) + "0 0 0\n", "at most 200000"),
        ("a.ply", PLY.format(3, 1) + "0 0 0\n1_0 0 0\n0 1 0\n3 0 1 2\n", "'1_0' is not a number"),
        ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 1 0\n3.0 0 1 2\n", "a list of '3.0' numbers"),
        ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 2 1\n", "'3' after the last row"),
        (
            "a.ply",
            PLY.format(3, 1).replace("ascii", "binary_little_endian").encode()
            + struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
            + struct.pack("<B3i", 3, 0, 1, 2) * 2,
            "13 bytes after the last row",
        ),
        ("a.ply", PLY.format(3, 1).replace("float x", "float t") + "0 0 0\n", "a header without"),
        ("a.ply", "ply\n", "no header"),
    ],
)
def test_what_is_no_whole_mesh_is_refused_with_its_place(tmp_path, name, content, said):
    data = content if isinstance(content, bytes) else content.encode()
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_mesh(tmp_path / name, "component 'rock'")
    assert said in str(caught.value) and str(caught.value).startswith(str(tmp_path / name))


@settings(max_examples=80, deadline=None)
@given(
    suffix=st.sampled_from(["obj", "stl", "ply"]),
    cut=st.integers(0, 400),
    change=st.binary(max_size=6),
    at=st.integers(0, 400),
)
def test_a_damaged_file_is_read_or_refused(tmp_path_factory, suffix, cut, change, at):
    whole = trimesh.creation.box().export(file_type=suffix)
    whole = whole.encode() if isinstance(whole, str) else whole
    damaged = whole[:at] + change + whole[at : len(whole) - cut]
    path = tmp_path_factory.mktemp("damaged") / f"a.{suffix}"
    path.write_bytes(damaged)
    try:
        found, _ = read_mesh(path, "component 'rock'")
    except InputError:
        return
    assert np.isfinite(found).all()


@pytest.mark.skipif(not CASES.is_dir(), reason=f"{CASES} is not here")
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("C8.obj", 7.0), ("dart0.obj", 0.5), ("il_neg.obj", 28.0), ("dupface.obj", 1.0),
        ("zero_based.obj", "corner 0"), ("bin_trunc.stl", "654 bytes, where 12 faces would take 684"),
    ],
)  # fmt: skip
def test_files_that_went_wrong(name, expected):
    """Volumes, m3, which are the areas of the caps for the prisms of height 1."""
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            measured(CASES / name)
    else:
        assert measured(CASES / name)[1] == pytest.approx(expected, rel=1e-12)
