"""What a person at a terminal sees: progress with time left, one line for an error, and the exit code that
goes with it.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import json
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import typer

from torchlc.errors import ResourceError, TorchlcError

INTERRUPTED = 130
TERMINATED = 143
"""As a shell has it for SIGTERM; also for a terminal that closes."""
LONGEST_NAME = 200
DEFECT = 1
USAGE = 2
TRACEBACK = "TORCHLC_TRACEBACK"
"""Environment variable that shows where a defect of ours lies."""
UsageProblem: type[Exception] = next(
    cls for cls in typer.BadParameter.__mro__ if cls.__name__ == "ClickException"
)
"""Base of everything the command line itself objects to; newer typer brings a click of its own."""


SPELLED = "torchlc-spelled"
"""Name of the way in which streams write what their encoding lacks."""
SPELLINGS = {"±": "+-", "→": "->", "°": " deg", "−": "-"}
"""Signs of our own output in ASCII."""


def spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    """One sign that an encoding lacks, in ASCII, and where to go on; what is not a sign of ours, a name's letter, is escaped
    so that it stays told apart."""
    if isinstance(error, UnicodeEncodeError) and (sign := error.object[error.start]) in SPELLINGS:
        return SPELLINGS[sign], error.start + 1
    if isinstance(error, UnicodeEncodeError):
        error.end = error.start + 1
    return codecs.backslashreplace_errors(error)


codecs.register_error(SPELLED, spelled)


class Terminated(SystemExit):
    """The process was asked to end by a signal of this name. No error: only the end of the command hears of it."""


def prepare_process() -> None:
    """Make the command independent of how it was started: streams that are closed take what is written to them, signs
    that the terminal does not have are spelled and letters escaped, and settings of matplotlib that a person or a notebook left behind, which
    could end a run at its first figure, do not count.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(
                os.devnull, os.O_RDWR
            )  # takes the lowest number that is free; a file of results would else
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115 - for the life of the process
        else:
            stream.reconfigure(errors=SPELLED)
    os.environ |= {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull}


def exit_code(action: Callable[[], object], after_interrupt: str = "") -> int:
    """Run a command and turn whatever it raises into one line on standard error and the exit code of
    FORMATS.
    """
    try:
        with quiet_libraries():
            found = action()
        if found == INTERRUPTED:  # newer typer turns Ctrl-C into this exit code itself
            raise KeyboardInterrupt
    except TorchlcError as error:
        say(f"error: {error}")
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        say(f"interrupted{after_interrupt}")
        return INTERRUPTED
    except Terminated as error:
        say(f"ended by {error}{after_interrupt}")
        return TERMINATED
    except UsageProblem as error:
        say(f"error: {one_line(getattr(error, 'format_message', error.__str__)())}. Try --help.")
        return USAGE
    except (BrokenPipeError, SystemExit) as error:
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            raise  # the command line's library makes an exit of a broken pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError:
        say("error: out of memory")
        return ResourceError.exit_code
    except Exception as error:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            say("error: no room on disk")
            return ResourceError.exit_code
        if isinstance(error, OSError) and (error.filename is not None or error.errno == errno.EIO):
            name = one_line(str(error.filename or "a file"))[:LONGEST_NAME]
            say(f"error: {name}: cannot be used: {error.strerror}")
            return USAGE
        say(f"a defect of torchlc, please report it: {type(error).__name__}: {one_line(str(error))}")
        if os.environ.get(TRACEBACK):
            traceback.print_exc()
        else:
            say(f"({TRACEBACK}=1 shows where)")
        return DEFECT
    return found if isinstance(found, int) else 0


@contextlib.contextmanager
def quiet_libraries() -> Iterator[None]:
    """Keep what other people's code warns of away from the terminal; our own warnings are part of the
    results.
    """
    import logging

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
        try:
            yield
        finally:
            logging.disable(logging.NOTSET)


def one_line(text: str) -> str:
    return " ".join(text.split()).rstrip(".")


def say(text: str) -> None:
    """One line on standard error."""
    with contextlib.suppress(OSError, ValueError):
        print(f"torchlc: {printable(text)}", file=sys.stderr, flush=True)


def printable(text: str) -> str:
    """``text`` without characters that would move a terminal's cursor or colour."""
    return "".join(c if c.isprintable() else "?" for c in text)


def show_json(content: Any) -> None:
    """A result on standard output; refuses NaN, which JSON does not have. Letters are escaped where the output lacks them."""
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    try:
        text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        text = json.dumps(content, indent=1, allow_nan=False)
    print(text)


@contextlib.contextmanager
def progress_bar(wanted: bool) -> Iterator[Callable[[str, float], None]]:
    """A callback (stage, fraction done) that draws a bar with the time left while standard error is a
    terminal.
    """
    if not wanted or not sys.stderr.isatty():
        yield lambda stage, fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:<22}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def advance(stage: str, fraction: float) -> None:
            if stage not in tasks:
                for earlier in tasks.values():
                    bars.update(earlier, completed=1.0)
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=min(fraction, 1.0))

        yield advance
