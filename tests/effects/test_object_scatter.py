"""An offset of each object, integrated out: normal densities by SciPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tests.effects.passes import magnitudes, model_with, orbiting, rows
from torchlc.effects import registry
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve

SCENE = orbiting()
RECORDING = rows(SCENE)
RECORDING = replace(RECORDING, object=np.arange(len(RECORDING)) % 3, object_ids=("a", "b", "c"))


@pytest.mark.parametrize("mag", [0.0, 0.2, 1.0])
def test_density(mag):
    residual = 0.06 * np.random.default_rng(0).normal(size=len(RECORDING))
    recording = replace(RECORDING, observed=magnitudes(SCENE, RECORDING) + residual)
    model, theta = model_with(SCENE, recording, "object_scatter", object_scatter__mag=mag)
    same = recording.object[:, None] == recording.object
    covariance = np.diag(recording.error**2) + mag**2 * same
    expected = multivariate_normal(np.zeros(len(residual)), covariance).logpdf(residual)
    assert float(Likelihood(model).log_likelihood(theta)) == pytest.approx(expected, rel=1e-11)


def test_one_object_differs_from_no_other():
    alone = replace(RECORDING, object=np.zeros(len(RECORDING), dtype=int), object_ids=("a",))
    context = LightCurve(SCENE, alone, effects=[]).assembly.context
    assert "one object" in (registry()["object_scatter"]().missing(context) or "")
