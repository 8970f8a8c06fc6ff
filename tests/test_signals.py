"""What ends a run from outside ends it in words, with the promised exit code, and leaves no lock."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.whole_processes import ENVIRONMENT, start
from torchlc.files.writing import LOCK_NAME


def until(condition: Callable[[], bool], seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "times", "code", "word"),
    [("SIGINT", 3, 130, "interrupted"), ("SIGHUP", 2, 143, "ended by SIGHUP")],
)
def test_a_signal_ends_a_run_in_words(
    name: str, times: int, code: int, word: str, case: tuple[str, str], tmp_path: Path
):
    """Also one that comes again while the first is heeded: locks and partial files go."""
    out = tmp_path / "out"
    process = start(["-m", "torchlc", "fit", *case, "-o", str(out), "--steps", "100000"])
    until((out / LOCK_NAME).exists)
    for _ in range(times):
        process.send_signal(getattr(signal, name))
        time.sleep(0.02)
    _, error = process.communicate(timeout=60)
    assert process.returncode == code
    assert error.startswith(f"torchlc: {word}") and len(error.splitlines()) == 1
    assert not out.exists() or not list(out.glob(".*"))


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 143)])
def test_a_signal_while_the_program_is_loaded(name: str, code: int):
    """As in the first tenths of a second: no traceback of a library that was being imported."""
    call = (
        "from torchlc.cli import signals; signals.leave_at_once(); print('there', flush=True); import time; "
        "time.sleep(60)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", call], env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == "there\n"
    process.send_signal(getattr(signal, name))
    _, error = process.communicate(timeout=60)
    assert process.returncode == code and error == ""


EVERYWHERE = """
import mmap, os, signal, sys
from torchlc import cli
from torchlc.cli import program

OURS = ("/cli/__init__.py", "/cli/program.py", "/cli/signals.py", "/torchlc/terminal.py")
sys.argv[1:] = ["--version"]
built = program.typer.main.get_command(program.app)  # once, as all that is loaded on first use
program.typer.main.get_command = lambda app: built
cli.run(sys.argv[1:])
lines = 0


def trace(frame, event, argument):
    global lines
    if not frame.f_code.co_filename.endswith(OURS):
        return None
    if event == "line" and signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        lines += 1
        if lines == at:
            sent[0] = 1
            os.kill(os.getpid(), signal.SIGINT)
    return trace


at, ends, sent = 0, set(), mmap.mmap(-1, 1)
sent[0] = 1
while sent[0]:
    at, sent[0] = at + 1, 0
    child = os.fork()
    if not child:
        sys.settrace(trace)
        try:
            cli.main()
        except SystemExit as end:
            os._exit(end.code)
    code = os.waitstatus_to_exitcode(os.wait()[1])
    ends.add(code)
    assert code in (0, 130), (at, code)
print(at, sorted(ends))
"""


def test_a_signal_at_every_line_between_start_and_end():
    """From the first handler to the end, in whichever line of the frame about a command a signal comes: 130 without a traceback,
    or the end it would have come to when all is done."""
    command = [sys.executable, "-c", EVERYWHERE]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert done.stdout.splitlines()[-1].endswith("[0, 130]")


@pytest.mark.parametrize(
    "where",
    [
        "exec('kill()')",
        "type('Table', (), {'field': type('Field', (), {'__set_name__': lambda *_: kill()})()})",
    ],
)
def test_a_signal_inside_of_exec_or_of_a_class_is_a_signal(where: str):
    """Both are common while libraries are imported. Python ends by the signal after exec, whatever code it is given, and makes
    a RuntimeError of it in a class."""
    call = f"""
import os, signal
from torchlc.cli import signals
from torchlc.terminal import exit_code

def kill():
    os.kill(os.getpid(), signal.SIGINT)

code = exit_code(lambda: signals.unwinding(lambda: {where}))
print("done", end="")
signals.leave(code)
"""
    done = subprocess.run(
        [sys.executable, "-c", call], env=ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "done", "torchlc: interrupted\n")


@pytest.mark.parametrize(
    ("lasts", "printed"),
    [("0.3", "imported done"), ("60", "done")],
    ids=["an import is not broken off", "but one that computes for long"],
)
def test_a_signal_while_something_is_imported_waits_for_its_end(lasts: str, printed: str, tmp_path: Path):
    """Compiled modules abort the whole process when an exception meets them as they start; the user's own may compute for hours."""
    (tmp_path / "slow_to_import.py").write_text(
        f"import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep({lasts})\n"
        "print('imported', end=' ')\n"
    )
    call = f"""
import sys, time
from torchlc.cli import signals
from torchlc.terminal import exit_code

signals.IMPORT_S = 1.0
sys.path.insert(0, {str(tmp_path)!r})

def action():
    import slow_to_import
    time.sleep(60)

code = exit_code(lambda: signals.unwinding(action))
print("done", end="")
signals.leave(code)
"""
    done = subprocess.run(
        [sys.executable, "-c", call], env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=30
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, printed, "torchlc: interrupted\n")


@pytest.mark.long
def test_ctrl_c_at_any_moment_of_the_first_half_second():
    """As a whole process, many times: 130 in a line or none, or the end it would have come to. Until the first line of the program
    runs, Python itself answers."""
    before, ends = 0, set()
    for number in range(60):
        process = start(["-m", "torchlc", "effects"])
        time.sleep(0.5 * number / 60)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
        reached = re.search(r'cli/__init__\.py", line \d+, in main', error)
        if process.returncode == -signal.SIGINT or ("Traceback" in error and not reached):
            before += 1
            continue
        assert error in ("", "torchlc: interrupted\n") and process.returncode in (0, 130), error
        ends.add(process.returncode)
    assert 130 in ends and before < 30


def test_what_is_to_be_ignored_stays_ignored():
    """As under nohup: a SIGHUP that the parent ignores changes nothing."""
    call = (
        "import os, signal; from torchlc.cli import signals; signals.leave_at_once(); signals.unwind(); "
        "os.kill(os.getpid(), signal.SIGHUP); print('on')"
    )
    done = subprocess.run(
        ["sh", "-c", 'trap "" HUP; exec "$@"', "sh", sys.executable, "-c", call],
        env=ENVIRONMENT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout == "on\n" and done.returncode == 0, done.stderr
