"""One run at a time in a directory, files whole or not at all, and a full disk said in words."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from torchlc.errors import BusyError, InputError, ResourceError
from torchlc.files.writing import LOCK_NAME, MANIFEST_NAME, OutputDirectory, without_nan, write_whole

HOLD = """
import sys, time
from torchlc.files.writing import OutputDirectory
with OutputDirectory(sys.argv[1]) as directory:
    directory.write_text("early.txt", "whole")
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path: Path):
    """A live process that holds ``tmp_path / "out"``."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "out")], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_the_second_run_is_refused_while_the_first_lives_and_let_in_after_it_is_killed(
    holder: subprocess.Popen[str], tmp_path: Path
):
    with (
        pytest.raises(BusyError, match=f"process {holder.pid}, started 20"),
        OutputDirectory(tmp_path / "out"),
    ):
        pass
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (tmp_path / "out" / LOCK_NAME).exists(), "a killed process leaves its lock file"
    with OutputDirectory(tmp_path / "out") as directory:
        directory.write_text("late.txt", "whole")
    assert listed(tmp_path / "out") == ["early.txt", "late.txt", MANIFEST_NAME]


def listed(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_writer_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path):
    def half(path: Path) -> None:
        path.write_text("half")
        raise ValueError("in the middle")

    with OutputDirectory(tmp_path) as directory:
        directory.write_text("fit.json", "old")
        with pytest.raises(ValueError, match="in the middle"):
            directory.write("fit.json", half)
    assert listed(tmp_path) == ["fit.json", MANIFEST_NAME]
    assert (tmp_path / "fit.json").read_text() == "old"


def test_a_directory_made_in_vain_is_taken_away(tmp_path: Path):
    with pytest.raises(KeyError), OutputDirectory(tmp_path / "a" / "b"):
        raise KeyError
    assert not any(tmp_path.iterdir())


def test_partial_files_of_a_killed_run_are_cleared_and_those_of_others_stay(tmp_path: Path):
    """The lock that a killed process leaves says whose they are."""
    others = ["notes.partial", ".notes.partial", ".chain.h5.124.partial", "chain.h5.123.partial"]
    for name in (*others, ".chain.h5.123.partial", ".fit.json.123-1.partial"):
        (tmp_path / name).write_text("half")
    (tmp_path / LOCK_NAME).write_text(json.dumps({"pid": 123, "started": "2020-01-01T00:00:00Z"}))
    with OutputDirectory(tmp_path):
        assert listed(tmp_path) == sorted([*others, LOCK_NAME])
    assert listed(tmp_path) == sorted(others)


def test_a_place_that_cannot_hold_a_directory_is_bad_input(tmp_path: Path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="-o"), OutputDirectory(path):
            pass


FULL = """
import resource, sys, h5py, numpy
from pathlib import Path
from torchlc.errors import ResourceError
from torchlc.files.writing import OutputDirectory
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
def hdf5(path):
    with h5py.File(path, "w") as file:
        file["data"] = numpy.ones(100_000)
with OutputDirectory(sys.argv[1]) as directory:
    directory.write_text("small.txt", "fits")
    for name, writer in (("bytes", lambda path: path.write_bytes(bytes(200_000))), ("hdf5", hdf5)):
        try:
            directory.write(name, writer)
        except ResourceError as error:
            print(name, error.exit_code, error)
"""


def test_a_file_limit_is_told_as_a_full_disk_and_leaves_no_half_file(tmp_path: Path):
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path)], capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()
    assert [line.split()[:2] for line in lines] == [["bytes", "3"], ["hdf5", "3"]]
    assert all("no room on disk" in line for line in lines)
    assert listed(tmp_path) == ["small.txt", MANIFEST_NAME]


def test_a_disk_without_room_for_a_lock_keeps_nothing(tmp_path: Path):
    text = FULL.replace("100_000, 100_000", "0, 0")
    command = [sys.executable, "-c", text, str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "ResourceError: no room on disk" in done.stderr
    assert not (tmp_path / "out").exists()


def test_json_has_no_nan(tmp_path: Path):
    content = {
        "a": [1.0, math.nan, np.float64(math.inf)],
        "b": {"c": np.bool_(True), "d": np.int64(3)},
        "e": (None, "x"),
    }
    with OutputDirectory(tmp_path) as directory:
        path = directory.write_json("a.json", content)
    assert json.loads(path.read_text()) == {
        "a": [1.0, None, None],
        "b": {"c": True, "d": 3},
        "e": [None, "x"],
    }
    assert without_nan(-math.inf) is None


RACE = """
import sys, time
from pathlib import Path
from torchlc.errors import BusyError
from torchlc.files.writing import OutputDirectory
while time.time() < float(sys.argv[2]):
    pass
