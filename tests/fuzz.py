"""Mutated scenes and recordings through the command line: exit 0 or 2 only, in bounded time and memory.

A fit or a diagnosis may take what its scene costs: still at work after ``LONGEST_S`` of CPU it is interrupted as
by Ctrl-C, and has to end with 130.

python -m tests.fuzz                                  # 10,000 in process and 200 whole processes
python -m tests.fuzz --examples 500 --processes 10
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, settings

from tests.fuzz_cases import LONG, QUICK, WHOLE, Case, cases
from torchlc.cli import run

LONGEST_S = 30.0
LONGEST_END_S = 30.0
"""From the interrupt to the end, of CPU."""
LONGEST_WAIT_S = 1800.0
"""On the clock: a command that waits for ever."""
MOST_BYTES = 2 << 30


def problem(code: int, error: str, output: str, seconds: float, folder: Path) -> str | None:
    """What is wrong with the end of a run; None if nothing is."""
    if code not in (0, 2):
        return f"exit {code}: {error.strip().splitlines()[:1]}"
    if "Traceback" in error + output:
        return f"traceback: {error.strip().splitlines()[-1]}"
    if code == 2 and not (error.startswith("torchlc: ") and len(error.splitlines()) == 1 and not output):
        return f"exit 2 without exactly one line: {error!r}"
    if code == 2 and (folder / "out").exists():
        return "exit 2, but something was written"
    return f"{seconds:.0f} s" if seconds > LONGEST_S else None


def in_process(case: Case) -> str | None:
    """Run the case in this process; what is wrong with its end."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    with tempfile.TemporaryDirectory(prefix="torchlc-fuzz") as name:
        output, error, began = io.StringIO(), io.StringIO(), time.process_time()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(error):
            code = run(case.write(Path(name)))
        said = problem(code, error.getvalue(), output.getvalue(), time.process_time() - began, Path(name))
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return said or _too_much(int(status["VmHWM"].split()[0]) * 1024)


def whole_process(case: Case) -> str | None:
    """Run the case as a command of its own; what is wrong with its end, its time and its memory."""
    with tempfile.TemporaryDirectory(prefix="torchlc-fuzz") as name:
        folder = Path(name)
        with (folder / "stdout").open("wb") as output, (folder / "stderr").open("wb") as error:
            command = [sys.executable, "-m", "torchlc", *case.write(folder)]
            worker = subprocess.Popen(command, stdout=output, stderr=error)
        usage, interrupted = _ended(worker, case.command[0] in LONG)
        seconds = usage.ru_utime + usage.ru_stime
        said = problem(
            0 if interrupted and worker.returncode == 130 else worker.returncode,
            (folder / "stderr").read_text(errors="replace"),
            (folder / "stdout").read_text(errors="replace"),
            0.0 if interrupted else seconds,
            folder,
        )
    return said or _too_much(usage.ru_maxrss * 1024)


def _ended(worker: subprocess.Popen[bytes], long: bool) -> tuple[resource.struct_rusage, bool]:
    """What a process has used at its end, and whether that was by our Ctrl-C; what takes too long is killed."""
    began, interrupted = time.monotonic(), False
    while True:
        ended, status, usage = os.wait4(worker.pid, os.WNOHANG)
        if ended:
            worker.returncode = os.waitstatus_to_exitcode(status)
            return usage, interrupted
        ticks = Path(f"/proc/{worker.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
        used = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
        if long and not interrupted and used > LONGEST_S:
            interrupted = True
            os.kill(worker.pid, signal.SIGINT)
        elif used > LONGEST_S + LONGEST_END_S or time.monotonic() - began > LONGEST_WAIT_S:
            os.kill(worker.pid, signal.SIGKILL)
        time.sleep(0.05)


def _too_much(peak: int) -> str | None:
    return f"{peak / 2**30:.1f} GiB" if peak > MOST_BYTES else None


def campaign(
    runner: Callable[[Case], str | None], commands: list[tuple[str, ...]], count: int, keep: Path
) -> int:
    """Run ``count`` cases; each new kind of failure is printed and its files are kept. The number of failures."""
    failures: Counter[str] = Counter()
    done = 0

    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(cases(commands))
    def each(case: Case) -> None:
        nonlocal done
        done += 1
        said = runner(case)
        if said is not None:
            kind = said[:120]
            if not failures[kind]:
                folder = keep / f"{len(failures):02d}"
                folder.mkdir(parents=True, exist_ok=True)
                print(f"{folder}: {said}: torchlc {' '.join(case.write(folder))}", flush=True)
            failures[kind] += 1
        if done % 20 == 0:
            print(f"{runner.__name__}: {done} of {count}", file=sys.stderr, flush=True)

    each()
    print(f"{runner.__name__}: {done} cases, {failures.total()} failures", flush=True)
    return failures.total()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--examples", type=int, default=10_000, help="in this process")
    parser.add_argument("--processes", type=int, default=200, help="as commands of their own")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"), help="where failing files go")
    chosen = parser.parse_args()
    failures = 0
    # a job in a shell's background ignores it, and so would what it starts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # processes first: the peak of a child counts that of the process it was forked from
    if chosen.processes:
        failures += campaign(whole_process, WHOLE, chosen.processes, chosen.keep / "whole")
    if chosen.examples:
        failures += campaign(in_process, QUICK, chosen.examples, chosen.keep)
    return min(failures, 1)


if __name__ == "__main__":
    sys.exit(main())
