"""How a search goes on: what its budget allows, what an earlier run finished, and who is told."""

from __future__ import annotations

from dataclasses import dataclass

from torchlc.files.steps import Steps
from torchlc.inference.budget import Budget
from torchlc.inference.rotation.kinds import Progress


class Allowed:
    """Whether a stage may begin within a budget of CPU seconds, and which ones that were due did not."""

    def __init__(self, seconds: float | None) -> None:
        self.budget = Budget(seconds)
        self.omitted: list[str] = []

    def __call__(self, stage: str) -> bool:
        if self.budget.left():
            return True
        if stage not in self.omitted:
            self.omitted.append(stage)
        return False

    def told(self, words: str) -> str:
        """The verdict of what was looked at, after what was not."""
        seen = words.removeprefix("cannot tell: ")
        return f"cannot tell: the budget of {self.budget.seconds:g} CPU s left out {', '.join(self.omitted)}; of what was looked at: {seen}"


@dataclass(frozen=True)
class Course:
    """``kept`` holds the results of finished stages; ``say`` is told a stage and the share of it that is done."""

    allowed: Allowed
    kept: Steps
    say: Progress
