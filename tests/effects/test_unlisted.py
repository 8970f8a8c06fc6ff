"""Effects that are never named: each against one that is, at the rows or for the wings where the two are the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.effects.cases import STILL, flux, seen_from, still, unit
from tests.effects.passes import BODY, CELLS, MATERIALS, WINGS
from torchlc.effects import every, names, registry
from torchlc.errors import InputError
from torchlc.lightcurve.model import LightCurve
from torchlc.scene import Scene

UNLISTED = ("attitude_drift", "attitude_jump", "wing_split")
ROWS = 40
BOX_WING = (BODY + WINGS, MATERIALS + CELLS)


@pytest.fixture
def seen(tmp_path):
    """A box with wings, and 40 rows, a second apart, that look at it from all sides."""
    scene = still(*BOX_WING)
    return scene, seen_from(scene, tmp_path, *unit(np.random.default_rng(8).normal(size=(2, ROWS, 3))))


def test_they_are_known_but_no_scene_may_list_them():
    assert set(every()) - set(registry()) == set(UNLISTED)
    assert not set(UNLISTED) & set(names())
    text = (
        'format = "torchlc-scene/1"\nname = "case"\n' + STILL + WINGS + CELLS + '[model]\neffects = ["ONE"]\n'
    )
    Scene.from_toml(text.replace("ONE", "panel_offset"), Path(), known_effects=names())
    with pytest.raises(InputError, match="wing_split"):
        Scene.from_toml(text.replace("ONE", "wing_split"), Path(), known_effects=names())


def test_a_jump_is_an_offset_from_its_time_on(seen):
    scene, recording = seen
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


def test_a_drift_is_an_offset_that_grows_from_the_middle(seen):
    scene, recording = seen
    rate = {"x": 4.0, "y": -2.0, "z": 3.0}
    drifted = flux(
        scene, recording, ["attitude_drift"],
        **{f"attitude_drift__{axis}": one for axis, one in rate.items()},
    )  # fmt: skip
    for row in (0, 5, 39):
        hours = (row - 0.5 * (ROWS - 1)) / 3600
        turned = flux(
            scene, recording, ["attitude_offset"],
            **{f"attitude_offset__{axis}": one * hours for axis, one in rate.items()},
        )  # fmt: skip
        np.testing.assert_allclose(drifted[row], turned[row], rtol=1e-12)


def test_split_wings_are_the_mean_of_wings_turned_one_way_and_the_other(tmp_path):
    scene = still(WINGS, CELLS)
    recording = seen_from(scene, tmp_path, *unit(np.random.default_rng(9).normal(size=(2, ROWS, 3))))
    one, other = (flux(scene, recording, ["panel_offset"], panel_offset__deg=deg) for deg in (4.0, -4.0))
    split = flux(scene, recording, ["wing_split"], wing_split__deg=4.0)
    np.testing.assert_allclose(split, 0.5 * (one + other), rtol=1e-12)
    assert np.abs(one - other).max() > 0.1 * one.max()


def test_split_goes_by_the_sense_of_the_axes(tmp_path):
    scene = still(WINGS, CELLS)
    turned = still(WINGS.replace("axis = [0, 1, 0]", "axis = [0, -1, 0]", 1), CELLS)
    directions = unit(np.random.default_rng(10).normal(size=(2, ROWS, 3)))
    curves = [
        flux(one, seen_from(one, tmp_path, *directions), ["wing_split"], wing_split__deg=3.0)
        for one in (scene, turned)
    ]
    np.testing.assert_allclose(*curves, rtol=1e-9)


def test_one_wing_cannot_be_split(tmp_path):
    alone = still(WINGS[: WINGS.index("[[components]]", 20)], CELLS)
    recording = seen_from(alone, tmp_path, [0, 0, 1], [0, 0.6, 0.8])
    context = LightCurve(alone, recording, effects=[]).assembly.context
    assert every()["wing_split"]().missing(context) == "fewer than two parts track the Sun"
