"""torchlc as a process, on a small case."""

from __future__ import annotations

import subprocess
import sys
import time

TLE = """\
TEST SATELLITE
1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993
2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966
TEST SATELLITE
1 00001U 16037A   20294.07341138 -.00000354  00000-0  00000+0 0  9994
2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966
"""


def process(*arguments: str, **options) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "torchlc", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def until(condition, worker: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 240
    while not condition():
        assert worker.poll() is None and time.monotonic() < end, worker.communicate()
        time.sleep(0.02)
