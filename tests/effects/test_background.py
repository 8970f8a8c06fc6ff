"""Constant light over the median."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.effects.passes import model_with, orbiting, rows


@pytest.mark.parametrize("number", [36, 37])
@pytest.mark.parametrize("fraction", [-0.3, 0.2])
def test_adds_the_same_to_every_row(number, fraction):
    scene = orbiting()
    recording = replace(rows(scene, hours=(number - 1) / 6.0), kind="flux")
    model, off = model_with(scene, recording, "background", background__fraction=0.0)
    before = model(off).detach().numpy()
    assert len(before) == number
    extra = model(off + fraction).detach().numpy() - before
    np.testing.assert_allclose(extra, fraction * np.median(before), rtol=1e-12)


def test_a_row_without_light_is_infinitely_faint():
    scene = orbiting()
    model, theta = model_with(scene, rows(scene), "background", background__fraction=-0.9)
    found = model(theta).detach().numpy()
    assert not np.isnan(found).any()
    assert np.isinf(found).any()
