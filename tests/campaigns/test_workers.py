"""The processes of a campaign: workers that die, raise, wait for nobody else and end with it; memory that does not grow."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import dask.config
import distributed  # noqa: F401  (loads the configuration that is changed below)
import psutil
import pytest

from tests.campaign_tasks import deadly, raises
from tests.campaigns.cases import ENVIRONMENT, ROOT, alive, until
from tests.killed_runs import check_files
from torchlc.campaigns.cluster import connected, spread
from torchlc.cli import run
from torchlc.errors import InputError, TorchlcError
from torchlc.files.writing import LOCK_NAME


def test_what_is_no_cluster_is_said(manifest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ["campaign", str(manifest), "-o", str(tmp_path / "out")]
    with dask.config.set({"distributed.comm.timeouts.connect": "1s"}):
        assert run([*arguments, "--scheduler", "nonsense://here"]) == 2
        assert "--scheduler: no Dask scheduler answers at nonsense://here" in capsys.readouterr().err
    assert run([*arguments, "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"]) == 2
    assert run(["campaign", str(tmp_path / "none.csv"), "-o", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


def test_without_dask_the_pip_line_is_said(manifest: Path, tmp_path: Path):
    call = "import sys; sys.modules['distributed'] = None; from torchlc.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", call, "campaign", str(manifest), "-o", str(tmp_path / "out")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2 and "pip install 'torchlc[dask]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1 and not (tmp_path / "out").exists()


def test_an_object_that_kills_every_worker_stops_nothing():
    with connected(None, 2, 1) as client:
        outcomes = dict(spread(client, deadly, range(8)))
    assert {number: outcome for number, outcome in outcomes.items() if number != 3} == {
        number: str(number) for number in range(8) if number != 3
    }
    assert isinstance(outcomes[3], TorchlcError) and "died" in str(outcomes[3])


def test_what_a_worker_raises_arrives_whole():
    with connected(None, 1, 1) as client:
        ((_, error),) = spread(client, raises, [7])
    assert isinstance(error, InputError)
    assert str(error) == "file.csv: line 7: nothing; expected something. a hint" and error.hint == "a hint"


def listening(process: psutil.Process) -> list[Any]:
    """Sockets at which a process and those it began wait for others, of the internet or of this machine by name."""
    family = [process, *process.children(recursive=True)]
    inet = [one for each in family for one in each.net_connections("inet")]
    named = [one for each in family for one in each.net_connections("unix") if one.laddr]
    return [one for one in inet if one.status == psutil.CONN_LISTEN or one.type == socket.SOCK_DGRAM] + named


@pytest.mark.long
def test_nobody_else_can_reach_the_workers_and_a_killed_campaign_takes_them_along(
    manifest: Path, tmp_path: Path
):
    """No port is open and no socket has a name while objects are being done; the kernel's list says so."""
    command = ["campaign", str(manifest), "-o", str(tmp_path / "out"), "--workers", "2", "--quiet"]
    campaign = subprocess.Popen(
        [sys.executable, "-m", "torchlc", *command], env=ENVIRONMENT, start_new_session=True
    )
    process = psutil.Process(campaign.pid)
    until(lambda: any((tmp_path / "out").glob(f"objects/*/{LOCK_NAME}")))
    seen = listening(process)
    workers = len(process.children(recursive=True))
    campaign.send_signal(signal.SIGKILL)
    campaign.wait()
    until(lambda: not alive(campaign.pid), 30)
    check_files(tmp_path / "out")
    assert workers >= 2 and seen == []
    with socket.create_server(("127.0.0.1", 0)) as server:  # what would be seen
        mine = listening(psutil.Process())
        assert server.getsockname() in [one.laddr for one in mine]


MEMORY = """
from distributed import Client
from tests.campaign_tasks import resident_mib
from torchlc.campaigns.cluster import AHEAD, spread

def counted(most):
    global taken
    for taken in range(most):
        yield taken

with Client(processes=False, n_workers=1, threads_per_worker=2, dashboard_address=None) as client:
    for done, _ in enumerate(spread(client, str, counted(4_000)), start=1):
        assert taken < done + AHEAD * 2, (taken, done)
        if done == 1_000:
            early = resident_mib()
    print(resident_mib() - early)
"""


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_the_memory_of_the_client_does_not_grow_with_the_number_of_objects():
    """4,000 tasks, with scheduler and workers in the same process; 4.7 MiB were measured after the first 1,000, which Dask's
    logs of fixed length fill; the tasks themselves, held, would add 2.5 kB each, 7.5 MiB."""
    done = subprocess.run(
        [sys.executable, "-c", MEMORY], env=ENVIRONMENT, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert float(done.stdout) < 8


@pytest.mark.long
def test_ctrl_c_ends_with_130_and_leaves_no_worker(manifest: Path, tmp_path: Path):
    command = ["campaign", str(manifest), "-o", str(tmp_path / "out"), "--workers", "1", "--quiet"]
    campaign = subprocess.Popen(
        [sys.executable, "-m", "torchlc", *command], env=ENVIRONMENT, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    until(lambda: any((tmp_path / "out").glob(f"objects/*/{LOCK_NAME}")))
    os.killpg(campaign.pid, signal.SIGINT)
    _, error = campaign.communicate(timeout=60)
    assert campaign.returncode == 130
    assert error.splitlines() == [f"torchlc: interrupted; continue with: torchlc {' '.join(command)}"]
    until(lambda: not alive(campaign.pid), 20)
