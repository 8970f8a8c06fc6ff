"""A curve that repeats another to the last digit is told, however late it does; measurements of the same light are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from torchlc.readers import load_recording

START = np.datetime64("2021-03-20T12:00:00")


def file(tmp_path: Path, curves: dict[str, np.ndarray], name: str = "flux") -> Path:
    rows = [
        f"{START + np.timedelta64(10 * k, 's')},{value:.4f},0.01,{curve}"
        for curve, values in curves.items()
        for k, value in enumerate(values)
    ]
    path = tmp_path / "curves.csv"
    path.write_text("\n".join([f"time,{name},{name}_err,curve", *rows]))
    return path


def told(path: Path) -> list[str]:
    return [text for text in load_recording(path).warnings if "to the last digit" in text]


@pytest.fixture
def light() -> np.ndarray:
    rng = np.random.default_rng(3)
    return 1.0 + 0.3 * np.sin(np.arange(120) / 9.0) + 0.01 * rng.normal(size=120)


def test_a_copy(tmp_path, light):
    (text,) = told(file(tmp_path, {"a": light, "b": light[::-1], "c": light}))
    assert text == (
        "curve c repeats curve a to the last digit (row by row; 120 of 120 rows): one of the two is no measurement"
    )


@pytest.mark.parametrize(("late", "what"), [(7, "7 rows behind, +70 s"), (-30, "30 rows ahead, -300 s")])
def test_a_delayed_copy_that_goes_on_at_its_beginning(tmp_path, light, late, what):
    (text,) = told(file(tmp_path, {"a": light, "b": np.roll(light, late)}))
    assert f"curve b repeats curve a to the last digit ({what}; {120 - abs(late)} of 120 rows)" in text


def test_most_of_a_longer_curve(tmp_path, light):
    rng = np.random.default_rng(5)
    spoiled = light.copy()
    spoiled[rng.choice(120, 4, replace=False)] += 0.1  # some rows were mended
    assert len(told(file(tmp_path, {"a": np.concatenate([light, 2 * light]), "b": spoiled}))) == 1


def test_two_cameras_of_one_light_a_constant_and_a_short_curve_are_no_copies(tmp_path, light):
    rng = np.random.default_rng(4)
    seen = {name: light + 0.01 * rng.normal(size=120) for name in "ab"}
    flat = np.round(0.5 + 0.01 * (np.arange(120) % 40 == 0), 2)
    assert not told(file(tmp_path, {**seen, "c": flat, "d": flat.copy(), "e": light[:11], "f": light[:11]}))


def test_coarse_values_agree_by_chance_here_and_there(tmp_path):
    """Two curves of 5,000 rows of ten steps: some hundred windows agree by chance, and no curve."""
    rng = np.random.default_rng(4)
    assert not told(file(tmp_path, {name: rng.integers(1, 6, 5000) / 10.0 for name in "ab"}))
