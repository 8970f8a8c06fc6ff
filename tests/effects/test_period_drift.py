"""A period that grows steadily: the angle is the integral of one over the period."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from tests.effects.cases import unit
from tests.effects.turning import INERTIAL, PERIOD_S, SPIN_POLE, rotations, turning
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording, load_recording

COLUMNS = ",".join(["time,mag,mag_err", *(f"{who}_{axis}" for who in ("sun", "obs") for axis in "xyz")])
SCENE = turning(SPIN_POLE)


def at(folder: Path, times: Sequence[str]) -> Recording:
    path = folder / "rows.csv"
    path.write_text("\n".join([COLUMNS, *(f"{time},10,0.1,1.5e8,0,0,0,1000,300" for time in times)]))
    return load_recording(path, SCENE)


def _two_nights() -> Recording:
    start = np.datetime64("2021-03-20T12:00:00")
    with TemporaryDirectory() as folder:
        return at(Path(folder), [str(start + np.timedelta64(k + 86000 * (k > 11), "s")) for k in range(24)])


RECORDING = _two_nights()
"""In minutes no rate shows: other effects are held against a single pass."""


@pytest.mark.parametrize(("attitude", "axis"), [(SPIN_POLE, [0, 0, 1.0]), (INERTIAL, [0.3, 0.8, 0.5])])
@pytest.mark.parametrize("per_day", [-900.0, 500.0])
def test_the_turn_is_the_integral_of_the_rate(tmp_path, attitude, axis, per_day):
    """Over a day and a half, in which the period changes by up to 1.35 s of 20."""
    scene = turning(attitude)
    times = ["2021-03-20T12:00:00", "2021-03-20T12:07:00", "2021-03-21T03:00:00", "2021-03-22T00:00:00"]
    recording = at(tmp_path, times)
    steady = rotations(scene, recording)
    found = rotations(scene, recording, "period_drift", period_drift__ms_per_day=per_day)
    turned = Rotation.from_matrix(np.swapaxes(steady, 1, 2) @ found)
    rate = per_day * 1e-3 / 86400
    for k, seconds in enumerate(recording.seconds):
        turns = quad(lambda t: 1 / (PERIOD_S + rate * t) - 1 / PERIOD_S, 0, seconds, epsabs=1e-13)[0]
        expected = Rotation.from_rotvec(2 * np.pi * (turns % 1) * unit(axis))
        # light time, 3 ms at 1000 km, moves what the epoch is: by 3 ms of the change of rate, at most 5e-5 turns
        assert (turned[k] * expected.inv()).magnitude() < 2 * np.pi * 5e-5


def test_it_adds_to_the_rate_of_the_scene():
    drifting = turning(SPIN_POLE + "period_rate = 300.0\n")
    np.testing.assert_allclose(
        rotations(drifting, RECORDING, "period_drift", period_drift__ms_per_day=-300.0),
        rotations(SCENE, RECORDING),
        atol=1e-9,  # 2e-16 of 4300 turns
    )


def test_a_single_pass_shows_no_rate(tmp_path):
    context = LightCurve(
        SCENE, at(tmp_path, ["2021-03-20T12:00:00", "2021-03-20T12:01:00"]), effects=[]
    ).assembly.context
    reason = registry()["period_drift"]().missing(context)
    assert reason == "10 ms a day change the turn by less than 0.001 in this recording"
