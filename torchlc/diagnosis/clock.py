"""The time that a search may take."""

from __future__ import annotations

from collections.abc import Callable

from torchlc.inference.budget import Budget

MOST_S = 900.0
"""CPU seconds after which a search without a budget ends: thirty times what most take, and as long as somebody waits unasked."""
MOST_FIT_S = 150.0
"""CPU seconds of a step beyond which it is not made."""


class Clock(Budget):
    """The budget of a search, MOST_S if nobody ``gave`` one, that tells how far it is, and that a person may stop. ``cut`` is
    whether something was left out for want of time."""

    def __init__(self, budget: float | None, progress: Callable[[str, float], None] | None = None) -> None:
        super().__init__(MOST_S if budget is None else budget)
        self.progress = progress
        self.gave = budget is not None
        self.stopped = self.cut = False

    def left(self, share: float = 1.0) -> bool:
        in_time = super().left(share)
        self.cut |= not in_time
        return in_time and not self.stopped

    def affords(self, seconds: float) -> bool:
        """Whether a step of so many seconds is worth it: within half of what is left of the budget, and MOST_FIT_S."""
        return not self.stopped and seconds < min(MOST_FIT_S, 0.5 * self.remaining)

    def tell(self, text: str, part: float) -> None:
        if self.progress is not None:
            self.progress(text, part)
