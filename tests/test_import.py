"""Nobody waits for a library to load: torchlc beside torch, and the command line without it.

Times are CPU seconds of a process of its own, the least of several, so that other work on the machine does
not count.
"""

from __future__ import annotations

import os
import subprocess
import sys

RUNS = 3
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def cpu_seconds(*arguments: str) -> float:
    """Least CPU time of ``python ARGUMENTS`` over RUNS runs, after one that fills the caches."""
    times = []
    for _ in range(RUNS + 1):
        process = subprocess.Popen(
            [sys.executable, *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=ENVIRONMENT,
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        assert process.returncode == 0
        times.append(usage.ru_utime + usage.ru_stime)
    return min(times[1:])


def test_the_package_loads_with_torch_in_hardly_more_time() -> None:
    """Public names are imported on first use; the model pulls in astropy and pydantic."""
    assert cpu_seconds("-c", "import torch, torchlc") - cpu_seconds("-c", "import torch") <= 0.3


def test_the_command_line_helps_at_once() -> None:
    call = "from torchlc.cli import main; main()"
    assert cpu_seconds("-c", call, "--help") <= 0.6


def test_help_needs_no_torch() -> None:
    call = (
        "import sys, torchlc.cli as c; sys.argv[1:] = ['fit', '--help']\n"
        "try: c.main()\nexcept SystemExit as end: assert not end.code\n"
        "heavy = {'torch', 'astropy', 'numpy', 'matplotlib'} & set(sys.modules); assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
