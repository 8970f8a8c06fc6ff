"""Tasks of a campaign's workers, in a module that takes no time to load: every worker process begins with it."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

from torchlc.errors import InputError


def deadly(number: int) -> str:
    """Kill the worker for one number."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return str(number)


def raises(number: int) -> str:
    raise InputError("file.csv", f"line {number}", "nothing", "something", "a hint")


def tells(number: int, tell: Any) -> str:
    """Says two thirds, and waits until it may say more."""
    tell(2 / 3)
    time.sleep(0.6)
    tell(0.9)
    return str(number)


def resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
