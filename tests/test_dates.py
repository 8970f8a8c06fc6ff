"""Dates, clocks and counts of seconds as people and programs write them, against astropy's and Python's own parsers."""

from __future__ import annotations

import datetime
import random
import time

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from torchlc.errors import InputError
from torchlc.readers.dates import Calendar, is_moment
from torchlc.scene.timestamps import instant

MOMENT = datetime.datetime(2020, 11, 25, 19, 2, 4)
FORMS = [
    "%Y-%m-%d %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%Y.%m.%dT%H:%M:%S", "%d.%m.%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S",
    "%d-%m-%Y %H:%M:%S", "%m-%d-%Y %I:%M:%S %p", "%d-%b-%Y %H:%M:%S", "%d %B %Y %H:%M:%S", "%Y-%b-%d %H:%M:%S", "%Y %b %d %I:%M:%S%p",
    "%b/%d/%Y %H:%M:%S", "%Y%m%dT%H%M%S", "%Y-%jT%H:%M:%S", "%Y:%j:%H:%M:%S", "%d/%m/%Y, %H:%M:%S",
]  # fmt: skip
"""As strftime writes them; the 25th can be no month."""


@pytest.mark.parametrize("form", FORMS)
def test_forms_of_one_moment(form: str):
    text = MOMENT.strftime(form)
    assert datetime.datetime.fromisoformat(Calendar("").iso([text])[0]) == MOMENT
    assert is_moment(text)


@pytest.mark.parametrize("hour", range(24))
def test_the_twelve_hours_of_each_half_of_the_day(hour: int):
    moment = MOMENT.replace(hour=hour)
    for text in (
        moment.strftime("%Y-%m-%d %I:%M:%S %p"),
        moment.strftime("%Y-%m-%d %I:%M:%S %p").replace(" 0", " "),
    ):
        assert datetime.datetime.fromisoformat(Calendar("").iso([text])[0]) == moment


@given(st.floats(0, 0.999999))
def test_a_share_of_a_day(share: float):
    text = f"{share:.6f}"[1:]
    expected = Time("2020-11-10", scale="tai") + float(text) * u.day
    found = Time(Calendar("").iso([f"2020 11 10{text}"])[0], scale="tai")
    assert abs((found - expected).to_value(u.s)) < 2e-6  # written to the microsecond


@pytest.mark.parametrize("text", ["2020-000", "2021-366", "0000-001", "9999-366", "2020-367"])
def test_a_day_that_a_year_has_not_is_refused(read, text: str):
    with pytest.raises(InputError, match=r"row 1, column time: .*a day of the year from 1 to 36[56]"):
        read(f"time,mag\n{text}T01:00:00,5.0\n{text}T02:00:00,5.0\n")


class TestOrder:
    """10/11/2020 is no date until somebody tells, or another row does."""

    BOTH = "time,mag\n10/11/2020 19:12:00,5.1\n10/11/2020 19:12:20,5.2\n"

    def test_it_is_asked_and_the_answers_work(self, read):
        with pytest.raises(InputError, match='date_order=day-first", or columns="date_order=month-first"'):
            read(self.BOTH)
        for order, month in (("day-first", 11), ("month-first", 10)):
            found = read(self.BOTH, columns=f"date_order={order}")
            assert found.time[0].isot == f"2020-{month}-{21 - month}T19:12:00.000"
            assert any(f"dates are read {order}" in one for one in found.warnings)

    def test_another_row_tells(self, read):
        found = read(self.BOTH + "9/25/2020 19:12:00,5.3\n")
        assert found.time.isot.tolist() == [
            f"2020-{day}.000" for day in ("09-25T19:12:00", "10-11T19:12:00", "10-11T19:12:20")
        ]
        assert any("month-first: 9/25/2020" in one for one in found.warnings)

    def test_rows_that_contradict_are_refused(self, read):
        with pytest.raises(InputError, match=r"row 3, column time: '13/10/2020.*month from 1 to 12"):
            read("time,mag\n10/11/2020 1:00,5.1\n10/25/2020 1:00,5.1\n13/10/2020 1:00,5.1\n")

    def test_one_reading_only_needs_no_order(self, read):
        found = read("time,mag\n11/11/2020 19:12:00,5.1\n11/11/2020 19:13:00,5.2\n")
        assert found.time[0].isot == "2020-11-11T19:12:00.000"

    @given(
        st.lists(
            st.dates(datetime.date(1999, 1, 1), datetime.date(2030, 1, 1)),
            min_size=40,
            max_size=60,
            unique=True,
        )
    )
    def test_many_dates(self, dates: list[datetime.date]):
        if all(date.day <= 12 for date in dates):
            return
        random.Random(1).shuffle(dates)
        texts = [f"{date.month}/{date.day}/{date.year} 01:02:03" for date in dates]
        assert Calendar("").iso(texts) == [f"{date.isoformat()}T01:02:03" for date in dates]


