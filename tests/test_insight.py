"""What counts as known: draws of made-up posteriors against their priors, and the paper's Object 2."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import torchlc
from torchlc.inference.identifiability import PRIOR_DRAWS, narrower_or_moved
from torchlc.parameters import Prior

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "paper"))

import setting

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


def test_object_2_says_nothing_of_its_lobes():
    """No glint comes within 20 deg of any facet: (1 - r_spec) r_diff is measured, n and r_spec are not."""
    start, hours = setting.NIGHT[2]
    curve = torchlc.simulate(setting.object_2(), start=start, hours=hours, cadence=360.0, noise=0.02, seed=1)
    observed, error = (np.asarray(curve.columns[name]) for name in ("mag", "mag_err"))
    recording = replace(curve.recording, observed=observed, error=error)
    result = torchlc.fit(setting.object_2(setting.free_materials()), recording, steps=300)
    known = {name: row["informed"] for name, row in result.parameters().items()}
    assert known == {
        f"{part}.{short}": short == "r_diff"
        for part in ("body", "panel")
        for short in ("n", "r_spec", "r_diff")
    }
    for part, degrees in (("body", "20.4"), ("panel", "25.9")):
        for short in ("n", "r_spec"):
            reason = f"no glint comes within {degrees} deg of any {part} facet"
            assert f"{part}.{short} is set by its prior: {reason}" in result.all_warnings
