"""A drift against the constant offset that it amounts to at each row."""

from __future__ import annotations

import numpy as np

from tests.effects.cases import flux, seen_from, still, unit
from tests.effects.passes import BODY, CELLS, MATERIALS, WINGS

ROWS = 40


def test_a_drift_is_an_offset_that_grows_from_the_middle(tmp_path):
    scene = still(BODY + WINGS, MATERIALS + CELLS)
    recording = seen_from(scene, tmp_path, *unit(np.random.default_rng(8).normal(size=(2, ROWS, 3))))
    rate = {"x": 4.0, "y": -2.0, "z": 3.0}
    drifted = flux(
        scene, recording, ["attitude_drift"],
        **{f"attitude_drift__{axis}": value for axis, value in rate.items()},
    )  # fmt: skip
    for row in (0, 5, 39):
        hours = (row - 0.5 * (ROWS - 1)) / 3600
        turned = flux(
            scene, recording, ["attitude_offset"],
            **{f"attitude_offset__{axis}": value * hours for axis, value in rate.items()},
        )  # fmt: skip
        np.testing.assert_allclose(drifted[row], turned[row], rtol=1e-12)
