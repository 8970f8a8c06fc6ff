"""Times that other work on the machine disturbs least: calls take turns, and the least CPU time of each counts."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Call = Callable[[], object]


@dataclass(frozen=True)
class Result:
    """One line of the table: what it is, the ratio, and what it is held to (None: nothing)."""

    what: str
    ratio: float
    bar: str | None = None
    unit: str = ""

    def __str__(self) -> str:
        held = f"   ({self.bar})" if self.bar else ""
        return f"  {self.what:<82} {self.ratio:9.3g}{self.unit}{held}"


def least(calls: Mapping[str, Call], runs: int, *, threads: int = 1) -> dict[str, float]:
    """Least seconds of each call over ``runs`` rounds of all in turn, after a round that fills caches: of CPU
    time with one thread, of elapsed time with more."""
    clock = time.process_time if threads == 1 else time.perf_counter
    for call in calls.values():
        call()
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(runs):
        for name, call in calls.items():
            start = clock()
            call()
            best[name] = min(best[name], clock() - start)
    return best
