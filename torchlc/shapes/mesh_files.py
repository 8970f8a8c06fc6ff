"""Corners and faces of mesh files, as they stand there: OBJ, STL and PLY.

Each reader gives corners (V, 3) and faces as lists of corner indices, of three or more corners each. Nothing is
guessed: what does not name one body (an index that is not there, a count that does not fit the file) is an InputError
with the line or the byte. Colours, normals, textures, groups, lines and points are passed over.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.files.decimals import decimal

MOST_FACES = 200_000
"""With 300 rows, 60 million pairs: 0.5 GB an angle."""
MOST_CORNERS = 2_000_000
"""A file may have corners that no face has, but hardly more than these."""
MOST_SIDES = 1000
"""Corners of one face: cutting it into triangles takes up to the cube of them."""
STL_HEADER, STL_FACE = 84, 50
"""Bytes of a binary STL before its faces, and of a face."""
NUMBERS = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
"""Types of PLY as :mod:`struct` writes them."""


@dataclass
class Faces:
    """What a file holds: ``corners`` (V, 3), and ``faces`` as corner indices."""

    corners: np.ndarray
    faces: list[list[int]]


Refuse = Callable[..., InputError]
"""Makes an error of found, expected, hint and a place in the file."""


def read_faces(path: Path, place: str) -> Faces:
    """The content of a mesh file; ``place`` is the component that names it."""
    content = path.read_bytes()

    def refuse(found: str, expected: str | None = None, hint: str | None = None, at: str = "") -> InputError:
        return InputError(path, f"{place}, {at}" if at else place, found, expected, hint)

    reader = {".obj": read_obj, ".stl": read_stl, ".ply": read_ply}[path.suffix.lower()]
    mesh = reader(content, refuse)
    if not mesh.faces:
        raise refuse("a mesh without faces", "at least one triangle")
    if not np.isfinite(mesh.corners).all():
        bad = int(np.flatnonzero(~np.isfinite(mesh.corners).all(1))[0]) + 1
        raise refuse(f"corner {bad} has a coordinate that is no finite number", "finite coordinates")
    longest = max(map(len, mesh.faces))
    if longest > MOST_SIDES:
        raise refuse(f"a face of {longest} corners", f"at most {MOST_SIDES}", "Cut it into triangles.")
    return mesh


def read_obj(content: bytes, refuse: Refuse) -> Faces:
    """Wavefront OBJ: ``v`` and ``f``. Indices begin at 1; a negative one counts back from the last corner so far."""
    corners: list[list[float]] = []
    faces: list[list[int]] = []
    lines: list[int] = []
    for number, words in _obj_lines(content):
        if words[0] == "v":
            if len(words) < 4:
                raise refuse(
                    f"a corner of {number_of(len(words) - 1, 'number')}", "x, y and z", at=f"line {number}"
                )
            corners.append(_numbers(words[1:4], refuse, number))
        elif words[0] == "f":
            faces.append([_obj_index(word, len(corners), refuse, number) for word in words[1:]])
            lines.append(number)
            if len(faces) > MOST_FACES:
                raise refuse(f"more than {MOST_FACES} faces", f"at most {MOST_FACES}", "Decimate the mesh.")
        if len(corners) > MOST_CORNERS:
            raise refuse(f"more than {MOST_CORNERS} corners", f"at most {MOST_CORNERS}")
    for face, number in zip(faces, lines, strict=True):
        last = max(face, default=-1)
        if last >= len(corners):
            found = f"a face with corner {last + 1}, of {len(corners)}"
            raise refuse(found, f"1 to {len(corners)}, or negative", at=f"line {number}")
        if len(face) < 3:
            raise refuse(f"a face of {len(face)} corners", "three or more", at=f"line {number}")
    return Faces(np.array(corners, dtype=float).reshape(-1, 3), faces)


def _obj_lines(content: bytes) -> Iterator[tuple[int, list[str]]]:
    """Line number and words; comments are cut, a backslash at the end joins the next line."""
    joined, first = "", 0
    for number, raw in enumerate(content.decode("utf-8", errors="replace").splitlines(), 1):
        line = raw.partition("#")[0].rstrip()
        first = first or number
        if line.endswith("\\"):
            joined += line[:-1] + " "
            continue
        words = (joined + line).split()
        if words:
            yield first, words
        joined, first = "", 0
    if joined.split():
        yield first, joined.split()


def _obj_index(word: str, corners: int, refuse: Refuse, line: int) -> int:
    """Index from 0 of ``7``, ``7/1``, ``7//3``, ``7/1/3`` or, counted back, ``-1``."""
    text = word.partition("/")[0]
    if not re.fullmatch(r"[+-]?\d{1,10}(/[+-]?\d*){0,2}", word, re.ASCII):
        raise refuse(f"{word[:40]!r} in a face", "corners such as 7, 7/1, 7//3 or 7/1/3", at=f"line {line}")
    index = int(text)
    if index == 0:
        hint = "Faces that count from 0 belong to another format: add 1 to each index."
        raise refuse("a face with corner 0", "corners counted from 1", hint, at=f"line {line}")
    if index < -corners:
        raise refuse(
            f"a face with corner {index}, of {corners} so far", f"-{corners} to -1", at=f"line {line}"
        )
    return index - 1 if index > 0 else corners + index


