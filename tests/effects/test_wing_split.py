"""Wings that point apart, against wings that are turned together one way and the other."""

from __future__ import annotations

import numpy as np

from tests.effects.cases import flux, seen_from, still, unit
from tests.effects.passes import CELLS, WINGS
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve

ROWS = 40


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
        flux(either, seen_from(either, tmp_path, *directions), ["wing_split"], wing_split__deg=3.0)
        for either in (scene, turned)
    ]
    np.testing.assert_allclose(*curves, rtol=1e-9)


def test_one_wing_cannot_be_split(tmp_path):
    alone = still(WINGS[: WINGS.index("[[components]]", 20)], CELLS)
    recording = seen_from(alone, tmp_path, [0, 0, 1], [0, 0.6, 0.8])
    context = LightCurve(alone, recording, effects=[]).assembly.context
    assert registry()["wing_split"]().missing(context) == "fewer than two parts track the Sun"
