"""Scenes: what is read is what was written, and nothing but an InputError comes out of a broken file."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from sgp4.io import compute_checksum

import torchlc
from tests.good_input import BODY, MESH_SCENE, SCENE, TETRAHEDRON
from tests.test_orbit_files import GEO_1, GEO_2
from torchlc.api import simulate
from torchlc.errors import InputError
from torchlc.files.numbers import CONTROLS
from torchlc.materials import known as materials
from torchlc.scene import Free, Scene, load_scene
from torchlc.scene.checks import MAX_FILE_BYTES
from torchlc.scene.tle import checksum
from torchlc.scene.writer import toml_value

SHARED = Path(__file__).parents[2] / "shared"
REAL_SCENES = sorted(SHARED.glob("practice/*/scene.toml")) + sorted(SHARED.glob("data/*/scene*.toml"))

ALL_SHAPES = """\
format = "torchlc-scene/1"
name = "every shape, \\"quoted\\" \\u00e9"
[orbit]
vectors = "ecliptic"
[attitude]
mode = "spin-pole"
pole = [{ value = 17.2, low = 0.0, high = 360.0 }, 11.4]
period = { value = 5.27, sigma = 0.001 }
phase = 203.7
epoch = 2000-01-01T12:00:00Z
[[components]]
name = "box"
shape = "box"
size = [1, { value = 2.0, low = 1.5, high = 2.5 }, 3]
centre = [0, 0, 0]
rotation = [10, 20, 30]
material = "white paint"
face_materials = { "+Y" = "gold", "-Z" = "gold" }
[[components]]
name = "plate"
shape = "plate"
size = [1, { value = 2.0, sigma = 0.1 }]
centre = [0, 0, 2]
u = [0.6, 0.8, 0]
v = [-0.8, 0.6, 0]
material = "gold"
back_material = "white paint"
tracks = { target = "sun", axis = [0, 0, 2] }
[[components]]
name = "cylinder"
shape = "cylinder"
radius = 0.5
length = { value = 4.0, sigma = 0.1, prior = "lognormal" }
axis = [0, 1, 0]
facets = 64
centre = [0, 0, 4]
material = "gold"
[[components]]
name = "cone"
shape = "cone"
radius = 0.5
radius_top = { value = 0.1, sigma = 0.1, prior = "halfnormal" }
length = 1.0
centre = [0, 0, 6]
material = "gold"
[[components]]
name = "dish"
shape = "dish"
radius = 0.5
depth = 0.1
centre = [0, 0, 8]
material = "gold"
[[components]]
name = "sphere"
shape = "sphere"
radius = 0.5
centre = [0, 0, 9]
material = "gold"
[materials."white paint"]
model = "lambert"
albedo = { value = 0.8, low = 0.0, high = 1.0 }
[materials.gold]
n_u = 10.0
n_v = { value = 100.0, low = 1, high = 1e4, prior = "loguniform" }
r_spec = 0.5
r_diff = { value = 0.3, sigma = 0.2 }
[model.parameters]
zero_point = { value = 0.0, sigma = 0.1, per = "night" }
band_sun_magnitude = { clear = -26.9, V = -26.76 }
"panel_offset.deg" = 1.0
"normal_dispersion.deg[gold]" = { value = 1.0, low = 0.0, high = 20.0 }
"""


def read(text: str) -> Scene:
    return Scene.from_toml(text)


@pytest.mark.parametrize("text", [SCENE, ALL_SHAPES], ids=["box-wing", "all shapes"])
def test_written_and_read_again_it_is_the_same_scene(text: str):
    scene = read(text)
    assert read(scene.to_toml()) == scene


@pytest.mark.skipif(not REAL_SCENES, reason="../shared is not there")
@pytest.mark.parametrize("path", REAL_SCENES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_real_scenes_are_read_without_a_warning_and_survive_writing(path: Path):
    scene = load_scene(path)
    assert not scene.warnings
    assert Scene.from_toml(scene.to_toml(), scene.directory, scene.source) == scene


def test_numbers_have_full_names():
    numbers = read(ALL_SHAPES).numbers()
    assert list(numbers) == [
        "white paint.albedo", "gold.n_u", "gold.n_v", "gold.r_spec", "gold.r_diff",
        "attitude.period", "attitude.phase", "attitude.pole_lon", "attitude.pole_lat",
        "box.size_x", "box.size_y", "box.size_z", "plate.size_u", "plate.size_v",
        "cylinder.radius", "cylinder.length", "cone.radius", "cone.radius_top", "cone.length",
        "dish.radius", "dish.depth", "sphere.radius",
    ]  # fmt: skip
    assert numbers["box.size_x"] == 1.0
    assert numbers["box.size_y"] == Free(value=2.0, low=1.5, high=2.5)


def test_defaults_of_priors():
    numbers = read(ALL_SHAPES).numbers()
    prior = {name: number.prior for name, number in numbers.items() if isinstance(number, Free)}
    assert prior["white paint.albedo"] == "uniform"
    assert prior["gold.r_diff"] == "normal"
    assert prior["gold.n_v"] == "loguniform"
    assert prior["cylinder.length"] == "lognormal"
    assert prior["cone.radius_top"] == "halfnormal"


def test_open_bounds_are_the_physical_ones():
    numbers = read(ALL_SHAPES).numbers()
    reflectance, size = numbers["gold.r_diff"], numbers["plate.size_v"]
    assert isinstance(reflectance, Free) and isinstance(size, Free)
    assert (reflectance.low, reflectance.high) == (0.0, 1.0)
    assert (size.low, size.high) == (0.0, None)


def test_what_is_left_out_takes_its_default():
    scene = read(SCENE)
    assert scene.materials["body"].model == "ashikhmin-shirley"
    assert (
        read(SCENE.replace("[model]\n", "").replace('effects = ["self_shadowing"]\n', "")).model.effects
        is None
    )
    assert read(SCENE.replace('["self_shadowing"]', "[]")).model.effects == []
    lommel = read(
        SCENE.replace(
            "n = 1000.0\nr_spec = 0.3\nr_diff = 0.3", 'model = "lommel-seeliger-lambert"\nweight = 0.1'
        )
    )
    assert lommel.materials["body"].parameters == {"weight": 0.1, "albedo": 1.0}


def test_a_preset_fills_in_what_the_scene_leaves_out():
    model, known = materials.preset("kapton")
    own = next(iter(known))
    given = {"value": known[own], "low": 0.5 * known[own], "high": known[own] * 1.01}
    text = SCENE.replace(
        "n = 1000.0\nr_spec = 0.3\nr_diff = 0.3", f'preset = "kapton"\n{own} = {toml_value(given)}'
    )
    body = read(text).materials["body"]
    assert body.model == model and body.preset == "kapton"
    assert body.parameters[own] == Free(**given)
    assert {**body.parameters, own: known[own]} == known
    assert read(read(text).to_toml()).materials["body"] == body


def test_quirks_of_editors(tmp_path: Path):
    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xef\xbb\xbf" + SCENE.replace("\n", "\r\n").encode())
    assert load_scene(path).components == read(SCENE).components


def test_checksum_of_the_published_space_station():
    lines = (
        "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927",
        "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537",
    )
    assert [checksum(line) for line in lines] == [7, 7]


@given(st.text("0123456789-+. ABU", min_size=68, max_size=68))
def test_checksum_agrees_with_sgp4(line: str):
    assert checksum(line) == compute_checksum(line)


class TestFiles:
    """A mesh must lie inside the scene's folder unless the scene is trusted."""

    def folder(self, tmp_path: Path) -> Path:
        (tmp_path / "inside").mkdir()
        (tmp_path / "outside.obj").write_text(TETRAHEDRON)
        return tmp_path / "inside"

    def scene(self, folder: Path, file: str, trust: bool = False) -> Scene:
        (folder / "scene.toml").write_text(MESH_SCENE.replace("body.obj", file))
        return load_scene(folder / "scene.toml", trust=trust)

    def test_inside(self, tmp_path: Path):
        folder = self.folder(tmp_path)
        (folder / "deep").mkdir()
        (folder / "deep" / "body.obj").write_text(TETRAHEDRON)
        scene = self.scene(folder, "deep/body.obj")
        assert scene.file_path("deep/body.obj").read_text() == TETRAHEDRON

    @pytest.mark.parametrize(
        "file", ["../outside.obj", "a/../../outside.obj", "C:\\\\x.obj", "..\\\\outside.obj"]
    )
    def test_a_way_out_is_refused(self, tmp_path: Path, file: str):
        with pytest.raises(InputError, match=r"a relative path inside the scene's folder\. .*trust=True"):
            self.scene(self.folder(tmp_path), file)

    def test_a_link_that_leads_out_is_refused(self, tmp_path: Path):
        folder = self.folder(tmp_path)
        (folder / "link.obj").symlink_to("../outside.obj")
        with pytest.raises(InputError, match=r"leads out of the scene's folder.*trust=True"):
            self.scene(folder, "link.obj")
        assert self.scene(folder, "link.obj", trust=True)

    def test_trust_opens_the_way(self, tmp_path: Path):
        assert self.scene(self.folder(tmp_path), "../outside.obj", trust=True)

    def test_too_large(self, tmp_path: Path):
        folder = self.folder(tmp_path)
        with (folder / "body.obj").open("wb") as stream:
            stream.truncate(MAX_FILE_BYTES + 1)
        with pytest.raises(InputError, match="100 MB; expected at most 100 MB"):
            self.scene(folder, "body.obj")

    @pytest.mark.parametrize("file", ["deep", "no.obj", "x" * 300, "nul\\u0000.obj"])
    def test_no_file(self, tmp_path: Path, file: str):
        folder = self.folder(tmp_path)
        (folder / "deep").mkdir()
        with pytest.raises(InputError, match="no file"):
            self.scene(folder, file)

    def test_a_folder_or_pipe_is_no_scene(self, tmp_path: Path):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(InputError, match="not a regular file"):
            load_scene(tmp_path / "pipe")
        with pytest.raises(InputError, match="a folder; expected"):
            load_scene(tmp_path)
        (tmp_path / "curve.ecsv").touch()
        with pytest.raises(InputError, match=r"Did you mean .*curve\.ecsv\?"):
            load_scene(tmp_path)
        with pytest.raises(InputError, match="no such file"):
            load_scene(tmp_path / "none.toml")
        with pytest.raises(InputError, match="cannot be read"):
            load_scene(tmp_path / ("x" * 300))


