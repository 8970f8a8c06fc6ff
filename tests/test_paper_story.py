"""The size of occlusion at Object 1's peak, as the example measures it with the brute-force reference, against torchlc's own
closed form of the shadow."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from astropy.time import Time, TimeDelta

import torchlc

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "calibration"))

from paper_story import PEAK, night
from setting import TABLE_3, object_1


def test_occlusion_is_even_over_the_peak() -> None:
    """Wings at the wall take 0.023 mag or so, the same all over the peak; 1.59 m off it they take nothing. The reference
    draws 4096 rays a row against each part: 1e-3 mag."""
    from gain import truth_of

    setup = night(gap=0.0)
    some = slice(None, None, 10)
    changed = truth_of(setup, {"self_shadowing": {}}, seed=1)[1] - truth_of(setup, {}, seed=1)[1]
    stamps = Time("2000-01-01T00:00:00", scale="utc") + TimeDelta(setup.t[some], format="sec")
    rows = {"time": stamps.isot, "mag": np.zeros(len(stamps)), "mag_err": np.full(len(stamps), 0.02)}

    def curve(gap: float, effects: str) -> np.ndarray:
        scene = object_1(TABLE_3[1], gap=gap, effects=effects)
        return np.asarray(torchlc.simulate(scene, rows).mag)

    expected = curve(0.0, "['self_shadowing']") - curve(0.0, "[]")
    np.testing.assert_allclose(changed[some], expected, atol=1e-3)
    peak = (stamps > Time(PEAK[0])) & (stamps < Time(PEAK[1]))
    assert peak.sum() >= 3
    assert expected[peak].min() > 0.02 and np.ptp(expected[peak]) < 1e-3
    np.testing.assert_allclose(curve(1.59, "['self_shadowing']"), curve(1.59, "[]"), atol=1e-9)
