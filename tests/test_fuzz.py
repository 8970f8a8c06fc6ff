"""A subset of ``python -m tests.fuzz``: mutated scenes and recordings end with 0 or 2, whole and in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from tests.fuzz import in_process, whole_process
from tests.fuzz_cases import BESIDE, QUICK, WHOLE, Case, cases
from tests.good_input import BODY, MESH_SCENE, RECORDING, SCENE
from torchlc.cli import run

pytestmark = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="needs Linux's /proc")
patient = settings(deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.long
@settings(patient, max_examples=150)
@given(cases(QUICK))
def test_in_process(case: Case):
    assert in_process(case) is None


@pytest.mark.long
@settings(patient, max_examples=3)
@given(cases(WHOLE))
def test_as_a_process(case: Case):
    assert whole_process(case) is None


def test_more_facets_than_can_be_held_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A thousand finely cut spheres in a few kilobytes of text."""
    ball = BODY.replace('"box"', '"sphere"').replace("size = [2.0, 1.7, 2.2]", "radius = 1.0")
    many = "".join(ball.replace('"body"', f'"b{i}"', 1) for i in range(998))
    scene = SCENE.replace("[materials.body]", many + "[materials.body]")
    files = {"scene.toml": scene.encode(), "recording.csv": RECORDING.encode()}
    assert run(Case(files, QUICK[0]).write(tmp_path)) == 2
    assert "more than 1,000,000 facets in all" in capsys.readouterr().err


WATCH = """
import subprocess
import sys
from pathlib import Path
from torchlc.cli import run

folder = sys.argv[1]
arguments = ["fit", f"{folder}/scene.toml", f"{folder}/recording.csv", "-o", f"{folder}/out", "--steps", "20", "--quiet"]
assert run(arguments) == 0  # what libraries read once of their own they have read now
if len(sys.argv) > 2:
    Path(folder, "body.obj").write_text(sys.argv[2])
seen = []
def watch(event, details):
    if event.startswith("pickle.") or event in ("marshal.loads", "socket.connect", "subprocess.Popen"):
        seen.append((event, str(details)[:100]))
    if event == "open" and isinstance(details[0], str):
        path = Path(details[0]).resolve()
        if not any(path.is_relative_to(one) for one in (Path(folder).resolve(), sys.prefix, sys.base_prefix, "/proc")):
            seen.append((event, str(path)))
sys.addaudithook(watch)
code = run(arguments)
print(code, seen)
"""


@pytest.mark.long
def test_a_strangers_scene_opens_nothing_outside_its_folder(tmp_path: Path):
    """As Python's audit hooks see it: no file elsewhere, no pickle, no connection, no process, whatever a mesh
    asks for."""
    inside = tmp_path / "in"
    inside.mkdir()
    (tmp_path / "secret.mtl").write_text("newmtl stolen\nKd 1 0 0\nmap_Kd secret.png\n")
    mesh = "mtllib ../secret.mtl /etc/passwd\nusemtl stolen\n" + BESIDE["body.obj"].decode()
    files = {**BESIDE, "scene.toml": MESH_SCENE.encode(), "recording.csv": RECORDING.encode()}
    Case(files, ()).write(inside)
    done = subprocess.run(
        [sys.executable, "-c", WATCH, str(inside), mesh], capture_output=True, text=True, check=False
    )
    assert done.stdout == "0 []\n", (done.stdout, done.stderr)
