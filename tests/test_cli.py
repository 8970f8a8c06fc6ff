"""The command line, as typed: exit codes, one line of error, nothing written on bad input, JSON, locks, Ctrl-C."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

import torchlc
from tests.bad_input_cases import CASES
from tests.command_line import TLE
from tests.input_cases import Case
from torchlc.cli import run
from torchlc.errors import InputError, at_a_shell, option

LAB_TABLE = Path(__file__).parents[2] / "shared" / "data" / "starlink_v15" / "lab_brdf_array.csv"


def test_help_of_every_command_ends_well(capsys: pytest.CaptureFixture[str]):
    for command in (
        "",
        "simulate",
        "predict",
        "fit",
        "diagnose",
        "campaign",
        "period",
        "rotation",
        "materials",
        "effects",
        "demo",
        "init",
    ):
        assert run([*command.split(), "--help"]) == 0
        assert "Usage" in capsys.readouterr().out
    assert run([]) == 0
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("torchlc 0.")


@pytest.mark.parametrize(
    "arguments",
    [["nonsense"], ["fit"], ["fit", "a.toml"], ["fit", "a", "b", "-o"], ["simulate", "a", "-o", "o", "--hours", "x"],
     ["effects", "--sideways"], ["fit", "a", "b", "-o", "o", "--seed", "-1"], ["fit", "a", "b", "-o", "o", "--steps", "0"]],
)  # fmt: skip
def test_a_command_typed_wrongly_is_one_line_and_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1 and said.err.startswith("torchlc: error: ")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("case", [c for c in CASES if c.outcome == "exit2"], ids=lambda case: case.name)
def test_bad_input_is_one_line_and_2_and_nothing_is_written(
    case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = tmp_path / "in"
    folder.mkdir()
    scene, recording = case.write(folder)
    assert run(["fit", str(scene), str(recording), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1
    assert (
        said.err.startswith("torchlc: error: ") and case.message in said.err and "Traceback" not in said.err
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("call", "typed", "words"),
    [
        (
            lambda scene, recording: torchlc.simulate(scene, start="2020-10-18T14:00"),
            "simulate SCENE --start 2020-10-18T14:00",
            "not all of --start, --hours and --cadence",
        ),
        (
            lambda scene, recording: torchlc.predict(scene, date="2020-10-18", elevation=99),
            "predict SCENE --date 2020-10-18 --elevation 99",
            "error: --elevation: 99 deg",
        ),
        (
            lambda scene, recording: torchlc.load(scene, recording, columns="tme=JD"),
            "simulate SCENE RECORDING --columns tme=JD",
            "error: --columns: 'tme'",
        ),
    ],
)
def test_an_error_names_the_argument_in_a_call_and_the_option_at_a_shell(
    case: tuple[str, str], call, typed: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(InputError) as caught:
        call(*case)
    command = typed.replace("SCENE", case[0]).replace("RECORDING", case[1])
    assert run([*shlex.split(command), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert words in said and "--" not in str(caught.value)
    assert said.replace("--", "").strip() == f"torchlc: error: {caught.value}"


def test_an_offer_is_typed_as_the_reader_types_it():
    assert option("columns", "time=my time") == 'columns="time=my time"'
    assert option("station", "A,1,2,3", argument="stations") == 'stations="A,1,2,3"'
    assert (option("resume", True), option("seed", 3), option("hours")) == ("resume=True", "seed=3", "hours")
    with at_a_shell():
        assert shlex.split(option("columns", 'time="a, b"')) == ["--columns", 'time="a, b"']
        assert (option("resume", True), option("seed", 3)) == ("--resume", "--seed 3")


@pytest.mark.parametrize("case", [c for c in CASES if c.outcome != "exit2"], ids=lambda case: case.name)
def test_what_can_be_mended_is_told_in_the_result(case: Case, tmp_path: Path):
    content = torchlc.fit(*case.write(tmp_path), steps=20).to_json()
    if case.outcome == "dropped":
        assert content["dropped"] == {case.message: 1}
        assert any(text.startswith("1 row is left out: 1 ") for text in content["warnings"])
    else:
        assert any(case.message in warning for warning in content["warnings"])


def test_simulate_on_a_grid_and_at_rows(
    case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = str(tmp_path / "out")
    grid = ["--start", "2020-10-17T15:00:00", "--hours", "1", "--cadence", "600"]
    assert run(["simulate", case[0], *grid, "-o", out]) == 0
    assert "7 rows" in capsys.readouterr().out
    first = Table.read(tmp_path / "out" / "curve.ecsv", format="ascii.ecsv")
    assert len(first) == 7 and "mag_err" not in first.colnames
    jd = ["--start", "2459140.125", *grid[2:]]
    assert run(["simulate", case[0], *jd, "-o", out, "--noise", "0.05", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    noisy = Table.read(told["file"], format="ascii.ecsv")
    assert list(noisy["time"]) == list(first["time"]) and set(noisy["mag_err"]) == {0.05}
    assert run(["simulate", *case, "-o", out, "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    np.testing.assert_array_equal(
        Table.read(tmp_path / "out" / "curve.ecsv", format="ascii.ecsv")["time"],
        Table.read(case[1], format="ascii.ecsv")["time"],
    )
    assert run(["simulate", *case, *grid, "-o", out]) == 2


def test_simulate_at_rows_says_how_far_from_the_recording_it_is(
    case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """The same recording, one magnitude fainter and without one of its rows."""
    table = Table.read(case[1], format="ascii.ecsv")
    table["mag"] += 1.0
    peak = int(np.argmin(table["mag"]))
    table["mag"][(peak + 5) % len(table)] = np.nan
    table.write(tmp_path / "obs.ecsv", format="ascii.ecsv")
    arguments = ["simulate", case[0], str(tmp_path / "obs.ecsv"), "-o", str(tmp_path / "out")]
    assert run([*arguments, "--json"]) == 0
    recorded = json.loads(capsys.readouterr().out)["recorded"]
    assert recorded["brightest"]["time"] == table["time"][peak]
    assert recorded["brightest"]["mag"] == pytest.approx(table["mag"][peak])
    assert recorded["fainter_mag"] == pytest.approx(1.0, abs=0.02), "errors of 0.02 mag"
    assert run(arguments) == 0
    said = capsys.readouterr()
    assert "mag fainter" in said.out and "1 row is left out: 1 without a number" in said.err


def test_fit_says_what_it_found(case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ["fit", *case, "-o", str(tmp_path), "--steps", "60", "--seed", "4"]
    assert run(arguments) == 0
    said = capsys.readouterr()
    assert "panel.n" in said.out and "±" in said.out and "report.html" in said.out
    assert all(line.startswith("torchlc: warning: ") for line in said.err.splitlines())
    content = json.loads((tmp_path / "fit.json").read_text())
    assert (
        content["provenance"]["command"].startswith("torchlc fit ")
        and "--seed 4" in content["provenance"]["command"]
    )


def test_json_on_standard_output_is_that_of_the_file(
    case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert run(["fit", *case, "-o", str(tmp_path), "--steps", "40", "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out) == json.loads((tmp_path / "fit.json").read_text())
    assert said.err == ""


def test_warnings_of_libraries_stay_away(
    case: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    import torchlc.api

    def noisy(*arguments: object, **options: object) -> object:
        warnings.warn("from a library", DeprecationWarning, stacklevel=1)
        return original(*arguments, **options)  # type: ignore[arg-type]

    original = torchlc.api.simulate
    monkeypatch.setattr("torchlc.api.simulate", noisy)
    assert run(["simulate", *case, "-o", str(tmp_path)]) == 0
    assert "from a library" not in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_options_and_names():
    typed = {
        "torchlc di": {"diagnose"},
        "torchlc diagnose --q": {"--quick", "--quiet"},
        "torchlc diagnose a b --effects panel_offset,earth": {
            "panel_offset,earth_shadow", "panel_offset,earthshine"
        },
        "torchlc materials fit a --model gg": {"ggx", "ggx-conductor", "ggx-dielectric", "ggx-lambert"},
        "torchlc init my.toml --shape cu": {"cubesat", *(f"cubesat-{units}u" for units in (1, 2, 3, 6, 12, 16))},
        "torchlc fit a b --use f": {"flux"},
    }  # fmt: skip
    asks = "".join(
        f"COMP_WORDS=({words}); COMP_CWORD={len(words.split()) - 1}; COMPREPLY=()\n"
        '_torchlc_completion torchlc; (IFS=" "; echo "${COMPREPLY[*]}")\n'
        for words in typed
    )
    where = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", f'eval "$(torchlc --show-completion bash)"\n{asks}'],
        capture_output=True, text=True, check=True, env={**os.environ, "PATH": where},
    )  # fmt: skip
    assert [set(line.split()) for line in done.stdout.splitlines()] == list(typed.values())


def test_effects_and_materials_are_listed(capsys: pytest.CaptureFixture[str]):
    from torchlc.effects import names

    assert run(["effects", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    listed = {one["name"]: one for one in [*told["effects"], *told["looked_for"]]}
    assert set(listed) == set(names())
    assert {one["name"] for one in told["looked_for"]}.isdisjoint(one["name"] for one in told["effects"])
    assert all(one["sentence"].endswith(".") for one in listed.values())
    deg = listed["panel_offset"]["parameters"][0]
    assert (deg["name"], deg["unit"], deg["low"], deg["high"], deg["sigma"]) == ("deg", "deg", -15, 15, 3)
    assert run(["effects"]) == 0
    assert "panel_offset" in capsys.readouterr().out
    assert run(["materials", "--json"]) == 0
    assert {one["name"] for one in json.loads(capsys.readouterr().out)["materials"]} >= {
        "Kapton",
        "GaAs",
        "Al",
    }
    assert run(["materials"]) == 0
    assert "Kapton (ashikhmin-shirley)" in capsys.readouterr().out


def test_materials_of_a_posterior(case: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run(["fit", *case, "-o", str(tmp_path), "--steps", "40", "--quiet"]) == 0
    capsys.readouterr()
    assert run(["materials", "--posterior", str(tmp_path), "--json"]) == 0
    matches = json.loads(capsys.readouterr().out)["materials"]["panel"]
    assert sum(one["probability"] for one in matches) == pytest.approx(1)
    assert run(["materials", "--posterior", str(tmp_path / "nowhere")]) == 2


@pytest.mark.skipif(not LAB_TABLE.exists(), reason="needs ../shared/data/starlink_v15")
def test_a_laboratory_table_is_fitted(capsys: pytest.CaptureFixture[str]):
    assert run(["materials", "fit", str(LAB_TABLE), "--model", "lambert", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["converged"] and 0 < told["parameters"]["albedo"]["value"] < 0.2
    assert run(["materials", "fit", str(LAB_TABLE), "--model", "velvet"]) == 2


def test_period_of_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    hours = np.linspace(0, 3, 200)
    rows = [f"{2459000.5 + h / 24:.9f},{10 + 0.2 * np.sin(2 * np.pi * h / 0.25):.5f}" for h in hours]
    (tmp_path / "obs.csv").write_text("\n".join(["time,mag", *rows]) + "\n")
    assert run(["period", str(tmp_path / "obs.csv"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["candidates"][0]["period_s"] == pytest.approx(900, rel=1e-3)
    assert run(["period", str(tmp_path / "obs.csv")]) == 0
    assert "min (900.0" in capsys.readouterr().out


def test_rows_below_the_horizon_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The demonstration's object is up all day, and from the other side of the Earth never."""
    scene = (Path(torchlc.__file__).parent / "demo" / "scene.toml").read_text(encoding="utf-8")
    far = re.sub(
        r"longitude = [-\d.]+", "longitude = -60.0", re.sub(r"latitude = [-\d.]+", "latitude = -35.0", scene)
    )
    grid = ["--start", "2020-10-17T13:00", "--hours", "1", "--cadence", "1200"]
    for name, text, told in (("near", scene, False), ("far", far, True)):
        (tmp_path / f"{name}.toml").write_text(text)
        assert run(["simulate", str(tmp_path / f"{name}.toml"), *grid, "-o", str(tmp_path / name)]) == 0
        assert ("4 of 4 rows are below the horizon" in capsys.readouterr().err) is told


