"""A Dask cluster of processes with the certificate of the page "A campaign on several machines", as that page makes it: the
campaign runs on it, and nobody without the key gets in."""

from __future__ import annotations

import contextlib
import http.client
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pandas
import pytest

from tests.campaigns.cases import ENVIRONMENT, ROOT, ROWS, until, write_manifest
from tests.run_page import blocks
from tests.small_case import write_case

PAGE = ROOT / "docs" / "how_to" / "clusters.md"


def free_ports(count: int) -> list[int]:
    with_ports = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [one.getsockname()[1] for one in with_ports]
    for one in with_ports:
        one.close()
    return ports


def answers(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, int, int]]:
    """Folder of a certificate, port of a scheduler with two workers, and port of its pages."""
    folder = tmp_path_factory.mktemp("guarded")
    (script,) = [text for _, kind, text in blocks(PAGE) if kind == "sh"]
    subprocess.run(["sh", "-ec", script], cwd=folder, check=True, capture_output=True)
    port, pages = free_ports(2)
    own = {**ENVIRONMENT, "DASK_CONFIG": str(folder / "cluster")}

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", *arguments], cwd=folder, env=own, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )  # fmt: skip

    processes = [
        start("distributed.cli.dask_scheduler", "--protocol", "tls", "--host", "127.0.0.1", "--port", str(port),
              "--no-dashboard", "--dashboard-address", f"127.0.0.1:{pages}"),
    ]  # fmt: skip
    until(lambda: answers(port))
    processes += [
        start("distributed.cli.dask_worker", f"tls://127.0.0.1:{port}", "--nthreads", "1", "--no-nanny", "--no-dashboard")
        for _ in range(2)
    ]  # fmt: skip
    yield folder / "cluster", port, pages
    for process in reversed(processes):
        process.kill()
        process.wait()


def campaign(folder: Path, address: str, settings: Path | None) -> subprocess.CompletedProcess[str]:
    own = ENVIRONMENT if settings is None else {**ENVIRONMENT, "DASK_CONFIG": str(settings)}
    command = ["-m", "torchlc", "campaign", "manifest.csv", "-o", "out", "--scheduler", address]
    return subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        env=own,
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )


@pytest.mark.long
@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
def test_a_campaign_runs_where_only_the_key_opens(guarded: tuple[Path, int, int], tmp_path: Path):
    settings, port, pages = guarded
    assert (settings / "key.pem").stat().st_mode & 0o077 == 0
    write_case(tmp_path, rows=ROWS)
    one = {
        "scene": "scene.toml",
        "recording": "recording.ecsv",
        "task": "fit",
        "options": "--steps 30 --walkers 10",
    }
    write_manifest(tmp_path / "manifest.csv", [{"id": name, **one} for name in "ab"])
    for address, own in (("tls", None), ("tcp", None), ("tcp", settings)):
        refused = campaign(tmp_path, f"{address}://127.0.0.1:{port}", own)
        assert refused.returncode == 2 and len(refused.stderr.splitlines()) == 1, refused.stderr
        assert "no Dask scheduler answers" in refused.stderr and not (tmp_path / "out").exists()
    done = campaign(tmp_path, f"tls://127.0.0.1:{port}", settings)
    assert done.returncode == 0 and done.stdout.startswith("2 of 2 objects done"), done.stderr
    assert list(pandas.read_parquet(tmp_path / "out" / "summary.parquet").status) == ["done", "done"]
    for page in ("info/main/workers.html", "json/counts.json", "health", ""):
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", pages, timeout=10)) as asked:
            asked.request("GET", f"/{page}")
            assert asked.getresponse().status == 404
