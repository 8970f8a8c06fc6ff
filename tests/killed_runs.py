"""A command killed with ``kill -9`` at random moments and gone on with, again and again, beside the same command
left alone:  python -m tests.killed_runs FOLDER KILLS COMMAND...

Runs are forked from this process, which has imported everything, so that the moments fall into their work: into any
of it, and every second time into the little that follows the writing of a file. What a kill leaves behind is looked
at; a run that ends must end in the answer of the one left alone, and the next begins anew. Prints how many runs were
killed, how many ended, and how many whole files the killed ones left.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import arviz
import h5py
import pandas
import torch
from PIL import Image

from torchlc.campaigns import processes
from torchlc.campaigns.objects import read_record
from torchlc.cli import run

RESULTS = ("fit.json", "diagnosis.json", "rotation.json")
LATER = 1.1
"""The range of moments grows so with each kill until a run ends: other work on the machine may slow it down."""
SOON_S = 0.1
GONE_S = 60.0
"""What workers of a killed campaign may take to notice."""


def main(folder: Path, kills: int, command: list[str]) -> None:
    processes.START_METHOD = "fork"  # spawned workers would import for seconds
    random.seed(8)
    began = time.monotonic()
    assert wait(start([*command, "-o", str(folder / "alone")])) == 0
    longest = latest = time.monotonic() - began
    expected = answer(folder / "alone")
    assert expected, "there is an answer"
    killed = ended = left = 0
    out = folder / "0"
    while killed < kills:
        before = written(out)
        child = start(again(command, out))
        if killed % 2:
            while written(out) == before and running(child):
                time.sleep(0.001)
            time.sleep(random.uniform(0, SOON_S))
        else:
            time.sleep(random.uniform(0, latest))
        os.kill(child, signal.SIGKILL)
        code = wait(child)
        check_files(out)
        if code == -signal.SIGKILL:
            killed += 1
            latest *= LATER
            left += len(written(out))
        else:
            assert code == 0, code
            ended += 1
            latest = longest
            check_end(out, expected)
            out = folder / str(ended)
    assert wait(start(again(command, out))) == 0
    check_files(out)
    check_end(out, expected)
    print(json.dumps({"killed": killed, "ended": ended, "left": left}))


def again(command: list[str], out: Path) -> list[str]:
    """The command to go on with."""
    return [*command, "-o", str(out), *(["--resume"] if command[0] == "fit" else [])]


def start(arguments: list[str]) -> int:
    """The command in a process, and a session, of its own."""
    child = os.fork()
    if child == 0:
        os.setsid()
        os._exit(run(arguments))
    return child


def wait(child: int) -> int:
    """Its exit code, once nothing that it started is alive either."""
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    end = time.monotonic() + GONE_S
    while alive(child):
        assert time.monotonic() < end, "a process of a killed run lives on"
        time.sleep(0.01)
    return code


def running(child: int) -> bool:
    """Whether it has not ended, nor been waited for."""
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None


def written(folder: Path) -> dict[Path, int]:
    """Whole files, and when each was written."""
    found = {}
    for place, _, names in os.walk(folder):
        for name in names:
            if not name.startswith("."):
                with contextlib.suppress(FileNotFoundError):  # replaced while we look
                    found[Path(place, name)] = Path(place, name).stat().st_mtime_ns
    return found


def alive(session: int) -> bool:
    try:
        os.killpg(session, 0)
    except ProcessLookupError:
        return False
    return True


def answer(folder: Path) -> dict[str, Any]:
    """The results in ``folder``, but for when and how they were made."""
    found = {
        path.relative_to(folder): json.loads(path.read_text())
        for path in folder.rglob("*.json")
        if path.name in RESULTS
    }
    return {
        str(name): {key: value for key, value in content.items() if key not in ("seconds", "provenance")}
        for name, content in found.items()
    }


def check_end(folder: Path, expected: dict[str, Any]) -> None:
    assert answer(folder) == expected
    assert not list(folder.rglob(".*")), "nothing half-made is left, nor a lock"
    if (folder / "campaign.json").exists():
        told = json.loads((folder / "campaign.json").read_text())
        assert told["done"] == told["objects"] == len(expected) and not told["failures"]


def check_files(folder: Path) -> None:
    """Every file that does not begin with a dot is whole."""
    for path in written(folder):
        match path.suffix:
            case ".json":
                json.loads(path.read_text())
                if path.name == "object.json":
                    record = read_record(path.parent)
                    assert record is not None
                    files = record.get("files", {})
                    assert files == {name: (path.parent / name).stat().st_size for name in files}
            case ".h5":
                with h5py.File(path) as file:
                    group: Any = file["mcmc"]
                    rows = {len(group["chain"]), len(group["log_prob"]), int(group.attrs["iteration"])}
                    assert len(rows) == 1 and rows != {0}
            case ".nc":
                arviz.from_netcdf(path).posterior.load()
            case ".parquet":
                assert len(pandas.read_parquet(path))
            case ".csv":
                assert path.read_text().endswith("\n")
            case ".html":
                assert path.read_text().rstrip().endswith("</html>")
            case ".png":
                Image.open(path).load()
            case ".pt":
                assert torch.load(path, weights_only=True)["steps"]
            case ".toml":
                assert tomllib.loads(path.read_text())["attitude"]
            case _:
                raise AssertionError(f"an unknown file {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
