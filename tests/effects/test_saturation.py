"""Bright rows lose light: the law at its brightest row, and the cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.effects.passes import model_with, orbiting, rows


@pytest.fixture
def linear_and():
    scene = orbiting()
    recording = replace(rows(scene), kind="flux")

    def pair(**values):
        off, typical = ({"saturation__q": 0.0, "saturation__limit": 1.5} | given for given in ({}, values))
        model, theta = model_with(scene, recording, "saturation", **off)
        bare = model(theta).detach().numpy()
        model, theta = model_with(scene, recording, "saturation", **typical)
        return bare, model(theta).detach().numpy()

    return pair


@pytest.mark.parametrize("q", [-0.05, 0.03, 0.1])
def test_the_loss_is_q_at_the_peak_and_grows_with_the_light(linear_and, q):
    before, after = linear_and(saturation__q=q)
    loss = 1 - after / before
    assert loss[before.argmax()] == pytest.approx(q, rel=1e-12)
    np.testing.assert_allclose(np.diff(loss / before), 0, atol=1e-9 * abs(q) / before.max())


def test_the_cut(linear_and):
    before, after = linear_and(saturation__limit=0.4)
    dim = before < 0.4 * before.max()
    assert 0 < dim.sum() < len(dim)
    np.testing.assert_array_equal(after[dim], before[dim])
    np.testing.assert_allclose(after[~dim], 0.4 * before.max(), rtol=1e-14)
    np.testing.assert_array_equal(*linear_and(saturation__limit=1.01))