def _numbers(words: list[str], refuse: Refuse, line: int) -> list[float]:
    try:
        return [decimal(word) for word in words]
    except ValueError:
        raise refuse(f"{' '.join(words)[:60]!r}", "numbers", at=f"line {line}") from None


def read_stl(content: bytes, refuse: Refuse) -> Faces:
    """STL: binary where the count in its header fits the size, else the text that begins with ``solid``."""
    size = len(content)
    count = struct.unpack_from("<I", content, 80)[0] if size >= STL_HEADER else None
    text = content[:512].lstrip()[:5].lower() == b"solid" and b"facet" in content[:4096].lower()
    if count is not None and size == STL_HEADER + STL_FACE * count:
        return _binary_stl(content, count, refuse)
    if text:
        return _text_stl(content, refuse)
    if content.lstrip()[:5].lower() == b"solid" and b"endsolid" in content[-512:].lower():
        raise refuse("a text STL without a facet", "at least one facet between solid and endsolid")
    if count is None:
        raise refuse(
            number_of(size, "byte"), "a binary STL of at least 84 bytes, or text that begins with solid"
        )
    needed = STL_HEADER + STL_FACE * count
    if size < needed:
        found = f"{number_of(size, 'byte')}, where {number_of(count, 'face')} would take {needed}"
        raise refuse(found, "a whole file", "The file was cut off: copy or export it again.")
    raise refuse(f"{number_of(size - needed, 'byte')} after the {number_of(count, 'face')} declared", "none")


def _binary_stl(content: bytes, count: int, refuse: Refuse) -> Faces:
    if count > MOST_FACES:
        raise refuse(f"{count} faces", f"at most {MOST_FACES}", "Decimate the mesh.")
    layout = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("flags", "<u2")])
    corners = np.frombuffer(content, layout, count, STL_HEADER)["corners"].reshape(-1, 3).astype(float)
    return Faces(corners, np.arange(3 * count).reshape(-1, 3).tolist())


def _text_stl(content: bytes, refuse: Refuse) -> Faces:
    corners: list[list[float]] = []
    faces: list[list[int]] = []
    face: list[int] | None = None
    for number, line in enumerate(content.decode("utf-8", errors="replace").splitlines(), 1):
        words = line.lower().split()
        if words[:2] == ["outer", "loop"]:
            face = []
        elif words[:1] == ["vertex"]:
            if face is None or len(words) != 4:
                raise refuse(f"{line.strip()[:60]!r}", "vertex x y z in an outer loop", at=f"line {number}")
            face.append(len(corners))
            corners.append(_numbers(words[1:], refuse, number))
        elif words[:1] == ["endloop"]:
            if face is None or len(face) < 3:
                raise refuse(f"a face of {len(face or ())} corners", "three", at=f"line {number}")
            faces.append(face)
            face = None
            if len(faces) > MOST_FACES:
                raise refuse(f"more than {MOST_FACES} faces", f"at most {MOST_FACES}", "Decimate the mesh.")
    if face is not None or b"endsolid" not in content.lower():
        raise refuse("no endsolid: the file was cut off", "a whole file", "Copy or export it again.")
    return Faces(np.array(corners, dtype=float).reshape(-1, 3), faces)


