"""Time that a search may take: when it is spent, the best so far is the answer, and the answer says so."""

from __future__ import annotations

import math
import time


class Budget:
    """CPU seconds since it was made; None is no bound. CPU seconds, for a machine that is busy with other work must not
    cut a search short."""

    def __init__(self, seconds: float | None = None) -> None:
        self.began, self.seconds = time.process_time(), seconds

    @property
    def bounded(self) -> bool:
        return self.seconds is not None

    @property
    def spent(self) -> float:
        return time.process_time() - self.began

    @property
    def remaining(self) -> float:
        """CPU seconds left, at least 0; infinite without a bound."""
        return math.inf if self.seconds is None else max(self.seconds - self.spent, 0.0)

    def left(self, share: float = 1.0) -> bool:
        """Whether less than a share of the budget is spent."""
        return self.seconds is None or self.spent < share * self.seconds

    def part(self, share: float) -> Budget:
        """A budget, from now on, of a share of what remains."""
        return Budget(None if self.seconds is None else share * self.remaining)
