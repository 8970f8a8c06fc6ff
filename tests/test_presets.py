"""Presets of ``torchlc init``: published sizes, parts that fit together, and a prior on whatever nobody knows exactly."""

from __future__ import annotations

import itertools
import math
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.good_input import TETRAHEDRON
from torchlc.cli import run
from torchlc.cli.scaffold import PRESETS, new_scene
from torchlc.effects import names
from torchlc.scene import Free, Scene, load_scene
from torchlc.scene.tle import Elements

LINES = (
    "1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993",
    "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966",
)
ELEMENTS = Elements("x", LINES)
SHAPES = [name for name in PRESETS if name != "mesh"]
SIZES = ("size", "radius", "length")


def parts(preset: str, *, exact: bool) -> dict[str, Any]:
    """The components of a preset's scene, by name, as TOML has them."""
    content = tomllib.loads(new_scene(ELEMENTS, preset, exact=exact))
    return {part["name"]: part for part in content["components"]}


def sizes(part: dict[str, Any]) -> list[Any]:
    found = [part[key] for key in SIZES if key in part]
    return [one for value in found for one in (value if isinstance(value, list) else [value])]


@pytest.mark.parametrize("preset", SHAPES)
def test_every_size_has_a_prior_unless_exact(preset: str):
    """Normal, of the preset's width, and never down to nothing; the scene is read, with the source in a comment."""
    text = new_scene(ELEMENTS, preset)
    assert PRESETS[preset].source in text
    scene = Scene.from_toml(text, known_effects=names())
    share = PRESETS[preset].percent / 100
    for name, part in parts(preset, exact=False).items():
        assert sizes(part)
        for size in sizes(part):
            assert size["prior"] == "normal", name
            assert size["sigma"] == pytest.approx(
                share * size["value"], rel=0.005
            )  # three digits are written
            assert 0 < size["low"] < size["value"] - 2 * size["sigma"]
    assert all(
        isinstance(size, float | int) for part in parts(preset, exact=True).values() for size in sizes(part)
    )
    free = [key for key, value in scene.model.parameters.items() if isinstance(value, Free)]
    tumbles = any(isinstance(one, Free) for one in (scene.attitude.spin_phase, scene.attitude.x_angle))
    fitted = preset in ("starlink-v1.5", "starlink-v2-mini")
    offsets = {f"attitude_offset.{axis}" for axis in "xyz"}
    assert tumbles or fitted or offsets <= set(free)
    assert tumbles or fitted or "jitter" in (scene.model.effects or [])
    exact = Scene.from_toml(new_scene(ELEMENTS, preset, exact=True), known_effects=names())
    assert not offsets & set(exact.model.parameters)


@pytest.mark.parametrize(
    ("preset", "published"),
    [
        ("cubesat-1u", (0.1, 0.1, 0.1135)),
        ("cubesat-2u", (0.1, 0.1, 0.227)),
        ("cubesat-3u", (0.1, 0.1, 0.3405)),
        ("cubesat-6u", (0.1, 0.2263, 0.366)),
        ("cubesat-12u", (0.2263, 0.2263, 0.366)),
    ],
)
def test_cubesats_are_those_of_the_specification(preset: str, published: tuple[float, float, float]):
    """CubeSat Design Specification, rev. 14.1, 2022: appendix B."""
    assert tuple(sizes(parts(preset, exact=True)["body"])) == published


def test_starlinks_have_the_published_areas():
    """Fankhauser, Tyson, Askari 2023, section 4: chassis 3.64 m2, array 22.68 m2; Mallama et al. 2023: 2.7 x 4.1 and 2 x 4.1 x
    12.8 m."""
    for preset, chassis, array in (
        ("starlink-v1.5", 3.64, 22.68),
        ("starlink-v2-mini", 2.7 * 4.1, 2 * 4.1 * 12.8),
    ):
        first, second = parts(preset, exact=True).values()
        assert sizes(first)[0] * sizes(first)[1] == pytest.approx(chassis)
        assert sizes(second)[0] * sizes(second)[1] == pytest.approx(array)


