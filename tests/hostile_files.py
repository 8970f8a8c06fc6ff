"""Files of strangers, broken on purpose, through the commands that read them:

    python -m tests.hostile_files FOLDER EACH [NUMBERS]

Works in FOLDER. Each kind of file meets each kind of damage EACH times. Prints how often a command did its work or refused in one
line with nothing written, and what ended otherwise, took more than LONGEST_S of CPU or more memory than MOST_BYTES. NUMBERS, a file
of JSON, gets the counts: docs/how_to/hostile_files.json is one, and docs/fill_numbers.py makes the tables of the page from it.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import resource
import shutil
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.bad_recordings import RECORDING_CASES
from tests.bad_scenes import SCENE_CASES
from tests.good_input import ECSV, MESH_SCENE, RECORDING, SCENE
from torchlc.cli import run

LONGEST_S = 30.0
MOST_BYTES = 2 << 30
NUMBER = re.compile(rb"-?\d+\.?\d*(e[+-]?\d+)?")
ODD = [
    b"1e999", b"-1e308", b"nan", b"inf", b"0", b"-0", b"9" * 20, b"1_0", "٣".encode(), b"''", b'"', b"[]", b"{}", b"\0",
    b"5e-324", b"../../etc/passwd", b"true", b"1" * 5000,
]  # fmt: skip
NESTED = [
    b"\nx = " + b"[" * 5000,
    b"\n" + b".".join([b"k"] * 3000) + b" = 1",
    b"\nx = " + b"{a=" * 3000,
    b'\n"' * 4000,
]
MARKS = [b"\xef\xbb\xbf", b"\xff\xfe", b"\0\0\0\0", b"\x1f\x8b", b"%PDF-1.4\n", b"PK\x03\x04"]
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
STL = bytes(80) + struct.pack("<I", 1) + struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    b"property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)
ELEMENTS = (
    b"DEMO\n1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993\n"
    b"2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966\n"
)
MANIFEST = b"scene,recording,task\ns.toml,r.csv,fit\n"
HDF5 = b"\x89HDF\r\n\x1a\n" + bytes(200)
OUT = ["-o", "out", "--quiet"]
FILES = {
    "scene": ([("x.toml", SCENE.encode())], ["simulate", "x.toml", "r.csv", *OUT]),
    "recording, CSV": ([("x.csv", RECORDING.encode())], ["simulate", "s.toml", "x.csv", *OUT]),
    "recording, ECSV": ([("x.ecsv", ECSV.encode())], ["simulate", "s.toml", "x.ecsv", *OUT]),
    "two-line elements": ([("x.txt", ELEMENTS)], ["init", "out", "--tle", "x.txt", "--quiet"]),
    "mesh: OBJ, STL, PLY": (
        [("x.obj", OBJ), ("x.stl", STL), ("x.ply", PLY)],
        ["simulate", "m.toml", "r.csv", *OUT],
    ),
    "manifest": ([("x.csv", MANIFEST)], ["campaign", "x.csv", "--scheduler", "nonsense://", *OUT]),
    "posterior, HDF5": ([("fit/posterior.nc", HDF5)], ["predict", "fit", "--date", "2020-10-17", *OUT]),
}
"""What a file is: its names with sound contents, and the command that reads it."""
Damage = Callable[[random.Random, bytes], bytes]


def changed(rng: random.Random, content: bytes) -> bytes:
    made = bytearray(content)
    for _ in range(rng.choice([1, 5, 50])):
        made[rng.randrange(len(made))] = rng.randrange(256)
    return bytes(made)


def repeated(rng: random.Random, content: bytes) -> bytes:
    start = rng.randrange(len(content))
    end = min(len(content), start + rng.randrange(1, 40))
    return content[:start] + content[start:end] * rng.choice([2, 50, 2000]) + content[end:]


def odd_number(rng: random.Random, content: bytes) -> bytes:
    numbers = list(NUMBER.finditer(content))
    if not numbers:
        return changed(rng, content)
    chosen = rng.choice(numbers)
    return content[: chosen.start()] + rng.choice(ODD) + content[chosen.end() :]


DAMAGES: dict[str, Damage] = {
    "bytes changed": changed,
    "cut off": lambda rng, content: content[: rng.randrange(len(content))],
    "a piece repeated": repeated,
    "an odd number": odd_number,
    "deep nesting, long keys": lambda rng, content: content + rng.choice(NESTED),
    "marks of another format": lambda rng, content: rng.choice(MARKS) + content,
}


def outcome(command: list[str]) -> str:
    """ "done", "refused", or what is wrong with the end of a command."""
    shutil.rmtree("out", ignore_errors=True)
    Path("out").unlink(missing_ok=True)
    output, error, began = io.StringIO(), io.StringIO(), time.process_time()
    before = _most_memory()  # a test before this one may have had more
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(error):
        code = run(command)
    said, seconds = error.getvalue(), time.process_time() - began
    if code not in (0, 2) or "Traceback" in said:
        return f"exit {code}: {said[:200]}"
    if code == 2 and (len(said.splitlines()) != 1 or Path("out").exists()):
        return f"exit 2, but not in one line with nothing written: {said[:200]}"
    if seconds > LONGEST_S:
        return f"{seconds:.0f} s"
    if _most_memory() - before > MOST_BYTES:
        return "more than 2 GiB"
    return "refused" if code else "done"


def _most_memory() -> int:
    """The most that this process has held so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def attack(folder: Path, each: int) -> dict[str, dict[str, Counter[str]]]:
    """Outcomes by kind of file and kind of damage; every case with the same seed is the same file."""
    folder.mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    Path("fit").mkdir(exist_ok=True)
    Path("s.toml").write_text(SCENE)
    Path("r.csv").write_text(RECORDING)
    rng = random.Random(11)
    table: dict[str, dict[str, Counter[str]]] = {}
    for what, (contents, command) in FILES.items():
        table[what] = {kind: Counter() for kind in DAMAGES}
        for kind, damage in DAMAGES.items():
            for _ in range(each):
                name, content = rng.choice(contents)
                Path(name).write_bytes(damage(rng, content))
                Path("m.toml").write_text(MESH_SCENE.replace("body.obj", name))
                table[what][kind][outcome(command)] += 1
        print(f"{what}: {dict(sum(table[what].values(), Counter()))}", flush=True)
    return table


def numbers(table: dict[str, dict[str, Counter[str]]]) -> dict[str, Any]:
    """The counts for the page: broken files by kind of file and of damage, and the inputs that somebody wrote by hand."""

    def counts(outcomes: Counter[str]) -> dict[str, int]:
        told = {name: outcomes[name] for name in ("done", "refused")}
        return told | {"else": outcomes.total() - sum(told.values())}

    return {
        "files": {
            what: {"command": FILES[what][1][0], **counts(sum(table[what].values(), Counter()))}
            for what in table
        },
        "damages": {
            kind: counts(sum((by_damage[kind] for by_damage in table.values()), Counter()))
            for kind in DAMAGES
        },
        "by_hand": {"scenes": len(SCENE_CASES), "recordings": len(RECORDING_CASES)},
    }


if __name__ == "__main__":
    target = Path(sys.argv[3]).absolute() if len(sys.argv) > 3 else None
    found = numbers(attack(Path(sys.argv[1]), int(sys.argv[2])))
    if target is not None:
        target.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