def read_ply(content: bytes, refuse: Refuse) -> Faces:
    """PLY: ``vertex`` with x, y, z, and ``face`` with its list of corners, counted from 0; text or binary."""
    end = re.search(rb"^end_header[ \t]*\r?\n", content[: 1 << 16], re.MULTILINE)
    if not content.startswith(b"ply") or end is None:
        raise refuse("no header from ply to end_header", "a PLY file")
    kind, elements = _ply_header(content[: end.start()].decode("ascii", errors="replace"), refuse)
    rest = content[end.end() :]
    for name, count, _ in elements:
        if count > len(rest):  # every row has at least a byte
            found = f"a header for {number_of(count, 'row')} of {name}, with {number_of(len(rest), 'byte')} below it"
            raise refuse(found, "a whole file", "Copy or export it again.")
    try:
        rows = _ply_text(elements, rest) if kind == "ascii" else _ply_binary(elements, rest, kind)
    except (struct.error, IndexError, StopIteration):
        raise refuse(
            "the file ends before its last row", "a whole file", "Copy or export it again."
        ) from None
    except (ValueError, OverflowError) as error:
        raise refuse(f"a row that cannot be read ({error})", "numbers, as many as the header says") from None
    if any(len(row[axis]) != 1 for row in rows["vertex"] for axis in ("x", "y", "z")):
        raise refuse("a corner whose x, y or z is a list", "a number each")
    corners = [[row[axis][0] for axis in ("x", "y", "z")] for row in rows["vertex"]]
    faces = []
    for number, row in enumerate(rows["face"], 1):
        face = row["corners"]
        faces.append([int(index) if math.isfinite(index) else -1 for index in face])
        whole = all(index == corner for index, corner in zip(face, faces[-1], strict=True))
        if len(face) < 3 or not whole or not all(0 <= index < len(corners) for index in face):
            found = f"face {number} has corners {', '.join(f'{index:g}' for index in face[:6])}"
            raise refuse(found, f"three or more, from 0 to {len(corners) - 1}")
    return Faces(np.array(corners, dtype=float).reshape(-1, 3), faces)


Properties = list[tuple[str, str | None, str]]
"""Name of each property, the type of its count if it is a list, and that of its numbers."""


def _ply_header(text: str, refuse: Refuse) -> tuple[str, list[tuple[str, int, Properties]]]:
    kind, elements = "", []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        match words:
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as kind, *_]:
                pass
            case ["element", name, count] if re.fullmatch(r"\d{1,10}", count, re.ASCII):
                elements.append((name, int(count), []))
            case ["property", "list", counts, numbers, name] if elements and {counts, numbers} <= set(
                NUMBERS
            ):
                listed = "corners" if name in ("vertex_indices", "vertex_index") else name
                elements[-1][2].append((listed, NUMBERS[counts], NUMBERS[numbers]))
            case ["property", numbers, name] if elements and numbers in NUMBERS:
                elements[-1][2].append((name, None, NUMBERS[numbers]))
            case [] | ["ply"] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise refuse(f"{line[:60]!r}", "a line of a PLY header", at=f"line {number}")
    known = {name: {key for key, _, _ in properties} for name, _, properties in elements}
    if (
        not kind
        or not {"x", "y", "z"} <= known.get("vertex", set())
        or "corners" not in known.get("face", set())
    ):
        raise refuse("a header without format, vertex x y z or face vertex_indices", "a PLY of faces")
    limits = {"vertex": MOST_CORNERS, "face": MOST_FACES}
    for name, count, _ in elements:
        if count > limits.get(name, MOST_CORNERS):
            raise refuse(f"{count} rows of {name}", f"at most {limits.get(name, MOST_CORNERS)}")
    return kind, elements


def _ply_text(
    elements: list[tuple[str, int, Properties]], rest: bytes
) -> dict[str, list[dict[str, list[float]]]]:
    words = iter(rest.decode("ascii", errors="replace").split())
    rows: dict[str, list[dict[str, list[float]]]] = {}
    for name, count, properties in elements:
        rows[name] = []
        for _ in range(count):
            row = {}
            for key, counts, _ in properties:
                length = 1 if counts is None else _count(next(words))
                row[key] = [decimal(next(words)) for _ in range(length)]
            rows[name].append(row)
    left = next(words, None)
    if left is not None:
        raise ValueError(f"{left[:40]!r} after the last row that the header declares")
    return rows


def _count(text: str) -> int:
    if not re.fullmatch(r"\d{1,10}", text, re.ASCII):
        raise ValueError(f"a list of {text[:40]!r} numbers")
    return int(text)


def _ply_binary(
    elements: list[tuple[str, int, Properties]], rest: bytes, kind: str
) -> dict[str, list[dict[str, list[float]]]]:
    order, at = "<" if kind == "binary_little_endian" else ">", 0
    rows: dict[str, list[dict[str, list[float]]]] = {}
    for name, count, properties in elements:
        rows[name] = []
        for _ in range(count):
            row = {}
            for key, counts, numbers in properties:
                length = 1
                if counts is not None:
                    (length,) = struct.unpack_from(order + counts, rest, at)
                    at += struct.calcsize(order + counts)
                if length < 0 or length > len(rest):
                    raise ValueError(f"a list of {length} numbers")
                layout = f"{order}{length}{numbers}"
                row[key] = list(struct.unpack_from(layout, rest, at))
                at += struct.calcsize(layout)
            rows[name].append(row)
    if rest[at:].strip():
        raise ValueError(f"{len(rest) - at} bytes after the last row that the header declares")
    return rows
