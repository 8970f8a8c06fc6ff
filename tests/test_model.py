"""The light curve: against the printed equations, against central differences, and as a torch module."""

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


# ------------------------------------------------------------------ eqs. 1-11, written out a second time

C_SUN = 455.0


def facet_irradiance(n, u, v, area, sun, obs, range_m, material):
    """Eqs. 2-6, 8 and 9 for one facet and one epoch, in floats, term by term as printed."""
    n_u, n_v = material.get("n_u", material.get("n")), material.get("n_v", material.get("n"))
    r_spec, r_diff = material["r_spec"], material["r_diff"]
    if n @ sun <= 0 or n @ obs <= 0:
        return 0.0
    h = (sun + obs) / np.linalg.norm(sun + obs)
    z = n_u if n_u == n_v else (n_u * (h @ u) ** 2 + n_v * (h @ v) ** 2) / (1 - (h @ n) ** 2)
    fresnel = r_spec + (1 - r_spec) * (1 - sun @ h) ** 5
    lobe = np.sqrt((n_u + 1) * (n_v + 1)) / (8 * np.pi) * (n @ h) ** z
    f_spec = lobe / ((h @ sun) * max(n @ sun, n @ obs)) * fresnel
    bend = (1 - (1 - n @ sun / 2) ** 5) * (1 - (1 - n @ obs / 2) ** 5)
    f_diff = 28 * r_diff / (23 * np.pi) * (1 - r_spec) * bend
    f_sun = C_SUN * (f_spec + f_diff) * (n @ sun)
    return f_sun * area * (n @ obs) / range_m**2


def unit(vector):
    return vector / np.linalg.norm(vector)


def body_frame(mode, position, velocity, sun, x_angle=0.0, spin_axis=None, turn=0.0):
    """Columns body X, Y, Z in the inertial frame; FORMATS, attitude modes."""
    pole = np.array([0.0, 0.0, 1.0])
    if mode == "nadir":
        z = -unit(position)
        x = unit(velocity - (velocity @ z) * z)
    elif mode == "yaw-steering":
        z = -unit(position)
        x = np.cross(unit(np.cross(z, sun)), z)
    elif mode == "sun":
        z = sun
        x = unit(np.cross(pole, z))
    else:
        z = pole
        x = np.array([np.cos(x_angle), np.sin(x_angle), 0.0])
    rotation = np.stack([x, np.cross(z, x), z], -1)
    if spin_axis is not None:  # Rodrigues' formula, vector by vector
        k = np.asarray(spin_axis, float) / np.linalg.norm(spin_axis)
        turned = [
            np.cos(turn) * e + np.sin(turn) * np.cross(k, e) + (1 - np.cos(turn)) * (k @ e) * k
            for e in np.eye(3)
        ]
        rotation = rotation @ np.stack(turned, -1)
    return rotation


def box_faces(size, material):
    """(normal, u, v, area, material) of the six faces: u is the next body axis cyclically, v = n x u."""
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            n, u = sign * np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
            faces.append((n, u, np.cross(n, u), size[(axis + 1) % 3] * size[(axis + 2) % 3], material))
    return faces


def wing_faces(area, axis, sun_body, material, back):
    """A plate that turns about ``axis`` until its front normal, u x axis, is nearest to the Sun."""
    n = unit(sun_body - (sun_body @ axis) * axis)
    u = np.cross(axis, n)
    return [(n, u, axis, area, material), (-n, u, -axis, area, back)]


def paper_curve(scene, recording, materials, size, wing_area=0.0, mode="nadir", **attitude):
    """Eqs. 7 and 10 with positions taken from torchlc's track and nothing else: W/m2 (T,)."""
    state = torchlc.LightCurve(scene, recording).assembly.track.at(0.0, 0.0, 0.0)
    rate, axis = attitude.pop("rate", 0.0), attitude.pop("spin_axis", None)
    found = []
    for k, t in enumerate(state.time.numpy()):
        turn = 2 * np.pi * rate * t / 3600.0
        sun, obs = unit(state.sun[k].numpy()), unit(state.observer[k].numpy())
        frame = body_frame(
            mode,
            state.position[k].numpy(),
            state.velocity[k].numpy(),
            sun,
            spin_axis=axis,
            turn=turn,
            **attitude,
        )
        faces = box_faces(size, materials["body"])
        if wing_area:
            panel = materials["panel"]
            faces += 2 * wing_faces(wing_area, np.array([0, 1.0, 0]), frame.T @ sun, panel, panel)
        range_m = 1e3 * np.linalg.norm(state.observer[k].numpy())
        total = sum(
            facet_irradiance(frame @ n, frame @ u, frame @ v, area, sun, obs, range_m, material)
            for n, u, v, area, material in faces
        )
        found.append(total)
    return np.array(found)


