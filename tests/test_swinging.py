"""An angle that the library takes as constant, and that swings: the light, where to look for it, and what a diagnosis says."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.effects.cases import RANGE_KM, flux, seen_from, still, tilted
from tests.effects.test_panel_offset import LAMBERT, wing
from torchlc import diagnose
from torchlc.diagnosis.attitude_search import GIVEN_AXIS, Target, swings
from torchlc.effects import registry, unlisted
from torchlc.readers import load_recording
from torchlc.scene import load_scene

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "calibration"))
import make_injections


def test_what_may_swing_is_no_effect_of_the_library():
    """A scene may list it, but no list of effects does, and nobody can be told it as one."""
    found = unlisted()
    assert {"panel_offset_swing", "panel_cant_swing", "wing_split_swing"} <= set(found)
    assert not set(found) & set(registry())


@pytest.mark.parametrize(("effect", "towards"), [("panel_offset", 0.0), ("panel_cant", 90.0)])
def test_cosines_of_a_normal_that_swings(tmp_path, effect, towards):
    """With the Sun at +Z the normal leans by the angle of each row, towards X or Y."""
    scene = still(wing("[0, 1, 0]"), LAMBERT)
    aside = np.linspace(-40.0, 40.0, 30)  # one row a second
    recording = seen_from(scene, tmp_path, [0, 0, 1], tilted(aside, towards))
    angle = np.radians(8.0 * np.sin(2 * np.pi * np.arange(30) / 72.0 + np.radians(40.0)))
    expected = 0.6 / np.pi * 6.0 * np.cos(angle) * np.cos(np.radians(aside) - angle) / (1e3 * RANGE_KM) ** 2
    name = f"{effect}_swing"
    values = {f"{name}__deg": 8.0, f"{name}__period_min": 1.2, f"{name}__phase_deg": 40.0}
    np.testing.assert_allclose(flux(scene, recording, [name], **values), expected, rtol=1e-10)


@pytest.mark.parametrize("phase", [25.0, 205.0])
def test_a_swing_about_a_given_axis_is_found_in_the_residuals(phase):
    """Rows whose light changes by a slope of their own for each degree, one third of them not at all."""
    minutes = torch.arange(0.0, 400.0, 1.5, dtype=torch.float64)
    generator = torch.Generator().manual_seed(3)
    slope = 20 * torch.randn(len(minutes), generator=generator, dtype=torch.float64)
    slope[::3] = 0.0

    def change(psi: torch.Tensor) -> torch.Tensor:
        deg, period, start = psi.T[..., None]
        return slope * deg * torch.sin(2 * math.pi * minutes / period + torch.deg2rad(start))

    residual = change(torch.tensor([[0.4, 37.0, phase]]))[0]
    residual = residual + torch.randn(len(minutes), generator=generator, dtype=torch.float64)
    flat = torch.full((len(minutes), 1), len(minutes) ** -0.5, dtype=torch.float64)
    found = swings(Target(residual, flat, change), minutes, 1.5, (1.0, 720.0), 3, GIVEN_AXIS)
    assert found.shape == (3, 3)
    deg, period, start = found[0].tolist()
    assert deg == pytest.approx(0.4, rel=0.05) and period == pytest.approx(37.0, rel=0.01)
    assert math.cos(math.radians(start - phase)) > 0.98


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("made")


@pytest.mark.long
def test_wings_that_flex_are_told_as_what_they_do_and_not_as_an_effect(folder) -> None:
    """By the independent program of the examples. Before, a wobble with another effect was named with 0.97 and more."""
    number = {name: number for number, name in make_injections.numbered()}["outside-flexing"]
    made = make_injections.observed("outside-flexing", number, seed=71)
    made.write(folder)
    scene = load_scene(folder / "scene.toml")
    content = diagnose(scene, load_recording(folder / "recording.ecsv", scene)).to_json()
    swing = made.concealed["flexing"]
    assert (content["verdict"], content["named"]) == ("unexplained", [])
    odd = content["discrepancy"]
    assert odd["like"] == ["panel_offset_swing"] and "by an angle that swings by" in odd["course"]
    assert odd["period_s"] / 60 == pytest.approx(swing["period_min"], rel=0.03)
    assert {one["name"] for one in content["where"]["components"][:2]} == {"panel +Y", "panel -Y"}
    assert not any(row["effect"] in unlisted() for row in content["candidates"])
