"""A straight line in magnitudes about the middle of each night of each curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.effects.passes import magnitudes, orbiting, rows
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve


def added(scene, recording, rate):
    drifting = magnitudes(scene, recording, "zero_point_drift", zero_point_drift__mag_per_hour=rate)
    return drifting - magnitudes(scene, recording)


def test_a_line_through_zero_at_the_mean_time():
    scene = orbiting()
    recording = rows(scene)
    line = added(scene, recording, 0.03)
    slope, at_zero = np.polyfit(recording.seconds / 3600, line, 1)
    assert abs(slope - 0.03) < 1e-12
    assert abs(line.mean()) < 1e-12
    np.testing.assert_allclose(line, slope * recording.seconds / 3600 + at_zero, atol=1e-12)


def test_each_night_of_each_curve_has_its_own_middle():
    scene = orbiting()
    recording = rows(scene)
    number = np.arange(len(recording))
    night, curve = (number > 20).astype(np.int64), number % 2
    recording = replace(recording, night=night, night_ids=("1", "2"), curve=curve, curve_ids=("a", "b"))
    line = added(scene, recording, 0.05)
    for one in range(4):
        rows_of_one = 2 * night + curve == one
        assert abs(line[rows_of_one].mean()) < 1e-12
        slope = np.diff(line[rows_of_one]) / np.diff(recording.seconds[rows_of_one]) * 3600
        np.testing.assert_allclose(slope, 0.05, atol=1e-10)


def test_single_rows_have_no_slope():
    scene = orbiting()
    recording = rows(scene)
    alone = np.arange(len(recording))
    recording = replace(recording, night=alone, night_ids=tuple(map(str, alone)))
    context = LightCurve(scene, recording, effects=[]).assembly.context
    assert "no two rows" in (registry()["zero_point_drift"]().missing(context) or "")
