"""Outputs beside other people's files: what is never replaced, and what is recorded of the inputs."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

import torchlc
from tests.command_line import TLE, process, until
from tests.small_case import write_case
from torchlc.cli import run
from torchlc.files.writing import MANIFEST_NAME


def contents(folder: Path) -> dict[str, tuple[int, bytes | None]]:
    """Every entry below ``folder``: what it is, and what it holds."""
    return {
        str(path.relative_to(folder)): (path.lstat().st_mode, path.read_bytes() if path.is_file() else None)
        for path in folder.rglob("*")
    }


def refused_with(arguments: list[str], folder: Path, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 2, one line, and everything in ``folder`` as it was."""
    before = contents(folder)
    capsys.readouterr()
    assert run(arguments) == 2
    told = capsys.readouterr()
    assert told.out == "" and len(told.err.splitlines()) == 1 and said in told.err, told.err
    assert contents(folder) == before


GRID = ["--start", "2020-10-17T15:00:00", "--hours", "1", "--cadence", "1200"]


@pytest.mark.parametrize("link", ["itself", "symbolic", "hard", "folder"])
def test_an_output_that_is_an_input_is_refused(
    link: str, case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Although torchlc wrote it, and by whatever name it is given."""
    out = tmp_path / "D"
    assert run(["simulate", case[0], *GRID, "--noise", "0.02", "-o", str(out), "--quiet"]) == 0
    given = out / "curve.ecsv"
    if link == "symbolic":
        given = tmp_path / "night.ecsv"
        given.symlink_to(out / "curve.ecsv")
    elif link == "hard":
        given = tmp_path / "night.ecsv"
        os.link(out / "curve.ecsv", given)
    elif link == "folder":
        (tmp_path / "E").symlink_to(out)
        given = tmp_path / "E" / "curve.ecsv"
    arguments = ["simulate", case[0], str(given), "-o", str(out)]
    refused_with(arguments, tmp_path, "curve.ecsv: an input of this run", capsys)
    assert run([*arguments[:-1], str(tmp_path / "other"), "--quiet"]) == 0


@pytest.mark.parametrize("verb", ["fit", "diagnose"])
def test_inputs_named_as_outputs_are_refused(
    verb: str, case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """A recording called report.html, and a scene of that name at the end of a hard link."""
    shutil.copy(case[1], tmp_path / "report.html")
    arguments = [verb, case[0], str(tmp_path / "report.html"), "-o", str(tmp_path)]
    refused_with(arguments, tmp_path, "report.html: an input of this run", capsys)
    (tmp_path / "report.html").unlink()
    shutil.copy(case[0], tmp_path / "scene.toml")
    os.link(tmp_path / "scene.toml", tmp_path / "report.html")
    arguments = [verb, str(tmp_path / "scene.toml"), case[1], "-o", str(tmp_path)]
    refused_with(arguments, tmp_path, "report.html: an input of this run", capsys)


def test_a_campaign_does_not_replace_its_list(
    case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "summary.csv").write_text(f"scene,recording,task\n{case[0]},{case[1]},fit\n")
    arguments = ["campaign", str(tmp_path / "summary.csv"), "-o", str(tmp_path), "--workers", "1"]
    refused_with(arguments, tmp_path, "summary.csv: an input of this run", capsys)
    (tmp_path / "summary.csv").rename(tmp_path / "list.csv")
    (tmp_path / "objects").write_text("mine")
    arguments[1] = str(tmp_path / "list.csv")
    refused_with(arguments, tmp_path, "objects: a file; expected a directory", capsys)


@pytest.mark.parametrize("name", ["scene.toml", "recording.ecsv", "report.html", "diagnosis.json"])
def test_the_demo_leaves_files_that_are_not_its_own(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / name).write_text("mine")
    refused_with(
        ["demo", "-o", str(tmp_path)], tmp_path, f"{name}: there, but not in {MANIFEST_NAME}", capsys
    )


def test_results_of_a_version_without_manifest_are_refused_in_words(
    case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "out"
    arguments = ["simulate", case[0], *GRID, "-o", str(out), "--quiet"]
    assert run(arguments) == 0
    (out / MANIFEST_NAME).unlink()
    refused_with(
        arguments, tmp_path, "where an earlier version left it, which kept no manifest, remove it", capsys
    )
    (out / "curve.ecsv").unlink()
    assert run(arguments) == 0


def test_a_directory_holds_what_one_run_wrote(
    case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Of a fit, then of one in which nothing is free, then of a diagnosis; with the user's files kept."""
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / ".fit.json.77.partial").write_text("mine")
    (tmp_path / "traces.partial").write_text("mine")
    mine = {"notes.txt", ".fit.json.77.partial", "traces.partial", MANIFEST_NAME}

    def left() -> set[str]:
        return {path.name for path in tmp_path.iterdir()} - mine

    evaluated = {"fit.json", "report.html", "curve.png", "shares.png", "object.png"}
    sampled = {"posterior.nc", "corner.png", "traces.png", "chain.h5"}
    assert run(["fit", *case, "-o", str(tmp_path), "--steps", "30", "--quiet"]) == 0
    assert left() == evaluated | sampled
    assert run(["fit", *case, "-o", str(tmp_path), "--steps", "30", "--quiet", "--resume"]) == 0
    assert left() == evaluated | sampled, "a chain that needs no more steps stays"
    scene = Path(case[0]).parent / "fixed.toml"
    scene.write_text(re.sub(r"\{ value = ([-\d.]+)[^}]*\}", r"\1", Path(case[0]).read_text()))
    assert run(["fit", str(scene), case[1], "-o", str(tmp_path), "--quiet"]) == 0
    assert left() == evaluated
    quick = ["--quick", "--effects", "panel_offset", "--quiet"]
    assert run(["diagnose", *case, "-o", str(tmp_path), *quick]) == 0
    assert left() == {"diagnosis.json", "report.html", "curve.png", "object.png"}