@pytest.mark.parametrize(
    ("preset", "engines", "thrust_kn", "pressure_mpa", "area_ratio"),
    [
        ("rocket-body-sl-16", 1, 833.6, 16.28, 106.0),  # RD-120
        ("rocket-body-centaur", 1, 99.2, 4.2, 84.0),  # RL10A-4-2
        ("rocket-body-falcon-9", 1, 981.0, 9.7, 165.0),  # Merlin 1D Vacuum
        ("rocket-body-h-2a", 1, 137.2, 3.58, 110.0),  # LE-5B
        ("rocket-body-ariane-5", 1, 64.8, 3.7, 83.1),  # HM7B
        ("rocket-body-cz-3b", 2, 78.45, 3.76, 80.0),  # YF-75
    ],
)
def test_nozzles_are_as_wide_as_their_engines_make_them(
    preset: str, engines: int, thrust_kn: float, pressure_mpa: float, area_ratio: float
):
    """Thrust = C_F p A_throat, with C_F of 1.85 to 2.0 in vacuum at such area ratios (Sutton & Biblarz, Rocket Propulsion
    Elements, fig. 3-6): 4 % of the radius, and a
    standard deviation of the prior."""
    throat_m2 = engines * thrust_kn * 1e3 / (1.92 * pressure_mpa * 1e6)
    radius = (area_ratio * throat_m2 / math.pi) ** 0.5
    nozzle = parts(preset, exact=True)["nozzle"]["radius"]
    assert nozzle == pytest.approx(radius, rel=0.04 + PRESETS[preset].percent / 100)


def test_parts_do_not_overlap_and_span_what_is_published():
    """Wings begin outside of the body and nozzles below the tank. Iridium NEXT spans 9.4 m; the ISS's truss with its wings
    109 m, its wings 35 m each to either side."""
    for preset in SHAPES:
        part = parts(preset, exact=True)
        if PRESETS[preset].template == "box_wing":
            inner = part["panel +Y"]["centre"][1] - part["panel +Y"]["size"][1] / 2
            assert inner >= part["body"]["size"][1] / 2
        if PRESETS[preset].template == "rocket_body":
            top = part["nozzle"]["centre"][2] + part["nozzle"]["length"] / 2
            assert top == pytest.approx(-part["tank"]["length"] / 2)
            assert part["nozzle"]["radius"] < part["tank"]["radius"]
    wing = parts("iridium-next", exact=True)["panel +Y"]
    assert 2 * (wing["centre"][1] + wing["size"][1] / 2) == pytest.approx(9.4)
    station = parts("iss", exact=True)
    outer = station["wing S6"]
    assert 2 * (outer["centre"][1] + outer["size"][1] / 2) == pytest.approx(
        109, rel=0.06
    )  # within its prior of 5 %
    assert outer["size"][0] == pytest.approx(2 * 35, rel=0.01)
    rows = sorted(part["centre"][1] for name, part in station.items() if name.startswith("wing"))
    assert min(b - a for a, b in itertools.pairwise(rows)) >= outer["size"][1]


def test_both_spellings_of_the_option_and_of_a_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "tle.txt").write_text("\n".join(LINES) + "\n")
    texts = []
    for number, option in enumerate([["--preset", "rocket body SL-16"], ["--shape", "rocket-body-sl-16"]]):
        scene = tmp_path / f"{number}.toml"
        assert run(["init", str(scene), "--tle", str(tmp_path / "tle.txt"), *option, "--quiet"]) == 0
        texts.append(scene.read_text())
    assert texts[0] == texts[1]
    assert (
        run(["init", str(tmp_path / "a.toml"), "--tle", str(tmp_path / "tle.txt"), "--preset", "cubsat"]) == 2
    )
    error = capsys.readouterr().err
    assert "Did you mean 'cubesat'" in error and "iridium-next" in error


def test_a_mesh_is_named_from_the_scene_or_from_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The path that a shell completes, the whole path and the one from the scene's folder are the same file."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "sub"
    folder.mkdir()
    (folder / "body.obj").write_text(TETRAHEDRON)
    (tmp_path / "out.obj").write_text(TETRAHEDRON)
    (tmp_path / "tle.txt").write_text("\n".join(LINES) + "\n")

    def init(mesh: str) -> int:
        arguments = ["--tle", "tle.txt", "--shape", "mesh", "--mesh", mesh, "--quiet", "--force"]
        return run(["init", "sub/s.toml", *arguments])

    for mesh in ("body.obj", "sub/body.obj", str(folder / "body.obj")):
        assert init(mesh) == 0
        assert load_scene(folder / "s.toml").components[0].file == "body.obj"
    for mesh in ("none.obj", str(tmp_path / "out.obj"), "x" * 300, ""):
        assert init(mesh) == 2
