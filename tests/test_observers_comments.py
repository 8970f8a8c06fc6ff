"""Comments above the header of a CSV: what they say of the times and of the file."""

from __future__ import annotations

import re

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from torchlc.errors import InputError
from torchlc.readers import Recording

FIRST = "2026-03-15T20:50:00"
ROWS = f"time,mag,mag_err\n{FIRST},14.9,0.02\n2026-03-15T20:52:00,14.8,0.02\n"


def moved_s(recording: Recording) -> float:
    """Seconds from the time that stands in the file, as UTC, to the one that was read."""
    return float((recording.time[0] - Time(FIRST, scale="utc")).to_value(u.s))


@pytest.mark.parametrize(
    ("comment", "moved"),
    [
        ("# time_zone: Europe/Vienna", -3600.0),
        ("# time_zone = +02:00", -7200.0),
        ("# time_mark: start\n# exptime: 30", 15.0),
        ("# time_mark = end\n# exptime = 30 s", -15.0),
        ("# TIMESYS = TAI", -37.0),
        ("# TIMESYS: TDB", -69.184),
        ("# DATE-OBS: start of exposure\n# exptime: 30", 15.0),
    ],
)
def test_what_a_comment_says_of_the_times_is_done_and_told(read, comment: str, moved: float):
    """37 leap seconds since 2017; TT is 32.184 s before TAI, and TDB within 2 ms of TT."""
    recording = read(f"{comment}\n{ROWS}")
    assert moved_s(recording) == pytest.approx(moved, abs=0.003)
    told = " ".join(recording.warnings)
    assert all(value in told for value in re.findall(r"[:=] (\S+)", comment))


def test_exposures_and_the_decimal_sign_of_a_comment(read):
    recording = read(f"# exptime: 30\n{ROWS}")
    assert recording.exptime is not None and recording.exptime.tolist() == [30.0, 30.0]
    recording = read("# decimal: comma\n" + ROWS.replace(",", ";").replace(".", ","))
    assert recording.observed.tolist() == [14.9, 14.8]


def test_the_user_counts_before_a_comment(read):
    assert moved_s(read(f"# time_zone: Europe/Vienna\n{ROWS}", columns="time_zone=+03:00")) == -10800.0
    assert moved_s(read(f"# time_zone: anywhere\n{ROWS}", columns="time_zone=+03:00")) == -10800.0
    assert moved_s(read(f"# TIMESYS: TAI\n{ROWS}", columns="time_scale=utc")) == 0.0


@pytest.mark.parametrize(
    ("comment", "message"),
    [
        ("# time_zone: anywhere", r"comment time_zone: 'anywhere'; expected an offset such as"),
        ("# exptime: long", r"comment exptime: 'long'; expected a number of seconds"),
        ("# time_mark: beginning", r"comment time_mark: 'beginning'; expected"),
        ("# time_mark: start", "the start of the exposures"),
        ("# time system: GPS", "metadata time system: 'GPS'"),
        ("# timezone: Europe/Vienna", "metadata timezone: 'Europe/Vienna'"),
        ("# Time zone = +01:00", r"metadata Time zone: '\+01:00'"),
        ("# Zeit: MEZ", "local time"),
        ("# Times: local time", "local time"),
    ],
)
def test_what_cannot_be_taken_is_refused_and_the_advice_works(read, comment: str, message: str):
    with pytest.raises(InputError, match=message) as caught:
        read(f"{comment}\n{ROWS}")
    option = re.findall(r'columns="(\w+=[^\s,;"]+)"', str(caught.value))[0]
    typed = {
        "time_zone=...": "time_zone=+01:00",
        "exptime=...": "exptime=30",
        "time_mark=...": "time_mark=middle",
        "exptime=SECONDS": "exptime=30",
    }
    assert len(read(f"{comment}\n{ROWS}", columns=typed.get(option, option))) == 2


@pytest.mark.parametrize(
    ("comment", "option"),
    [
        ("# Times are local (UTC+1)", "time_zone=+02:00"),
        ("# UT+1", "time_zone=+02:00"),
        ("# Alle Zeiten in MEZ", "time_zone=+02:00"),
        ("# DATE-OBS is start", "time_mark=start"),
        ("# exposure start", "time_mark=start"),
        ("# times are TDB", "time_scale=tdb"),
        ("# times are on the clock of GPS", "time_scale=gps"),
        ("# heliocentric corrected", "light_path=heliocentric"),
    ],
)
def test_another_remark_on_the_times_is_said_with_the_option_that_settles_it(read, comment: str, option: str):
    recording = read(f"{comment}\n{ROWS}")
    (told,) = [text for text in recording.warnings if "a comment says" in text]
    assert f'columns="{option}"' in told and moved_s(recording) == 0.0
    settled = {"time_zone": "+00:00", "time_mark": "middle", "time_scale": "utc", "light_path": "observer"}
    key = option.partition("=")[0]
    assert "a comment says" not in " ".join(
        read(f"{comment}\n{ROWS}", columns=f"{key}={settled[key]}").warnings
    )


@pytest.mark.parametrize(
    "comment",
    ["# Observer: A. B.", "# Object: SAT 1", "# Date: 2026-03-15", "# Exposure: 10 s", "# object: FOO", "# all times UTC", "# see http://example.org/time"],
)  # fmt: skip
def test_a_remark_on_other_things_changes_nothing(read, comment: str):
    plain, recording = read(ROWS), read(f"{comment}\n{ROWS}")
    assert recording.warnings == plain.warnings
    np.testing.assert_array_equal(recording.time.jd, plain.time.jd)
