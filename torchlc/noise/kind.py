"""The contract of a noise model: an effect of the noise stage, which also says how a diagnosis searches its numbers.

One file a kind. A kind declares its quantities and a title, and ``noise`` gives back the noise that it was handed, with
more variance (:meth:`Noise.wider`), another law (:meth:`Noise.with_law`) or a further process
(:meth:`Noise.with_process`). Densities, weights of the optimiser, whitened residuals, draws, evidence and held-out
scores follow from these for every kind, those included that are defined outside the package.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch

from torchlc.noise.correlated import too_many, why_not_beside
from torchlc.parameters import Quantity
from torchlc.parameters.prior import prior_of
from torchlc.stages.effect import Context, Effect

Values = Mapping[str, float]
FIRST, CLOSER = 48, 32
"""Values tried of a kind that names none itself: anywhere in its prior, then about the best of these. The kinds of the
library try 6 to 20 values; one that knows nothing of its numbers gets a few times as many."""
NEAR = 0.75
"""Half the width, in unconstrained coordinates, of the second search; the first one's points are about 1 apart."""


@dataclass(frozen=True)
class Facts:
    """What a kind may know of residuals when it says which values to try: median standard deviation ``sigma`` of a row
    and standard deviation ``spread`` of residuals, mag; ``excess``, mag^2, of their mean square over what is quoted;
    and ``taus``, time scales in minutes that the recording can tell, none if it is too short."""

    sigma: float
    spread: float
    excess: float
    taus: Sequence[float]


class NoiseKind(Effect):
    """A noise model. ``widens``, ``reshapes`` and ``correlates`` say which of variance, law and processes it changes;
    ``mends_errors`` marks the kind that a fit adds where chi-square says that the quoted errors are too small; ``between_objects``
    one by whose ``mag`` objects of one design differ, which an object that was not seen is predicted with."""

    stage = "noise"
    widens: ClassVar[bool] = False
    reshapes: ClassVar[bool] = False
    correlates: ClassVar[bool] = False
    mends_errors: ClassVar[bool] = False
    between_objects: ClassVar[bool] = False

    def missing(self, context):
        return super().missing(context) or (too_many(context.limits) if self.correlates else None)

    def beside(self, others):
        kinds = [other for other in others if isinstance(other, NoiseKind)]
        laws = [other.name for other in kinds if other.reshapes]
        if self.correlates and laws:
            return why_not_beside(laws)
        if self.reshapes and laws and self.name > min(laws):
            return f"{', '.join(laws)} give errors another law already. Leave out one of the two"
        return None

    def trials(self, facts: Facts) -> Sequence[Values]:
        """Values of its quantities that a diagnosis tries; none where the recording cannot show it."""
        if not self.quantities:
            return [{}]
        u = torch.quasirandom.SobolEngine(len(self.quantities), scramble=True, seed=0)
        share = u.draw(FIRST, dtype=torch.float64).clamp(0.01, 0.99)
        columns = [
            prior_of(quantity).quantile(part) for quantity, part in zip(self.quantities, share.T, strict=True)
        ]
        return [self._named(row) for row in torch.stack(columns, -1).tolist()]

    def closer(self, best: Values, facts: Facts) -> Sequence[Values]:
        """Values to try once the best of :meth:`trials` is known, itself among them; none where it will do."""
        if not self.quantities:
            return []
        u = torch.quasirandom.SobolEngine(len(self.quantities), scramble=True, seed=1)
        steps = NEAR * (2 * u.draw(CLOSER, dtype=torch.float64) - 1)
        columns = [
            self._about(quantity, best[quantity.name], step)
            for quantity, step in zip(self.quantities, steps.T, strict=True)
        ]
        return [best, *(self._named(row) for row in torch.stack(columns, -1).tolist())]

    @staticmethod
    def _about(quantity: Quantity, value: float, steps: torch.Tensor) -> torch.Tensor:
        prior = prior_of(quantity)
        transform = prior.transform()
        centre = transform.inv(prior.inside(torch.tensor(value, dtype=steps.dtype)))  # pyright: ignore[reportArgumentType]
        return torch.as_tensor(transform(torch.as_tensor(centre) + steps))

    def _named(self, row: Sequence[float]) -> dict[str, float]:
        return {quantity.name: value for quantity, value in zip(self.quantities, row, strict=True)}


__all__ = ["Context", "Facts", "NoiseKind", "Values"]
