"""Runs as whole processes, in places that are not made for them: the results are there, the exit code is the one promised,
and no traceback is shown. What ends a run from outside ends it in words and leaves no lock.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from matplotlib.figure import Figure

import torchlc
from tests.bad_input_cases import MESH_SCENE, RECORDING, SCENE
from tests.hostile_files import attack
from tests.small_case import write_case
from torchlc.cli import run
from torchlc.errors import InputError
from torchlc.figures import saving
from torchlc.files.hdf5 import check_hdf5
from torchlc.files.toml import MOST_PARTS, parse_toml
from torchlc.files.writing import LOCK_NAME
from torchlc.inference.period import MOST_FREQUENCIES, find_period
from torchlc.readers import load_recording

ROOT = Path(__file__).parent.parent
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
NAME = "Ω é"
FIT = ["--steps", "20", "--walkers", "10"]
WRITTEN = {"fit.json", "posterior.nc", "curve.png", "report.html"}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    scene, recording = write_case(tmp_path_factory.mktemp("case"), rows=9, name=NAME)
    return str(scene), str(recording)


def start(
    arguments: list[str], redirection: str = "", change: dict[str, str] | None = None
) -> subprocess.Popen[str]:
    """A Python process behind a shell's redirection."""
    command = ["sh", "-c", f'exec "$@" {redirection}', "sh", sys.executable, *arguments]
    return subprocess.Popen(
        command, env=ENVIRONMENT | (change or {}), text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


@pytest.mark.long
@pytest.mark.parametrize("kind", ["terminal", "notebook"])
def test_a_fit_is_whole_wherever_it_runs(kind: str, case: tuple[str, str], tmp_path: Path):
    """A home that is a file, letters of ASCII only and no standard error; through Python a notebook's backend, a matplotlibrc
    that wants a LaTeX, and warnings that are errors."""
    out = tmp_path / "out"
    if kind == "terminal":
        home = tmp_path / "home"
        home.write_text("a file")
        change = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"), str(home))
        change |= {"TERM": "dumb", "PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}
        process = start(["-m", "torchlc", "fit", *case, *FIT, "-o", str(out), "--json"], "2>&-", change)
    else:
        (tmp_path / "matplotlibrc").write_text("text.usetex: True\nfont.family: none of that name\n")
        change = {
            "MPLBACKEND": "module://a_notebook.backend",
            "MATPLOTLIBRC": str(tmp_path / "matplotlibrc"),
            "PYTHONWARNINGS": "error",
        }
        call = (
            f"import torchlc; torchlc.fit({case[0]!r}, {case[1]!r}, steps=20, walkers=10, out={str(out)!r})"
        )
        process = start(["-c", call], change=change)
    output, error = process.communicate()
    assert process.returncode == 0, error
    assert "Traceback" not in error
    assert {path.name for path in out.iterdir()} >= WRITTEN and not list(out.glob(".*"))
    assert "could not be drawn" not in (out / "report.html").read_text()
    if kind == "terminal":
        assert json.loads(output)["chi2"] == json.loads((out / "fit.json").read_text())["chi2"]


@pytest.mark.long
def test_without_standard_streams(case: tuple[str, str], tmp_path: Path):
    """A result is never written into the place of a stream that was closed."""
    process = start(["-m", "torchlc", "simulate", *case, "-o", str(tmp_path)], "<&- >&- 2>&-")
    process.communicate()
    assert process.returncode == 0
    text = (tmp_path / "curve.ecsv").read_text()
    assert text.startswith("# %ECSV") and "written" not in text


@pytest.mark.long
@pytest.mark.parametrize("redirection", ["", "<&- >&- 2>&-"])
def test_a_campaign_is_whole_wherever_it_runs(redirection: str, case: tuple[str, str], tmp_path: Path):
    """Processes of workers, with warnings that are errors; with streams, and with none."""
    manifest, out = tmp_path / "nights.csv", tmp_path / "out"
    rows = [f"{name},{case[0]},{case[1]},fit,{' '.join(FIT)}" for name in ("a", "b")]
    manifest.write_text("\n".join(["id,scene,recording,task,options", *rows]) + "\n", encoding="utf-8")
    arguments = ["-m", "torchlc", "campaign", str(manifest), "-o", str(out), "--workers", "2"]
    process = start(arguments, redirection, {"PYTHONWARNINGS": "error"})
    _, error = process.communicate()
    assert process.returncode == 0, error
    assert "Traceback" not in error
    for name in ("a", "b"):
        assert {path.name for path in (out / "objects" / name).iterdir()} >= WRITTEN
    assert json.loads((out / "campaign.json").read_text())["done"] == 2
    assert (out / "index.html").read_text().startswith("<!")


def test_a_figure_that_cannot_be_drawn_says_so(tmp_path: Path):
    """Neither an error while it is drawn nor one while it is rendered ends a run; the size stays."""

    def broken() -> Figure:
        raise ValueError("no $such thing")

    def unrenderable() -> Figure:
        figure = Figure(figsize=(3, 2))
        figure.text(0.5, 0.5, r"$\nonsense{$")
        return figure

    for draw in (broken, unrenderable):
        stream = io.BytesIO()
        saving.save(saving.drawn(draw, (3.0, 2.0)), stream, format="svg")
        assert b"could not be drawn" in stream.getvalue().replace(b"<!-- ", b"").replace(b"\n", b" ")
        saving.save(saving.drawn(draw, (3.0, 2.0)), tmp_path / "a.png", format="png", dpi=100)
        width, height = struct.unpack(">II", (tmp_path / "a.png").read_bytes()[16:24])
        assert (width, height) == (300, 200)


def until(condition: Callable[[], bool], seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "times", "code", "word"),
    [("SIGINT", 3, 130, "interrupted"), ("SIGHUP", 2, 143, "ended by SIGHUP")],
)
def test_a_signal_ends_a_run_in_words(
    name: str, times: int, code: int, word: str, case: tuple[str, str], tmp_path: Path
):
    """Also one that comes again while the first is heeded: locks and partial files go."""
    out = tmp_path / "out"
    process = start(["-m", "torchlc", "fit", *case, "-o", str(out), "--steps", "100000"])
    until((out / LOCK_NAME).exists)
    for _ in range(times):
        process.send_signal(getattr(signal, name))
        time.sleep(0.02)
    _, error = process.communicate(timeout=60)
    assert process.returncode == code
    assert error.startswith(f"torchlc: {word}") and len(error.splitlines()) == 1
    assert not out.exists() or not list(out.glob(".*"))


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 143)])
def test_a_signal_while_the_program_is_loaded(name: str, code: int):
    """As in the first tenths of a second: no traceback of a library that was being imported."""
    call = (
        "from torchlc.cli import signals; signals.leave_at_once(); print('there', flush=True); import time; "
        "time.sleep(60)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", call], env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == "there\n"
    process.send_signal(getattr(signal, name))
    _, error = process.communicate(timeout=60)
    assert process.returncode == code and error == ""


