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
from torchlc.scene.parts import Attitude

ROOT = Path(torchlc.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
ATTITUDE = "attitude."
"""What full names of numbers of an attitude begin with."""
ASKING = frozenset((
    "startswith", "endswith", "removeprefix", "removesuffix", "partition", "find", "index", "count", "match",
    "fullmatch", "search", "fnmatch", "eq", "ne",
    "isdisjoint", "issubset", "issuperset", "intersection", "difference",
))  # fmt: skip
"""Methods and functions that tell by a string."""
LOOKING_UP = frozenset(("get", "pop", "setdefault"))
OTHER_MEANINGS = {
    ("sigma", "files/"): "the width of a prior, in a scene",
    ("attitude.", "inference/rotation/"): "the search for the rotation is for these numbers",
    ("mag", ""): "the kind of a recording, or its column: magnitudes or flux",
    ("time", "readers/"): "the column of a recording",
    ("nutation", "inference/rotation/"): "a number of the attitude of a body that turns freely",
    ("x", "shapes/"): "the column of a mesh file",
    ("y", "shapes/"): "the column of a mesh file",
    ("z", "shapes/"): "the column of a mesh file",
}
"""Constants that are the name of a quantity and, in all files or those of a folder, of something else."""
OTHER_KEYS = {
    ("time", ""): "the instants of what is written",
    ("alpha", "figures/"): "how opaque a mark is, to matplotlib",
    ("camera", "figures/"): "where a viewer looks from",
    ("lambert", "brdf/"): "a law's own table of angles, made and read in one file",
    (
        "n_u",
        "effects/second_material.py",
    ): "numbers of the one law that this effect builds on, and names by its class",
    ("n_v", "effects/second_material.py"): "as n_u",
    ("nutation", "results/rotation_result.py"): "a number of the attitude of a body that turns freely",
    ("nutation", "scene/"): "the same, in a scene",
    ("n", "scene/tle.py"): "a kind of column of two-line elements",
    ("outliers", ""): "rows that are doubtful, in what a diagnosis writes",
    ("phase_deg", "results/"): "the phase of a rotation, in what is written of it",
    ("rev_per_hour", "results/"): "the rate of a rotation, in what is written of it",
    ("s", "scene/tle.py"): "as n",
    ("sigma", "report/"): "the same, in a listing",
    ("width", "stages/entry.py"): "a group of a pattern",
    ("x", "scene/tle.py"): "as n",
}
"""The same of keys of a dictionary or an index."""
DECLARED = frozenset(("rivals",))
"""Dictionaries of a class whose keys are names that it declares: laws that stand in its place, and their numbers."""


def defined() -> dict[str, set[Path]]:
    """Names of effects, laws and their quantities, and of numbers of an attitude, with the files that define them."""
    found: dict[str, set[Path]] = defaultdict(set)
    for key in Attitude.MEANINGS:
        found[ATTITUDE + key] |= {path for path in FILES if path.parent == ROOT / "geometry" / "rotation"}
    found[ATTITUDE] |= found[ATTITUDE + "period"]
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


def compared(tree: ast.Module) -> Iterator[tuple[int, str, bool]]:
    """Line and string of every comparison with a string constant, and whether it is a key of a dictionary or an index;
    names of module-level constants stand for theirs."""
    known = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    declared = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if isinstance(target, ast.Name) and target.id in DECLARED
        for part in ast.walk(node.value)
    }
    for node in ast.walk(tree):
        if id(node) in declared:
            continue
        sides: list[ast.expr] = []
        key = isinstance(node, ast.Dict | ast.Subscript)
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            sides = [node.func.value, *node.args] if node.func.attr in ASKING | LOOKING_UP else []
            key = node.func.attr in LOOKING_UP
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd | ast.Sub):
            sides = [node.left, node.right]
        elif isinstance(node, ast.MatchValue):
            sides = [node.value]
        elif isinstance(node, ast.MatchMapping):
            sides = list(node.keys)
        elif isinstance(node, ast.Dict):
            sides = [key for key in node.keys if key is not None]
        elif isinstance(node, ast.Subscript):
            sides = [node.slice]
        for side in sides:
            side = known.get(side.id, side) if isinstance(side, ast.Name) else side
            if isinstance(side, ast.Constant | ast.Tuple | ast.List | ast.Set | ast.JoinedStr):
                for text in constants(side):
                    yield getattr(node, "lineno", 0), text, key


def told_by_name(path: Path, names: dict[str, set[Path]], text: str) -> list[str]:
    """Places in a file of this text that compare with the name of something that another file defines."""
    tree = ast.parse(text)
    place = str(path.relative_to(ROOT))
    return [
        f"{place}:{line}: {text!r}"
        for line, text, key in compared(tree)
        for name in [text if text.startswith(ATTITUDE) else text.replace("[", ".").partition(".")[0]]
        if name in names and path not in names[name]
        for meanings in [OTHER_MEANINGS | OTHER_KEYS if key else OTHER_MEANINGS]
        if not any(text == meant and place.startswith(folder) for meant, folder in meanings)
    ]


def test_no_file_decides_by_the_name_of_an_effect_a_law_or_a_quantity() -> None:
    names = defined()
    assert {"lobe_tail", "jitter", "ashikhmin-shirley", "r_spec"} <= set(names)
    places = [place for path in FILES for place in told_by_name(path, names, path.read_text("utf-8"))]
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
        'x = {"jitter": 1.0, "red_noise": 2.0}[name]',
        'SHARES = {"lobe_tail": 0.1}\nx = SHARES.get(name)',
        'x = {"jitter", "red_noise"} & names',
        'JUMPS = {"attitude_jump"}\nx = JUMPS.isdisjoint(names)',
        'x = values["n_u"]',
        'x = values.get("red_noise.mag")',
        'x = name.removeprefix("appendage.")',
        'x = re.match("appendage", name)',
        'x = name.startswith("attitude.")',
        'x = bounds["attitude.spin_rate"]',
        'match found:\n    case {"jitter": level}:\n        pass',
    ],
)
def test_a_comparison_by_name_is_seen(line: str) -> None:
    path = ROOT / "a_new_file.py"
    assert told_by_name(path, defined(), line)


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
