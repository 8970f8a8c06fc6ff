"""No file decides by the name of an effect, a law or a quantity of another file: what a thing is, its class declares.

The source is read by ``ast``. A comparison with a string constant, and a call of ``startswith`` or ``endswith`` with one,
counts where the constant is the name of a registered effect, law or quantity, or begins with one and a dot or bracket.
Looking up in a registry what a person typed is no comparison. Constants that merely look like a name are excepted below,
each with its reason.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

import torchlc
from torchlc.brdf.base import MODELS
from torchlc.effects import registry
from torchlc.parameters import ROLES

ROOT = Path(torchlc.__file__).parent
OTHER_MEANINGS = {
    ("mag", ""): "the kind of a recording, or its column: magnitudes or flux",
    ("time", "readers/"): "the column of a recording",
    ("nutation", "inference/rotation/"): "a number of the attitude of a body that turns freely",
    ("x", "shapes/"): "the column of a mesh file",
    ("y", "shapes/"): "the column of a mesh file",
    ("z", "shapes/"): "the column of a mesh file",
}
"""Constants that are the name of a quantity and, in all files or those of a folder, of something else."""


def defined() -> dict[str, set[Path]]:
    """Names of effects, laws and their quantities, with the files that define them."""
    found: dict[str, set[Path]] = defaultdict(set)
    for name, cls in [*registry().items(), *MODELS.items()]:
        path = Path(sys.modules[cls.__module__].__file__ or "")
        if ROOT not in path.parents:
            continue
        shared = getattr(cls, "shared", {})
        for one in (name, *shared, *(quantity.name for quantity in cls.quantities)):
            found[one].add(path)
    return found


def constants(node: ast.expr) -> Iterator[str]:
    """The strings in a constant, or in a tuple, list, set or dictionary of them."""
    for part in ast.walk(node):
        if isinstance(part, ast.Constant) and isinstance(part.value, str):
            yield part.value


def compared(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and string of every comparison with a string constant; names of module-level constants stand for theirs."""
    known = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        sides: list[ast.expr] = []
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            sides = list(node.args) if node.func.attr in ("startswith", "endswith") else []
        elif isinstance(node, ast.MatchValue):
            sides = [node.value]
        for side in sides:
            side = known.get(side.id, side) if isinstance(side, ast.Name) else side
            if isinstance(side, ast.Constant | ast.Tuple | ast.List | ast.Set):
                for text in constants(side):
                    yield getattr(node, "lineno", 0), text


def told_by_name(path: Path, names: dict[str, set[Path]]) -> list[str]:
    """Places in a file that compare with the name of something that another file defines."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    place = str(path.relative_to(ROOT))
    return [
        f"{place}:{line}: {text!r}"
        for line, text in compared(tree)
        for name in [text.replace("[", ".").partition(".")[0]]
        if name in names and path not in names[name]
        if not any(text == meant and place.startswith(folder) for meant, folder in OTHER_MEANINGS)
    ]


FILES = sorted(ROOT.rglob("*.py"))


def test_no_file_decides_by_the_name_of_an_effect_a_law_or_a_quantity() -> None:
    names = defined()
    assert {"lobe_tail", "jitter", "ashikhmin-shirley", "r_spec"} <= set(names)
    places = [place for path in FILES for place in told_by_name(path, names)]
    assert not places, "declare a property on the class or its Quantity instead:\n" + "\n".join(places)


@pytest.mark.parametrize(
    "line",
    [
        'x = effect.name == "lobe_tail"',
        'x = "jitter" in names',
        'x = short in ("n", "r_spec")',
        'NAMES = ("f0", "albedo")\nx = short in NAMES',
        'x = name.startswith("appendage.")',
        'match name:\n    case "red_noise":\n        pass',
        'x = law != "ggx"',
    ],
)
def test_a_comparison_by_name_is_seen(line: str) -> None:
    names = defined()
    assert any(text.partition(".")[0] in names for _, text in compared(ast.parse(line)))


def test_every_title_is_plain_words() -> None:
    """A few words of their own, in which no name of a file or class is."""
    titles = {name: cls.title for name, cls in registry().items() if "title" in vars(cls)}
    assert set(titles) == set(registry())
    assert len(set(titles.values())) == len(titles)
    for name, title in titles.items():
        assert "_" not in title and 2 <= len(title.split()) <= 12, name
        assert title != name.replace("_", " "), name


def test_roles_are_declared_with_their_meaning() -> None:
    used = {quantity.role for cls in [*registry().values(), *MODELS.values()] for quantity in cls.quantities}
    assert used - {""} == set(ROLES)
