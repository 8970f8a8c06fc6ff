"""The light curve: against central differences, and as a torch module."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import torchlc
from torchlc.geometry.orbit import observation_grid

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "examples" / "paper"))

import setting  # noqa: E402

DEMO = ROOT / "torchlc" / "demo"
pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func's own


def rows(
    scene: torchlc.Scene, start: str = "2020-10-17T14:00:00", hours: float = 7.0, cadence: float = 300.0
):
    return observation_grid(scene, start, hours, cadence)


def demo(effects: list[str] | None = None) -> torchlc.LightCurve:
    return torchlc.LightCurve(*torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv"), effects=effects)


# ------------------------------------------------------------------ gradients

TUMBLER = """
format = "torchlc-scene/1"
name = "tumbler"
[orbit]
tle = ["{0}", "{1}"]
[[stations]]
id = "weihai"
latitude = 37.536
longitude = 122.05
height = 110.0
[attitude]
mode = "inertial"
x_angle = {{ value = 30.0, sigma = 5.0 }}
spin_axis = [0.2, 0.5, 1.0]
spin_rate = {{ value = 1.3, low = 1.0, high = 1.6 }}
spin_phase = {{ value = 40.0, low = 0.0, high = 90.0 }}
[[components]]
name = "body"
shape = "box"
size = [{{ value = 2.0, sigma = 0.2 }}, {{ value = 1.7, sigma = 0.2 }}, {{ value = 2.2, sigma = 0.2 }}]
centre = [0, 0, 0]
material = "body"
[[components]]
name = "panel"
shape = "plate"
size = [{{ value = 1.7, sigma = 0.2 }}, {{ value = 6.6, sigma = 0.3 }}]
centre = [0, 5.0, 0]
u = [1, 0, 0]
v = [0, 1, 0]
tracks = {{ target = "sun", axis = [0, 1, 0] }}
material = "panel"
[[components]]
name = "mast"
shape = "cylinder"
radius = {{ value = 0.3, sigma = 0.05 }}
length = {{ value = 2.0, sigma = 0.1 }}
axis = [1, 0, 0]
centre = [2.6, 0, 0]
material = "mast"
[materials.body]
n_u = {{ value = 40.0, low = 1.0, high = 1e4, prior = "loguniform" }}
n_v = {{ value = 90.0, low = 1.0, high = 1e4, prior = "loguniform" }}
r_spec = {{ value = 0.3, low = 0.0, high = 1.0 }}
r_diff = {{ value = 0.3, low = 0.0, high = 1.0 }}
[materials.panel]
n = {{ value = 120.0, low = 1.0, high = 1e4, prior = "loguniform" }}
r_spec = {{ value = 0.2, low = 0.0, high = 1.0 }}
r_diff = {{ value = 0.1, low = 0.0, high = 1.0 }}
[materials.mast]
model = "{2}"
{3}
[model]
effects = []
[model.parameters]
zero_point = {{ value = 0.0, sigma = 0.1 }}
band_sun_magnitude = -26.7
"""
REFLECTANCES = (
    "{0} = {{ value = 0.3, low = 0.0, high = 1.0 }}\nr_diff = {{ value = 0.2, low = 0.0, high = 1.0 }}"
)
MASTS = {
    "lambert": "albedo = { value = 0.5, low = 0.0, high = 1.0 }",
    "ggx": "alpha = { value = 0.4, low = 0.05, high = 1.0 }\n" + REFLECTANCES.format("f0"),
    "cook-torrance": "m = { value = 0.4, low = 0.05, high = 1.0 }\n" + REFLECTANCES.format("f0"),
    "phong-half": "n = { value = 30.0, low = 1.0, high = 100.0 }\n" + REFLECTANCES.format("r_spec"),
    "phong-mirror": "n = { value = 9.0, low = 1.0, high = 50.0 }\n" + REFLECTANCES.format("r_spec"),
    "lommel-seeliger-lambert": "weight = { value = 0.2, low = 0.0, high = 1.0 }\n"
    "albedo = { value = 0.5, low = 0.0, high = 1.0 }",
    "ggx-dielectric": "alpha = { value = 0.4, low = 0.05, high = 1.0 }\nior = { value = 1.5, low = 1.0, high = 3.0 }\n"
    "r_diff = { value = 0.2, low = 0.0, high = 1.0 }",
    "oren-nayar": "sigma = { value = 25.0, low = 0.0, high = 40.0 }\n"
    "albedo = { value = 0.5, low = 0.0, high = 1.0 }",
    "eon": "roughness = { value = 0.4, low = 0.0, high = 1.0 }\n"
    "albedo = { value = 0.5, low = 0.0, high = 1.0 }",
}


def tumbler(
    mast: str = "lambert", effects: list[str] | None = None, cadence: float = 600.0
) -> torchlc.LightCurve:
    """A spinning box with a tracking wing and a cylinder, all numbers free; rows without light left out."""
    scene = torchlc.Scene.from_toml(TUMBLER.format(*setting.ORBITS[1], mast, MASTS[mast]))
    recording = rows(scene, cadence=cadence)
    lit = np.isfinite(torchlc.simulate(scene, recording).mag)
    return torchlc.LightCurve(scene, recording.keep(lit, "dark"), effects=effects)


def richardson(function, theta, column, step):
    """Fourth-order central difference (T,) of function(theta) (T,) in one column."""

    def central(size):
        ahead, behind = theta.clone(), theta.clone()
        ahead[column] += size
        behind[column] -= size
        return (function(ahead) - function(behind)) / (2 * size)

    with torch.no_grad():
        return (4 * central(step / 2) - central(step)) / 3


def worst_gradient(model):
    """Largest difference of Jacobian and central differences over the rows, by parameter, relative to its
    largest slope.
    """
    theta = model.theta().detach()
    jacobian = torch.func.jacrev(model)(theta)
    found = {}
    for column, name in enumerate(model.names):
        step = 2e-5 * max(abs(float(theta[column])), 0.1)
        numeric = richardson(model, theta, column, step)
        found[name] = float(
            (jacobian[:, column] - numeric).abs().max() / numeric.abs().max().clamp(min=1e-12)
        )
    return found


@pytest.mark.parametrize("mast", MASTS)
def test_gradient_by_every_parameter(mast):
    model = tumbler(mast)
    assert {"attitude.spin_rate", "body.size_x", "mast.radius", "panel.size_v", "zero_point"} <= set(
        model.names
    )
    worst = worst_gradient(model)
    assert max(worst.values()) < 1e-5, worst


def test_gradient_through_shadows():
    worst = worst_gradient(tumbler(effects=["self_shadowing"], cadence=1200.0))
    assert max(worst.values()) < 1e-5, worst


def test_gradient_of_known_physics_on_the_demo():
    """Exposure, solar disc, light time, shadow of the Earth and of the parts together."""
    known = [
        "sun_distance",
        "light_time",
        "finite_sun",
        "earth_shadow",
        "exposure_smearing",
        "self_shadowing",
    ]
    worst = worst_gradient(demo(known))
    assert max(worst.values()) < 1e-5, worst


def test_forward_and_reverse_mode_agree():
    model = tumbler(effects=["self_shadowing", "light_time"], cadence=5000.0)
    theta = model.theta().detach()
    torch.testing.assert_close(
        torch.func.jacfwd(model)(theta), torch.func.jacrev(model)(theta), rtol=1e-9, atol=1e-12
    )


# ------------------------------------------------------------------ a module like any other


def test_parameters_are_leaves_by_owner():
    model = demo()
    names = dict(model.named_parameters())
    assert {"free.body.n", "free.panel.r_spec", "free.calibration.zero_point"} <= set(names)
    assert all(parameter.is_leaf and parameter.requires_grad for parameter in names.values())
    assert len(names) == len(model.names)


def test_natural_values_of_the_scene_are_the_start():
    model = demo()
    values = dict(zip(model.names, model.theta().tolist(), strict=True))
    assert values["panel.n"] == pytest.approx(200.0, rel=1e-9)
    assert values["body.r_diff"] == pytest.approx(0.3, rel=1e-9)


def test_theta_of_another_length_and_unknown_effects_say_what_was_expected():
    model = demo()
    for wrong in (torch.ones(3), torch.ones(2, 8)):
        for call in (model, model.set_theta):
            with pytest.raises(
                ValueError, match=r"its last axis has to hold the 7 free parameters body\.n, "
            ):
                call(wrong)
    with pytest.raises(torchlc.InputError, match="Did you mean 'panel_offset'"):
        demo(effects=["panel_offsett"])


def test_state_dict_brings_a_curve_back():
    model, other = demo(), demo()
    model.set_theta(model.theta() * 0.9)
    assert not torch.equal(model(), other())
    other.load_state_dict(model.state_dict())
    torch.testing.assert_close(other(), model(), rtol=0, atol=0)


def test_functional_call_takes_other_parameters():
    model = demo()
    moved = {name: value.detach() + 0.1 for name, value in model.named_parameters()}
    expected = model(model.parameter_set.to_natural(model.unconstrained().detach() + 0.1))
    torch.testing.assert_close(torch.func.functional_call(model, moved, ()), expected, rtol=1e-12, atol=0)


def test_every_leaf_gets_a_gradient():
    model = demo(effects=[])
    model().square().sum().backward()
    assert all(p.grad is not None and torch.isfinite(p.grad) and p.grad != 0 for p in model.parameters())


@pytest.mark.parametrize("effects", [[], ["self_shadowing", "finite_sun"]], ids=["bare", "known physics"])
@pytest.mark.parametrize("kind", ["materials", "geometry"])
def test_batch_is_the_loop(effects, kind):
    """A batch of theta in one call, under vmap, and one by one."""
    model = demo(effects) if kind == "materials" else tumbler(effects=effects, cadence=2400.0)
    generator = torch.Generator().manual_seed(1)
    theta = (
        model.parameter_set.sample_prior(5, generator)
        if kind == "materials"
        else model.theta().detach().repeat(5, 1)
    )
    if kind == "geometry":
        theta = theta * (1 + 0.01 * torch.rand(theta.shape, generator=generator, dtype=theta.dtype))
    with torch.no_grad():
        one_by_one = torch.stack([model(row) for row in theta])
        torch.testing.assert_close(model(theta), one_by_one, rtol=1e-12, atol=0)
    torch.testing.assert_close(torch.vmap(model)(theta), one_by_one, rtol=1e-12, atol=0)
    torch.testing.assert_close(model(theta.reshape(5, 1, -1))[:, 0].detach(), one_by_one, rtol=1e-12, atol=0)


def test_the_table_of_a_fixed_geometry_is_the_model_of_a_free_one():
    """A free length that does nothing to the light makes the model build its geometry anew at every call."""
    scene, recording = torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")
    attitude = scene.attitude.model_copy(update={"spin_phase": torchlc.scene.Free(value=0.0, sigma=1.0)})
    free = torchlc.LightCurve(
        scene.model_copy(update={"attitude": attitude}), recording, effects=["self_shadowing"]
    )
    fixed = torchlc.LightCurve(scene, recording, effects=["self_shadowing"])
    assert free.geometry_free and not fixed.geometry_free
    torch.testing.assert_close(free(), fixed(), rtol=1e-12, atol=0)


@pytest.mark.parametrize("number", ["spin_rate", "spin_phase"])
def test_an_attitude_that_each_curve_has_for_itself(number):
    """The rows of each curve are those of the whole recording at that curve's value."""
    values = {"spin_rate": 3.0, "spin_phase": 20.0}
    text = TUMBLER.format(*setting.ORBITS[1], "lambert", MASTS["lambert"])

    def light(given: dict[str, object], curve: np.ndarray) -> np.ndarray:
        keys = "".join(f"{key} = {value}\n" for key, value in given.items())
        scene = torchlc.Scene.from_toml(re.sub(r"spin_rate = .*\nspin_phase = .*\n", keys, text))
        recording = dataclasses.replace(rows(scene), curve=curve, curve_ids=("a", "b.c"))
        model = torchlc.LightCurve(scene, recording)
        theta = model.theta().detach().clone()
        for name, value in (("a", 1.0), ("b.c", 2.5)):
            if (full := f"attitude.{number}[{name}]") in model.names:
                theta[model.names.index(full)] = value
        return model(theta).detach().numpy()

    curve = np.arange(len(rows(torchlc.Scene.from_toml(text)).seconds)) % 2
    own = light({**values, number: '{ value = 2.0, sigma = 1.0, per = "curve" }'}, curve)
    first, second = (light({**values, number: value}, curve) for value in (1.0, 2.5))
    assert np.nanmax(abs(first - second)) > 0.01
    np.testing.assert_allclose(own, np.where(curve == 0, first, second), rtol=1e-12)


