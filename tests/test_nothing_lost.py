"""``kill -9`` at any moment: what is there is whole, going on ends where an undisturbed run ends, and no process
is left behind. A full disk: an error in words, and no half file.
"""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.killed_runs import alive, check_files
from tests.small_case import write_case
from tests.warm import said
from torchlc.files.writing import LOCK_NAME

KILLS = 8
"""Half of them just after a file was written, where most can go wrong; ``python -m tests.killed_runs`` does more."""
ROOT = Path(__file__).parent.parent
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
QUICK = ["--quick", "--effects", "zero_point_drift"]


def write_manifest(folder: Path) -> Path:
    """Two diagnoses."""
    scene, recording = write_case(folder, rows=9)
    with (folder / "manifest.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["id", "scene", "recording", "task", "options"])
        writer.writerows([name, scene, recording, "diagnose", " ".join(QUICK)] for name in "ab")
    return folder / "manifest.csv"


@pytest.mark.timeout(900)
@pytest.mark.parametrize("verb", ["fit", "diagnose", "campaign"])
def test_killed_again_and_again(verb: str, tmp_path: Path, warm: tuple[str, Path]):
    scene, recording = map(str, write_case(tmp_path, rows=9))
    command = {  # one worker: two that are forked hold open what tells the other that its campaign is gone
        "fit": ["fit", scene, recording, "--steps", "160", "--walkers", "10", "--seed", "3"],
        "diagnose": ["diagnose", scene, recording, *QUICK],
        "campaign": ["campaign", str(write_manifest(tmp_path)), "--workers", "1"],
    }
    code, output, error = said(
        warm[0], ["killed", str(tmp_path / "runs"), str(KILLS), *command[verb], "--quiet"], env=ENVIRONMENT
    )
    assert code == 0, error[-2000:]
    told = json.loads(output.splitlines()[-1])
    assert told["killed"] == KILLS and told["left"] > 0


def test_a_killed_campaign_takes_its_workers_along(tmp_path: Path):
    command = [
        "campaign",
        str(write_manifest(tmp_path)),
        "-o",
        str(tmp_path / "out"),
        "--workers",
        "2",
        "--quiet",
    ]
    campaign = subprocess.Popen(
        [sys.executable, "-m", "torchlc", *command], env=ENVIRONMENT, start_new_session=True
    )
    until(lambda: any((tmp_path / "out").glob(f"objects/*/{LOCK_NAME}")))
    campaign.send_signal(signal.SIGKILL)
    campaign.wait()
    until(lambda: not alive(campaign.pid), 30)
    check_files(tmp_path / "out")


def until(condition: Callable[[], bool], seconds: float = 200) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("verb", ["diagnose", "campaign"])
def test_no_room_on_disk_is_3_and_leaves_no_half_file(verb: str, tmp_path: Path, warm: tuple[str, Path]):
    scene, recording = map(str, write_case(tmp_path, rows=9))
    command = {
        "diagnose": ["diagnose", scene, recording, *QUICK],
        "campaign": ["campaign", str(write_manifest(tmp_path)), "--workers", "1"],
    }
    arguments = ["torchlc", *command[verb], "-o", str(tmp_path / "out")]
    code, output, error = said(warm[0], arguments, env=ENVIRONMENT, most_bytes=3000)
    assert code == 3, error
    assert error.startswith("torchlc: error: no room on disk")
    assert len(error.splitlines()) == 1 and not output
    check_files(tmp_path / "out")
    assert not list((tmp_path / "out").rglob(".*"))
