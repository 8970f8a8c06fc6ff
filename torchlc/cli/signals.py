"""What ends a command from outside: Ctrl-C, SIGTERM, a terminal that closes. It unwinds once, so that locks and half-written
files go, and says what it was; no traceback, at whatever moment.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import time

TYPE_CHECKING = False
"""As that of typing: nothing is loaded before the handlers are set that need not be."""
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

    Handler = Callable[[int, FrameType | None], object]

INTERRUPTED, TERMINATED = 130, 143
ENDING = ("SIGTERM", "SIGHUP")
UNWIND_S = 5.0
"""Within this of a signal further ones change nothing: they would break off what takes locks and partial files away."""
IMPORT_S, AGAIN_S = 5.0, 0.02
"""A signal waits for the end of an import so long at most, for a module of the user's may compute for hours, and asks so often."""
_last = -UNWIND_S
_ending: BaseException | None = None
"""What the last signal was."""


def leave_at_once() -> None:
    """While the program is still being loaded nothing is there to unwind: a signal ends the process."""
    _handle(lambda number, frame: os._exit(INTERRUPTED), lambda number, frame: os._exit(TERMINATED))


def leave(code: int) -> None:
    """End the process with an exit code. Where Ctrl-C came inside of exec, which classes are made with, Python would end by the
    signal itself whatever code it was given; what waits for the end of the process is done here in its place."""
    if code != INTERRUPTED:
        sys.exit(code)
    import atexit
    import contextlib

    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def unwinding(action: Callable[[], object]) -> object:
    """What ``action`` returns. While it runs a signal is an exception, which the caller has to expect; after it a signal
    changes nothing, for nobody would expect the exception. Libraries make other exceptions of it, or fail because they were
    broken off: an error that is neither told in words nor one of a file counts as the signal.
    """
    from torchlc.errors import TorchlcError
    from torchlc.terminal import UsageProblem

    unwind()
    try:
        return action()
    except (TorchlcError, UsageProblem, OSError):
        raise
    except Exception:
        if _ending is None:
            raise
        raise _ending from None
    finally:
        ignore()


def unwind() -> None:
    """From here on a signal is an exception, which a command ends with. While something is imported it waits: compiled modules
    that meet an exception then may abort the whole process."""
    from torchlc.terminal import Terminated

    came: dict[int, float] = {}

    def interrupt(number: int, frame: FrameType | None) -> None:
        end(number, frame, KeyboardInterrupt())

    def terminate(number: int, frame: FrameType | None) -> None:
        end(number, frame, Terminated(signal.Signals(number).name))

    def end(number: int, frame: FrameType | None, ending: BaseException) -> None:
        global _ending
        now = time.monotonic()
        if _importing(frame) and now < came.setdefault(number, now) + IMPORT_S:
            _thread.start_new_thread(_send_later, (number, _thread.get_ident()))
            return
        came.pop(number, None)
        if _is_first():
            _ending = ending
            raise ending

    _handle(interrupt, terminate)


def ignore() -> None:
    """The command has said its last word: what libraries do at the end of the process is not broken off."""
    for name in ("SIGINT", *ENDING):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def _handle(interrupt: Handler, terminate: Handler) -> None:
    """Signals that this process is to ignore, as a job in a shell's background or under nohup, stay ignored."""
    for name, handler in [("SIGINT", interrupt), *((name, terminate) for name in ENDING)]:
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def _send_later(number: int, thread: int) -> None:
    time.sleep(AGAIN_S)
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(thread, number)  # this wakes what sleeps or reads; the other does not
    else:
        _thread.interrupt_main(signal.Signals(number))


def _is_first() -> bool:
    global _last
    before, _last = _last, time.monotonic()
    return _last - before > UNWIND_S
