"""The command line, as typed: exit codes, one line of error, nothing written on bad input, JSON, locks, Ctrl-C."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from astropy.table import Table

import torchlc
from tests.bad_input_cases import CASES, Case
from tests.rotating_bodies import write_turning
from tests.small_case import write_case
from torchlc.cli import run
from torchlc.cli.program import after_interrupt
from torchlc.files.writing import LOCK_NAME, MANIFEST_NAME
from torchlc.inference.rotation import pole_grid

LAB_TABLE = Path(__file__).parents[2] / "shared" / "data" / "starlink_v15" / "lab_brdf_array.csv"
TLE = """\
TEST SATELLITE
1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993
2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966
TEST SATELLITE
1 00001U 16037A   20294.07341138 -.00000354  00000-0  00000+0 0  9994
2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966
"""


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    scene, recording = write_case(tmp_path_factory.mktemp("case"))
    return str(scene), str(recording)


def process(*arguments: str, **options) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "torchlc", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


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


@pytest.mark.parametrize("case", [c for c in CASES if c.outcome != "exit2"], ids=lambda case: case.name)
def test_what_can_be_mended_is_told_in_the_result(case: Case, tmp_path: Path):
    content = torchlc.fit(*case.write(tmp_path), steps=20).to_json()
    if case.outcome == "dropped":
        assert content["dropped"] == {case.message: 1}
        assert f"rows left out: 1 {case.message}" in content["warnings"]
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
    assert "mag fainter" in said.out and "rows left out: 1 non-finite" in said.err


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


@pytest.mark.long
@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_options_and_names():
    typed = {
        "torchlc di": {"diagnose"},
        "torchlc diagnose --q": {"--quick", "--quiet"},
        "torchlc diagnose a b --effects panel_offset,earth": {
            "panel_offset,earth_shadow", "panel_offset,earthshine"
        },
        "torchlc materials fit a --model gg": {"ggx", "ggx-conductor", "ggx-dielectric"},
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


def until(condition, worker: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 240
    while not condition():
        assert worker.poll() is None and time.monotonic() < end, worker.communicate()
        time.sleep(0.02)


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


def test_effects_and_materials_are_listed(capsys: pytest.CaptureFixture[str]):
    from torchlc.effects import names

    assert run(["effects", "--json"]) == 0
    listed = {one["name"]: one for one in json.loads(capsys.readouterr().out)["effects"]}
    assert set(listed) == set(names())
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


@pytest.mark.parametrize("shape", ["box-wing", "cubesat", "rocket body", "cylinder"])
def test_init_writes_a_scene_that_simulates(shape: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "tle.txt").write_text(TLE)
    scene = str(tmp_path / "my.toml")
    arguments = ["init", scene, "--tle", str(tmp_path / "tle.txt"), "--shape", shape]
    assert run([*arguments, "--station", "weihai,37.536,122.05,110", "--date", "2020-10-11"]) == 0
    offered = re.search(
        r"next: torchlc (simulate .* --start 2020-10-11T00:00 .*) -o out", capsys.readouterr().out
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


# ------------------------------------------------------------------ outputs beside other people's files


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
