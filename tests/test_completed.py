"""A scene that a diagnosis completed is a scene: written, read and fitted, it is the model that was found."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import torchlc
from tests.good_input import SCENE
from torchlc.diagnosis.candidates import check_candidates
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench
from torchlc.diagnosis.result import completed_scene
from torchlc.diagnosis.run import diagnose
from torchlc.effects import Entry, effect_class, names, registry
from torchlc.errors import InputError
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording
from torchlc.scene import Free, Scene
from torchlc.stages.noise import Noise

ODD = "panel, +Y @night~1 'x'"
"""A name with every sign that means something in a list of effects, but brackets."""

SCENE_OF_ROLES = """
format = "torchlc-scene/1"
name = "materials and components of different names"
[orbit]
vectors = "icrs"
[attitude]
mode = "inertial"
[[components]]
name = "body"
shape = "box"
size = [1, 1, 1]
centre = [0, 0, 0]
material = "foil"
[[components]]
name = "wing"
shape = "plate"
size = [1, 2]
centre = [0, 2, 0]
u = [1, 0, 0]
v = [0, 1, 0]
material = "radiator"
[materials.foil]
n = 100
r_spec = 0.2
r_diff = 0.2
[materials.radiator]
n = 100
r_spec = 0.2
r_diff = 0.2
[model]
effects = [ENTRY]
[model.parameters]
band_sun_magnitude = -26.7
"""


def odd(text: str) -> str:
    return (
        text.replace('name = "panel"', f"name = {json.dumps(ODD)}")
        .replace("[materials.panel]", f"[materials.{json.dumps(ODD)}]")
        .replace('material = "panel"', f"material = {json.dumps(ODD)}")
    )


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A box-wing over two nights, two curves and two exposures' lengths, and the assembly of its bare model."""
    folder = tmp_path_factory.mktemp("completed")
    text = odd(SCENE)
    text = (
        text[: text.index("[model]")]
        + "[model]\neffects = []\n[model.parameters]\nband_sun_magnitude = -26.7\n"
    )
    (folder / "scene.toml").write_text(text)
    scene = Scene.from_toml(text, known_effects=names())
    lines = ["time,station,mag,mag_err,exptime,curve,object"]
    station = scene.stations[0].id
    lines += [
        f"{2459140.1 + k / 96 + (k // 12):.6f},{station},{12 + 0.1 * (k % 3)},0.05,{5 + k % 2},{'AB'[k // 12]},{'PQR'[k % 3]}"
        for k in range(24)
    ]
    (folder / "rows.csv").write_text("\n".join(lines))
    recording = load_recording(folder / "rows.csv", scene)
    return scene, recording, assemble(scene, recording)


def every_entry(case) -> list[str]:
    """All effects that a diagnosis could add, noise models too."""
    noise = [name for name, cls in registry().items() if cls.stage == "noise"]
    return [*Workbench(*case[:2]).candidates(None), *noise]


def numbers(noise: Noise) -> list[torch.Tensor | None]:
    """The added variance, and every tensor of the law and of the processes of a noise."""
    held = [noise.law, *noise.processes]
    return [noise.variance, *(v for part in held for v in vars(part).values() if isinstance(v, torch.Tensor))]


def assert_same_model(one: LightCurve, two: LightCurve) -> None:
    assert one.parameter_set.free == two.parameter_set.free
    assert [(effect.name, effect.target) for effect in one.effects] == [
        (effect.name, effect.target) for effect in two.effects
    ]
    theta = one.parameter_set.start()
    with torch.no_grad():
        torch.testing.assert_close(two(theta), one(theta), rtol=0, atol=1e-12)
        for mine, other in zip(numbers(one.noise(theta)), numbers(two.noise(theta)), strict=True):
            assert (mine is None) == (other is None)
            if mine is not None:
                torch.testing.assert_close(mine, other, rtol=0, atol=1e-12)


