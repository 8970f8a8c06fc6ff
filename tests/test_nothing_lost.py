"""``kill -9`` at any moment: what is there is whole, and going on ends where an undisturbed run ends. A full disk: an error in words, and no half file."""

from __future__ import annotations

import csv
import errno
import json
import os
from pathlib import Path

import pytest
import torch

from tests.killed_runs import check_files
from tests.rotating_bodies import write_turning
from tests.small_case import write_case
from tests.warm import said
from torchlc.errors import ResourceError
from torchlc.files.steps import Steps
from torchlc.files.writing import write_whole

KILLS = {"fit": 6, "diagnose": 6, "campaign": 6, "rotation": 2}
"""Half of them just after a file was written, where most can go wrong; ``python -m tests.killed_runs`` does more. Each run of a
search for a rotation takes as long as several of the others."""
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


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("verb", KILLS)
def test_killed_again_and_again(verb: str, tmp_path: Path, warm: tuple[str, Path]):
    scene, recording = map(
        str, write_turning(tmp_path) if verb == "rotation" else write_case(tmp_path, rows=9)
    )
    command = {  # one worker: two that are forked hold open what tells the other that its campaign is gone
        "fit": ["fit", scene, recording, "--steps", "160", "--walkers", "10", "--seed", "3"],
        "diagnose": ["diagnose", scene, recording, *QUICK],
        "campaign": ["campaign", str(write_manifest(tmp_path)), "--workers", "1"],
        "rotation": ["rotation", scene, recording, "--shortest", "29.9", "--longest", "30.1"],
    }
    arguments = ["killed", str(tmp_path / "runs"), str(KILLS[verb]), *command[verb], "--quiet"]
    code, output, error = said(warm[0], arguments, env=ENVIRONMENT)
    assert code == 0, error[-2000:]
    told = json.loads(output.splitlines()[-1])
    assert told["killed"] == KILLS[verb] and told["left"] > 0


@pytest.mark.long
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


class Stage:
    """A result of a stage of a search."""

    def __init__(self, light: torch.Tensor) -> None:
        self.light = light


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_full_disk_under_the_steps_of_a_search_is_told_as_one():
    """PyTorch's own writer makes a RuntimeError of it, which says nothing of disks."""
    steps = Steps("key", write=lambda fill: fill(Path("/dev/full")))
    with pytest.raises(OSError) as caught:
        steps.of("stage", Stage, lambda: [Stage(torch.zeros(100_000))])
    assert caught.value.errno == errno.ENOSPC


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_steps_of_a_search_that_were_cut_short_are_made_anew(share: float, tmp_path: Path):
    path = tmp_path / "search.pt"
    Steps("key", write=lambda fill: fill(path)).of("stage", Stage, lambda: [Stage(torch.arange(100.0))])
    whole = path.read_bytes()
    again = Steps("key", path)
    assert again.resumed and again.of("stage", Stage, list)[0].light.tolist() == list(range(100))
    path.write_bytes(whole[: int(share * len(whole))])
    assert not Steps("key", path).resumed


def test_a_full_disk_is_told_with_the_name_of_the_result(tmp_path: Path):
    """Not with the name that the file has while it is written."""

    def fill(partial: Path) -> None:
        write_whole(
            partial, lambda inner: (_ for _ in ()).throw(OSError(errno.ENOSPC, "No space left on device"))
        )

    with pytest.raises(ResourceError, match=r"no room on disk for \S*/curve\.ecsv;"):
        write_whole(tmp_path / "curve.ecsv", fill)
    assert not list(tmp_path.iterdir())
