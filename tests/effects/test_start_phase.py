"""Another phase is the scene with that phase, for all rows or for those of one curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.effects.cases import flux, seen_from, unit
from tests.effects.passes import model_with
from tests.effects.turning import INERTIAL, SPIN_POLE, turning

RIGID = (
    SPIN_POLE.replace("spin-pole", "rigid-body")
    + "inertia = [0.3, 0.9]\nnutation = 12.0\npolhode_phase = 0.0\n"
)


def recorded(scene, tmp_path):
    to_sun, to_observer = unit(np.random.default_rng(3).normal(size=(2, 30, 3)))
    return seen_from(scene, tmp_path, to_sun, to_observer)


@pytest.mark.parametrize("attitude", [SPIN_POLE, INERTIAL, RIGID])
def test_equals_a_scene_of_that_phase(tmp_path, attitude):
    key = "spin_phase = 5.0" if "spin_phase" in attitude else "\nphase = 10.0"
    name, _, value = key.partition(" = ")
    other = turning(attitude.replace(key, f"{name} = {float(value) + 33.0}"))
    scene = turning(attitude)
    recording = recorded(scene, tmp_path)
    found = flux(scene, recording, ["start_phase"], start_phase__deg=33.0)
    np.testing.assert_allclose(found, flux(other, recording), rtol=1e-9, atol=1e-20)


@pytest.mark.parametrize("attitude", [SPIN_POLE, INERTIAL, RIGID])
def test_each_curve_its_own(tmp_path, attitude):
    scene = turning(attitude)
    recording = recorded(scene, tmp_path)
    two = replace(recording, curve=np.arange(30) % 2, curve_ids=("a", "b"))
    model, theta = model_with(scene, two, "start_phase@curve~10")
    for name, value in {"start_phase.deg[a]": 0.0, "start_phase.deg[b]": -47.0}.items():
        theta[model.names.index(name)] = value
    found = model.brightness(theta).flux.detach().numpy()
    np.testing.assert_allclose(found[::2], flux(scene, recording)[::2], rtol=1e-9, atol=1e-20)
    moved = flux(scene, recording, ["start_phase"], start_phase__deg=-47.0)
    np.testing.assert_allclose(found[1::2], moved[1::2], rtol=1e-9, atol=1e-20)
