"""Worker processes of a campaign on this machine. The campaign talks to each over a pair of sockets without a name, which
nobody else can open: no port listens, and no other user of the machine can reach the workers.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from torchlc.errors import TorchlcError
from torchlc.files.libraries import environment
from torchlc.terminal import quiet_libraries

START_METHOD = "spawn"
"""A fresh interpreter: a fork of a process whose libraries have begun threads may hang."""
GRACE_S = 5.0
"""What a worker may take to give its directory back before it is killed."""
FIRST_TO_GO = "1000"
"""The kernel's highest score: out of memory, it ends a worker and never the campaign (man 5 proc_pid_oom_score_adj)."""
LIMITS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
TERMINATED = 128 + signal.SIGTERM
TELL_EVERY_S = 0.5
"""A line of progress is not read faster."""

Tell = Callable[[float], None]
"""What a task calls with the share of it that is done."""


@dataclass(frozen=True)
class Told:
    """A worker's word on how far its task is."""

    share: float


def now_and_then(tell: Tell) -> Tell:
    """``tell``, at most every TELL_EVERY_S."""
    last = 0.0

    def call(share: float) -> None:
        nonlocal last
        if time.monotonic() >= last + TELL_EVERY_S:
            last = time.monotonic()
            tell(share)

    return call


class Workers:
    """``count`` processes of ``threads`` threads each, from ``with`` to the end of the block. One task a process."""

    def __init__(self, count: int, threads: int) -> None:
        self.count, self._threads = count, threads
        self._context = multiprocessing.get_context(START_METHOD)
        self._idle: list[Worker] = []
        self._busy: dict[Worker, Any] = {}

    def __enter__(self) -> Workers:
        try:
            with _deaf_children(), _limited(self._threads):
                for _ in range(self.count):
                    self._idle.append(Worker(self._context))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        workers = [*self._idle, *self._busy]
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.end()

    def __len__(self) -> int:
        """How many tasks are being done."""
        return len(self._busy)

    def start(self, function: Callable[..., str], task: Any, telling: bool = False) -> None:
        """Hand a task to an idle worker; one of them must be. ``telling``: the function takes a Tell as well."""
        if not self._idle:
            with _deaf_children(), _limited(self._threads):
                self._idle.append(Worker(self._context))
        worker = self._idle.pop()
        self._busy[worker] = task
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it died: next() will find out
            worker.connection.send((function, task, telling))

    def next(self, told: Callable[[Any, float], None] | None = None) -> tuple[Any, str | BaseException]:
        """The next task to finish, with its answer, or what was raised; a TorchlcError where its worker died. ``told`` hears of the
        shares of tasks that are done until then."""
        while True:
            ready = wait([worker.connection for worker in self._busy])
            worker = next(worker for worker in self._busy if worker.connection in ready)
            try:
                answer = worker.connection.recv()
            except (EOFError, ConnectionResetError):
                return self._busy.pop(worker), worker.how_it_died()
            worker.began = True
            if isinstance(answer, Told):
                if told is not None:
                    told(self._busy[worker], answer.share)
            elif answer is not None:
                self._idle.append(worker)
                return self._busy.pop(worker), answer


class Worker:
    """One process and the campaign's end of the pair of sockets to it."""

    def __init__(self, context: Any) -> None:
        self.connection, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.began = False
        """Whether it has said its first word, None."""

    def how_it_died(self) -> TorchlcError:
        """Raises it where the process did not even start: the next would not either."""
        self.end()
        if self.began:
            return TorchlcError("every worker that tried it died, of lack of memory most likely")
        raise TorchlcError(
            f"a worker process did not start (exit code {self.process.exitcode}); a script that runs a campaign needs "
            'the guard if __name__ == "__main__"'
        )

    def end(self) -> None:
        """Wait for the process to end; kill it where it does not."""
        self.connection.close()
        self.process.join(GRACE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def _serve(connection: Connection) -> None:
    """The life of a worker: tasks in, answers out, until the campaign ends or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_GO)
    threading.Thread(target=_end_with_campaign, daemon=True).start()
    connection.send(None)
    with quiet_libraries():  # what a task needs is imported as it arrives
        _serve_tasks(connection)


def _serve_tasks(connection: Connection) -> None:
    while True:
        try:
            function, task, telling = connection.recv()
        except (EOFError, ConnectionResetError):
            return
        try:
            extra = (now_and_then(lambda share: connection.send(Told(share))),) if telling else ()
            answer: Any = function(task, *extra)
        except Exception as error:
            answer = error
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            connection.send(answer)


def _leave(*_: object) -> None:
    """Unwind, so that locks and half-written files go."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(TERMINATED)


def _end_with_campaign() -> None:
    """A worker whose campaign was killed ends too."""
    campaign = multiprocessing.parent_process()
    assert campaign is not None  # a worker has one
    campaign.join()
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(GRACE_S)
    os._exit(TERMINATED)


@contextlib.contextmanager
def _deaf_children() -> Iterator[None]:
    """Processes begun here do not hear Ctrl-C, which a terminal sends to all: the campaign ends them itself."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _limited(threads: int) -> AbstractContextManager[None]:
    """Processes begun here use that many threads in the libraries below torch."""
    return environment(dict.fromkeys(LIMITS, str(threads)))
