"""Names of materials, components, curves and the rest may be anything: no number depends on one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import torchlc
from torchlc.effects import Entry, registry
from torchlc.errors import InputError
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve, module_key
from torchlc.readers import load_recording
from torchlc.results.inference_data import variable_names
from torchlc.scene import Scene
from torchlc.scene.writer import toml_key, toml_value

ROWS = 24
CASES = Path(__file__).parents[2] / "shared" / "cases"
EFFECTS = [
    "appendage",
    "second_material",
    "color_term",
    "outliers",
    "time_offset",
    "panel_offset",
    "earthshine",
]

RESERVED = [
    *registry(), "attitude", "model", "zero_point", "n", "calibration", "effects", "materials", "free", "noise",
    "items", "keys", "training", "parameters", "a.b", "a_b", "a%2Eb", "appendage.n", "time_offset.s", "@curve",
    "x@night~0.1", "x, y", 'quoted "', "$\\frac$", "\u00e9", "e\u0301", "Panel", "panel", "a/b", "a|b", "gain",
    "share panel", "<b>", "=1+1", "\u540d\u524d", "scene.toml", "..", "-", "0", "None", "true",
]  # fmt: skip
name = st.sampled_from(RESERVED) | st.text(
    st.characters(exclude_categories=("C", "Z"), exclude_characters="[]"), min_size=1, max_size=12
)


def scene_text(body: str, panel: str, box: str, wing: str, *, effects: list[str] | None = None) -> str:
    """A box-wing seen by vectors: materials ``body`` and ``panel``, components ``box`` and ``wing``."""
    material = toml_key("materials", body), toml_key("materials", panel)
    listed = ["appendage", f"second_material[{panel}]", f"color_term[{wing}]"] if effects is None else effects
    return f"""
