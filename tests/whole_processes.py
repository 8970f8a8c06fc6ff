"""Runs as whole processes, behind a shell's redirection."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}


def start(
    arguments: list[str], redirection: str = "", change: dict[str, str] | None = None
) -> subprocess.Popen[str]:
    """A Python process behind a shell's redirection."""
    command = ["sh", "-c", f'exec "$@" {redirection}', "sh", sys.executable, *arguments]
    return subprocess.Popen(
        command, env=ENVIRONMENT | (change or {}), text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
