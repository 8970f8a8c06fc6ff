"""Manifests: seeds, options, names of directories, and defects by line."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

from tests.campaigns.cases import write_manifest
from tests.paper_orbits import ORBIT_1
from torchlc.campaigns.manifest import Job, check_manifest, read_manifest
from torchlc.cli import run


def test_seeds_belong_to_objects_not_to_places(manifest: Path, tmp_path: Path):
    jobs = {job.name: job for job in read_manifest(manifest, seed=3)}
    lines = manifest.read_text().splitlines()
    reordered = manifest.with_name("reordered.csv")
    reordered.write_text("\n".join([lines[0], *reversed(lines[1:])]) + "\n")
    again = {job.name: job for job in read_manifest(reordered, seed=3)}
    assert jobs == again and list(jobs) == list(reversed(again))
    assert len({job.seed for job in jobs.values()}) == len(jobs)
    other = {job.name: job for job in read_manifest(manifest, seed=4)}
    assert [name for name in jobs if jobs[name].seed == other[name].seed] == ["d"], "its seed is given"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("scene,recording,task\n", "no rows below the header"),
        ("scene,task\na,fit\n", "line 1: no column 'recording'"),
        ("scene,recording,tsk\na,b,fit\n", "Did you mean 'task'"),
        ("scene,scene,recording,task\n", "line 1: column 'scene' appears twice"),
        ("scene,recording,task\na,b,fit\n\na,c\n", "line 4: 2 cells; expected 3"),
        ("scene,recording,task\na,,fit\n", "line 2: recording is empty"),
        (
            "scene,recording,task\na,b,fti\n",
            "line 2: task 'fti'; expected fit or diagnose. Did you mean 'fit'",
        ),
        ("scene,recording,task,options\na,b,fit,--step 3\n", "line 2: options '--step 3'"),
        ("scene,recording,task,options\na,b,fit,--steps 0\n", "'0' is no whole number at least 1"),
        ("scene,recording,task,options\na,b,fit,--quick\n", "options as torchlc fit takes them"),
        ("scene,recording,task,options\na,b,fit,--budget 0\n", "no number of CPU seconds, 1 or more"),
        ("scene,recording,task,options\na,b,fit,--use 'mag\n", "No closing quotation"),
        ("scene,recording,task,options\na,b,diagnose,--effects panel_ofset\n", "Did you mean 'panel_offset'"),
        ("scene,recording,task\na,b,fit\nc,d,fit\na,b,fit\n", "line 4: object 'b-"),
        ("scene,recording,task,id\na,b,fit,x\na,c,fit,x\n", "line 3: object 'x' again, as in line 2"),
        ('scene,recording,task\na,b,"fit\n', "unexpected end of data"),
        ("scene,recording,task\na,b,f\xff\n", "not UTF-8 text"),
    ],
)
def test_a_defect_of_the_manifest_is_one_line_and_nothing_is_written(
    text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "m.csv").write_bytes(text.encode("latin-1"))
    assert run(["campaign", str(tmp_path / "m.csv"), "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error and f"{tmp_path / 'm.csv'}: " in error and len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("task", "options", "expected"),
    [
        ("diagnose", "", {"budget": 30.0}),
        ("diagnose", "--quick", {"quick": True}),
        ("fit", "--budget 2.5e1", {"budget": 25.0}),
    ],
)
def test_an_objects_own_time_stands(task: str, options: str, expected: dict[str, Any], tmp_path: Path):
    path = write_manifest(
        tmp_path / "m.csv", [{"id": "a", "scene": "s", "recording": "r", "task": task, "options": options}]
    )
    (job,) = read_manifest(path, budget=30.0)
    assert job.options == expected


def test_a_long_manifest_needs_no_more_than_a_short_one(tmp_path: Path):
    """61 bytes an object were measured while it is checked; the objects themselves are some 1,000 each."""
    import tracemalloc

    path = tmp_path / "long.csv"
    peaks = []
    for count in (500, 3_000):
        with path.open("w") as stream:
            stream.write("scene,recording,task,options\n")
            stream.writelines(f"s.toml,{i}.csv,fit,--steps 9\n" for i in range(count))
        tracemalloc.start()
        assert check_manifest(path) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 100 * 2_500


def test_names_of_directories_are_distinct_and_safe():
    names = ["a/b", "a%2Fb", ".", "..", ".hidden", "x" * 300, "x" * 299 + "y", "é", "a b", "A", "a"]
    jobs = [Job(name, Path("s"), Path("r"), "fit", 0) for name in names]
    found = [job.directory for job in jobs]
    assert len(set(found)) == len(names)
    assert all(len(name) < 150 and "/" not in name and not name.startswith(".") for name in found)


def test_no_cell_of_a_manifest_is_a_formula(tmp_path: Path):
    """Of files whose names are formulas; the manifest finds them."""
    (tmp_path / "elements.txt").write_text("\n".join(ORBIT_1))
    folder = tmp_path / "nights"
    folder.mkdir()
    lines = [
        "time,mag,mag_err",
        *(f"2020-10-17T15:{minute:02}:00,12.{minute:02},0.02" for minute in range(20)),
    ]
    (folder / "=HYPERLINK(1) 00001.csv").write_text("\n".join(lines))
    station = ["--station", "here,37.5,122.0,10"]
    assert run(["campaign", "init", str(tmp_path / "elements.txt"), str(folder), *station, "--quiet"]) == 0
    with (folder / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    assert not any(cell[:1] in tuple("=+-@\t\r") for cell in row.values()), row
    (job,) = read_manifest(folder / "manifest.csv")
    assert Path(job.recording).samefile(folder / "=HYPERLINK(1) 00001.csv") and Path(job.scene).is_file()
