"""Nothing before the step, all of it after."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.passes import magnitudes, model_with, orbiting, rows


@pytest.mark.parametrize("mag", [-0.4, 0.1])
def test_before_and_after(mag):
    """Half a cadence from its middle the step is within exp(-5) of its ends."""
    scene = orbiting()
    recording = rows(scene)
    hours = recording.seconds / 3600
    middle = 0.5 * (hours[11] + hours[12])
    added = magnitudes(
        scene, recording, "zero_point_step", zero_point_step__mag=mag, zero_point_step__time=middle
    )
    added -= magnitudes(scene, recording)
    np.testing.assert_allclose(added, np.where(hours > middle, mag, 0.0), atol=abs(mag) * np.exp(-5.0))
    np.testing.assert_allclose(
        np.delete(added, [11, 12]), np.delete(mag * (hours > middle), [11, 12]), atol=1e-6
    )


def test_the_time_ends_with_the_recording():
    scene = orbiting()
    model, _ = model_with(scene, rows(scene, hours=5.0), "zero_point_step")
    (prior,) = (entry.prior for entry in model.parameter_set.free if entry.name == "zero_point_step.time")
    assert (prior.low, prior.high) == (0.0, pytest.approx(5.0))
