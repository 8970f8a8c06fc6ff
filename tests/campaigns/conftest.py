"""A manifest of five objects, and a cluster that nobody of the package started."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.campaigns.cases import BAD, ENVIRONMENT, HOSTILE, ROWS, until, write_manifest
from tests.small_case import write_case


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three fits, a diagnosis and a recording that does not exist; the paths are relative."""
    folder = tmp_path_factory.mktemp("manifest")
    write_case(folder, rows=ROWS)
    files = {"scene": "scene.toml", "recording": "recording.ecsv"}
    fits = [
        {"id": name, **files, "task": "fit", "options": "--steps 30 --walkers 10"}
        for name in (HOSTILE, "b", "c")
    ]
    diagnosis = {"id": "d", **files, "task": "diagnose", "options": "--quick --effects panel_offset --seed 9"}
    missing = {"id": BAD, "scene": "scene.toml", "recording": "none.ecsv", "task": "fit"}
    return write_manifest(folder / "manifest.csv", [*fits, missing, diagnosis])


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler and its two workers, of one thread each, all processes of their own."""
    where = tmp_path_factory.mktemp("dask")
    file = where / "scheduler.json"

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", *arguments, "--scheduler-file", str(file), "--no-dashboard"],
            cwd=where, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    scheduler = start("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0")
    own = ("distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--host", "127.0.0.1")
    until(file.exists)
    workers = [start(*own) for _ in range(2)]
    yield json.loads(file.read_text())["address"], workers
    for process in (*workers, scheduler):
        process.kill()
        process.wait()
