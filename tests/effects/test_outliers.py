"""The mixture as the sum over which rows are bad."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from tests.effects.passes import model_with, orbiting
from tests.effects.test_jitter import noisy_recording
from torchlc.inference.likelihood import Likelihood


@pytest.mark.parametrize(("fraction", "width"), [(0.03, 8.0), (0.5, 2.0), (0.2, 100.0)])
def test_sum_over_all_choices_of_bad_rows(fraction, width):
    scene = orbiting()
    recording, residual = noisy_recording(scene)
    kept = np.arange(len(recording)) < 9
    recording, residual = recording.keep(kept, "test"), residual[kept].copy()
    residual[4] += 0.7
    recording = replace(recording, observed=recording.observed + np.where(np.arange(9) == 4, 0.7, 0.0))
    model, theta = model_with(
        scene, recording, "outliers", outliers__fraction=fraction, outliers__width=width
    )
    terms = []
    for bad in product([False, True], repeat=9):
        chance = np.where(bad, fraction, 1 - fraction)
        sigma = recording.error * np.where(bad, width, 1.0)
        terms.append(np.log(chance).sum() + norm.logpdf(residual, scale=sigma).sum())
    assert float(Likelihood(model).log_likelihood(theta)) == pytest.approx(logsumexp(terms), rel=1e-12)
