"""What counts as known: draws of made-up posteriors against their priors."""

from __future__ import annotations

import math

import pytest
import torch

from torchlc.insight import PRIOR_DRAWS, narrower_or_moved
from torchlc.parameters import Prior

EXPONENT = Prior("loguniform", 1.0, 1e6)
REFLECTANCE = Prior("uniform", 0.0, 1.0)
ZERO_POINT = Prior("normal", -math.inf, math.inf, 0.0, 0.02)


def even(prior: Prior, low: float = 0.0, high: float = 1.0, count: int = 5000) -> torch.Tensor:
    """The prior between two of its quantiles, in even steps of probability."""
    return prior.quantile(low + (high - low) * (torch.arange(count, dtype=torch.float64) + 0.5) / count)


@pytest.mark.parametrize(
    ("prior", "low", "high", "informed"),
    [
        (EXPONENT, 0.0, 1.0, False),
        (EXPONENT, math.log10(150) / 6, 1.0, False),  # no broad lobe is seen: a limit
        (EXPONENT, math.log10(12_000) / 6, 1.0, True),  # beyond the prior's median
        (EXPONENT, 0.3, 0.6, True),
        (REFLECTANCE, 0.0, 0.7, False),
        (REFLECTANCE, 0.0, 0.05, True),
        (ZERO_POINT, 0.0, 1.0, False),
        (ZERO_POINT, 0.6, 1.0, True),
    ],
)
def test_a_prior_cut_off_at_an_end_is_known_only_if_little_is_left(prior, low, high, informed):
    assert narrower_or_moved(prior, even(prior, count=PRIOR_DRAWS), even(prior, low, high)) is informed


@pytest.mark.parametrize(("share", "informed"), [(0.9, False), (0.6, True)])
def test_a_peaked_prior_is_compared_by_width(share, informed):
    prior = even(ZERO_POINT, count=PRIOR_DRAWS)
    assert narrower_or_moved(ZERO_POINT, prior, share * even(ZERO_POINT)) is informed
