"""Workers of our own or somebody's Dask cluster, and a loop that keeps them busy while it holds only a few
tasks at a time.

On a cluster an object whose worker dies is tried again elsewhere (Dask's own doing). An object that Dask has given up,
whose own worker died, or whose directory a live run still holds, comes last and alone: only then is it known that the
object itself, and no neighbour, killed the workers.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar, cast

from torchlc.campaigns.processes import Tell, Workers, now_and_then
from torchlc.errors import BusyError, InputError, MissingExtraError, TorchlcError, option

if TYPE_CHECKING:
    from distributed import Client, Future

AHEAD = 2
"""Tasks that the client holds for each thread of the workers: one that runs and one that waits."""
LOOK_EVERY_S = 2.0
"""How often the number of workers is asked for."""
CONNECT_S = 15.0
"""For a scheduler to answer, over whatever network."""

Task = TypeVar("Task")
Heard = Callable[[Any, float], None]
"""What is called with a task and the share of it that is done."""


def require_dask() -> None:
    """Raise MissingExtraError unless the packages of a campaign are installed."""
    try:
        import distributed  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            f"a campaign needs an extra ({error}): pip install 'torchlc[dask]'"
        ) from error


@contextlib.contextmanager
def connected(scheduler: str | None, workers: int | None, threads: int) -> Iterator[Client | Workers]:
    """A client of the scheduler at that address, else as many worker processes of our own (by default one a core),
    which end with the block."""
    if scheduler is None:
        with Workers(workers or max(1, cores() // threads), threads) as processes:
            yield processes
        return
    from distributed import Client

    with contextlib.ExitStack() as stack:
        for logger in map(logging.getLogger, ("distributed", "distributed.client")):
            stack.callback(logger.setLevel, logger.level)  # what goes wrong is told by us, in words
            logger.setLevel(logging.CRITICAL)
        try:
            client = stack.enter_context(Client(scheduler, timeout=CONNECT_S))
        except (OSError, RuntimeError, TimeoutError, TypeError, ValueError) as error:
            raise InputError(
                None,
                option("scheduler"),
                f"no Dask scheduler answers at {scheduler}: {error}"[:200],
                "the address of one that runs, such as tls://HOST:8786",
            ) from None
        yield client


def spread(
    client: Client | Workers,
    function: Callable[..., str],
    tasks: Iterable[Task],
    told: Callable[[Task, float], None] | None = None,
) -> Iterator[tuple[Task, str | TorchlcError]]:
    """Each task with what ``function`` gives for it, as they finish; an error where its workers died or its
    directory is held. Tasks are taken from ``tasks`` only as fast as they are worked off. With ``told`` the function takes a
    Tell beside its task, and ``told`` hears task and share.
    """
    kind = _OnProcesses if isinstance(client, Workers) else _OnCluster
    running = kind(cast(Any, client), function, told)
    held: list[Task] = []

    def one_more() -> Iterator[tuple[Task, str]]:
        task, outcome = running.next()
        if isinstance(outcome, str):
            yield task, outcome
        else:
            held.append(task)

    for task in tasks:
        running.start(task)
        while running.full():
            yield from one_more()
    while len(running):
        yield from one_more()
    for task in held:
        running.start(task)
        yield running.next()


class _OnProcesses:
    """The tasks on processes of our own."""

    def __init__(self, workers: Workers, function: Callable[..., str], told: Heard | None) -> None:
        self._workers, self._function, self._told = workers, function, told

    def __len__(self) -> int:
        return len(self._workers)

    def full(self) -> bool:
        """Whether every process has its task."""
        return len(self) >= self._workers.count

    def start(self, task: Any) -> None:
        self._workers.start(self._function, task, self._told is not None)

    def next(self) -> tuple[Any, str | TorchlcError]:
        """The next task to finish, with its result or why it should be tried again, alone."""
        task, answer = self._workers.next(self._told)
        if isinstance(answer, BaseException) and type(answer) not in (BusyError, InputError, TorchlcError):
            raise answer
        return task, cast(Any, answer)


class _OnCluster:
    """The tasks on the workers of a cluster, and how many of them there should be."""

    def __init__(self, client: Client, function: Callable[..., str], told: Heard | None) -> None:
        from distributed import as_completed

        self._client, self._function, self._told = client, function, told
        self._topic = f"torchlc {uuid.uuid4()}"
        if told is not None:
            client.subscribe_topic(self._topic, self._heard)
        self._tasks: dict[Future, Any] = {}
        self._completed: Any = as_completed()
        self._width, self._looked = 0, -math.inf

    def __len__(self) -> int:
        return len(self._tasks)

    def full(self) -> bool:
        """Whether every thread has its share; asks now and then how many there are."""
        if time.monotonic() > self._looked + LOOK_EVERY_S:
            self._width = AHEAD * max(1, sum(cast(Any, self._client.nthreads()).values()))
            self._looked = time.monotonic()
        return len(self) >= self._width

    def start(self, task: Any) -> None:
        key = f"torchlc-{uuid.uuid4()}"
        function = self._function if self._told is None else _Telling(self._function, self._topic, key)
        future = self._client.submit(function, task, pure=False, key=key)
        self._tasks[future] = task
        self._completed.add(future)

    def _heard(self, event: tuple[float, Any]) -> None:
        """A worker's word, in the thread of the client's loop."""
        key, share = event[1]
        for future, task in list(self._tasks.items()):
            if future.key == key and self._told is not None:
                self._told(task, share)

    def next(self) -> tuple[Any, str | TorchlcError]:
        """The next task to finish, with its result or why it should be tried again, alone."""
        from distributed import CancelledError
        from distributed.scheduler import KilledWorker

        future = next(self._completed)
        task = self._tasks.pop(future)
        try:
            return task, future.result()
        except (BusyError, InputError) as error:
            return task, error
        except KilledWorker:
            return task, TorchlcError("every worker that tried it died, of lack of memory most likely")
        except CancelledError:
            raise InputError(
                None,
                option("scheduler"),
                "the scheduler went away",
                hint="Repeat the command to go on: finished objects are skipped",
            ) from None
        except ImportError as error:
            raise InputError(
                None,
                option("scheduler"),
                f"a worker lacks a package: {error}",
                "workers and scheduler with the same torchlc as here",
            ) from error


@dataclass(frozen=True)
class _Telling:
    """A function that tells a topic of the scheduler how far it is."""

    function: Callable[..., str]
    topic: str
    key: str

    def __call__(self, task: Any) -> str:
        from distributed import get_worker

        worker = get_worker()
        tell: Tell = now_and_then(lambda share: worker.log_event(self.topic, (self.key, share)))
        return self.function(task, tell)


def cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
