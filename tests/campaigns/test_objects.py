"""One object of a campaign: what its result was made of, what is read for it, and what stays in its folder."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from tests.small_case import write_case
from torchlc.campaigns.manifest import Job
from torchlc.campaigns.objects import origin_of, read_record, run_object
from torchlc.errors import InputError


@pytest.mark.parametrize("name", ["elements.txt", "orbit.oem"])
def test_the_files_that_a_scene_names_are_part_of_a_result(name: str, tmp_path: Path):
    """Elements brought up to date make the object be done again."""
    key = {"elements.txt": "tle_file", "orbit.oem": "oem_file"}[name]
    (tmp_path / "scene.toml").write_text(f'[orbit]\n{key} = "{name}"\n')
    (tmp_path / "recording.csv").write_text("")
    job = Job("a", tmp_path / "scene.toml", tmp_path / "recording.csv", "fit", seed=0)
    seen = set()
    for content in ("old", "new"):
        (tmp_path / name).write_text(content)
        seen.add(json.dumps(origin_of(job)))
    assert len(seen) == 2


def test_no_file_is_read_before_it_is_known_where_it_lies(tmp_path: Path):
    """The record holds no hash of a file outside the scene's folder, by whatever way the scene names it, and neither a
    file of a terabyte nor an endless one is opened."""
    folder = tmp_path / "scenes"
    folder.mkdir()
    secret = tmp_path / "secret.bin"
    secret.write_bytes(b"secret")
    (folder / "link.bin").symlink_to(secret)
    with (folder / "large.bin").open("wb") as stream:
        stream.truncate(10**12)
    (folder / "recording.csv").write_text("time,mag\n")
    names = [
        "../secret.bin",
        str(secret),
        "link.bin",
        "large.bin",
        "missing.bin",
        "/dev/zero",
        "x" * 300,
        "a\\u0000b",
    ]
    for name in names:
        (folder / "scene.toml").write_text(f'[attitude]\nmode = "quaternions"\nfile = "{name}"\n')
        job = Job("a", folder / "scene.toml", folder / "recording.csv", "fit", seed=0)
        assert set(origin_of(job)["inputs"]) == {"scene", "recording"}, name
        assert run_object(job, tmp_path / "out") == "failed"
        assert hashlib.sha256(b"secret").hexdigest() not in (tmp_path / "out" / "object.json").read_text()
    trusted = Job(
        "a", folder / "scene.toml", folder / "recording.csv", "fit", seed=0, options={"trust": True}
    )
    (folder / "scene.toml").write_text('[attitude]\nfile = "../secret.bin"\n')
    assert origin_of(trusted)["inputs"]["../secret.bin"] == hashlib.sha256(b"secret").hexdigest()
    for scene, recording in (("scene.toml", "large.bin"), ("large.bin", "recording.csv")):
        job = Job("a", folder / scene, folder / recording, "fit", seed=0)
        with pytest.raises(InputError, match="at most"):
            origin_of(job)


@pytest.mark.long
def test_what_somebody_put_into_an_objects_folder_stays(tmp_path: Path):
    """A file of the user's under the name of a result fails that object, in words; one of ours that was changed is
    kept under another name, and the object is done again."""
    write_case(tmp_path, rows=9)
    job = Job(
        "a", tmp_path / "scene.toml", tmp_path / "recording.ecsv", "fit", 0, {"steps": 20, "walkers": 10}
    )
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "curve.png").write_text("mine")
    assert run_object(job, folder) == "failed"
    record = read_record(folder)
    assert record is not None and "curve.png: there, but not in" in record["reason"]
    assert (folder / "curve.png").read_text() == "mine"
    (folder / "curve.png").unlink()
    assert run_object(job, folder, "first") == "done" and run_object(job, folder, "second") == "skipped"
    report = (folder / "report.html").read_text()
    (folder / "report.html").write_text(f"{report}<!-- notes of mine -->")
    assert run_object(job, folder, "third") == "done"
    assert (folder / "report.html.changed").read_text().endswith("<!-- notes of mine -->")
    assert run_object(job, folder, "fourth") == "skipped"
