"""Arguments and files that are made to do harm are refused in one line, before they take time or memory."""

from __future__ import annotations

import struct
import time
from collections import Counter
from pathlib import Path

import h5py
import numpy as np
import pytest

import torchlc
from tests.good_input import MESH_SCENE, RECORDING, SCENE
from tests.hostile_files import attack
from torchlc.cli import run
from torchlc.errors import InputError
from torchlc.files.hdf5 import check_hdf5
from torchlc.files.toml import MOST_PARTS, parse_toml
from torchlc.inference.period import MOST_FREQUENCIES, find_period
from torchlc.readers import load_recording

LONG = "x" * 300


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", f"{LONG}.toml", "r.csv", "-o", "o"],
        ["simulate", "s.toml", f"{LONG}.csv", "-o", "o"],
        ["simulate", "s.toml", "r.csv", "-o", LONG],
        ["simulate", "s.toml", "r.csv", "-o", f"{LONG}/{LONG}"],
        ["simulate", "s.toml", "r.csv", "-o", ""],
        ["fit", "s.toml", "r.csv", "-o", ""],
        ["diagnose", "s.toml", "r.csv", "-o", ""],
        ["rotation", "s.toml", "r.csv", "-o", ""],
        ["predict", "s.toml", "-o", ""],
        ["demo", "-o", ""],
        ["campaign", "r.csv", "-o", ""],
        ["campaign", LONG, "-o", "o"],
        ["predict", LONG, "-o", "o"],
        ["simulate", "s.toml", "r.csv", "-o", "/proc/nowhere/out"],
        ["simulate", "s.toml", "r.csv", "-o", "s.toml/out"],
        ["simulate", "", "r.csv", "-o", "o"],
        ["simulate", "s.toml", "", "-o", "o"],
        ["simulate", "s.toml", "/dev/zero", "-o", "o"],
        ["period", "/proc/self/mem"],
        ["init", "none/such/s.toml", "--tle", "s.toml"],
        ["init", f"{LONG}.toml", "--tle", "s.toml"],
        ["init", "x.toml", "--tle", "/dev/zero"],
        *(
            ["simulate", "s.toml", "--start", start, "--hours", "1", "--cadence", "600", "-o", "o"]
            for start in ("٢٠٢٠-10-17", "2020-10-17T15:61:00", "1e999", "nan", "9" * 500, "1_0", "", "0001-01-01")
        ),
        ["simulate", "s.toml", "--start", "2020-10-17", "--hours", "1e9", "--cadence", "1", "-o", "o"],
    ],
    ids=lambda arguments: " ".join(arguments)[:60],
)  # fmt: skip
def test_one_line_and_exit_2(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(SCENE)
    Path("r.csv").write_text(RECORDING)
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("torchlc: error: ") and len(error.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.csv", "s.toml"]


@pytest.mark.parametrize("end", [" = 1", "]\nb = 1"])
def test_a_key_of_many_parts_is_refused_before_it_is_parsed(end: str):
    """50,000 parts took 47 s and 4.4 GB. What a scene holds is read, also where text has as many points."""
    began = time.process_time()
    with pytest.raises(InputError, match=f"line 2: a key of more than {MOST_PARTS} parts"):
        parse_toml("a = 1\n" + ("[" if end.startswith("]") else "") + ".".join("k" * 50_000) + end, "s.toml")
    assert time.process_time() - began < 1.0
    assert parse_toml("a.b.c = 1\n'x.y'.\"z\" = [0.5, 1.5]\n", None) == {
        "a": {"b": {"c": 1}},
        "x.y": {"z": [0.5, 1.5]},
    }
    began = time.process_time()
    parse_toml('name = "' + "word " * 200_000 + '"', None)
    assert time.process_time() - began < 1.0


@pytest.mark.long
def test_a_period_of_nothing_is_bounded(tmp_path: Path):
    """Asked for turns of 1e-9 s, the search stops at its most frequencies and says so; 2 GB and a minute before."""
    seconds = 30.0 * np.arange(12)
    rows = [f"{2459140.1 + t / 86400:.8f},{10 + 0.3 * np.sin(t / 40):.4f},0.02" for t in seconds]
    (tmp_path / "r.csv").write_text("\n".join(["time,mag,mag_err", *rows]) + "\n")
    recording = load_recording(tmp_path / "r.csv")
    for shortest in (1e-9, 5e-324):
        found = find_period(recording, shortest_s=shortest)
        assert any(f"{MOST_FREQUENCIES:,} frequencies are the most" in text for text in found.warnings)


def test_a_file_that_declares_more_than_it_holds(tmp_path: Path):
    """1e9 draws in a kilobyte of HDF5, 4e9 faces in 84 bytes, 1e9 corners in a header: refused, and nothing is allocated."""
    path = tmp_path / "posterior.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("posterior/panel.n", shape=(10**9, 4), dtype="f8", chunks=(10**6, 1))
    assert path.stat().st_size < 10_000
    for read in (lambda: check_hdf5(path, "x"), lambda: torchlc.predict(tmp_path, date="2020-10-17")):
        with pytest.raises(InputError, match="bytes of numbers are declared"):
            read()
    with h5py.File(path, "w") as file:
        file["posterior"] = h5py.ExternalLink("/etc/passwd", "/")
    with pytest.raises(InputError, match="a link"):
        check_hdf5(path, "x")
    (tmp_path / "r.csv").write_text(RECORDING)
    header = "ply\nformat ascii 1.0\nelement vertex {}\nproperty {} x\nproperty float y\nproperty float z\nelement face 1\n"
    header += "property list uchar int vertex_indices\nend_header\n"
    meshes = {
        "body.stl": b"\0" * 80 + struct.pack("<I", 2**32 - 1),
        "body.ply": header.format(10**9, "float").encode() + b"0 0 0\n",
        "list.ply": header.format(1, "list uchar float").encode() + b"0 0 0\n3 0 0 0\n",
    }
    for name, content in meshes.items():
        (tmp_path / name).write_bytes(content)
        scene = tmp_path / "s.toml"
        scene.write_text(MESH_SCENE.replace("body.obj", name))
        with pytest.raises(InputError, match=name):
            torchlc.simulate(scene, tmp_path / "r.csv")


@pytest.mark.long
def test_hostile_files_are_read_or_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One of each kind of damage for each kind of file; ``python -m tests.hostile_files FOLDER 14`` tries 588."""
    monkeypatch.chdir(tmp_path)
    for what, by_damage in attack(tmp_path / "private", 1).items():
        outcomes = sum(by_damage.values(), Counter())
        assert set(outcomes) <= {"done", "refused"}, what
        assert outcomes["refused"], what
