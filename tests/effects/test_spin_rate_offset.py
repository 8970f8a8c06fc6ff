"""Another rate is the scene with that rate; the phase at the epoch stays."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.passes import BODY, HIGH, MATERIALS, magnitudes, orbiting, rows
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve

BODY_ALONE = {"components": BODY, "materials": MATERIALS}


@pytest.mark.parametrize("mode", ["nadir", "inertial", "sun"])
def test_equals_a_scene_of_that_rate(mode):
    spin = f'mode = "{mode}"\nspin_axis = [0.2, 0.9, 0.1]\nspin_phase = 30.0\nspin_epoch = "{HIGH}"\n'
    slow = orbiting(f"{spin}spin_rate = 1.5", **BODY_ALONE)
    fast = orbiting(f"{spin}spin_rate = 1.73", **BODY_ALONE)
    recording = rows(slow)
    found = magnitudes(slow, recording, "spin_rate_offset", spin_rate_offset__rev_per_hour=0.23)
    np.testing.assert_allclose(found, magnitudes(fast, recording), atol=1e-9)
    assert found[0] == pytest.approx(magnitudes(slow, recording)[0], abs=1e-12)


@pytest.mark.parametrize("faster", [0.11, -0.3])
def test_spin_pole_turns_with_the_summed_rate(faster):
    """A negative sum turns the other way: 0.25 - 0.3 rev/h is a period of -20 h."""
    pole = f'mode = "spin-pole"\npole = [40.0, 25.0]\nphase = 10.0\nepoch = "{HIGH}"\n'
    slow = orbiting(f"{pole}period = 4.0", **BODY_ALONE)
    recording = rows(slow)
    found = magnitudes(slow, recording, "spin_rate_offset", spin_rate_offset__rev_per_hour=faster)
    if faster > 0:
        other = orbiting(f"{pole}period = {1 / (0.25 + faster)!r}", **BODY_ALONE)
        np.testing.assert_allclose(found, magnitudes(other, recording), atol=1e-9)
    else:
        model = LightCurve(slow, recording, effects=[])
        values = model.values() | {"attitude.period": model.theta().new_tensor(1 / (0.25 + faster))}
        tables = model.make_tables(model.view(values), False, compact=True)
        expected = model.magnitude(model.shine(tables, values)).detach().numpy()
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_nothing_spins():
    scene = orbiting()
    context = LightCurve(scene, rows(scene), effects=[]).assembly.context
    assert registry()["spin_rate_offset"]().missing(context) == "the attitude has no spin"
