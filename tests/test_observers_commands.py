"""Commands as observers type them, on files as they have them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import torchlc
from tests.good_input import SCENE
from tests.observers_night import EXPORTS, table
from tests.small_case import write_case
from torchlc.campaigns.manifest import read_manifest
from torchlc.cli import run
from torchlc.errors import InputError
from torchlc.scene import Scene, load_scene


class TestCommands:
    TWO = (
        "0 BIRD 7\n1 37834U 11045A   26074.51234567 -.00000155  00000-0  00000+0 0  9999\n"
        "2 37834   0.0213  85.4012 0002513 210.1123  30.2201  1.00271810 53325\n"
        "TEST SATELLITE\n1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993\n"
        "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966\n"
    )

    @pytest.fixture(autouse=True)
    def folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.chdir(tmp_path)
        Path("two.txt").write_text(self.TWO)

    def test_an_object_of_many(self, capsys: pytest.CaptureFixture[str]):
        assert run(["init", "s.toml", "--tle", "two.txt"]) == 2
        told = capsys.readouterr().err
        assert "1 TEST SATELLITE, 37834 BIRD 7" in told and not Path("s.toml").exists()
        followed = re.search(r"--object (\w+)", told)
        assert followed is not None
        for wanted, number in (
            (followed[1], "00001"),
            ("bird", "37834"),
            ("BIRD 7", "37834"),
            ("00001", "00001"),
        ):
            assert run(["init", "s.toml", "--tle", "two.txt", "--object", wanted, "--force"]) == 0
            assert f'"1 {number}U' in Path("s.toml").read_text()
        assert run(["init", "t.toml", "--tle", "two.txt", "--object", "plane"]) == 2
        assert run(["init", "t.toml", "--tle", "two.txt", "--object", "I"]) == 2  # both names have an i
        assert "2 objects for 'I'" in capsys.readouterr().err

    def test_a_wrong_set_of_another_object(self, capsys: pytest.CaptureFixture[str]):
        """It is said and passed over; one wrong set of the object itself is said where that has no other."""
        Path("three.txt").write_text(
            self.TWO.replace("53325\n", "53326\n") + self.TWO[: self.TWO.index("TEST")]
        )
        assert run(["init", "s.toml", "--tle", "three.txt", "--object", "test"]) == 0
        assert "set passed over: three.txt: line 3: checksum '6'" in capsys.readouterr().err
        assert run(["init", "s.toml", "--tle", "three.txt", "--object", "bird", "--force"]) == 0
        assert "passed over" in capsys.readouterr().err
        Path("two.txt").write_text(self.TWO.replace("53325\n", "53326\n"))
        assert run(["init", "t.toml", "--tle", "two.txt", "--object", "37834"]) == 2
        told = capsys.readouterr().err
        assert "no object '37834'" in told and "line 3: checksum '6'" in told
        assert run(["init", "t.toml", "--tle", "two.txt"]) == 2
        assert "line 3: checksum '6'" in capsys.readouterr().err
        night = ["--date", "2020-10-11", "--preset", "6u", "--station", "weihai,37.5,122.1,110"]
        assert run(["predict", "two.txt", *night, "-o", "out"]) == 2
        assert "--preset" in capsys.readouterr().err
        night[3] = "cubesat-6u"
        assert run(["predict", "two.txt", *night, "-o", "out"]) == 0
        assert "line 3: checksum '6'" in capsys.readouterr().err

    def test_a_campaign_from_a_folder(self, capsys: pytest.CaptureFixture[str]):
        nights = Path("nights")
        nights.mkdir()
        (nights / "37834_2026-03-15.csv").write_text(table("JD,Mag,Err"))
        (nights / "test-satellite 2.txt").write_text(EXPORTS["ZTF"])
        (nights / "inside.csv").write_text("# object: BIRD 7\n" + table("JD,Mag,Err"))
        (nights / "nobody.csv").write_text(table("JD,Mag,Err"))
        (nights / "bird-7-but.csv").write_text("# object: TEST SATELLITE\n" + table("JD,Mag,Err"))
        assert run(["campaign", "init", "two.txt", "nights", "--station", "weihai,37.5,122.1,110"]) == 0
        told = capsys.readouterr()
        assert "nobody.csv: left out" in told.err and "bird-7-but.csv: left out" in told.err
        jobs = list(read_manifest(nights / "manifest.csv"))
        numbers = {job.recording.name: load_scene(job.scene).orbit.tle[0][2:7] for job in jobs}
        assert numbers == {
            "37834_2026-03-15.csv": "37834",
            "inside.csv": "37834",
            "test-satellite 2.txt": "00001",
        }
        assert run(["campaign", "init", "two.txt", "nights"]) == 2
        assert "--force" in capsys.readouterr().err
        assert run(["campaign"]) == 2 and run(["campaign", "nights/manifest.csv"]) == 2  # no -o

    def test_columns_of_every_command(self, capsys: pytest.CaptureFixture[str]):
        rows = "".join(f"{2459140.125 + k / 288:.6f} {12 + 0.1 * np.sin(k):.4f} 0.02\n" for k in range(40))
        Path("r.txt").write_text("when light spread\n" + rows)
        Path("s.toml").write_text(SCENE)
        columns = ["--columns", "time=when,mag=light,mag_err=spread"]
        assert run(["simulate", "s.toml", "r.txt", "-o", "out", *columns]) == 0
        assert "when as time (Julian date, UTC, mid-exposure)" in capsys.readouterr().err
        assert run(["period", "r.txt", *columns]) == 0
        assert run(["period", "r.txt"]) == 2
        assert "--columns" in capsys.readouterr().err

    def test_columns_of_a_rotation(self, capsys: pytest.CaptureFixture[str]):
        """What is said of the columns comes as far as the search, which refuses a period that cannot be."""
        rows = "".join(f"{2459140.125 + k / 288:.6f} {12 + 0.1 * np.sin(k):.4f} 0.02\n" for k in range(40))
        Path("r.txt").write_text("when light spread\n" + rows)
        Path("s.toml").write_text(SCENE)
        search = ["rotation", "s.toml", "r.txt", "--shortest", "20", "--longest", "10"]
        assert run(search) == 2
        assert "--columns time=when,mag=light" in capsys.readouterr().err
        assert run([*search, "--columns", "time=when,mag=light,mag_err=spread"]) == 2
        told = capsys.readouterr().err
        assert "no column" not in told and "s.toml" in told

    def test_columns_of_a_campaign(self, capsys: pytest.CaptureFixture[str]):
        """They are read so when the campaign is written, and stand among the options of every object."""
        nights = Path("nights")
        nights.mkdir()
        (nights / "37834.csv").write_text(table("my time,light,spread"))
        init = ["campaign", "init", "two.txt", "nights", "--station", "weihai,37.5,122.1,110"]
        assert run(init) == 2
        (offered,) = re.findall(r"--columns '(time=[^']+)'", capsys.readouterr().err)
        assert run([*init, "--columns", offered]) == 0
        (job,) = read_manifest(nights / "manifest.csv")
        assert job.options["columns"] == offered == "time=my time,mag=light"
        assert len(torchlc.load(job.scene, job.recording, columns=job.options["columns"])[1]) == 3

    def test_a_fit_is_read_back(self):
        scene, recording = write_case(Path())
        result = torchlc.fit(scene, recording, steps=20, out="fit")
        stored = torchlc.load_fit("fit")
        assert stored.parameters() == json.loads(Path("fit/fit.json").read_text())["parameters"]
        assert result.posterior is not None and stored.names == result.names
        for k, name in enumerate(result.names):
            np.testing.assert_array_equal(stored.draws[name], result.posterior.theta[..., k].numpy())
        assert stored.to_pandas()["median"].tolist() == result.to_pandas()["median"].tolist()
        (Path("fit") / "posterior.nc").write_bytes(b"nothing")
        with pytest.raises(InputError, match=r"posterior\.nc: cannot be read"):
            torchlc.load_fit("fit")
        with pytest.raises(InputError, match="no such file"):
            torchlc.load_fit("nowhere")


def test_all_missing_keys_of_a_scene_are_told_at_once():
    with pytest.raises(InputError) as caught:
        Scene.from_toml('format = "torchlc-scene/1"\n[attitude]\n')
    assert all(
        key in str(caught.value) for key in ("name", "orbit", "attitude.mode", "components", "materials")
    )


def test_all_unknown_keys_of_a_scene_are_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """In whatever tables they stand, beside keys that are missing and values that are wrong."""
    path = tmp_path / "s.toml"
    text = SCENE.replace("r_diff = 0.3", "r_dif = 0.3\nshine = 2").replace(
        "[attitude]", "[attitude]\nspinn = 1"
    )
    text = text.replace("zero_point =", "zeropoint = 1.0\nzero_point =").replace(
        "height = 110.0", "hight = 1.0"
    )
    text = text.replace('name = "box-wing"', "colour = 1")
    path.write_text(text)
    assert run(["simulate", str(path), "none.csv", "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    for key in (
        "colour", "stations[0].hight (did you mean 'height'?)", "attitude.spinn", "materials.body.shine",
        "materials.body.r_dif (did you mean 'r_diff'?)", "model.parameters.zeropoint (did you mean 'zero_point'?)",
        "Missing: name",
    ):  # fmt: skip
        assert key in told
    assert len(told.splitlines()) == 1
    two = 'effects = ["self_shadoing", "sun_distence"]'
    path.write_text(SCENE.replace('effects = ["self_shadowing"]', two))
    assert run(["simulate", str(path), "none.csv", "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "Did you mean 'self_shadowing'?" in told and "(did you mean 'sun_distance'?)" in told


def test_one_column_is_not_two_things(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Whatever two quantities; a column that is told is no longer that of its own name."""
    (tmp_path / "s.toml").write_text(SCENE)
    (tmp_path / "r.csv").write_text(table("JD,mag,mag_err"))
    command = [
        "simulate",
        str(tmp_path / "s.toml"),
        str(tmp_path / "r.csv"),
        "-o",
        str(tmp_path / "out"),
        "--columns",
    ]
    for columns, told in {
        "time=JD,mag=JD": "'JD' told as time and as mag",
        "mag=mag,mag_err=2": "'mag' told as mag and as mag_err",
        "station=mag_err,band=mag_err": "'mag_err' told as station and as band",
    }.items():
        assert run([*command, columns]) == 2
        assert told in capsys.readouterr().err
    assert run([*command, "timee=JD,colour=mag"]) == 2
    told = capsys.readouterr().err
    assert "'timee'; expected one of time, mag" in told and "Unknown too: 'colour'" in told
    (tmp_path / "r.csv").write_text(table("JD,mag,flux"))
    assert run([*command, "mag=flux"]) == 0
    assert "flux as mag" in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_scenes_and_manifests_of_windows(tmp_path: Path, encoding: str):
    text = SCENE.replace("\n", "\r\n")
    (tmp_path / "scene.toml").write_bytes(text.encode(encoding))
    assert load_scene(tmp_path / "scene.toml").to_toml() == Scene.from_toml(SCENE).to_toml()
    (tmp_path / "rows.csv").write_bytes(table("time,mag,mag_err").encode(encoding))
    (tmp_path / "all.csv").write_bytes("scene,recording,task\r\nscene.toml,rows.csv,fit\r\n".encode(encoding))
    jobs = list(read_manifest(tmp_path / "all.csv"))
    assert [job.recording.name for job in jobs] == ["rows.csv"]
