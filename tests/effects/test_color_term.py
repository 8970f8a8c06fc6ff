"""Magnitudes by the component's share, the shares from components that shine alone."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.passes import BODY, MATERIALS, orbiting, rows
from torchlc.effects import registry
from torchlc.errors import InputError
from torchlc.lightcurve.model import LightCurve


def test_share_of_a_component_that_shines_alone():
    whole, alone = orbiting(), orbiting(components=BODY, materials=MATERIALS)
    recording = rows(whole)
    share = 10 ** (-0.4 * (LightCurve(alone, recording)() - LightCurve(whole, recording)()).detach().numpy())
    assert np.ptp(share) > 0.15
    model = LightCurve(whole, recording, effects=["color_term[body]"])
    assert model.names == ["color_term.mag[body]"]
    change = model(model.theta().new_tensor([0.13])) - LightCurve(whole, recording)()
    np.testing.assert_allclose(change.detach().numpy(), 0.13 * share, atol=1e-12)


def test_all_components_alike_is_a_zero_point():
    scene = orbiting()
    recording = rows(scene)
    model = LightCurve(scene, recording, effects=["color_term"])
    assert len(model.names) == 3
    change = model(model.theta() * 0 + 0.2) - LightCurve(scene, recording)()
    np.testing.assert_allclose(change.detach().numpy(), 0.2, atol=1e-12)


def test_one_component_has_no_colour_of_its_own():
    scene = orbiting(components=BODY, materials=MATERIALS)
    recording = rows(scene)
    context = LightCurve(scene, recording, effects=[]).assembly.context
    assert "zero point" in (registry()["color_term"]("body").missing(context) or "")
    with pytest.raises(InputError, match="zero point"):
        LightCurve(scene, recording, effects=["color_term"])