def test_the_case_carries_all_but_a_few_effects(case):
    """So that the tests below are of the whole library; what is left needs a spin, facets that face each other, wings
    that can part, or a laboratory."""
    carried = {Entry.parse(entry).name for entry in every_entry(case)}
    turning = {"spin_rate_offset", "period_drift", "start_phase", "axis_tilt", "nutation", "pole_offset"}
    laboratory = {"camera_direction", "near_field", "convex_hull"}
    laboratory |= {"radiance_power", "radiance_threshold", "radiance_pedestal"}
    assert set(registry()) - carried <= {"interreflection", "wing_split", *turning, *laboratory}
    assert f"second_material[{ODD}]" in every_entry(case)
    assert {"time_offset@curve", "color_term[body]"} <= set(every_entry(case))


def test_every_effect_alone_comes_back_from_the_file(case):
    scene, recording, base = case
    for entry in every_entry(case):
        parsed = Entry.parse(entry)
        wide = str(Entry(parsed.name, parsed.target, parsed.per, 0.125 if parsed.per else None))
        added = LightCurve(scene, recording, assembly=assemble(scene, recording, [wide], base=base))
        text = completed_scene(scene, added.effects).to_toml()
        again = Scene.from_toml(text, known_effects=names())
        assert_same_model(added, LightCurve(again, recording))


@settings(max_examples=20, deadline=None, derandomize=True)
@given(data=st.data())
def test_sets_of_effects_with_numbers_of_the_scene_come_back_from_the_file(case, data):
    """Up to three effects, some given fixed or free in the scene, with bounds, for each curve or all alike."""
    scene, recording, base = case
    entries = data.draw(
        st.lists(
            st.sampled_from(every_entry(case)),
            min_size=1,
            max_size=3,
            unique_by=lambda e: Entry.parse(e).name,
        )
    )
    given_numbers = {}
    for effect in LightCurve(
        scene, recording, assembly=assemble(scene, recording, entries, base=base)
    ).effects:
        for quantity in effect.quantities:
            low, high = max(quantity.low, -50.0), min(quantity.high, max(50.0, 2 * quantity.low))
            value = data.draw(st.sampled_from([low + 0.3 * (high - low), low + 0.5 * (high - low)]))
            whole = effect.brdf is not None or effect.stage == "material"
            per = None if whole else data.draw(st.sampled_from([None, "curve", "night", "station"]))
            number = data.draw(
                st.sampled_from(
                    [
                        None,
                        value,
                        Free(value=value, low=low, high=high, per=per),
                        Free(value=value, sigma=0.3 * (high - low), prior="normal", low=low, per=per),
                    ]
                )
            )
            if number is not None:
                given_numbers[effect.origin(quantity.name).full_name()] = number
    model = scene.model.model_copy(update={"parameters": scene.model.parameters | given_numbers})
    scene = scene.model_copy(update={"model": model})
    added = LightCurve(scene, recording, effects=entries)
    again = Scene.from_toml(completed_scene(scene, added.effects).to_toml(), known_effects=names())
    assert_same_model(added, LightCurve(again, recording))


@pytest.mark.long
def test_what_a_diagnosis_completed_is_fitted_from_its_file(case, tmp_path):
    """Half of the panel's area is a second, sharper material: found, written, read, simulated and searched."""
    scene, _recording, _ = case
    hidden = scene.model.model_copy(
        update={
            "effects": [f"second_material[{ODD}]"],
            "parameters": {
                f"second_material.{key}": number
                for key, number in {"weight": 0.4, "n": 3000.0, "r_spec": 0.6, "r_diff": 0.0}.items()
            },
        }
    )
    curve = torchlc.simulate(
        scene.model_copy(update={"model": hidden}),
        start="2020-10-17T12:00:00",
        hours=10,
        cadence=300,
        noise=0.01,
    )
    path = curve.write(tmp_path / "curve.ecsv")
    seen = load_recording(path, scene)
    found = diagnose(scene, seen, quick=True, effects=[f"second_material[{ODD}]"])
    assert found.named == ("second_material",)
    (tmp_path / "completed.toml").write_text(found.completed.to_toml())
    again = torchlc.load(tmp_path / "completed.toml")
    assert again.model.effects == [f"second_material[{ODD}]"]
    assert_same_model(found.final.model, LightCurve(again, seen))
    chi2 = float(Likelihood(LightCurve(again, seen)).chi2(found.final.theta))
    assert chi2 == pytest.approx(found.final.chi2, rel=1e-12)
    # that another law alone describes more than the scene's own changes nothing of the answer
    search = found.search
    hypothesis = Hypothesis(noise=search.robust, law=next(iter(search.bench.laws)))
    other = search.refit(hypothesis, search.posterior(hypothesis).model.parameter_set.start()[None])
    assert replace(found, baseline=other).completed == found.completed


