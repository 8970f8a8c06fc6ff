"""Manifests, and what tests of campaigns wait for."""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path
from typing import Any

HOSTILE = "../../R/B <img src=x onerror=alert(1)> 100%"
BAD = "no such recording"
ROWS = 13
ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}


def write_manifest(path: Path, rows: list[dict[str, str]]) -> Path:
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, ["id", "scene", "recording", "task", "options"])
        writer.writeheader()
        writer.writerows(rows)
    return path


def until(condition: Any, seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