def test_more_than_1000_components_are_refused():
    boxes = "".join(BODY.replace('"body"', f'"{index}"', 1) for index in range(1000))
    with pytest.raises(InputError, match="components: 1001 values; expected at most 1000"):
        read(SCENE.replace(BODY, boxes).replace("[materials.body]", "[materials.body]"))


number = st.floats(-1e6, 1e6, allow_nan=False)
free = st.builds(
    lambda low, width, place: {"value": low + place * width, "low": low, "high": low + width},
    number,
    st.floats(1e-3, 1e3),
    st.floats(0, 1),
).filter(lambda table: table["low"] <= table["value"] <= table["high"])


title = st.text(st.characters(exclude_categories=CONTROLS), max_size=30)


@given(zero_point=number | free, name=title, phase=number | free)
def test_any_number_and_name_survive_writing(zero_point: object, name: str, phase: object):
    text = SCENE.replace('{ value = 0.0, sigma = 0.02, prior = "normal" }', toml_value(zero_point))
    text = text.replace('"box-wing"', toml_value(name))
    text = text.replace(
        'mode = "nadir"',
        f'mode = "nadir"\nspin_axis = [1, 0, 0]\nspin_rate = 1\nspin_phase = {toml_value(phase)}',
    )
    scene = read(text)
    assert scene.name == name
    assert read(scene.to_toml()) == scene