@pytest.mark.parametrize("kind", ["pipe", "directory", "link", "link to nothing", "elements", "hard link"])
def test_init_with_force_replaces_only_a_file(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    elements, scene, precious = tmp_path / "tle.txt", tmp_path / "my.toml", tmp_path / "precious"
    elements.write_text(TLE)
    precious.write_text("mine")
    said = "an input of this run"
    match kind:
        case "pipe":
            os.mkfifo(scene)
            said = "a named pipe"
        case "directory":
            scene.mkdir()
            said = "a directory"
        case "link":
            scene.symlink_to(precious)
            said = "a symbolic link"
        case "link to nothing":
            scene.symlink_to(tmp_path / "nothing")
            said = "a symbolic link"
        case "elements":
            scene = elements
        case "hard link":
            os.link(elements, scene)
    for more in (["--force"], []):
        refused_with(["init", str(scene), "--tle", str(elements), *more], tmp_path, said, capsys)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root could replace a device")
def test_init_with_force_leaves_a_device(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "tle.txt").write_text(TLE)
    try:
        os.mknod(tmp_path / "my.toml", 0o666 | stat.S_IFCHR, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("this system lets nobody make a device")
    arguments = ["init", str(tmp_path / "my.toml"), "--tle", str(tmp_path / "tle.txt"), "--force"]
    refused_with(arguments, tmp_path, "my.toml: a device", capsys)


def test_init_says_that_a_folder_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "tle.txt").write_text(TLE)
    arguments = ["init", str(tmp_path / "no" / "my.toml"), "--tle", str(tmp_path / "tle.txt")]
    refused_with(arguments, tmp_path, "no directory", capsys)


@pytest.mark.long
def test_provenance_is_of_the_bytes_that_were_read(tmp_path: Path):
    """Against sha256sum before the run: while the chain grows every file is changed."""
    names = ["scene.toml", "recording.ecsv", "elements.txt", "attitude.csv", "cube.stl"]
    scene, recording = write_case(tmp_path, rows=9)
    trimesh.creation.box((1.0, 1.0, 1.0)).export(tmp_path / "cube.stl")
    hours = np.arange(-1, 6)
    attitude = [f"2020-10-17T{15 + hour:02d}:00:00,1,0,0,0" for hour in hours]
    (tmp_path / "attitude.csv").write_text("\n".join(["time,q0,q1,q2,q3", *attitude]) + "\n")
    text = scene.read_text()
    lines = re.search(r"tle\s*=\s*\[(.*?)\]", text, re.S)
    assert lines is not None
    (tmp_path / "elements.txt").write_text("\n".join(re.findall(r'"(.*?)"', lines[1])) + "\n")
    text = text.replace(lines[0], 'tle_file = "elements.txt"')
    text = re.sub(r'mode = "nadir"', 'mode = "quaternions"\nfile = "attitude.csv"', text)
    scene.write_text(
        text + '\n[[components]]\nname = "cube"\nshape = "mesh"\nfile = "cube.stl"\ncentre = [0, 0, 9]\n'
        'material = "body"\n'
    )
    said = subprocess.run(
        ["sha256sum", *names], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    expected = {name: digest for digest, name in map(str.split, said.splitlines())}
    out = tmp_path / "out"
    worker = process(
        "fit", str(scene), str(recording), "-o", str(out), "--steps", "300", "--walkers", "14", "--quiet"
    )
    until((out / "chain.h5").exists, worker)
    for name in names[:-1]:
        with (tmp_path / name).open("a") as stream:
            stream.write("# changed\n")
    trimesh.creation.box((2.0, 1.0, 1.0)).export(tmp_path / "cube.stl")
    assert worker.poll() is None, "it goes on"
    _, error = worker.communicate(timeout=240)
    assert worker.returncode == 0, error
    inputs = json.loads((out / "fit.json").read_text())["provenance"]["inputs"]
    assert {one["file"]: one["sha256"] for one in inputs.values()} == expected


def test_a_file_that_changes_between_two_models_is_refused(tmp_path: Path):
    """Every model reads the files of its scene; here one grows between the first and the second."""
    scene, recording = write_case(tmp_path, rows=9)
    (tmp_path / "elements.txt").write_text(TLE.split("\n", 3)[1] + "\n" + TLE.split("\n", 3)[2] + "\n")
    text = re.sub(r"tle\s*=\s*\[(.*?)\]", 'tle_file = "elements.txt"', scene.read_text(), flags=re.S)
    scene.write_text(text)
    read, rows = torchlc.load(scene, recording)
    torchlc.LightCurve(read, rows)
    with (tmp_path / "elements.txt").open("a") as stream:
        stream.write("\n")
    with pytest.raises(torchlc.InputError, match=r"elements\.txt: changed since it was first read"):
        torchlc.LightCurve(read, rows)
