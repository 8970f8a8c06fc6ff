"""A recording of another object than that of the scene's elements is told, by catalogue number."""

from __future__ import annotations

import re

import pytest

from tests.good_input import SCENE
from tests.observers_night import EXPORTS, table
from torchlc.readers import load_recording
from torchlc.scene import load_scene


def scene_of(number: str) -> str:
    """The scene with this number, five signs, in both lines of its elements, whose check sums follow."""

    def numbered(match: re.Match[str]) -> str:
        line = f"{match[1]} {number}{match[2]}"[:68]
        total = sum(int(sign) if sign.isdigit() else sign == "-" for sign in line)
        return f'"{line}{total % 10}"'

    return re.sub(r'"([12]) 00001(.*?)"', numbered, SCENE)


def warnings_on_elements(recording) -> list[str]:
    return [text for text in recording.warnings if "elements" in text]


@pytest.mark.parametrize(
    ("text", "number"),
    [
        (table("JD,Mag,Err,norad_cat_id", more=",25544"), "25544"),
        (table("JD,Mag,Err,Satellite,NORAD", more=",ISS,25544.0"), "25544"),
        (table("JD,Mag,Err,Satellite", more=",25544"), "25544"),
        (table("JD,Mag,Err,catalogue_number", more=",T0005"), "270005"),
        (table("JD,Mag,Err,norad", more=",00005"), "5"),
        ("# NORAD: 25544\n" + table("JD,Mag,Err"), "25544"),
        ("# object: 25544 ISS (ZARYA)\n" + table("JD,Mag,Err"), "25544"),
        ("# The ISS, NORAD catalogue number 25544.\n" + table("JD,Mag,Err"), "25544"),
        (EXPORTS["SCORE"], "12345"),
    ],
)
def test_another_number_is_told_with_both_and_what_to_do(read, text: str, number: str):
    (warning,) = warnings_on_elements(read(text, scene_of("44238")))
    assert warning == (
        f"the recording names object {number}, but the elements of the scene are of 44238: "
        f"give the scene the elements of {number}, or take a recording of 44238"
    )
    assert len(warning.split()) <= 30


@pytest.mark.parametrize(
    ("text", "number"),
    [
        (table("JD,Mag,Err,norad_cat_id", more=",44238"), "44238"),
        (table("JD,Mag,Err,norad_cat_id", more=",44238.0"), "44238"),
        (table("JD,Mag,Err,norad_cat_id", more=",270005"), "T0005"),
        (table("JD,Mag,Err,norad_cat_id", more=",00005"), "00005"),
        (table("JD,Mag,Err,norad_cat_id", more=","), "44238"),
        (table("JD,Mag,Err,norad_cat_id", more=",25544"), "xxxxx"),
        (table("JD,Mag,Err,Satellite", more=",COSMOS 2251"), "44238"),
        (table("JD,Mag,Err,Satellite", more=",7"), "44238"),
        ("# object: 44238\n# norad: 44238\n" + table("JD,Mag,Err"), "44238"),
        ("# catalogue: 1 NORAD\n# catalog: APASS 9\n" + table("JD,Mag,Err"), "44238"),
        (table("JD,Mag,Err"), "44238"),
    ],
)
def test_the_same_number_and_one_that_is_not_known_are_not(read, text: str, number: str):
    assert warnings_on_elements(read(text, scene_of(number))) == []
    assert warnings_on_elements(read(text)) == []


def test_the_object_that_is_chosen_counts(read):
    other = EXPORTS["SCORE"].splitlines()[1].replace("SAT 1,12345", "BIRD-7,54321")
    text = EXPORTS["SCORE"] + other + "\n"
    assert warnings_on_elements(read(text, scene_of("54321"), columns="object=BIRD-7")) == []
    assert (
        "names object 12345" in warnings_on_elements(read(text, scene_of("54321"), columns="object=SAT 1"))[0]
    )


def test_elements_of_a_file_have_a_number_too(tmp_path):
    lines = re.search(r'tle = \["(.*)",\s*"(.*)"\]', scene_of("44238"))
    assert lines is not None
    (tmp_path / "elements.txt").write_text(f"{lines[1]}\n{lines[2]}\n")
    (tmp_path / "scene.toml").write_text(re.sub(r"tle = \[[^]]*\]", 'tle_file = "elements.txt"', SCENE))
    (tmp_path / "night.csv").write_text(table("JD,Mag,Err,norad_cat_id", more=",25544"))
    recording = load_recording(tmp_path / "night.csv", load_scene(tmp_path / "scene.toml"))
    assert "elements of the scene are of 44238" in warnings_on_elements(recording)[0]