def test_a_part_is_the_same_in_every_curve():
    text = TUMBLER.format(*setting.ORBITS[1], "lambert", MASTS["lambert"])
    own = '"appendage.area" = { value = 1.0, low = 0.0, high = 2.0, per = "curve" }'
    scene = torchlc.Scene.from_toml(text.replace("effects = []", 'effects = ["appendage"]') + own)
    with pytest.raises(torchlc.InputError, match=r"appendage\.area\.per.*expected one value"):
        torchlc.LightCurve(scene, rows(scene))


def test_shares_sum_to_one_and_weigh_the_components():
    model = demo([])
    brightness = model.brightness(shares=True)
    assert brightness.shares is not None
    torch.testing.assert_close(brightness.shares.sum(0), torch.ones_like(brightness.flux), rtol=1e-12, atol=0)
    theta = model.theta()
    dark = theta.detach().clone()
    for name in ("panel.r_diff", "panel.r_spec"):
        dark[model.names.index(name)] = 0.0
    body = model.brightness(dark).flux
    share = brightness.shares[list(brightness.components).index("body")]
    schlick = model.brightness(dark, shares=True)  # an r_spec of 0 still reflects at grazing incidence
    assert schlick.shares is not None
    own = schlick.shares[0] * body
    torch.testing.assert_close(share * brightness.flux, own, rtol=1e-12, atol=0)


def test_relative_flux_is_the_irradiance_ratio(tmp_path):
    """A recording of flux gets Phi itself: magnitude and flux are one curve."""
    scene = setting.object_1()
    magnitudes = torchlc.simulate(scene, start="2020-10-17T14:00:00", hours=7, cadence=600, noise=0.01)
    path = magnitudes.write(tmp_path / "curve.ecsv")
    _, flux = torchlc.load(scene, path, use="flux")
    assert flux.kind == "flux"
    phi = torchlc.LightCurve(scene, flux)().numpy()
    clean = torchlc.simulate(scene, flux)
    np.testing.assert_allclose(-26.7 - 2.5 * np.log10(phi), clean.mag, rtol=1e-12)