anything = st.recursive(
    st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)
LINES = [index for index, line in enumerate(ALL_SHAPES.split("\n")) if " = " in line]


@given(line=st.sampled_from(LINES), value=st.none() | anything)
@example(line=LINES[2], value=math.nan)
def test_any_value_anywhere_gives_a_scene_or_an_input_error(line: int, value: object):
    lines = ALL_SHAPES.split("\n")
    lines[line] = f"{lines[line].split(' = ')[0]} = {toml_value(value)}" if value is not None else ""
    try:
        read("\n".join(lines))
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 800


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    cuts=st.lists(
        st.tuples(st.integers(0, len(ALL_SHAPES)), st.integers(0, 5), st.binary(max_size=4)), max_size=4
    )
)
def test_damaged_files_give_a_scene_or_an_input_error(tmp_path: Path, cuts: list[tuple[int, int, bytes]]):
    content = ALL_SHAPES.encode()
    for place, length, new in cuts:
        content = content[:place] + new + content[place + length :]
    path = tmp_path / "scene.toml"
    path.write_bytes(content)
    try:
        load_scene(path)
    except InputError as error:
        assert "\n" not in str(error)


def test_components_of_one_name_are_numbered():
    """Whatever names the file holds besides, each is used once, and the scene as it is written reads without a word."""
    body = SCENE[SCENE.index("[[components]]") : SCENE.index('[[components]]\nname = "panel"')]
    named = [body.replace('name = "body"', f'name = "{name}"') for name in ("wing 2", "wing", "wing")]
    scene = Scene.from_toml(SCENE.replace(body, "".join([*named, body, body])))
    names = [component.name for component in scene.components]
    assert names == ["wing 2", "wing 1", "wing 3", "body 1", "body 2", "panel"]
    assert [text.partition(". They")[0] for text in scene.warnings] == [
        "components: 2 have the name 'wing'",
        "components: 2 have the name 'body'",
    ]
    again = Scene.from_toml(scene.to_toml())
    assert again == scene and not again.warnings


