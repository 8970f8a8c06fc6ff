"""Predictions of many objects from one file of elements."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path

import numpy as np
import pytest

import torchlc
from tests.prediction_case import STATION, scene
from torchlc.cli import run
from torchlc.errors import InputError
from torchlc.scene.tle import checksum


def catalogue(folder: Path, count: int) -> Path:
    """Elements of a low shell, epochs at the night that is predicted."""
    generator = np.random.default_rng(4)
    lines = []
    for k in range(count):
        node, anomaly = generator.uniform(0, 360, 2)
        pair = (
            f"1 {60000 + k}U 23001A   23100.50000000  .00001000  00000-0  10000-3 0  999",
            f"2 {60000 + k}  53.0500 {node:8.4f} 0001000   0.0000 {anomaly:8.4f} 15.06000000 1000",
        )
        lines += [f"SHELL {k}", *(f"{line:68}{checksum(f'{line:68}')}" for line in pair)]
    path = folder / "shell.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


NIGHT = {"date": "2023-04-10"}


def test_many_objects_come_brightest_first_and_as_each_alone(tmp_path):
    path = catalogue(tmp_path, 12)
    found = torchlc.predict(scene(), elements=path, **NIGHT)
    medians = [one.brightest[2] for one in found.passes]
    assert medians == sorted(medians)
    assert sum(map(math.isfinite, medians)) > 5
    told = found.to_json()
    assert told["objects_searched"] == 12
    assert [one["mag"] for one in told["objects"]] == sorted(one["mag"] for one in told["objects"])
    text = path.read_text().splitlines()
    number = found.passes[0].path.orbiter
    alone = torchlc.predict(scene(text[3 * number + 1 : 3 * number + 3]), **NIGHT)
    here = next(one for one in alone.passes if one.path.begin == found.passes[0].path.begin)
    np.testing.assert_allclose(here.mag, found.passes[0].mag, rtol=1e-12)
    model = scene().name
    assert (
        found.headline().startswith(f"12 objects like {model}: ")
        and " of them; brightest " in found.headline()
    )
    assert alone.headline().startswith(f"{model}: ")
    path.write_text("\n".join(text[3 * number : 3 * number + 3]))
    named = torchlc.predict(scene(), elements=path, **NIGHT).headline()
    assert named.startswith(f"{text[3 * number].strip()}, like {model}: ")


def test_objects_of_one_name_are_told_apart_by_their_numbers(tmp_path):
    """In the printed table, the headline, the calendar and the figure; a long name leaves room for the number."""
    path = catalogue(tmp_path, 6)
    text = path.read_text()
    numbers = [line.split()[1] for line in text.splitlines() if line.startswith("2 ")]
    for name in ("SL-16 R/B", "SL-16 R/B of the Zenit-2 kind"):
        shared = re.sub(r"SHELL [0-4]", name, text)
        path.write_text(shared)
        found = torchlc.predict(scene(), elements=path, **NIGHT)
        seen = {found.orbiters[one.path.orbiter].number for one in found.passes if one.visible}
        assert len(seen) > 2
        rows = found.lines(most=1000)[1:]
        for row, one in zip(rows, found.passes, strict=True):
            number = found.orbiters[one.path.orbiter].number
            cell = row[31:55].strip()
            assert cell == ("SHELL 5" if number == numbers[5] else f"{name[: 24 - 6].strip()} {number}")
        first = found.orbiters[found.passes[0].path.orbiter]
        assert first.name == name and f"{name} {first.number}, " in found.headline()
        assert f"SUMMARY:{name} {first.number}\\, " in found.to_ics().replace("\r\n ", "")
        assert found.panels()[0].title == f"{name} {first.number} over weihai"


def test_what_has_no_orbit_is_left_out_and_named(tmp_path):
    path = catalogue(tmp_path, 3)
    decaying = (
        "1 70000U 23001A   22001.50000000  .09000000  00000-0  90000-1 0  999",
        "2 70000  53.0500  10.0000 0001000   0.0000  10.0000 16.40000000 1000",
    )
    gone = [f"{line:68}{checksum(f'{line:68}')}" for line in decaying]
    path.write_text(path.read_text() + "\n".join(["GONE", *gone]) + "\n")
    found = torchlc.predict(scene(), elements=path, **NIGHT)
    assert any("left out: GONE" in text for text in found.warnings)
    with pytest.raises(InputError, match="SGP4 fails"):
        torchlc.predict(scene(gone), **NIGHT)


def test_the_set_nearest_to_the_night_is_taken(tmp_path):
    path = catalogue(tmp_path, 1)
    name, first, second = path.read_text().splitlines()
    old = first.replace("23100.5", "23001.5")
    old = f"{old[:68]}{checksum(old[:68])}"
    path.write_text("\n".join([name, old, second, name, first, second]) + "\n")
    found = torchlc.predict(scene(), elements=path, **NIGHT)
    assert found.orbiters[0].age_days < 2
    assert any("1 element sets are left out" in text for text in found.warnings)


def test_elements_need_to_be_told_what_they_are(tmp_path, capsys):
    assert run(["predict", str(catalogue(tmp_path, 1)), "--date", "2023-04-10"]) == 2
    assert "--preset takes" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert run(["predict", str(tmp_path / "empty"), "--date", "2023-04-10"]) == 2
    assert "posterior.nc" in capsys.readouterr().err


def test_a_night_of_a_thousand_objects_takes_two_minutes(tmp_path):
    """On two cores, 240 s of CPU time: 0.24 s an object. Start-up is in the measurement."""
    from torchlc.cli import scaffold

    path = catalogue(tmp_path, 40)
    asked = scaffold.prediction_of(path, "starlink-v2-mini", None, [STATION], False)
    began = time.process_time()
    found = torchlc.predict(
        asked.scene, elements=path, stations=asked.stations, scatter=asked.scatter, **NIGHT
    )
    assert len(found.passes) > 40
    assert time.process_time() - began < 0.24 * 40
