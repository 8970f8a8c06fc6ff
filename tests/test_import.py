"""Nobody waits for a library to load: torchlc beside torch, and the command line without it.

Times are CPU seconds of a process of its own, the least of a few, so that other work on the machine does not count.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import torchlc

RUNS = 2
"""The first also fills the caches of files."""
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def cpu_seconds(code: str) -> float:
    """Least of the seconds that ``code`` prints over RUNS runs."""
    command = [sys.executable, "-c", code]
    runs = [
        subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=True)
        for _ in range(RUNS)
    ]
    return min(float(run.stdout.splitlines()[-1]) for run in runs)


def test_the_package_loads_with_torch_in_hardly_more_time() -> None:
    """Public names are imported on first use; the model pulls in astropy and pydantic."""
    code = "import time, torch\nbefore = time.process_time()\nimport torchlc\nprint(time.process_time() - before)"
    assert cpu_seconds(code) <= 0.3


def test_the_command_line_helps_at_once() -> None:
    """The start of the interpreter counts."""
    code = (
        "import sys, time\nfrom torchlc.cli import main\nsys.argv[1:] = ['--help']\n"
        "try: main()\nexcept SystemExit as end: assert not end.code\nprint(time.process_time())"
    )
    assert cpu_seconds(code) <= 0.6


def test_help_needs_no_torch() -> None:
    call = (
        "import sys, torchlc.cli as c; sys.argv[1:] = ['fit', '--help']\n"
        "try: c.main()\nexcept SystemExit as end: assert not end.code\n"
        "heavy = {'torch', 'astropy', 'numpy', 'matplotlib'} & set(sys.modules); assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_simulation_loads_no_library_that_only_other_verbs_use(tmp_path: Path) -> None:
    """Each of these takes as long to load as such a curve takes to compute. (NumPy finds shapes, because PyTorch's
    ``broadcast_shapes`` loads sympy.)"""
    demo = Path(torchlc.__file__).parent / "demo"
    call = (
        "import sys, torchlc.cli as c; sys.argv[1:] = ['simulate', *sys.argv[1:]]\n"
        "try: c.main()\nexcept SystemExit as end: assert not end.code\n"
        "heavy = {'scipy.stats', 'scipy.interpolate', 'sympy', 'emcee', 'arviz', 'matplotlib', 'pandas'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    files = [str(demo / "scene.toml"), str(demo / "recording.ecsv"), "--out", str(tmp_path)]
    done = subprocess.run([sys.executable, "-c", call, *files], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "curve.ecsv").exists()
