"""One run at a time in a directory, files whole or not at all, and a full disk said in words."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from torchlc.errors import BusyError, InputError, ResourceError
from torchlc.output import LOCK_NAME, OutputDirectory, without_nan

HOLD = """
import sys, time
from torchlc.output import OutputDirectory
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
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["early.txt", "late.txt"]


def test_a_writer_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path):
    def half(path: Path) -> None:
        path.write_text("half")
        raise ValueError("in the middle")

    with OutputDirectory(tmp_path) as directory:
        directory.write_text("fit.json", "old")
        with pytest.raises(ValueError, match="in the middle"):
            directory.write("fit.json", half)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("fit.json", "old")]


def test_a_directory_made_in_vain_is_taken_away(tmp_path: Path):
    with pytest.raises(KeyError), OutputDirectory(tmp_path / "a" / "b"):
        raise KeyError
    assert not any(tmp_path.iterdir())


def test_partial_files_of_a_killed_run_are_cleared(tmp_path: Path):
    (tmp_path / ".chain.h5.123.partial").write_text("half")
    with OutputDirectory(tmp_path):
        pass
    assert not any(tmp_path.iterdir())


def test_a_place_that_cannot_hold_a_directory_is_bad_input(tmp_path: Path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="-o"), OutputDirectory(path):
            pass


FULL = """
import resource, sys, h5py, numpy
from pathlib import Path
from torchlc.errors import ResourceError
from torchlc.output import OutputDirectory
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
    assert [p.name for p in tmp_path.iterdir()] == ["small.txt"]


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
from torchlc.output import OutputDirectory
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
    assert not any(tmp_path.iterdir())


def test_memory_that_runs_out_is_told():
    from torchlc.output import resources

    for error in (MemoryError(), RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory")):
        with pytest.raises(ResourceError, match="out of memory"), resources():
            raise error