@pytest.mark.parametrize("shape", ["box-wing", "cubesat", "rocket body", "cylinder"])
def test_init_writes_a_scene_that_simulates(shape: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "tle.txt").write_text(TLE)
    scene = str(tmp_path / "my.toml")
    arguments = ["init", scene, "--tle", str(tmp_path / "tle.txt"), "--shape", shape]
    assert run([*arguments, "--station", "weihai,37.536,122.05,110", "--date", "2020-10-11"]) == 0
    offered = re.search(
        r"next: torchlc (predict .* --start 2020-10-11T00:00 .*) -o out", capsys.readouterr().out
    )
    assert offered and run([*shlex.split(offered[1]), "-o", str(tmp_path / "offered"), "--quiet"]) == 0
    text = Path(scene).read_text()
    assert 'name = "TEST SATELLITE"' in text and "20284.07341138" in text, "the set nearest to the date"
    assert text.count("\n# ") >= 5, "commented"
    assert run(arguments) == 2, "an existing scene is not replaced"
    grid = ["--start", "2020-10-12T14:00", "--hours", "1", "--cadence", "1200"]
    assert run(["simulate", scene, *grid, "-o", str(tmp_path / "out"), "--quiet"]) == 0, (
        capsys.readouterr().err
    )
    assert run([*arguments, "--force"]) == 0
    assert "the station is a placeholder" in capsys.readouterr().err
    assert "20294.07341138" in Path(scene).read_text(), "the latest set where no date is given"


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (("9993", "9992"), [], "checksum"),
        (("1 ", "7 "), [], "no two-line elements"),
        (("", ""), ["--shape", "cubesatt"], "Did you mean 'cubesat'"),
        (("", ""), ["--preset", "cubesatt"], "--shape, --preset"),
        (("", ""), ["--station", "weihai"], "--station"),
        (("", ""), ["--station", "weihai,95,0,0"], "latitude"),
        (("", ""), ["--date", "tomorrow"], "--date"),
        (("", ""), ["--shape", "mesh"], "--mesh"),
        (("", ""), ["--shape", "mesh", "--mesh", "none.obj"], "none.obj"),
    ],
)
def test_init_refuses_what_would_not_load(
    change: tuple[str, str],
    options: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    (tmp_path / "tle.txt").write_text(TLE.replace(*change) if change[0] else TLE)
    arguments = [
        "init",
        str(tmp_path / "my.toml"),
        "--tle",
        str(tmp_path / "tle.txt"),
        "--date",
        "2020-10-12",
        *options,
    ]
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and len(error.splitlines()) == 1
    assert not (tmp_path / "my.toml").exists()