EVERYWHERE = """
import mmap, os, signal, sys
from torchlc import cli
from torchlc.cli import program

OURS = ("/cli/__init__.py", "/cli/program.py", "/cli/signals.py", "/torchlc/terminal.py")
sys.argv[1:] = ["--version"]
built = program.typer.main.get_command(program.app)  # once, as all that is loaded on first use
program.typer.main.get_command = lambda app: built
cli.run(sys.argv[1:])
lines = 0


def trace(frame, event, argument):
    global lines
    if not frame.f_code.co_filename.endswith(OURS):
        return None
    if event == "line" and signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        lines += 1
        if lines == at:
            sent[0] = 1
            os.kill(os.getpid(), signal.SIGINT)
    return trace


at, ends, sent = 0, set(), mmap.mmap(-1, 1)
sent[0] = 1
while sent[0]:
    at, sent[0] = at + 1, 0
    child = os.fork()
    if not child:
        sys.settrace(trace)
        try:
            cli.main()
        except SystemExit as end:
            os._exit(end.code)
    code = os.waitstatus_to_exitcode(os.wait()[1])
    ends.add(code)
    assert code in (0, 130), (at, code)
print(at, sorted(ends))
"""


def test_a_signal_at_every_line_between_start_and_end():
    """From the first handler to the end, in whichever line of the frame about a command a signal comes: 130 without a traceback,
    or the end it would have come to when all is done."""
    command = [sys.executable, "-c", EVERYWHERE]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert done.stdout.splitlines()[-1].endswith("[0, 130]")


