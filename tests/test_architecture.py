"""The rooms of the package stand above one another as docs/architecture says: no circle, and no import that runs up.

Imports are read from the syntax trees, those inside functions and under TYPE_CHECKING included.
"""

from __future__ import annotations

import ast
import functools
import importlib.util
import json
from pathlib import Path
from typing import Any

from PIL import Image

import torchlc

PACKAGE = Path(torchlc.__file__).parent
PAGE = Path(__file__).parents[1] / "docs" / "architecture"


def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = list(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path: Path, known: dict[str, Path]) -> set[str]:
    """The modules of the package that a file names in its imports."""
    named = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names if alias.name in known}
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "torchlc":
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                named.add(inner if inner in known else node.module)
    return named


def make_picture() -> Any:
    specification = importlib.util.spec_from_file_location("make_picture", PAGE / "make_picture.py")
    assert specification is not None and specification.loader is not None
    drawing = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(drawing)
    return drawing


def floors() -> dict[str, int]:
    """Each room's floor, as the page's table has it from the bottom."""
    drawing = make_picture()
    return {room: level for level, floor in enumerate(drawing.rooms()) for room in floor}


@functools.cache
def arrows() -> set[tuple[str, str]]:
    known = modules()
    pairs = {(name, other) for name, path in known.items() for other in imports(path, known)}
    return {(name, other) for name, other in pairs if name != other}


def room(module: str) -> str:
    return module.split(".")[1]


def test_the_page_lists_every_room() -> None:
    there = {room(name) for name in modules() if name != "torchlc"}
    assert set(floors()) == there


def test_the_picture_is_of_the_code_as_it_is() -> None:
    """Every room, with as many lines as are drawn within a tenth, or 100."""
    with Image.open(PAGE / "rooms.png") as picture:
        drawn = json.loads(picture.info["Description"])
    now = {name: make_picture().lines(name) for name in floors()}
    assert drawn.keys() == now.keys()
    old = [name for name in now if abs(now[name] - drawn[name]) > max(0.1 * now[name], 100)]
    assert not old, f"{old}: python docs/architecture/make_picture.py"


def test_no_import_runs_up() -> None:
    """The package's own __init__ stands above all: it loads public names on first use."""
    level = floors()
    up = [
        f"{name} -> {other}"
        for name, other in arrows()
        if name != "torchlc" and (other == "torchlc" or level[room(other)] > level[room(name)])
    ]
    assert not up, sorted(up)


def test_no_module_is_in_a_circle() -> None:
    """Modules that import nothing of the rest, or that nothing of the rest imports, are taken away until none is left;
    what stays is in a circle."""
    left = set(modules())
    while True:
        inner = {(a, b) for a, b in arrows() if a in left and b in left}
        tied = {a for a, _ in inner} & {b for _, b in inner}
        if tied == left:
            break
        left = tied
    assert not left, sorted(left)


def test_the_reader_of_imports_sees_a_circle_and_an_arrow_up(tmp_path: Path) -> None:
    """The tests above would see one: imports in a function and for type checkers are read."""
    path = tmp_path / "lazy.py"
    path.write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from torchlc.cli import main\n"
        "def f():\n    from torchlc import api\n"
    )
    assert imports(path, modules()) == {"torchlc.cli", "torchlc.api"}