try:
    with OutputDirectory(sys.argv[1]) as directory:
        assert not (directory.path / "inside").exists()
        directory.write_text("inside", "")
        time.sleep(0.3)
        (directory.path / "inside").unlink()
        print("ran")
except BusyError:
    print("refused")
"""


def test_of_several_runs_at_once_over_a_stale_lock_one_goes_in(tmp_path: Path):
    (tmp_path / LOCK_NAME).write_text(json.dumps({"pid": os.getpid(), "started": "long ago"}))
    start = str(time.time() + 1.5)
    racers = [
        subprocess.Popen(
            [sys.executable, "-c", RACE, str(tmp_path), start], stdout=subprocess.PIPE, text=True
        )
        for _ in range(4)
    ]
    said = sorted(racer.communicate()[0].strip() for racer in racers)
    assert said.count("ran") >= 1 and set(said) <= {"ran", "refused"}
    assert listed(tmp_path) == [MANIFEST_NAME]


def test_memory_that_runs_out_is_told():
    from torchlc.files.disk import resources

    for error in (MemoryError(), RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory")):
        with pytest.raises(ResourceError, match="out of memory"), resources():
            raise error


# ------------------------------------------------------------------ what is not ours


def made(path: Path, kind: str, target: Path) -> None:
    """Something at ``path`` that no run may replace; ``target`` is a file of the user's."""
    match kind:
        case "file":
            path.write_text("mine")
        case "directory":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "link":
            path.symlink_to(target)
        case "link to nothing":
            path.symlink_to(target.with_name("nothing"))


def state_of(path: Path) -> tuple[int, str | None]:
    status = path.lstat()
    return status.st_ino, path.read_text() if path.is_file() else None


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("file", "there, but not in torchlc-manifest.json"),
        ("directory", "a directory"),
        ("pipe", "a named pipe"),
        ("link", "a symbolic link"),
        ("link to nothing", "a symbolic link"),
    ],
)
def test_what_torchlc_did_not_write_is_refused_before_any_work(kind: str, said: str, tmp_path: Path):
    """Also where it comes while the run is at work, and by :func:`write_whole`, files excepted."""
    out, precious = tmp_path / "out", tmp_path / "precious"
    out.mkdir()
    precious.write_text("mine")
    made(out / "fit.json", kind, precious)
    before = state_of(out / "fit.json")
    with pytest.raises(InputError, match=said), OutputDirectory(out, ["report.html", "fit.json"]):
        raise AssertionError("the block must not begin")
    assert listed(out) == ["fit.json"]
    with OutputDirectory(out) as directory, pytest.raises(InputError, match=said):
        directory.write_text("fit.json", "ours")
    if kind != "file":
        with pytest.raises(InputError, match=said):
            write_whole(out / "fit.json", lambda path: path.write_text("ours"))
    assert state_of(out / "fit.json") == before and precious.read_text() == "mine"


@pytest.mark.parametrize("new_inode", [False, True])
def test_a_file_of_ours_that_somebody_changed_is_refused(new_inode: bool, tmp_path: Path):
    with OutputDirectory(tmp_path) as directory:
        directory.write_text("report.html", "ours")
    if new_inode:
        (tmp_path / "report.html").unlink()
    (tmp_path / "report.html").write_text("ours, and notes of mine")
    with (
        pytest.raises(InputError, match="changed since torchlc wrote it"),
        OutputDirectory(tmp_path, ["report.html"]),
    ):
        pass
    assert (tmp_path / "report.html").read_text() == "ours, and notes of mine"


def test_a_copied_folder_of_results_is_still_ours(tmp_path: Path):
    with OutputDirectory(tmp_path / "a") as directory:
        directory.write_text("fit.json", "old")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    with OutputDirectory(tmp_path / "b", ["fit.json"]) as directory:
        directory.write_text("fit.json", "new")
    assert [(tmp_path / name / "fit.json").read_text() for name in "ab"] == ["old", "new"]


def test_what_a_run_before_left_is_cleared_and_nothing_else(tmp_path: Path):
    with OutputDirectory(tmp_path) as directory:
        for name in ("posterior.nc", "corner.png", "traces.png", "curve.ecsv"):
            directory.write_text(name, "old")
    (tmp_path / "traces.png").write_text("changed by me")
    (tmp_path / "shares.png").write_text("mine")
    names = ["posterior.nc", "corner.png", "traces.png", "shares.png", "absent.png", "curve.ecsv"]
    os.link(tmp_path / "curve.ecsv", tmp_path / "input.ecsv")
    with OutputDirectory(tmp_path, inputs=[tmp_path / "input.ecsv"]) as directory:
        directory.clear(names)
        assert listed(tmp_path) == sorted(
            [LOCK_NAME, "curve.ecsv", "input.ecsv", "shares.png", MANIFEST_NAME, "traces.png"]
        )