def test_what_is_to_be_ignored_stays_ignored():
    """As under nohup: a SIGHUP that the parent ignores changes nothing."""
    call = (
        "import os, signal; from torchlc.cli import signals; signals.leave_at_once(); signals.unwind(); "
        "os.kill(os.getpid(), signal.SIGHUP); print('on')"
    )
    done = subprocess.run(
        ["sh", "-c", 'trap "" HUP; exec "$@"', "sh", sys.executable, "-c", call],
        env=ENVIRONMENT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout == "on\n" and done.returncode == 0, done.stderr


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


def may_mount() -> bool:
    """Whether a private file system of a megabyte can be had here."""
    unshare = shutil.which("unshare")
    if unshare is None:
        return False
    with contextlib.suppress(OSError):
        call = [unshare, "-rm", "sh", "-c", "mount -t tmpfs -o size=64k none /mnt"]
        return subprocess.run(call, capture_output=True, check=False).returncode == 0
    return False


ON_A_DISK_THAT_FILLS = """
import contextlib, importlib
from pathlib import Path
from tests.warm import LOADED
from torchlc.campaigns import processes
from torchlc.cli import run

for name in LOADED:
    importlib.import_module(name)
processes.START_METHOD = "fork"  # workers have them then

def campaign(manifest):
    return run(["campaign", manifest, "-o", "disk/out", "--workers", "1", "--quiet"])

assert campaign("one.csv") == 0
filler, done = Path("disk/filler"), Path("disk/out/objects/a/diagnosis.json")
with contextlib.suppress(OSError), filler.open("wb", buffering=0) as stream:
    while stream.write(bytes(4096)):
        pass
before = done.read_bytes()
code = campaign("two.csv")
assert done.read_bytes() == before
filler.unlink()
assert campaign("two.csv") == 0
assert Path("disk/out/objects/b/diagnosis.json").stat().st_size
print(code)
"""


@pytest.mark.long
@pytest.mark.skipif(not may_mount(), reason="needs unshare and the right to mount a tmpfs of its own")
def test_a_campaign_on_a_disk_that_fills_ends_with_3_and_keeps_what_is_done(
    case: tuple[str, str], tmp_path: Path
):
    """The disk of the first campaign is filled up after its object, and the campaign goes on with a second object."""
    options = "--quick --effects zero_point_drift"
    for name, ids in (("one.csv", "a"), ("two.csv", "ab")):
        rows = [f"{one},{case[0]},{case[1]},diagnose,{options}" for one in ids]
        (tmp_path / name).write_text("\n".join(["id,scene,recording,task,options", *rows]) + "\n")
    script = f'mount -t tmpfs -o size=3M none {tmp_path}/disk && cd {tmp_path} && exec "$@"'
    (tmp_path / "disk").mkdir()
    command = ["unshare", "-rm", "sh", "-c", script, "sh", sys.executable, "-c", ON_A_DISK_THAT_FILLS]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "3\n"), done.stderr
    assert "no room on disk" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.long
def test_hostile_files_are_read_or_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One of each kind of damage for each kind of file; ``python -m tests.hostile_files FOLDER 14`` tries 588."""
    monkeypatch.chdir(tmp_path)
    for what, by_damage in attack(tmp_path / "private", 1).items():
        outcomes = sum(by_damage.values(), Counter())
        assert set(outcomes) <= {"done", "refused"}, what
        assert outcomes["refused"], what