def test_components_of_one_name_have_the_brightness_of_named_ones():
    scene = Scene.from_toml(SCENE.replace('name = "panel"', 'name = "body"'))
    times = {"start": "2020-10-17T15:00:00", "hours": 2.0, "cadence": 1200.0}
    alike, apart = (simulate(given, **times) for given in (scene, Scene.from_toml(SCENE)))
    assert (alike.mag == apart.mag).all()
    assert {"share body 1", "share body 2"} <= set(alike.to_table().colnames)


def test_all_that_is_missing_is_told_at_once() -> None:
    """Keys of materials, the station and numbers of a spin, which are checked at different places."""
    demo = (Path(torchlc.__file__).parent / "demo" / "scene.toml").read_text(encoding="utf-8")
    bare = re.sub(r"(?m)^(n|r_spec|r_diff) = .*\n", "", demo)
    with pytest.raises(InputError) as caught:
        Scene.from_toml(re.sub(r"\[\[stations\]\]\n(?:.+\n)*", "", bare))
    keys = [f"materials.{name}.{key}" for name in ("body", "panel") for key in ("n", "r_spec", "r_diff")]
    assert str(caught.value).startswith("stations: no station")
    assert f"Missing too: {', '.join(keys)}" in str(caught.value)
    with pytest.raises(
        InputError, match=r"attitude\.pole: missing.*attitude\.period, attitude\.phase, attitude\.epoch"
    ):
        Scene.from_toml(demo.replace('mode = "nadir"', 'mode = "spin-pole"'))


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("f0 = .4", "Write a 0 before the point: 0.4"),
        ("size = [2.0, -.4]", "Write a 0 before the point: -0.4"),
        ("n = 4.", "Write a 0 behind the point: 4.0"),
        ("n = { value = 1.e5, low = 1.0 }", "Write a 0 behind the point: 1.0e5"),
        ("n = 04", "Leave out the zeros in front: 4"),
        ("n = 0,4", "Write decimals with a point, and nothing between thousands"),
        ("n = 5d3", "Write the exponent with e"),
        ("n = 50%", "Write the number alone, without a unit"),
        ("n = True", "Write true"),
        ("name = GEO", "Put text between double quotes"),
        ("name = \N{LEFT DOUBLE QUOTATION MARK}GEO\N{RIGHT DOUBLE QUOTATION MARK}", "as the keyboard has them"),
        ("name = ", "Write a value behind ="),
        ("name: 4", "Write = between a key and its value"),
        ("my name = 4", "Put a key with blanks or signs between double quotes"),
        ('file = "C:\\Users"', "Write each backslash twice"),
    ],
)  # fmt: skip
def test_a_known_slip_of_toml_is_told_with_what_to_write(line: str, hint: str):
    with pytest.raises(InputError, match="line 2") as caught:
        Scene.from_toml(f"a = 1\n{line}\nb = 2\n")
    assert hint in str(caught.value)


def test_a_list_that_is_not_closed_is_no_decimal_comma():
    with pytest.raises(InputError, match=r"unclosed array; expected TOML$"):
        Scene.from_toml("a = [1,2")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "elements.txt",
            f"GEO\n{GEO_1}\n{GEO_2}\n",
            r"two-line elements; expected a scene in TOML\. torchlc init",
        ),
        ("night.csv", "time,mag\n2459164.3,12.1\n", r"no scene; .* given first, then the recording"),
    ],
)
def test_another_file_in_the_place_of_the_scene_is_told_by_its_kind(
    tmp_path: Path, name: str, text: str, message: str
):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        load_scene(tmp_path / name)
