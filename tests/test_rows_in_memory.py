"""Rows in memory: tables, frames and mappings in place of a file, and what a notebook shows."""

from __future__ import annotations

import re
from typing import ClassVar

import astropy.units as u
import numpy as np
import pandas
import pytest
from astropy.table import Table
from astropy.time import Time

from tests.good_input import SCENE
from tests.observers_night import AIJ, ERROR, JD, MAG
from tests.test_layouts import same
from torchlc.errors import InputError
from torchlc.readers import Recording
from torchlc.scene import Scene


class TestRowsInMemory:
    COLUMNS: ClassVar = {
        "time": Time(JD, format="jd", scale="utc"),
        "mag": np.array(MAG),
        "mag_err": np.array(ERROR),
    }

    @pytest.mark.parametrize("rows", [
        COLUMNS,
        {**COLUMNS, "mag": MAG * u.mag, "mag_err": 1000 * np.array(ERROR) * u.mmag},
        {"JD": JD, "Mag": MAG, "Err": ERROR},
        {**COLUMNS, "time": Time(JD, format="jd", scale="utc").tai},
        Table({"time": JD, "mag": MAG, "mag_err": ERROR}),
        Table(COLUMNS),
        pandas.DataFrame({"jd": JD, "mag": MAG, "mag_err": ERROR}),
        pandas.DataFrame({"time": pandas.to_datetime([Time(one, format="jd").isot for one in JD]), "mag": MAG, "mag_err": ERROR}),
        pandas.DataFrame({"mag": MAG, "mag_err": ERROR}, index=pandas.to_datetime([Time(one, format="jd").isot for one in JD], utc=True)),
    ], ids=["arrays and Time", "quantities", "names of others", "TAI", "Table", "Table with Time", "DataFrame", "instants", "index"])  # fmt: skip
    def test_every_kind(self, rows):
        recording = Recording.from_table(rows)
        np.testing.assert_allclose(recording.observed, MAG, rtol=1e-15)
        np.testing.assert_allclose(recording.error, ERROR, rtol=1e-14)
        assert np.abs((recording.time - Time(JD, format="jd", scale="utc")).to_value(u.s)).max() < 1e-4

    def test_instants_with_a_zone(self):
        frame = pandas.DataFrame({"time": pandas.to_datetime(["2020-10-17T17:00:00+02:00"]), "mag": [12.0]})
        assert Recording.from_table(frame).time[0].isot == "2020-10-17T15:00:00.000"

    @pytest.mark.parametrize("way", ["to_table", "to_pandas", "to_timeseries"])
    def test_there_and_back(self, read, way: str):
        recording = read(AIJ)
        same(Recording.from_table(getattr(recording, way)()), recording)

    def test_what_cannot_be(self):
        for rows, message in (
            ({"time": JD, "mag": MAG[:2]}, "different lengths"),
            ({"time": JD, "mag": 12.0}, "column mag is one number"),
            (12.0, "a path, a Recording"),
            ({}, "no columns"),
        ):
            with pytest.raises(InputError, match=message):
                Recording.from_table(rows)


def test_pictures_of_a_notebook(read):
    shown = read(AIJ)._repr_html_()
    assert shown.count("<circle") == 3 and "</svg>" in shown
    heights = [float(one) for one in re.findall(r'cy="([\d.]+)"', shown)]
    assert heights == sorted(heights, reverse=True)  # it brightens: the dots rise, y counts downwards
    assert (
        Scene.from_toml(SCENE)._repr_html_().count("<polygon") >= 4
    )  # three faces of the box, one of the plate
