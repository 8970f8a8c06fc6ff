"""``python -m benchmarks [SECTION ...]``: torchlc and its peers side by side, as ratios.

Every section runs in a process of its own, one thread unless it says otherwise. Sections: call, threads,
compiled, effects, geometry, memory, mesh, start, posterior, whole, free.
"""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
SECTIONS = (
    "call",
    "threads",
    "compiled",
    "effects",
    "geometry",
    "memory",
    "mesh",
    "start",
    "posterior",
    "whole",
    "free",
)


def run(name: str) -> None:
    """One section, in this process."""
    import torch

    from benchmarks import speed

    if name != "threads":
        torch.set_num_threads(1)
    warnings.filterwarnings("ignore", module="arviz")
    if name == "posterior":
        from benchmarks.posterior import posterior as section
    elif name == "whole":
        from benchmarks.posterior import whole as section
    elif name == "free":
        from benchmarks.free import free as section
    else:
        section = getattr(speed, name)
    print(f"{name}: {section.__doc__.splitlines()[0]}")
    for result in section():
        print(result, flush=True)


def main(names: list[str]) -> int:
    """All sections named, each in a process; the number of those that failed."""
    failed = 0
    for name in names or SECTIONS:
        if name not in SECTIONS:
            print(f"{name}: no such section; there are {', '.join(SECTIONS)}", file=sys.stderr)
            return 2
        threads = {} if name == "threads" else ONE_THREAD
        call = [sys.executable, "-c", f"from benchmarks.__main__ import run; run({name!r})"]
        failed += subprocess.run(call, env={**os.environ, **threads}, check=False).returncode != 0
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
