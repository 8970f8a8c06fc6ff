"""A jump against a constant offset, at the rows where the two are the same."""

from __future__ import annotations

import numpy as np

from tests.effects.cases import flux, seen_from, still, unit
from tests.effects.passes import BODY, CELLS, MATERIALS, WINGS

ROWS = 40


def test_a_jump_is_an_offset_from_its_time_on(tmp_path):
    """The turn takes a tenth of the second between rows: two rows later e^-15 of it is left."""
    scene = still(BODY + WINGS, MATERIALS + CELLS)
    recording = seen_from(scene, tmp_path, *unit(np.random.default_rng(8).normal(size=(2, ROWS, 3))))
    turn = {"x": 1.5, "y": -0.7, "z": 3.0}
    jumped = flux(
        scene, recording, ["attitude_jump"], attitude_jump__time=20.5 / 3600,
        **{f"attitude_jump__{axis}": angle for axis, angle in turn.items()},
    )  # fmt: skip
    offset = flux(
        scene, recording, ["attitude_offset"],
        **{f"attitude_offset__{axis}": angle for axis, angle in turn.items()},
    )  # fmt: skip
    before = flux(scene, recording)
    np.testing.assert_allclose(jumped[:20], before[:20], rtol=1e-3)
    np.testing.assert_allclose(jumped[22:], offset[22:], rtol=1e-3)
    assert np.abs(jumped - before)[22:].max() > 0.05 * before[22:].max()
