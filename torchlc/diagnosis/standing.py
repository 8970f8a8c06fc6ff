"""Where a search stands: what its leader leaves, and what the library does not hold beside it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from torchlc.diagnosis.discrepancy import FAR, Discrepancy
from torchlc.diagnosis.fits import REACH
from torchlc.diagnosis.hypotheses import Hypothesis, effect_columns
from torchlc.diagnosis.promises import NEAR, Promises
from torchlc.diagnosis.swing_shape import shape_of
from torchlc.inference.density import SCALE_SIGMA, Fitted

CLEAN_P = 0.05
"""p-value of what a set leaves above which its rivals are not grown."""


def near_quoted(at: Fitted) -> bool:
    """Whether the errors that a fit leaves are within twice what is believed of those quoted, a row counted as FAR off at most:
    larger ones, or many bad rows, leave nothing to be seen either."""
    squares = (at.delta / at.quoted).square().clamp(max=FAR**2)
    return float(squares.mean()) < math.exp(2 * SCALE_SIGMA) ** 2


@dataclass
class Standing(Promises):
    """Promises, with discrepancies that nothing of the library explains, and what the foremost leaves."""

    odd: list[Discrepancy] = field(default_factory=list)
    _swung: dict[Hypothesis, Discrepancy] = field(default_factory=dict)

    @property
    def ahead_of_foremost(self) -> float:
        """Log odds by which what errs otherwise, or something unknown alone, is ahead of the foremost."""
        return max(self.log_odds(self.leader), self.stranger_alone) - self.log_odds(self.foremost)

    def clean(self, left: Callable[[Fitted], float]) -> bool:
        """Whether the foremost leaves nothing, by the p-value that ``left`` gives, and neither red noise nor something unknown beside it is
        ahead of it; another way to err independently is no sign that anything is left."""
        hidden = self.correlated(self.leader) and self.ahead_of_foremost > NEAR
        beside = (self.odd_log_odds(odd) for odd in self.odd if odd.beside.added == self.foremost.added)
        hidden = hidden or max(beside, default=-math.inf) > self.log_odds(self.leader)
        return not hidden and left(self.visited[self.foremost]) > CLEAN_P

    @property
    def as_quoted(self) -> bool:
        """Whether the errors that the foremost leaves are :func:`near_quoted`."""
        return near_quoted(self.visited[self.foremost])

    def numbers(self, hypothesis: Hypothesis) -> int:
        """How many numbers the effects of a set have."""
        parameters = self.bench.likelihood(hypothesis).model.parameter_set
        return sum(len(effect_columns(parameters, entry)) for entry in hypothesis.added)

    @property
    def stranger_leads(self) -> bool:
        """Whether something unknown alone is beyond the reach of the leader."""
        return self.stranger_alone > self.log_odds(self.leader) + REACH

    @property
    def stranger_alone(self) -> float:
        """Log odds of the best of something unknown beside no effect."""
        return max((self.odd_log_odds(odd) for odd in self.odd if not odd.beside.added), default=-math.inf)

    def odd_log_odds(self, odd: Discrepancy) -> float:
        """Log odds of a discrepancy with what it stands beside."""
        return odd.log_z + self.bench.log_odds(odd.beside) + odd.log_gain + odd.log_odds

    def strongest(self) -> Discrepancy | None:
        """The discrepancy of highest odds, that of an angle that swings among them."""
        odd = max(self.odd, key=self.odd_log_odds, default=None)
        swings = self.ranked(hypothesis for hypothesis in self.visited if hypothesis.unlisted)
        if not swings or (odd is not None and self.odd_log_odds(odd) > self.log_odds(swings[0])):
            return odd
        whole = swings[0]
        beside = replace(whole, added=tuple(entry for entry in whole.added if entry not in whole.unlisted))
        without = self.counterpart(beside)
        gain = self.visited[whole].log_z - (self.visited[without].log_z if without is not None else -math.inf)
        prior = self.bench.log_odds(whole) - self.bench.log_odds(beside)
        known = self._swung.get(whole)
        if known is None or known.like is not self.visited[whole]:
            self._swung[whole] = shape_of(self.visited[whole], beside, gain, prior)
        return self._swung[whole]

    def state(self) -> str:
        """The leader with its odds against the second, for a progress bar."""
        order = self.ranked()
        name = " + ".join(order[0].names) or ("noise" if order[0].noise else "nothing missing")
        return f"leads: {name}"
