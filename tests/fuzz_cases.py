"""What the fuzzer tries: scenes, recordings and the files beside them, mutated, each with a command that reads them."""

from __future__ import annotations

import contextlib
import copy
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from tests.good_input import (
    ALTAZ_RECORDING,
    ALTAZ_SCENE,
    ECSV,
    ECSV_VECTORS,
    MESH_SCENE,
    RECORDING,
    SCENE,
    TETRAHEDRON,
    TLE,
    VECTOR_RECORDING,
    VECTOR_SCENE,
)
from tests.test_layouts import ALCDEF, DAMIT, MMT, SIMPLE
from torchlc.cli.scaffold import PRESETS, new_scene
from torchlc.effects import names as effect_names
from torchlc.scene.tle import Elements
from torchlc.scene.writer import toml_key, toml_value

QUATERNIONS = "time,q0,q1,q2,q3\n2020-10-17T14:00:00,1,0,0,0\n2020-10-17T16:00:00,0.7,0.7,0.1,0\n"
LINES = tomllib.loads(TLE)["tle"]
NADIR = 'mode = "nadir"'
INERTIAL = (
    'mode = "inertial"\nx_angle = 20.0\nspin_axis = [0, 0, 1]\nspin_rate = { value = 3.0, sigma = 0.1 }'
)
POLE = 'mode = "spin-pole"\npole = [10.0, { value = 40.0, low = -80, high = 80 }]\nperiod = 2.5\nphase = 0.0\nepoch = 2459140.0'
SMOOTH = """
[[components]]
name = "tank"
shape = "cone"
radius = 0.5
radius_top = { value = 0.2, low = 0.1, high = 0.4 }
length = 1.0
centre = [0, 0, 2]
material = "body"
facets = 12

[[components]]
name = "dish"
shape = "dish"
radius = 0.6
depth = 0.2
centre = [2, 0, 0]
rotation = [10, 20, 30]
material = "body"

[[components]]
name = "ball"
shape = "sphere"
radius = 0.3
centre = [-2, 0, 0]
material = "body"

"""
EPHEMERIS = """\
CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2020-10-17T00:00:00
ORIGINATOR = TEST
META_START
CENTER_NAME = EARTH
REF_FRAME = ITRF2014
TIME_SYSTEM = TAI
META_STOP
2020-10-17T12:00:00.000 -26500.0 32800.0 100.0 0.0 0.0 0.05
2020-10-17T15:00:00.000 -26500.0 32800.0 600.0 0.0 0.0 0.03
2020-10-17T18:00:00.000 -26500.0 32800.0 800.0 0.0 0.0 0.0
2020-10-17T21:00:00.000 -26500.0 32800.0 600.0 0.0 0.0 -0.03
"""
BESIDE = {
    "body.obj": TETRAHEDRON.encode(),
    "turn.csv": QUATERNIONS.encode(),
    "many.txt": f"{LINES[0]}\n{LINES[1]}\n0 ANOTHER NAME\n{LINES[0]}\n{LINES[1]}\n".encode(),
    "sat.oem": EPHEMERIS.encode(),
}
"""Files that scenes name."""
SCENES = [
    SCENE,
    SCENE.replace('effects = ["self_shadowing"]\n', ""),
    SCENE.replace(NADIR, 'mode = "quaternions"\nfile = "turn.csv"'),
    SCENE.replace(NADIR, INERTIAL),
    SCENE.replace(NADIR, POLE),
    SCENE.replace("[materials.body]", SMOOTH + "[materials.body]"),
    MESH_SCENE,
    VECTOR_SCENE,
    ALTAZ_SCENE,
    SCENE.replace(TLE, 'tle_file = "many.txt"\n\n'),
    SCENE.replace(TLE, 'oem_file = "sat.oem"\n\n'),
    *(
        new_scene(Elements("x", (LINES[0], LINES[1])), preset, mesh="body.obj" if preset == "mesh" else None)
        for preset in {one.template: name for name, one in PRESETS.items()}.values()
    ),
]
RECORDINGS = [RECORDING, VECTOR_RECORDING, ALTAZ_RECORDING, ECSV, ECSV_VECTORS, MMT, ALCDEF, SIMPLE, DAMIT]
ODD = [
    *(0, -1, 1, 2, 3, 90, 1000, 100_000, 2**63, 10**30, -(10**30)),
    *(
        0.0,
        -0.0,
        5e-324,
        1e-300,
        1e-9,
        0.5,
        1.0000001,
        1e9,
        1e300,
        -1e300,
        float("nan"),
        float("inf"),
        -float("inf"),
    ),
    *(
        True,
        False,
        "",
        "x",
        "body",
        "panel",
        "x" * 5000,
        "\u202e\u0000\x1b[31m",
        "../../etc/passwd",
        "body.obj",
    ),
    *([], [0, 0, 0], [1, 0, 0], [1e-200, 0, 0], {}, [[]], {"value": 1.0}),
    {"value": 1.0, "low": 0.0, "high": 2.0},
    {"value": 1.0, "sigma": 1e300},
    {"value": 1e-300, "low": 1e-300, "high": 1e300, "prior": "loguniform"},
    {"value": 0.3, "low": 0.0, "high": 1.0, "per": "curve"},
    {"value": 0.3, "sigma": 0.1, "low": 0.0, "prior": "lognormal", "per": "night"},
]
CELLS = [
    *("", "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "0", "-0", "-1", "12.5", "1e5", "99.99", "true", "--"),
    *("2459140.125", "59139.6", "2020-10-17T15:00:00", "2020-10-17T15:00:00.5", "2199-12-31T23:59:59", "1960-01-01T00:00:00"),
    *("2020-10-17T15:05:00+14:00", "0x10", "1_000", "\u0661\u0662", '"', "x" * 300),
]  # fmt: skip
SPLICES = [
    b"",
    b"\n",
    b"\r",
    b"\x00",
    b"\xff",
    b'"',
    b",",
    b"=",
    b"[",
    b"]]",
    b"{",
    b"nan",
    b"1e999",
    b"#",
    b"\xef\xbb\xbf",
]


@dataclass(frozen=True)
class Case:
    """Files by name and the command that reads them; ``{out}`` stands for the output directory."""

    files: dict[str, bytes]
    command: tuple[str, ...]

    def write(self, folder: Path) -> list[str]:
        """Write the files; the command's arguments."""
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        return [one.format(folder=folder) for one in self.command]


QUICK = [
    ("simulate", "{folder}/scene.toml", "{folder}/recording.csv", "-o", "{folder}/out", "--quiet"),
    ("simulate", "{folder}/scene.toml", "-o", "{folder}/out", "--start", "2020-10-17T15:00", "--hours", "2",
     "--cadence", "600", "--noise", "0.02", "--json"),
    ("period", "{folder}/recording.csv", "--json"),
]  # fmt: skip
WHOLE = [
    *QUICK,
    ("fit", "{folder}/scene.toml", "{folder}/recording.csv", "-o", "{folder}/out", "--steps", "20", "--quiet"),
    ("diagnose", "{folder}/scene.toml", "{folder}/recording.csv", "-o", "{folder}/out", "--quick", "--quiet",
     "--effects", "panel_offset,zero_point_drift"),
]  # fmt: skip

LONG = ("fit", "diagnose")


def cases(commands: list[tuple[str, ...]]) -> st.SearchStrategy[Case]:
    """Scenes and recordings with up to a few changes each, and a command for them."""
    suited = st.sampled_from([(scene, _suited(scene)) for scene in SCENES])
    pair = st.one_of(suited, suited, suited, st.tuples(st.sampled_from(SCENES), st.sampled_from(RECORDINGS)))

    def changed(texts: tuple[str, str]) -> st.SearchStrategy[Case]:
        scene, recording = restructured(texts[0]).flatmap(spliced), recelled(texts[1]).flatmap(spliced)
        return st.builds(_case, scene, recording, beside(), st.sampled_from(commands))

    return pair.flatmap(changed)


def beside() -> st.SearchStrategy[dict[str, bytes]]:
    """The files that scenes name: as they are, or one of them damaged."""

    def damaged(name: str) -> st.SearchStrategy[dict[str, bytes]]:
        return spliced(BESIDE[name]).map(lambda content: {**BESIDE, name: content})

    return st.one_of(st.just(BESIDE), st.sampled_from(sorted(BESIDE)).flatmap(damaged))


def _suited(scene: str) -> str:
    return {VECTOR_SCENE: VECTOR_RECORDING, ALTAZ_SCENE: ALTAZ_RECORDING}.get(scene, RECORDING)


def _case(scene: bytes, recording: bytes, beside: dict[str, bytes], command: tuple[str, ...]) -> Case:
    return Case({"scene.toml": scene, "recording.csv": recording, **beside}, command)


def spliced(content: bytes) -> st.SearchStrategy[bytes]:
    """Mostly as it is; else with bytes cut out and put in."""
    piece = st.sampled_from(SPLICES) | st.binary(max_size=4)
    cut = st.tuples(st.floats(0, 1), st.integers(0, 30), piece)

    def apply(cuts: list[tuple[float, int, bytes]]) -> bytes:
        changed = content
        for place, length, new in cuts:
            start = int(place * len(changed))
            changed = changed[:start] + new + changed[start + length :]
        return changed

    return st.one_of(st.just(content), st.just(content), st.lists(cut, max_size=3).map(apply))


def recelled(text: str) -> st.SearchStrategy[bytes]:
    """Cells of some rows replaced, rows repeated or swapped."""
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    comma = "," if "," in lines[first] else " "
    width = len(lines[first].split(comma))
    place = st.tuples(st.integers(first, len(lines) - 1), st.integers(0, width - 1))

    def apply(changes: list[tuple[tuple[int, int], str]], repeats: list[int]) -> bytes:
        rows = [line.split(comma) if i >= first else [line] for i, line in enumerate(lines)]
        for (row, column), cell in changes:
            rows[row][column] = cell
        rows += [rows[row] for row in repeats]
        return ("\n".join(comma.join(row) for row in rows) + "\n").encode("utf-8", "surrogatepass")

    changes = st.lists(st.tuples(place, st.sampled_from(CELLS)), max_size=3)
    return st.builds(apply, changes, st.lists(st.integers(first, len(lines) - 1), max_size=3))


def restructured(text: str) -> st.SearchStrategy[bytes]:
    """The scene's tree with entries replaced, taken away, repeated or added; other effects in the model."""
    tree = tomllib.loads(text)
    paths = list(_paths(tree))
    change = st.tuples(
        st.sampled_from(["replace", "replace", "scale", "remove", "repeat", "add"]),
        st.sampled_from(paths),
        st.sampled_from(ODD),
        st.floats(allow_nan=False),
    )
    effects = st.none() | st.lists(st.sampled_from(effect_names()), max_size=4)

    def apply(changes: list[tuple[str, tuple[Any, ...], Any, float]], listed: list[str] | None) -> bytes:
        changed = copy.deepcopy(tree)
        for kind, path, odd, number in changes:
            with contextlib.suppress(KeyError, IndexError, TypeError, AttributeError):
                _change(changed, kind, path, odd, number)
        if listed is not None and isinstance(changed.get("model"), dict):
            changed["model"]["effects"] = listed
        lines = (f"{toml_key(str(key))} = {toml_value(value)}" for key, value in changed.items())
        return "\n".join(lines).encode("utf-8", "surrogatepass")

    return st.builds(apply, st.lists(change, max_size=3), effects)


def _paths(node: Any, path: tuple[Any, ...] = ()) -> Any:
    entries = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in entries:
        yield (*path, key)
        yield from _paths(value, (*path, key))


def _change(tree: Any, kind: str, path: tuple[Any, ...], odd: Any, number: float) -> None:
    parent = tree
    for key in path[:-1]:
        parent = parent[key]
    match kind:
        case "replace":
            parent[path[-1]] = copy.deepcopy(odd)
        case "scale":
            parent[path[-1]] *= number
        case "remove":
            del parent[path[-1]]
        case "repeat":
            parent.append(copy.deepcopy(parent[path[-1]]))
        case "add":
            parent["extra" if isinstance(odd, bool) else str(odd)[:20]] = copy.deepcopy(odd)
