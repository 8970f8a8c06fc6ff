"""Runs as whole processes, in places that are not made for them: the results are there, the exit code is the one promised,
and no traceback is shown.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from tests.small_case import write_case
from tests.whole_processes import ENVIRONMENT, start
from torchlc import terminal
from torchlc.figures import saving

NAME = "Ω é"
FIT = ["--steps", "20", "--walkers", "10"]
WRITTEN = {"fit.json", "posterior.nc", "curve.png", "report.html"}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    scene, recording = write_case(tmp_path_factory.mktemp("case"), rows=9, name=NAME)
    return str(scene), str(recording)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["terminal", "notebook"])
def test_a_fit_is_whole_wherever_it_runs(kind: str, case: tuple[str, str], tmp_path: Path):
    """A home that is a file, letters of ASCII only and no standard error; through Python a notebook's backend, a matplotlibrc
    that wants a LaTeX, and warnings that are errors."""
    out = tmp_path / "out"
    if kind == "terminal":
        home = tmp_path / "home"
        home.write_text("a file")
        change = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"), str(home))
        change |= {"TERM": "dumb", "PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}
        process = start(["-m", "torchlc", "fit", *case, *FIT, "-o", str(out), "--json"], "2>&-", change)
    else:
        (tmp_path / "matplotlibrc").write_text("text.usetex: True\nfont.family: none of that name\n")
        change = {
            "MPLBACKEND": "module://a_notebook.backend",
            "MATPLOTLIBRC": str(tmp_path / "matplotlibrc"),
            "PYTHONWARNINGS": "error",
        }
        call = (
            f"import torchlc; torchlc.fit({case[0]!r}, {case[1]!r}, steps=20, walkers=10, out={str(out)!r})"
        )
        process = start(["-c", call], change=change)
    output, error = process.communicate()
    assert process.returncode == 0, error
    assert "Traceback" not in error
    assert {path.name for path in out.iterdir()} >= WRITTEN and not list(out.glob(".*"))
    assert "could not be drawn" not in (out / "report.html").read_text()
    if kind == "terminal":
        assert json.loads(output)["chi2"] == json.loads((out / "fit.json").read_text())["chi2"]


def test_a_terminal_of_ascii_is_told_signs_in_ascii(case: tuple[str, str]):
    """Degrees in words; the letters of a name stay apart from each other, escaped."""
    change = {"TERM": "dumb", "PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}
    arguments = ["-m", "torchlc", "predict", case[0], "--date", "2020-10-17", "--cadence", "600"]
    output, error = start(arguments, change=change).communicate()
    head, _, row = output.splitlines()[:3]
    assert head.startswith("\\u03a9 \\xe9: 1 pass to be seen"), error
    assert re.search(r" \d+ deg  ", row) and "\\xb0" not in output


@pytest.mark.parametrize(
    ("encoding", "written"),
    [("ascii", "0.373 +- 0.032 -> \\u03a9 +- 5 deg"), ("latin-1", "0.373 ± 0.032 -> \\u03a9 ± 5°")],
)
def test_signs_are_spelled_where_an_encoding_lacks_them(encoding: str, written: str):
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors=terminal.SPELLED)
    stream.write("0.373 ± 0.032 → Ω ± 5°")
    stream.flush()
    assert stream.buffer.getvalue().decode(encoding) == written  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.long
def test_without_standard_streams(case: tuple[str, str], tmp_path: Path):
    """A result is never written into the place of a stream that was closed."""
    process = start(["-m", "torchlc", "simulate", *case, "-o", str(tmp_path)], "<&- >&- 2>&-")
    process.communicate()
    assert process.returncode == 0
    text = (tmp_path / "curve.ecsv").read_text()
    assert text.startswith("# %ECSV") and "written" not in text


@pytest.mark.long
@pytest.mark.parametrize("redirection", ["", "<&- >&- 2>&-"])
def test_a_campaign_is_whole_wherever_it_runs(redirection: str, case: tuple[str, str], tmp_path: Path):
    """Processes of workers, with warnings that are errors; with streams, and with none."""
    manifest, out = tmp_path / "nights.csv", tmp_path / "out"
    rows = [f"{name},{case[0]},{case[1]},fit,{' '.join(FIT)}" for name in ("a", "b")]
    manifest.write_text("\n".join(["id,scene,recording,task,options", *rows]) + "\n", encoding="utf-8")
    arguments = ["-m", "torchlc", "campaign", str(manifest), "-o", str(out), "--workers", "2"]
    process = start(arguments, redirection, {"PYTHONWARNINGS": "error"})
    _, error = process.communicate()
    assert process.returncode == 0, error
    assert "Traceback" not in error
    for name in ("a", "b"):
        assert {path.name for path in (out / "objects" / name).iterdir()} >= WRITTEN
    assert json.loads((out / "campaign.json").read_text())["done"] == 2
    assert (out / "index.html").read_text().startswith("<!")


def test_a_figure_that_cannot_be_drawn_says_so(tmp_path: Path):
    """Neither an error while it is drawn nor one while it is rendered ends a run; the size stays."""

    def broken() -> Figure:
        raise ValueError("no $such thing")

    def unrenderable() -> Figure:
        figure = Figure(figsize=(3, 2))
        figure.text(0.5, 0.5, r"$\nonsense{$")
        return figure

    for draw in (broken, unrenderable):
        stream = io.BytesIO()
        saving.save(saving.drawn(draw, (3.0, 2.0)), stream, format="svg")
        assert b"could not be drawn" in stream.getvalue().replace(b"<!-- ", b"").replace(b"\n", b" ")
        saving.save(saving.drawn(draw, (3.0, 2.0)), tmp_path / "a.png", format="png", dpi=100)
        width, height = struct.unpack(">II", (tmp_path / "a.png").read_bytes()[16:24])
        assert (width, height) == (300, 200)


def may_mount() -> bool:
    """Whether a private file system of a megabyte can be had here."""
    unshare = shutil.which("unshare")
    if unshare is None:
        return False
    with contextlib.suppress(OSError):
        call = [unshare, "-rm", "sh", "-c", "mount -t tmpfs -o size=64k none /mnt"]
        return subprocess.run(call, capture_output=True, check=False).returncode == 0
    return False


ON_A_DISK_THAT_FILLS = """
import contextlib, importlib
from pathlib import Path
from tests.warm import LOADED
from torchlc.campaigns import processes
from torchlc.cli import run

