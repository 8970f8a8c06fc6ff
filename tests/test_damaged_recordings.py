"""Recordings that went wrong on their way, and numbers that stand for none: read in part, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.good_input import (
    ALTAZ_RECORDING,
    ALTAZ_SCENE,
    ECSV,
    ECSV_VECTORS,
    RECORDING,
    SCENE,
    VECTOR_RECORDING,
    VECTOR_SCENE,
)
from tests.test_recording import SHARED, pieces
from torchlc.errors import InputError
from torchlc.readers import load_recording

CASES = SHARED / "cases"
RIGHT = {
    "alc/ucor_none.txt": [13.0, 13.1, 13.2],
    "alc/magadjust.txt": [13.5, 13.6, 13.7],
    "alc/latin1.txt": [13.0, 13.1, 13.2],
    "alc/ucor_blank.txt": [1.0, 10**-0.04, 10**-0.08],
    "alc/damit_extra.txt": "after the last point",
    "rec/mask_min.ecsv": [10.0, 10.2],
    "rec/fluxpct.ecsv": "column flux_err: unit %",
    "rec/e_start.ecsv": "start of the exposures",
    "rec/e_hjd.ecsv": "HJD",
    "rec/e_jd1jd2.ecsv": [10.0, 10.01, 10.02, 10.03, 10.04, 10.05],
    "observer/night_jdred.csv": "time_format: jd-2400000",
}
"""What each file holds, in magnitudes or relative flux, or why it is refused."""


@pytest.mark.skipif(not CASES.is_dir(), reason="../shared/cases is not there")
@pytest.mark.parametrize("name", RIGHT)
def test_files_that_went_wrong(name: str):
    right = RIGHT[name]
    if isinstance(right, str):
        with pytest.raises(InputError) as caught:
            load_recording(CASES / name)
        assert right in str(caught.value)
    else:
        np.testing.assert_allclose(load_recording(CASES / name).observed, right, rtol=1e-12)


@pytest.mark.skipif(not CASES.is_dir(), reason="../shared/cases is not there")
def test_a_night_with_a_marker_loses_that_row_only():
    recording = load_recording(CASES / "observer" / "night_badrow.csv")
    assert recording.dropped == {"beyond 90 mag": 1}


GOOD_FILES = [
    (RECORDING, SCENE),
    (VECTOR_RECORDING, VECTOR_SCENE),
    (ALTAZ_RECORDING, ALTAZ_SCENE),
    (ECSV, SCENE),
    (ECSV_VECTORS, None),
]


@given(
    good=st.sampled_from(GOOD_FILES),
    cuts=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12), pieces), max_size=4),
    with_scene=st.booleans(),
    use=st.sampled_from([None, "mag", "flux"]),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_damaged_files_give_a_recording_or_an_input_error(
    read, good, cuts, with_scene: bool, use: str | None
):
    content = good[0].encode()
    for place, length, new in cuts:
        start = int(place * len(content))
        content = content[:start] + new + content[start + length :]
    try:
        recording = read(content, good[1] if with_scene else None, use=use)
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 800
    else:
        assert np.isfinite(recording.observed).all() and np.isfinite(recording.seconds).all()
        assert recording.error is None or (recording.error > 0).all()
        assert (np.diff(recording.seconds) >= 0).all()


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ("0.000", "row 4, column mag: 0 mag is 10.1 mag from all others: if"),
        ("0 10.4 0", "row 4, column mag: 0 mag is 10.1 mag from all others, and so is 1 more row: if"),
        ("88.8", "88.8 mag is 78.5 mag from all others"),
        ("50", "50 mag is 39.7 mag from all others"),
        ("-9.99", "-9.99 mag is 20.1 mag from all others"),
        ("4.37", None),  # a glint
        ("6.66", None),  # 3.4 mag from the others
        ("10.10", None),
    ],
)
def test_numbers_that_stand_for_none_are_told_of(read, values: str, said: str | None):
    rows = [f"2020-10-17T15:{minute:02d}:00,{mag},0.02" for minute, mag in
            enumerate(["10.10", "10.23", "10.31", *values.split(), "10.27"])]  # fmt: skip
    recording = read("\n".join(["time,mag,mag_err", *rows]))
    assert len(recording) == len(rows) and recording.dropped == {}
    assert bool(recording.warnings) == (said is not None)
    if said is not None:
        assert said in recording.warnings[0]


def test_whole_magnitudes_of_a_visual_observer_are_no_markers(read):
    rows = [f"2020-10-17T15:{minute:02d}:00,{mag}" for minute, mag in enumerate([0, 3, 8, 0, 7, 12, 5])]
    assert read("\n".join(["time,mag", *rows])).warnings == ()


@pytest.mark.parametrize("told", ["curve", "station", "band"])
def test_what_is_usual_is_that_of_a_row_s_own_curve(read, told: str):
    """One curve in counts, one in W/m2: an upper limit without an error takes the median of its own curve's, and an error of
    1e-14 beside fluxes of 3e-13 is none that stands for nothing."""
    lines = [f"time,flux,flux_err,upper_limit,{told}"]
    for minute in range(5):
        limit = minute == 4
        for name, unit in (("a", 1.0), ("b", 1e-13)):
            error = "" if limit else f"{(0.1 + 0.05 * minute) * unit:.6g}"
            cells = (
                f"2020-10-17T15:{minute:02d}:00",
                f"{(3 + minute) * unit:.6g}",
                error,
                str(limit).lower(),
                name,
            )
            lines.append(",".join(cells))
    recording = read("\n".join(lines))
    assert recording.upper_limit.sum() == 2 and len(recording) == 10
    ids = recording.curve_ids
    for curve, unit in ((0, 1.0), (1, 1e-13)):
        assert ids[curve].endswith("ab"[curve])
        (error,) = recording.error[recording.upper_limit & (recording.curve == curve)]
        assert error == pytest.approx(np.median(0.1 + 0.05 * np.arange(4)) * unit, rel=1e-9)


def test_a_wild_row_does_not_hide_numbers_that_stand_for_none(read):
    """A camera that saturates wrote 0 in many rows, and 0.483 in one that it did read."""
    magnitudes = [10 + 0.001 * row for row in range(120)]
    magnitudes[40:50] = [0.0] * 10
    magnitudes[50] = 0.483
    rows = [
        f"2020-10-17T{15 + row // 60}:{row % 60:02d}:00,{mag:.3f},0.02" for row, mag in enumerate(magnitudes)
    ]
    recording = read("\n".join(["time,mag,mag_err", *rows]))
    assert len(recording) == 120 and recording.dropped == {}
    said = "row 41, column mag: 0 mag is 10.0 mag from nearly all others, and so are 9 more rows: if"
    assert [said in warning for warning in recording.warnings] == [True]
