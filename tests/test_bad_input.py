"""Bad input is refused with one clear line, and what can be mended is mended and said."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bad_input_cases import CASES
from tests.good_input import (
    ALTAZ_RECORDING,
    ALTAZ_SCENE,
    ECSV,
    RECORDING,
    SCENE,
    VECTOR_RECORDING,
    VECTOR_SCENE,
)
from tests.input_cases import Case
from torchlc import effects
from torchlc.errors import InputError
from torchlc.readers import load_recording
from torchlc.scene import load_scene


def load(case: Case, folder: Path):
    scene_path, recording_path = case.write(folder)
    scene = load_scene(scene_path, known_effects=effects.names())
    return scene, load_recording(recording_path, scene, min_rows=2)


GOOD = {
    "TLE": (SCENE, RECORDING),
    "vectors": (VECTOR_SCENE, VECTOR_RECORDING),
    "alt-az": (ALTAZ_SCENE, ALTAZ_RECORDING),
    "ECSV": (SCENE, ECSV),
}


@pytest.mark.parametrize("kind", GOOD)
def test_the_inputs_that_cases_break_are_good(kind: str, tmp_path: Path):
    scene, recording = load(
        Case(kind, dict(zip(("scene.toml", "recording.csv"), GOOD[kind], strict=True)), "", ""), tmp_path
    )
    assert not scene.warnings and not recording.warnings and not recording.dropped


def test_case_names_are_distinct():
    assert len({case.name for case in CASES}) == len(CASES) >= 60


@pytest.mark.parametrize("case", [c for c in CASES if c.outcome == "exit2"], ids=lambda case: case.name)
def test_refused_with_one_line(case: Case, tmp_path: Path):
    with pytest.raises(InputError) as caught:
        load(case, tmp_path)
    line = str(caught.value)
    assert case.message in line
    assert str(tmp_path) in line, "the line names the file"
    assert "\n" not in line and len(line) < 800
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("case", [c for c in CASES if c.outcome == "dropped"], ids=lambda case: case.name)
def test_dropped_and_counted(case: Case, tmp_path: Path):
    _, recording = load(case, tmp_path)
    assert recording.dropped == {case.message: 1}


@pytest.mark.parametrize("case", [c for c in CASES if c.outcome == "warning"], ids=lambda case: case.name)
def test_read_with_a_warning(case: Case, tmp_path: Path):
    scene, recording = load(case, tmp_path)
    assert any(case.message in warning for warning in (*scene.warnings, *recording.warnings))