def test_check_candidates_and_diagnose_take_the_same_names(case):
    scene, recording, base = case
    bench = Workbench(scene, recording)
    for entry in every_entry(case):
        check_candidates([entry], base)
        if effect_class(entry).stage != "noise":
            assert entry in bench.candidates([entry])
            assert all(Entry.parse(one).name == Entry.parse(entry).name for one in bench.candidates([entry]))
    only = bench.candidates(["second_material[body]", "time_offset@curve"])
    assert only == ["time_offset@curve", "second_material[body]"]
    assert bench.likelihood(Hypothesis(("second_material[body]",))).model.names


@pytest.mark.parametrize(
    "entry",
    [
        "second_material[nobody]", "second_material[body", "second_materiel", "panel_offset[body]", "panel_offset@curve",
        "time_offset@station", "time_offset@curve~0.1", "color_term[nobody]", "", "\0", "x" * 5000,
    ],
)  # fmt: skip
def test_candidates_that_there_are_none_of_are_refused_in_one_line(case, entry):
    with pytest.raises(InputError) as caught:
        check_candidates([entry], case[2])
    assert len(str(caught.value)) < 1500 and str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("second_material[nobody]", "no material or component 'nobody'"),
        ("second_material[body", "unknown effect 'second_material.body'. expected"),
        ("second_material@curve", "per = "),
        ("time_offset@curve~0.1", "per = "),
        ("panel_offset[body]", "cannot be applied"),
        ("second_material[bodi]", "Did you mean 'body'"),
    ],
)
def test_a_scene_with_a_target_that_is_not_there_is_refused(case, entry, said):
    scene, recording, _ = case
    text = scene.to_toml().replace("effects = []", f"effects = [{json.dumps(entry)}]")
    with pytest.raises(InputError, match=said):
        LightCurve(Scene.from_toml(text, known_effects=names()), recording)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("color_term[radiator]", r"no component 'radiator'; its components: 'body', 'wing'"),
        ("back_transmission[radiator]", "no component 'radiator'; its components: "),
        ("second_material[wing]", "no material 'wing'; its materials: "),
        ("normal_dispersion[wing]", "no material 'wing'; its materials: "),
        ("back_transmission[body]", "the component is no two-sided plate"),
    ],
)
def test_a_target_of_another_role_is_told_from_one_that_cannot_carry_the_effect(tmp_path, entry, said):
    """A material's name is no component's: the sentence is not that of a scene that could not have the effect at all."""
    scene = Scene.from_toml(SCENE_OF_ROLES.replace("ENTRY", json.dumps(entry)), known_effects=names())
    rows = [f"{2459140.1 + k / 96:.6f},1,0,0.2,1,0.1,0,12.0,0.05" for k in range(4)]
    (tmp_path / "rows.csv").write_text(
        "\n".join(["time,sun_x,sun_y,sun_z,obs_x,obs_y,obs_z,mag,mag_err", *rows])
    )
    with pytest.raises(InputError, match=said):
        LightCurve(scene, load_recording(tmp_path / "rows.csv", scene))


def test_numpy_numbers_are_written_as_numbers(case):
    scene = case[0]
    numbers = {"zero_point": np.float64(0.25)}
    model = scene.model.model_copy(update={"parameters": numbers})
    text = scene.model_copy(update={"model": model}).to_toml()
    assert Scene.from_toml(text).model.parameters["zero_point"] == 0.25