def agree(scene, recording, irradiance):
    """Flux to 1e-10, and the magnitude of eq. 11 where there is light.

    A face that the Sun grazes to the last bit (+-Y when steering in yaw) may hold light of 1e-48.
    """
    curve = torchlc.simulate(scene, recording)
    np.testing.assert_allclose(curve.flux, irradiance / C_SUN, rtol=1e-10, atol=1e-40)
    lit = irradiance > 0
    np.testing.assert_allclose(
        curve.mag[lit], -26.7 - 2.5 * np.log10(irradiance[lit] / C_SUN), rtol=0, atol=1e-10
    )
    assert lit.any()


@pytest.mark.parametrize("table", [1, 2], ids=["object 1", "object 2"])
def test_box_wings_of_the_paper_against_the_equations(table):
    scene = setting.object_1() if table == 1 else setting.object_2()
    start = "2020-10-17T14:00:00" if table == 1 else "2020-10-11T00:00:00"
    recording = rows(scene, start)
    size = setting.BOX_OBJECT_1 if table == 1 else (2.0, 2.0, 2.0)
    area, mode = (setting.AREA_WING_1, "nadir") if table == 1 else (setting.AREA_WING_2, "yaw-steering")
    expected = paper_curve(scene, recording, setting.TABLE_3[table], size, area, mode)
    agree(scene, recording, expected)


@pytest.mark.parametrize("attitude", [1, 2, 3, 4])
def test_cube_in_every_attitude_against_the_equations(attitude):
    scene = setting.cube(attitude=attitude)
    recording = rows(scene, "2020-10-10T12:00:00", 8.0)
    options = {
        1: {"mode": "nadir", "spin_axis": [0, 1, 0], "rate": 1.0},
        2: {"mode": "inertial", "x_angle": np.deg2rad(30.0)},
        3: {"mode": "sun", "spin_axis": [0, 0, 1], "rate": 1.0},
        4: {"mode": "nadir"},
    }[attitude]
    materials = {"body": {"n": 12_000.0, "r_spec": 0.8, "r_diff": 0.2}}
    expected = paper_curve(scene, recording, materials, (4.0, 4.0, 4.0), **options)
    agree(scene, recording, expected)


@pytest.mark.parametrize("seed", range(6))
def test_random_anisotropic_box_wings_against_the_equations(seed):
    """Lobes of n_u and n_v apart, broad enough to be seen from every side."""
    rng = np.random.default_rng(seed)

    def material():
        n_u, n_v = 10 ** rng.uniform(0, 3, 2)
        r_spec = rng.uniform(0, 1)
        return {"n_u": n_u, "n_v": n_v, "r_spec": r_spec, "r_diff": rng.uniform(0, 1 - r_spec)}

    materials = {"body": material(), "panel": material()}
    scene = setting.object_1(materials)
    recording = rows(scene, "2020-10-16T00:00:00", 24.0, 900.0)
    expected = paper_curve(scene, recording, materials, setting.BOX_OBJECT_1, setting.AREA_WING_1)
    agree(scene, recording, expected)


def test_range_and_area_scale_as_they_must():
    """Twice the edges: 4 times the light, 1.505 mag."""
    small = setting.object_1()
    large = setting.object_1()
    parts = [
        part.model_copy(update={"size": tuple(2 * one for one in part.size)}) for part in large.components
    ]
    large = large.model_copy(update={"components": parts})
    recording = rows(small)
    gain = torchlc.simulate(small, recording).mag - torchlc.simulate(large, recording).mag
    np.testing.assert_allclose(gain, 2.5 * np.log10(4.0), rtol=1e-12)


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
