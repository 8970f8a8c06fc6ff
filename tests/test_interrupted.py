"""Runs that are interrupted, and readers that go away."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from astropy.table import Table

from tests.command_line import process, until
from tests.rotating_bodies import write_turning
from torchlc.cli import run
from torchlc.cli.program import after_interrupt
from torchlc.files.writing import LOCK_NAME, MANIFEST_NAME
from torchlc.inference.rotation import pole_grid


@pytest.mark.long
def test_an_interrupted_fit_resumes_to_the_same_answer_and_a_second_one_is_refused(
    case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Ctrl-C ends with 130 and says how to go on; the result is that of an undisturbed run."""

    def arguments(name: str) -> list[str]:
        return ["fit", *case, "-o", str(tmp_path / name), "--steps", "300", "--seed", "3", "--quiet"]

    first = process(*arguments("b"))
    until(lambda: (tmp_path / "b" / "chain.h5").exists(), first)
    assert run(arguments("b")) == 2
    error = capsys.readouterr().err
    assert f"in use by another run: process {first.pid}" in error and len(error.splitlines()) == 1
    first.send_signal(signal.SIGINT)
    _, error = first.communicate(timeout=180)
    assert first.returncode == 130
    assert error.splitlines() == [
        f"torchlc: interrupted; continue with: torchlc {' '.join(arguments('b'))} --resume"
    ]
    assert run([*arguments("b"), "--resume"]) == 0
    assert run(arguments("a")) == 0
    told = [json.loads((tmp_path / name / "fit.json").read_text()) for name in "ab"]
    for one in told:
        del one["seconds"], one["provenance"]
    assert told[0] == told[1]
    assert not [p for p in (tmp_path / "b").iterdir() if p.name.startswith(".")]


def test_an_interrupted_diagnosis_leaves_nothing_and_says_how_to_begin_again(
    case: tuple[str, str], tmp_path: Path
):
    arguments = ["diagnose", *case, "-o", str(tmp_path / "out"), "--quiet"]
    worker = process(*arguments)
    until((tmp_path / "out" / LOCK_NAME).exists, worker)
    worker.send_signal(
        signal.SIGINT
    )  # before the scene's own model is fitted, without which there is no verdict
    said, error = worker.communicate(timeout=180)
    assert worker.returncode == 130 and not said
    assert error.splitlines() == [f"torchlc: interrupted; begin again with: torchlc {' '.join(arguments)}"]
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_an_interrupted_rotation_goes_on_from_what_it_had(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Ctrl-C after the grid of poles: 130 and one line, which without -o says that nothing was kept. The same command again does
    not work out the grid a second time."""
    arguments = ["rotation", *map(str, write_turning(tmp_path)), "-o", str(tmp_path / "out"), "--quiet"]
    worker = process(*arguments)
    until((tmp_path / "out" / "search.pt").exists, worker)
    worker.send_signal(signal.SIGINT)
    said, error = worker.communicate(timeout=180)
    assert worker.returncode == 130 and not said
    assert error.splitlines() == [f"torchlc: interrupted; continue with: torchlc {' '.join(arguments)}"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"search.pt", MANIFEST_NAME}
    assert after_interrupt(arguments[:3]) == f"; begin again with: torchlc {' '.join(arguments[:3])}"

    def again(*_: object, **__: object) -> None:
        raise AssertionError("the grid is known")

    monkeypatch.setattr(pole_grid, "search", again)
    assert run(arguments) == 0
    assert not (tmp_path / "out" / "search.pt").exists() and (tmp_path / "out" / "rotation.json").exists()


@pytest.mark.parametrize("buffered", [True, False])
@pytest.mark.parametrize("command", ["effects", "materials --json", "fit --help"])
def test_a_reader_that_has_gone_away_is_no_error(command: str, buffered: bool):
    """As in ``torchlc effects | head -1``."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "torchlc", *command.split()], stdout=writer, stderr=subprocess.PIPE, text=True,
        check=False, env={**os.environ, "PYTHONUNBUFFERED": "" if buffered else "1"},
    )  # fmt: skip
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_chain_of_other_data_is_not_resumed(
    case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert run(["fit", *case, "-o", str(tmp_path / "out"), "--steps", "40", "--quiet"]) == 0
    other = Table.read(case[1], format="ascii.ecsv")
    other["mag"] += 0.05
    other.write(tmp_path / "other.ecsv", format="ascii.ecsv")
    arguments = [
        "fit",
        case[0],
        str(tmp_path / "other.ecsv"),
        "-o",
        str(tmp_path / "out"),
        "--steps",
        "40",
        "--resume",
    ]
    before = (tmp_path / "out" / "fit.json").read_bytes()
    capsys.readouterr()
    assert run(arguments) == 2
    assert "a chain of other data" in capsys.readouterr().err
    assert run([arguments[0], *case, *arguments[3:], "--seed", "4"]) == 2
    assert "a chain of seed 0; expected one of seed 4" in capsys.readouterr().err
    assert (tmp_path / "out" / "fit.json").read_bytes() == before


@pytest.mark.skipif(shutil.which("prlimit") is None, reason="needs prlimit")
def test_no_room_on_disk_is_3_and_leaves_no_half_file(case: tuple[str, str], tmp_path: Path):
    limited = subprocess.run(
        ["prlimit", "--fsize=20000", sys.executable, "-m", "torchlc", "fit", *case, "-o", str(tmp_path / "out"),
         "--steps", "40"],
        capture_output=True, text=True, check=False, env={**os.environ, "MPLCONFIGDIR": str(tmp_path)},
    )  # fmt: skip
    assert limited.returncode == 3, limited.stderr
    assert limited.stderr.startswith("torchlc: error: no room on disk")
    left = tmp_path / "out"
    assert not left.exists() or all(
        p.name in ("fit.json", MANIFEST_NAME) and json.loads(p.read_text()) for p in left.iterdir()
    )