class TestCounts:
    """Seconds since an instant."""

    MOMENTS = Time(["2020-11-10T19:12:00.250", "2020-11-10T19:12:00.500"], scale="utc")

    @pytest.mark.parametrize("name", ["unix", "gps"])
    def test_those_of_astropy(self, read, name: str):
        numbers = getattr(self.MOMENTS, name)
        rows = "".join(f"{number:.3f},5.1\n" for number in numbers)
        for text, options in ((f"{name}_time,mag\n", {}), ("time,mag\n", {"columns": f"time_format={name}"})):
            found = read(text + rows, **options)
            assert (
                np.abs((found.time - self.MOMENTS).to_value(u.s)).max() < 1e-6
            )  # 1.6e9 s in a double: 0.24 us

    def test_milliseconds(self, read):
        rows = "".join(f"{1000 * number:.0f},5.1\n" for number in self.MOMENTS.unix)
        with pytest.raises(InputError, match='columns="time_format=unix-ms"'):
            read("timestamp,mag\n" + rows)
        found = read("timestamp,mag\n" + rows, columns="time_format=unix-ms")
        assert np.abs((found.time - self.MOMENTS).to_value(u.s)).max() < 1e-6

    @pytest.mark.parametrize(
        ("unit", "step"), [("seconds", 1.0), ("minutes", 60.0), ("hours", 3600.0), ("days", 86400.0)]
    )
    def test_since_a_start(self, read, unit: str, step: float):
        text = "elapsed_s,mag\n0.0,5.1\n0.5,5.2\n"
        found = read(text, columns=f"time=elapsed_s,time_format={unit} since 2020-11-10T19:12:00.25")
        assert np.abs((found.time - self.MOMENTS[0]).to_value(u.s) - [0.0, 0.5 * step]).max() < 1e-6

    def test_a_number_that_may_be_either_is_asked_for(self, read):
        with pytest.raises(InputError, match='columns="time_format=unix"; or time_format=gps'):
            read("time,mag\n1605035520.5,5.1\n1605035521.5,5.1\n")

    def test_another_scale_beside_is_refused(self, read):
        with pytest.raises(InputError, match="beside the time format gps"):
            read("time,mag\n1289070738,5.1\n1289070739,5.1\n", columns="time_format=gps,time_scale=utc")


@pytest.mark.parametrize(("name", "number", "jd"), [
    ("JD-2450000", 9164.3, 2459164.3), ("JD - 2,459,000", 164.3, 2459164.3), ("Time (MJD)", 59163.8, 2459164.3),
    ("Time [JD-2400000.5]", 59163.8, 2459164.3), ("J.D. - 2450000.5", 9163.8, 2459164.3), ("date (JD)", 2459164.3, 2459164.3),
])  # fmt: skip
def test_names_that_say_from_where_days_count(read, name: str, number: float, jd: float):
    text = f'"{name}",mag\n{number},5.1\n{number + 0.1},5.2\n'
    found = read(text)
    assert np.abs((found.time - Time([jd, jd + 0.1], format="jd", scale="utc")).to_value(u.s)).max() < 1e-4


@pytest.mark.parametrize(("name", "zero", "scale"), [
    ("BTJD", 2457000.0, "tdb"), ("BKJD", 2454833.0, "tdb"), ("HJD-2450000", 2450000.0, "utc"), ("BJD_TDB - 2457000 (days)", 2457000.0, "tdb"),
    ("Time (BJD_TDB-2450000)", 2450000.0, "tdb"),
])  # fmt: skip
def test_days_at_the_sun_are_refused_until_that_can_be_taken_back(read, name: str, zero: float, scale: str):
    text = f"{name},mag\n{2459164.3 - zero:.4f},5.1\n{2459164.4 - zero:.4f},5.2\n"
    with pytest.raises(InputError, match="times at the observer"):
        read(text)
    taken = read(text, columns="light_path=observer")
    assert (
        np.abs((taken.time - Time([2459164.3, 2459164.4], format="jd", scale=scale)).to_value(u.s)).max()
        < 1e-3
    )
    moved = read(text, columns='direction="120.5 -3.2"')
    assert 1.0 < abs((moved.time[0] - taken.time[0]).to_value(u.s)) < 499.1  # at most the way from the Sun


@pytest.mark.parametrize("name", ["time" + " " * 60_000 + "x", "time " + "(a)" * 20_000, "(" * 60_000])
def test_a_long_name_is_read_at_once(read, name: str):
    """A pattern that looks for brackets at the end from every blank takes a minute."""
    start = time.process_time()
    with pytest.raises(InputError):
        read(f"{name},mag\n1,2\n")
    assert time.process_time() - start < 3.0


@pytest.mark.parametrize("scale", ["utc", "tt", "tdb"])
def test_an_epoch_that_ends_in_z_is_utc_beside_any_scale(scale: str) -> None:
    """Against astropy's scales: without the Z it is 69 s off beside TT and TDB."""
    wanted = Time("2026-01-01T00:00:00", scale="utc")
    assert abs((instant("2026-01-01T00:00:00Z", scale) - wanted).sec) < 1e-6
    plain = instant("2026-01-01T00:00:00", scale)
    assert (wanted - plain).sec == pytest.approx(0.0 if scale == "utc" else 69.184, abs=0.01)