for name in LOADED:
    importlib.import_module(name)
processes.START_METHOD = "fork"  # workers have them then

def campaign(manifest):
    return run(["campaign", manifest, "-o", "disk/out", "--workers", "1", "--quiet"])

assert campaign("one.csv") == 0
filler, done = Path("disk/filler"), Path("disk/out/objects/a/diagnosis.json")
with contextlib.suppress(OSError), filler.open("wb", buffering=0) as stream:
    while stream.write(bytes(4096)):
        pass
before = done.read_bytes()
code = campaign("two.csv")
assert done.read_bytes() == before
filler.unlink()
assert campaign("two.csv") == 0
assert Path("disk/out/objects/b/diagnosis.json").stat().st_size
print(code)
"""


@pytest.mark.long
@pytest.mark.skipif(not may_mount(), reason="needs unshare and the right to mount a tmpfs of its own")
def test_a_campaign_on_a_disk_that_fills_ends_with_3_and_keeps_what_is_done(
    case: tuple[str, str], tmp_path: Path
):
    """The disk of the first campaign is filled up after its object, and the campaign goes on with a second object."""
    options = "--quick --effects zero_point_drift"
    for name, ids in (("one.csv", "a"), ("two.csv", "ab")):
        rows = [f"{one},{case[0]},{case[1]},diagnose,{options}" for one in ids]
        (tmp_path / name).write_text("\n".join(["id,scene,recording,task,options", *rows]) + "\n")
    script = f'mount -t tmpfs -o size=3M none {tmp_path}/disk && cd {tmp_path} && exec "$@"'
    (tmp_path / "disk").mkdir()
    command = ["unshare", "-rm", "sh", "-c", script, "sh", sys.executable, "-c", ON_A_DISK_THAT_FILLS]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "3\n"), done.stderr
    assert "no room on disk" in done.stderr and "Traceback" not in done.stderr
