"""Slots in which a camera found nothing become upper limits: against the measurements that a known threshold hid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.good_input import SCENE
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording
from torchlc.scene import Scene

TUMBLING = Path(__file__).parents[2] / "shared" / "data" / "tumbling"
START = np.datetime64("2021-01-02T15:29:22.895")
SLOT = 0.1
"""The rows of Mini-MegaTORTORA are ten a second."""


def track(mag: np.ndarray, seen: np.ndarray, channel: str = "5", start: float = 0.0) -> str:
    """Rows of the slots that were ``seen``, stamped with a millisecond of scatter, as published times have."""
    jitter = np.random.default_rng(4).integers(-1, 2, len(mag))
    rows = []
    for k in np.flatnonzero(seen):
        time = START + np.timedelta64(round(1000 * (start + k * SLOT)) + int(jitter[k]), "ms")
        date, clock = str(time).split("T")
        rows.append(f"{date} {clock} 6.000 {mag[k]:.5f} Clear 0.0 609.5 48.0 {channel}")
    return "\n".join(rows) + "\n"


def file(tmp_path: Path, *tracks: str) -> Path:
    path = tmp_path / "track.txt"
    path.write_text(
        "# satellite: 1 X\n# Date Time StdMag Mag Filter Penumbra Distance Phase Channel\n" + "".join(tracks)
    )
    return path


def tumbling(
    threshold: float, noise: float, period: float = 7.3, seed: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """What a camera would measure of a tumbling body in 60 s, and what of it is brighter than the threshold."""
    rng = np.random.default_rng(seed)
    seconds = SLOT * np.arange(600)
    mag = 8.5 + 1.5 * np.sin(2 * np.pi * seconds / period) + noise * rng.normal(size=600)
    seen = mag < threshold
    seen[[0, -1]] = True  # only what lies between the first and the last row is known to be in the frame
    return mag, seen


@pytest.mark.parametrize(("threshold", "noise"), [(9.0, 0.05), (9.3, 0.3), (8.2, 0.2)])
def test_the_limit_is_the_threshold_and_the_hidden_measurements_keep_it(tmp_path, threshold, noise):
    mag, seen = tumbling(threshold, noise)
    found = load_recording(file(tmp_path, track(mag, seen)))
    limit = found.upper_limit
    assert limit.sum() == (~seen).sum() and len(found) == 600
    # slots stand where the camera's were: the scatter of stamps is 1 ms, which the neighbours share
    np.testing.assert_allclose(found.seconds[limit], SLOT * np.flatnonzero(~seen), atol=2.5e-3)
    (value,) = np.unique(found.observed[limit])
    # a twentieth of the rows is fainter than it, which are spread over what a twentieth of the slots passes through
    assert threshold - 0.35 < value < threshold
    assert (mag[~seen] > value).all()
    assert f"{(~seen).sum()} of 0.1 s in channel 5 at {value:.6g} mag" in found.warnings[-1]


def test_without_a_switch_nothing_else_changes_and_with_it_nothing_is_added(tmp_path):
    mag, seen = tumbling(9.0, 0.1)
    path = file(tmp_path, track(mag, seen))
    every = load_recording(path)
    off = load_recording(path, columns="non_detections=false")
    scene = Scene.from_toml(SCENE + "\n[recording]\nnon_detections = false\n")
    assert len(load_recording(path, scene)) == len(off) == seen.sum() and not off.upper_limit.any()
    np.testing.assert_array_equal(every.observed[~every.upper_limit], off.observed)
    np.testing.assert_array_equal(every.seconds[~every.upper_limit], off.seconds)


def test_gaps_longer_than_the_bound_are_left(tmp_path):
    """A turn of 40 s hides 20 s and is faint on its way there; a tracker may have lost the object meanwhile."""
    mag, seen = tumbling(8.5, 0.01, period=40.0)
    path = file(tmp_path, track(mag, seen))
    assert not load_recording(path).upper_limit.any()
    whole = load_recording(path, columns="longest_gap=21")
    assert whole.upper_limit.sum() == (~seen).sum()


def test_lost_frames_of_a_bright_object_are_no_limits(tmp_path):
    rng = np.random.default_rng(2)
    mag = 6.0 + 0.3 * np.sin(np.arange(600) / 30) + 0.05 * rng.normal(size=600)
    seen = rng.random(600) > 0.03
    seen[200:206] = False  # cameras lose runs of six
    found = load_recording(file(tmp_path, track(mag, seen)))
    assert not found.upper_limit.any()
    assert "taken as lost frames: " in found.warnings[-1]


def test_few_non_detections_in_the_faint_part_of_a_slow_turn(tmp_path):
    """7 % of the slots are empty, all of them where the object is faint."""
    mag, seen = tumbling(9.96, 0.02)
    assert 0.03 < (~seen).mean() < 0.1
    assert load_recording(file(tmp_path, track(mag, seen))).upper_limit.sum() == (~seen).sum()


def test_what_another_camera_saw_is_no_empty_slot(tmp_path):
    mag, seen = tumbling(8.5, 0.1)
    other = ~seen & (np.arange(600) < 300)
    found = load_recording(file(tmp_path, track(mag, seen), track(mag, other, channel="6")))
    first = found.curve == found.curve_ids.index("channel 5")
    times = found.seconds[first & found.upper_limit]
    hidden = np.flatnonzero(~seen & ~other)
    np.testing.assert_allclose(times, SLOT * hidden, atol=2.5e-3)


def test_a_row_that_is_dropped_was_there(tmp_path):
    mag, seen = tumbling(8.5, 0.1)
    spoiled = mag.copy()
    spoiled[np.flatnonzero(seen)[40:60]] = 99.0
    found = load_recording(file(tmp_path, track(spoiled, seen)))
    assert found.dropped == {"beyond 90 mag": 20}
    assert found.upper_limit.sum() == (~seen).sum()


def test_any_recording_and_its_geometry(tmp_path):
    """Vectors of a low circular orbit between rows: off by the sagitta of the longest gap, v^2/r gap^2/8."""
    mag, seen = tumbling(8.5, 0.1)
    seconds = SLOT * np.arange(600)
    angle = seconds * 7.6 / 6900
    position = 6900 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    names = [f"{p}_{axis}" for p in ("sun", "obs") for axis in "xyz"]
    lines = ["time,mag,mag_err," + ",".join(names)]
    for k in np.flatnonzero(seen):
        cells = [*(1.5e8, 0.0, 0.0), *(position[k] - [6378.0, 0.0, 0.0])]
        time = START + np.timedelta64(int(100 * k), "ms")
        lines.append(f"{time},{mag[k]:.5f},0.1," + ",".join(f"{cell:.6f}" for cell in cells))
    path = tmp_path / "rows.csv"
    path.write_text("\n".join(lines))
    assert len(load_recording(path)) == seen.sum()
    found = load_recording(path, columns="non_detections=true")
    assert len(found) == 600 and found.obs is not None and found.error is not None
    np.testing.assert_allclose(found.error, 0.1)
    longest = np.diff(np.flatnonzero(seen)).max() * SLOT
    sagitta = 7.6**2 / 6900 * longest**2 / 8
    away = np.linalg.norm(found.obs - (position - [6378.0, 0.0, 0.0]), axis=-1)
    assert 0.5 * sagitta < away.max() < 1.01 * sagitta + 1e-5


def test_directions_between_rows_pass_through_north(tmp_path):
    az = (358.0 + 0.02 * np.arange(300)) % 360.0
    seen = np.arange(300) % 7 < 4
    stamps = [START + np.timedelta64(100 * k, "ms") for k in range(300)]
    lines = [f"{stamps[k]},9.0,0.1,40.0,{az[k]:.4f},800.0" for k in np.flatnonzero(seen)]
    path = tmp_path / "rows.csv"
    path.write_text("\n".join(["time,mag,mag_err,alt,az,height", *lines]))
    found = load_recording(path, columns="non_detections=true")
    assert found.az is not None and found.alt is not None
    off = (found.az - az[: len(found)] + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(off, 0.0, atol=1e-6)  # chord against arc: (gap 0.08 deg)^3 at most
    np.testing.assert_allclose(found.alt, 40.0, atol=1e-4)


def test_limits_take_the_bias_of_what_is_seen_away(tmp_path):
    """A ball of constant brightness at the threshold, noise 0.4 mag: the mean of what is seen is 0.32 mag
    (0.4 sqrt(2/pi)) too bright."""
    rng = np.random.default_rng(6)
    ball = Scene.from_toml(
        'format = "torchlc-scene/1"\nname = "ball"\n[orbit]\nvectors = "icrs"\n[attitude]\nmode = "inertial"\n'
        '[[components]]\nname = "ball"\nshape = "sphere"\nradius = 1.0\ncentre = [0, 0, 0]\nmaterial = "white"\n'
        '[materials.white]\nmodel = "lambert"\nalbedo = 0.5\n[model]\neffects = []\n[model.parameters]\n'
        "band_sun_magnitude = -26.7\nzero_point = { value = 0.0, low = -5.0, high = 5.0 }\n"
    )
    names = [f"{p}_{axis}" for p in ("sun", "obs") for axis in "xyz"]

    def recording(mag: np.ndarray, seen: np.ndarray, **options):
        lines = ["time,mag,mag_err," + ",".join(names)]
        for k in np.flatnonzero(seen):
            time = START + np.timedelta64(int(100 * k), "ms")
            lines.append(f"{time},{mag[k]:.5f},0.4,1.5e8,0,0,800,600,0")
        path = tmp_path / "ball.csv"
        path.write_text("\n".join(lines))
        return load_recording(path, ball, **options)

    model = LightCurve(ball, recording(np.full(2, 5.0), np.ones(2, dtype=bool)), effects=[])
    level = model.magnitude(model.brightness())[0].item()
    mag = level + 0.4 * rng.normal(size=600)
    seen = mag < level
    biased, limited = (recording(mag, seen, columns=f"non_detections={use}") for use in ("false", "true"))
    offset = torch.linspace(-1.0, 1.0, 401, dtype=torch.float64)[:, None]
    best = [
        float(offset[Likelihood(LightCurve(ball, one, effects=[])).log_likelihood(offset).argmax()])
        for one in (biased, limited)
    ]
    # 600 rows of which half are limits: sd 0.02; the limit lies 0.04 mag inside the threshold
    assert best[0] == pytest.approx(-0.32, abs=0.06)
    assert best[1] == pytest.approx(0.0, abs=0.06)


@pytest.mark.skipif(not TUMBLING.is_dir(), reason="needs ../shared/data/tumbling")
@pytest.mark.parametrize(
    ("name", "filled"),
    [("10025_10419535", 0.55), ("1863_10198570", 0.39), ("1863_32164168", 0.69), ("40209_25396882", 0.38)],
)
def test_real_tracks_are_filled_as_their_description_says(name, filled):
    """38 to 69 % of the slots in which the object was in the frame are filled; by track counted by hand."""
    found = load_recording(TUMBLING / f"track_{name}.txt")
    assert (~found.upper_limit).mean() == pytest.approx(filled, abs=0.01)
    limit = found.observed[found.upper_limit]
    seen = found.observed[~found.upper_limit]
    assert np.ptp(limit) == 0 and np.quantile(seen, 0.9) < limit[0] < seen.max()