format = "torchlc-scene/1"
name = "any name"
[orbit]
vectors = "icrs"
[attitude]
mode = "inertial"
x_angle = 3.0
spin_axis = [0.1, 0.2, 1.0]
spin_rate = 0.3
[[components]]
name = {toml_value(box)}
shape = "box"
size = [2.0, 1.7, 2.2]
centre = [0, 0, 0]
material = {toml_value(body)}
[[components]]
name = {toml_value(wing)}
shape = "plate"
size = [1.7, {{ value = 6.0, sigma = 0.1 }}]
centre = [0, 5.75, 0]
u = [1, 0, 0]
v = [0, 1, 0]
material = {toml_value(panel)}
[{material[0]}]
n = 100.0
r_spec = 0.1
r_diff = {{ value = 0.3, low = 0.0, high = 1.0 }}
[{material[1]}]
n = {{ value = 50.0, low = 1.0, high = 1e4, prior = "loguniform" }}
r_spec = {{ value = 0.2, low = 0.0, high = 1.0 }}
r_diff = 0.2
[model]
effects = {toml_value(listed)}
[model.parameters]
band_sun_magnitude = -26.7
zero_point = {{ value = 0.01, sigma = 0.02, per = "curve" }}
"appendage.area" = 1.0
"appendage.lon" = 60.0
"appendage.lat" = 30.0
"appendage.n" = 7.0
"appendage.r_spec" = 0.6
"appendage.r_diff" = {{ value = 0.01, low = 0.0, high = 1.0 }}
"second_material.weight" = {{ value = 0.2, low = 0.0, high = 1.0 }}
"second_material.n" = 400.0
"second_material.r_spec" = 0.3
"second_material.r_diff" = 0.1
"color_term.mag" = {{ value = 0.05, sigma = 0.1 }}
"""


def write_recording(folder: Path, curves: Sequence[str], stations: Sequence[str]) -> Path:
    """Two curves of two stations, crossing: rows 0, 1, 2, 3 are a/x, b/x, a/y, b/y and so on."""
    from astropy.table import Table

    turn = np.linspace(0, 4, ROWS)
    row = np.arange(ROWS)
    sun = 1.5e8 * np.stack([np.cos(0.02 * turn), np.sin(0.02 * turn), 0 * turn + 0.1], -1)
    seen = 4e4 * np.stack([np.cos(0.5 * turn), np.sin(0.5 * turn), 0.3 + 0 * turn], -1)
    columns = {
        "time": 2460000.5 + turn / 24,
        "mag": 10 + 0.3 * np.sin(3 * turn) + 0.05 * (row % 2),
        "mag_err": np.full(ROWS, 0.02),
        "curve": np.array(curves)[row % 2],
        "station": np.array(stations)[row // 2 % 2],
    }
    columns |= {f"sun_{axis}": sun[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"obs_{axis}": seen[:, k] for k, axis in enumerate("xyz")}
    path = folder / "names.ecsv"
    meta = {"time_scale": "utc", "time_format": "jd", "frame": "icrs"}
    Table(columns, meta=meta).write(path, format="ascii.ecsv", overwrite=True)
    return path


def numbers_of(folder: Path, names: tuple[str, ...]):
    """Magnitudes and shares as simulated, the maximum a posteriori of a quick fit, and the model."""
    scene = Scene.from_toml(scene_text(*names[:4]), known_effects=registry())
    path = write_recording(folder, names[4:6], names[6:8])
    recording = load_recording(path, scene)
    curve = torchlc.simulate(scene, recording)
    fit = fit_map(Likelihood(LightCurve(scene, recording)), starts=3, adam_steps=8, seed=3)
    return np.stack([curve.mag, *curve.shares.values()]), fit.theta.numpy(), fit.model


def density_of(folder: Path, names: tuple[str, ...], effects: list[str]) -> list[np.ndarray]:
    """What each component gives, the log posterior of a recording, and its gradient: all that a fit goes by."""
    scene = Scene.from_toml(scene_text(*names[:4], effects=effects), known_effects=registry())
    recording = load_recording(write_recording(folder, names[4:6], names[6:8]), scene)
    likelihood = Likelihood(LightCurve(scene, recording))
    theta = likelihood.model.parameter_set.start().requires_grad_()
    value = likelihood.log_prob(theta)
    (gradient,) = torch.autograd.grad(value, theta)
    with torch.no_grad():
        seen = likelihood.model.brightness(theta, shares=True)
    assert seen.shares is not None
    return [one.detach().numpy() for one in (seen.flux, seen.shares, value, gradient)]


PLAIN = ("hull", "cells", "body", "wing", "first", "second", "north", "south")


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return numbers_of(tmp_path_factory.mktemp("plain"), PLAIN)


@pytest.mark.long
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(names=st.tuples(*[st.lists(name, min_size=2, max_size=2, unique=True).map(tuple)] * 4))
@example(names=(("appendage", "attitude"), ("appendage", "attitude"), ("x", "y"), ("y", "x")))
@example(names=(("zero_point", "second_material"), ("time_offset", "appendage"), ("a.b", "a_b"), ("a", "b")))
@example(names=(("color_term", "n"), ("n", "model"), ("curve", "station"), ("night", "curve")))
@example(names=(("items", "keys"), ("training", "items"), ("a]", "b["), ("e\u0301", "\u00e9")))
@example(names=(("a.b", "a_b"), ("a/b", "a|b"), ("x[y]", "x"), ("$", "%")))
def test_no_number_depends_on_a_name(plain, tmp_path_factory, names):
    """The same arithmetic in the same order: equal to the last bit, but for the order of sums (1e-9)."""
    seen, theta, model = numbers_of(
        tmp_path_factory.mktemp("named"), tuple(n for pair in names for n in pair)
    )
    np.testing.assert_allclose(seen, plain[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(theta, plain[1], rtol=1e-9)
    assert len(set(model.names)) == len(plain[2].names)
    assert len(dict(model.named_parameters())) == len(plain[2].names)
    assert len(set(variable_names(model.names))) == len(plain[2].names)
    before = model.theta()
    model.load_state_dict(model.state_dict())
    torch.testing.assert_close(model.theta(), before, rtol=0, atol=0)


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(entry=st.sampled_from(sorted(registry())), names=st.lists(name, min_size=2, max_size=2, unique=True))
def test_no_effect_minds_a_material_or_component_of_its_name(tmp_path_factory, entry, names):
    """Every effect that these data can carry, with its own name for a material and for a component."""
    folder = tmp_path_factory.mktemp("effect")
    results = []
    for used in (PLAIN, (entry, names[0], names[1], entry, *PLAIN[4:])):
        try:
            results.append(density_of(folder, used, [entry]))
        except InputError as error:
            results.append(str(error))
    if isinstance(results[0], str):
        assert results[0] == results[1]
    else:
        for one, two in zip(*results, strict=True):
            np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9)


def test_the_full_names_say_whose_a_number_is_where_that_is_in_doubt(tmp_path):
    scene = Scene.from_toml(scene_text("appendage", "attitude", "appendage", "attitude"))
    path = write_recording(tmp_path, ("x", "y"), ("x", "y"))
    model = LightCurve(scene, load_recording(path, scene))
    assert model.names == [
        "appendage.r_diff", "attitude.n", "attitude.r_spec", "attitude.size_v", "zero_point[x]", "zero_point[y]",
        "effects[appendage].r_diff", "second_material.weight[attitude]", "color_term.mag[attitude]",
    ]  # fmt: skip
    assert model.assembly.components == ["appendage", "attitude", "effects[appendage]"]
    assert float(model.values()["appendage.n"]) == 100 and float(model.values()["effects[appendage].n"]) == 7


@pytest.mark.parametrize("division", ["curve", "station"])
def test_a_value_of_each_station_is_not_that_of_the_curve_of_its_name(tmp_path, division):
    """Curves and stations are both called x and y, and cross."""
    text = scene_text(*PLAIN[:4]).replace('per = "curve"', f'per = "{division}"')
    scene = Scene.from_toml(text)
    recording = load_recording(write_recording(tmp_path, ("x", "y"), ("x", "y")), scene)
    model = LightCurve(scene, recording)
    start = model.parameter_set.start()
    column = model.names.index("zero_point[y]")
    moved = start.clone()
    moved[column] += 0.5
    with torch.no_grad():
        shift = (model(moved) - model(start)).numpy()
    row = np.arange(ROWS)
    mine = row % 2 if division == "curve" else row // 2 % 2
    np.testing.assert_allclose(shift, 0.5 * mine, atol=1e-12)
    colours = Likelihood(model).colours(prior_rows=False)
    assert colours is not None
    assert np.array_equal(colours.touched[column].numpy(), mine == 1)


def test_curves_whose_joined_names_are_equal_stay_apart(tmp_path):
    """Station "a b" in band c, and station "a" in band "b c"."""
    scene = Scene.from_toml(scene_text(*PLAIN[:4]))
    path = write_recording(tmp_path, ("c", "b c"), ("a b", "a"))
    path.write_text(path.read_text().replace("curve", "band"))
    recording = load_recording(path, scene)
    assert len(set(recording.curve_ids)) == 4
    assert len(LightCurve(scene, recording).names) == len(set(LightCurve(scene, recording).names))


@pytest.mark.parametrize("text", ["a.b", "a_b", "a%2Eb", "items", "%69tems", "", "training", "a%b"])
def test_keys_of_modules_are_told_apart_and_can_be_read_back(text):
    from urllib.parse import unquote

    assert unquote(module_key(text)) == text
    assert "." not in module_key(text)


BAD = ["\0", "a\tb", "\x1b[31m", "n" * 5000, "x\u2028y", "", " outer ", "a[b", "a]"]


@pytest.mark.parametrize("bad", BAD, ids=[ascii(text[:12]) for text in BAD])
@pytest.mark.parametrize("place", [0, 2], ids=["material", "component"])
def test_a_name_that_cannot_be_shown_is_refused_in_one_line(bad, place):
    names = ["hull", "cells", "body", "wing"]
    names[place] = bad
    with pytest.raises(InputError) as caught:
        Scene.from_toml(scene_text(*names, effects=[]))
    assert len(str(caught.value)) < 500 and str(caught.value).isprintable()


@pytest.mark.parametrize("bad", [text for text in BAD[:5] if text != "a\tb"], ids=ascii)
def test_a_title_that_cannot_be_shown_is_refused_in_one_line(bad):
    text = scene_text(*PLAIN[:4]).replace('"any name"', toml_value(bad))
    with pytest.raises(InputError, match=r"^name: "):
        Scene.from_toml(text)


@pytest.mark.parametrize("bad", ["a\0b", "a\x07b", "n" * 5000], ids=["NUL", "bell", "long"])
@pytest.mark.parametrize("column", ["curve", "station", "band"])
def test_a_name_in_a_recording_that_cannot_be_shown_is_refused(tmp_path, bad, column):
    path = write_recording(tmp_path, ("first", "second"), ("north", "south"))
    old = "north" if column == "station" else "first"
    text = path.read_text().replace("curve", "band") if column == "band" else path.read_text()
    path.write_text(text.replace(old, bad, 1))
    with pytest.raises(InputError, match=f"{column}.*at most 200 printable characters") as caught:
        load_recording(path, Scene.from_toml(scene_text(*PLAIN[:4])))
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("panel_offset", Entry("panel_offset")),
        ("second_material[a@b~1]", Entry("second_material", "a@b~1")),
        ("time_offset@curve~0.25", Entry("time_offset", None, "curve", 0.25)),
        ("x[a, b]@night", Entry("x", "a, b", "night")),
        ("x[a", Entry("x[a")),
        ("x]", Entry("x]")),
        ("x@moon", Entry("x@moon")),
    ],
)
def test_an_entry_is_read_as_it_is_written(text, expected):
    assert Entry.parse(text) == expected
    assert str(Entry.parse(text)) == text


def test_commas_in_a_target_do_not_divide_a_list():
    assert Entry.split("a[x, y] , b,,c[z]") == ["a[x, y]", "b", "c[z]"]


@pytest.mark.long
def test_files_of_a_fit_hold_every_parameter_under_its_own_name(tmp_path):
    """fit.json, posterior.nc and chain.h5, with names that meet wherever signs are exchanged."""
    import arviz
    import h5py

    scene = Scene.from_toml(scene_text("a/b", "a|b", "e\u0301", "\u00e9"))
    recording = load_recording(write_recording(tmp_path, ("a.b", "a_b"), ("x", "y")), scene)
    result = torchlc.fit(scene, recording, steps=30, seed=1, out=tmp_path / "out")
    content = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert list(content["parameters"]) == result.names
    posterior = arviz.from_netcdf(tmp_path / "out" / "posterior.nc")["posterior"]
    stored = {one.attrs["parameter"]: one.values for one in posterior.data_vars.values()}
    assert result.posterior is not None
    for index, full in enumerate(result.names):
        np.testing.assert_array_equal(stored[full], result.posterior.theta[..., index].numpy())
    with h5py.File(tmp_path / "out" / "chain.h5") as file:
        assert np.array_equal(
            np.asarray(file["mcmc"].attrs["parameters"]), np.array(result.names, dtype=object)
        )


@pytest.mark.skipif(not CASES.is_dir(), reason=f"{CASES} is not here")
def test_two_scenes_that_differ_in_a_name_are_of_one_brightness():
    curves = [
        torchlc.simulate(CASES / "scene" / f"{stem}.toml", CASES / "scene" / "small.ecsv").mag
        for stem in ("col_hull", "col_appendage")
    ]
    np.testing.assert_array_equal(curves[0], curves[1])
    assert np.isfinite(
        torchlc.simulate(CASES / "scene" / "am.toml", CASES / "scene" / "small.ecsv").mag
    ).all()


def test_assembled_twice_the_names_are_the_same(tmp_path):
    """Names hang on the scene alone, so that values carry over to a model with further effects."""
    scene = Scene.from_toml(scene_text("appendage", "cells", "body", "wing", effects=[]))
    recording = load_recording(write_recording(tmp_path, ("x", "y"), ("x", "y")), scene)
    base = assemble(scene, recording)
    more = assemble(scene, recording, ["appendage"], base=base)
    assert set(base.parameters.names) < set(more.parameters.names)