def test_changed_files_are_set_aside(tmp_path: Path):
    for content in ("one", "two"):
        with OutputDirectory(tmp_path) as directory:
            directory.write_text("a", content)
            directory.write_text("b", content)
        (tmp_path / "a").write_text(f"{content} changed")
        with OutputDirectory(tmp_path) as directory:
            directory.set_aside()
    assert {path.name: path.read_text() for path in tmp_path.iterdir() if path.name != MANIFEST_NAME} == {
        "a.changed": "one changed",
        "a.changed-2": "two changed",
        "b": "two",
    }


@pytest.mark.parametrize("kind", ["file", "directory", "pipe", "link", "link to nothing", "hard link"])
def test_a_lock_that_is_none_is_refused_and_left_as_it_is(kind: str, tmp_path: Path):
    """A link's target was truncated before."""
    out, precious = tmp_path / "out", tmp_path / "precious"
    out.mkdir()
    precious.write_text("mine")
    if kind == "hard link":
        os.link(precious, out / LOCK_NAME)
    else:
        made(out / LOCK_NAME, kind, precious)
    before = state_of(out / LOCK_NAME)
    with pytest.raises(InputError, match="not a lock of torchlc"), OutputDirectory(out):
        pass
    assert state_of(out / LOCK_NAME) == before
    assert precious.read_text() == "mine" and listed(tmp_path) == ["out", "precious"]


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"schema": "other/1", "files": {}}', "\0", "[" * 9000])
def test_a_manifest_that_is_none_is_refused_and_left_as_it_is(content: str, tmp_path: Path):
    (tmp_path / MANIFEST_NAME).write_text(content)
    with pytest.raises(InputError, match="not readable as a manifest"), OutputDirectory(tmp_path):
        pass
    assert (tmp_path / MANIFEST_NAME).read_text() == content and listed(tmp_path) == [MANIFEST_NAME]


@pytest.mark.parametrize("kind", ["directory", "pipe", "link", "link to nothing"])
def test_a_manifest_that_is_no_file_is_refused(kind: str, tmp_path: Path):
    out, precious = tmp_path / "out", tmp_path / "precious"
    out.mkdir()
    precious.write_text('{"schema": "torchlc-manifest/1", "files": {}}')
    made(out / MANIFEST_NAME, kind, precious)
    with pytest.raises(InputError, match=r"a (directory|named pipe|symbolic link)"), OutputDirectory(out):
        pass
    assert listed(out) == [MANIFEST_NAME]


def test_a_half_written_file_never_goes_through_a_link(tmp_path: Path):
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / f".fit.json.{os.getpid()}.partial").symlink_to(precious)
    with OutputDirectory(tmp_path / "out") as directory:
        directory.write_text("fit.json", "ours")
    assert precious.read_text() == "mine" and (tmp_path / "out" / "fit.json").read_text() == "ours"


KILLED = """
import os, signal, sys
from pathlib import Path
from torchlc.files.writing import OutputDirectory
calls, last = 0, int(sys.argv[2])
def counted(event, arguments):
    global calls
    if event in ("open", "os.rename", "os.remove", "os.truncate", "os.fsync", "os.mkdir", "os.rmdir"):
        calls += 1
        if calls == last:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(counted)
with OutputDirectory(sys.argv[1], ["a", "b"]) as directory:
    directory.write_text("a", f"a {last}")
    directory.write_text("b", f"b {last}")
    directory.clear(["b"])
"""


@pytest.mark.long
def test_killed_at_every_call_on_files_it_can_begin_again(tmp_path: Path):
    """SIGKILL before the 1st, the 2nd, ... opening, renaming or removing of a file: the next run is let in, what is
    there is whole, and nothing half-written stays."""
    out, moment = tmp_path / "out", 0
    while True:
        moment += 1
        done = subprocess.run([sys.executable, "-c", KILLED, str(out), str(moment)], check=False)
        if done.returncode == 0:
            break
        assert done.returncode == -signal.SIGKILL
        with contextlib.suppress(FileNotFoundError):
            assert all(path.read_text()[:2] in ("a ", "b ") for path in out.glob("[ab]"))
        with OutputDirectory(out, ["a", "b"]):
            assert not list(out.glob(".*.partial"))
    assert moment > 20 and listed(out) == ["a", MANIFEST_NAME]
    assert (out / "a").read_text() == f"a {moment}"
