"""What [model.parameters] and ``--effects`` ask for is used, refused, or said to be unused."""

from __future__ import annotations

import numpy as np
import pytest

import torchlc
from torchlc.diagnosis.run import diagnose
from torchlc.effects import with_title
from torchlc.errors import InputError
from torchlc.lightcurve.assembly import assemble
from torchlc.readers import load_recording

SCENE = """format = "torchlc-scene/1"
name = "plate"
[orbit]
vectors = "icrs"
[attitude]
mode = "inertial"
[[components]]
name = "plate"
shape = "plate"
size = [1.0, 1.0]
centre = [0, 0, 0]
u = [1, 0, 0]
v = [0, 1, 0]
material = "white"
[materials.white]
model = "lambert"
albedo = {{ value = 0.5, low = 0.0, high = 1.0 }}
[model]
effects = {effects}
[model.parameters]
band_sun_magnitude = -26.7
{parameters}
"""


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    """40 rows of a plate that is seen from ever further aside; nothing is right about their magnitudes."""
    path = tmp_path_factory.mktemp("night") / "night.csv"
    angle = np.linspace(0.1, 1.0, 40)
    lines = ["time,mag,mag_err,sun_x,sun_y,sun_z,obs_x,obs_y,obs_z"]
    for k, a in enumerate(angle):
        mag = 4.0 + 0.5 * np.sin(7 * a)
        lines.append(
            f"{2459000.5 + k / 1440:.6f},{mag:.4f},0.01,0,0,149597870.7,{1e3 * np.sin(a)},0,{1e3 * np.cos(a)}"
        )
    path.write_text("\n".join(lines) + "\n")
    return path


def scene_of(parameters: str = "", effects: str = "[]") -> torchlc.Scene:
    return torchlc.Scene.from_toml(SCENE.format(parameters=parameters, effects=effects))


@pytest.mark.parametrize("effects", ["[]", '["attitude_offset", "appendage", "self_shadowing"]'])
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ('"attitude_offset.xx" = 3.0', ["'xx'", "one of x, y, z", "Did you mean 'x'?"]),
        ('"appendage.aera" = 3.0', ["'aera'", "Did you mean 'area'?"]),
        ('"self_shadowing.deg" = 3.0', ["'deg'", "no numbers"]),
        ('"atitude_offset.x" = 3.0', ["unknown effect", "Did you mean 'attitude_offset'?"]),
        ('"attitude_offset.x[white]" = 3.0', ["'white'", "without brackets"]),
        ('"opposition_surge.b0[plate]" = 0.3', ["'plate'", "one of white"]),
    ],
)
def test_a_number_that_no_effect_has_is_refused(night, effects, given, words):
    scene = scene_of(given, effects)
    with pytest.raises(InputError) as error:
        assemble(scene, load_recording(night, scene))
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ('"appendage.area" = -3.0', ["-3", "0 to 10 m2"]),
        ('"appendage.area" = { value = -3.0, low = -5.0, high = -1.0 }', ["value: -3", "0 to 10 m2"]),
        ('"attitude_offset.x" = 400.0', ["400", "-15 to 15 deg"]),
        ('"attitude_offset.x" = { value = 30.0, sigma = 5.0 }', ["value: 30", "-15 to 15 deg"]),
    ],
)
def test_a_value_beyond_the_range_of_its_number_is_refused(night, given, words):
    scene = scene_of(given, '["attitude_offset", "appendage"]')
    with pytest.raises(InputError) as error:
        assemble(scene, load_recording(night, scene))
    assert all(word in str(error.value) for word in words), error.value


def test_a_prior_that_is_cut_is_said(night):
    scene = scene_of('"attitude_offset.x" = { value = 3.0, low = 1.0, high = 40.0 }', '["attitude_offset"]')
    assembly = assemble(scene, load_recording(night, scene))
    prior = next(one.prior for one in assembly.parameters.free if one.name == "attitude_offset.x")
    assert (prior.low, prior.high) == (1.0, 15.0)
    assert [text for text in assembly.warnings if "attitude_offset.x is cut to -15 to 15 deg" in text]


@pytest.mark.parametrize(("effects", "said"), [("[]", True), ('["attitude_offset"]', False)])
def test_a_number_that_the_model_does_not_use_is_said(night, effects, said):
    scene = scene_of('"attitude_offset.x" = 3.0', effects)
    warnings = assemble(scene, load_recording(night, scene)).warnings
    assert any("attitude_offset.x is not used" in text for text in warnings) is said


def test_what_cannot_be_a_candidate_is_said(night):
    """Nothing here tracks the Sun, no material has a lobe, and the Sun's distance is in the model."""
    scene = scene_of(effects='["sun_distance"]')
    asked = ["panel_offset", "lobe_tail", "sun_distance", "jitter", "background"]
    found = diagnose(scene, load_recording(night, scene), effects=asked, quick=True)
    assert list(found.untried) == ["panel_offset", "lobe_tail", "sun_distance"]
    assert [one["effect"] for one in found.to_json()["untried"]] == list(found.untried)
    assert all(
        any(text.startswith(f"{with_title(name)} is no candidate: ") for text in found.warnings)
        for name in found.untried
    )
