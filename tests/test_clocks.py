"""Clocks of several observers: most are right, and some are far off."""

from __future__ import annotations

import numpy as np
import pytest

import torchlc
from torchlc.diagnosis.run import diagnose

SIDES = np.array([3.0, 1.6, 1.0])
TURN_H, ROWS, NOISE = 9.0, 30, 0.01
START = np.datetime64("2021-05-03T00:00:00.000")
LATE_S = {"A": 0.0, "B": 0.0, "C": 2400.0, "D": 0.0}
SUN, CAMERA = np.array([1.0, 0.2, 0.3]), np.array([0.5, 0.9, -0.2])
ALBEDO = 0.3


def brick(seconds: np.ndarray) -> np.ndarray:
    """Light of a Lambert brick that turns about its third axis, in closed form: albedo / pi times area and both cosines of each face."""
    sun, camera = SUN / np.linalg.norm(SUN), CAMERA / np.linalg.norm(CAMERA)
    turn = 2 * np.pi * seconds / (3600 * TURN_H)
    light = np.zeros(len(seconds))
    for axis in range(3):
        for sign in (1.0, -1.0):
            area = np.prod(np.delete(SIDES, axis))
            normal = sign * np.eye(3)[axis]
            x, y = (
                normal[0] * np.cos(turn) - normal[1] * np.sin(turn),
                normal[0] * np.sin(turn) + normal[1] * np.cos(turn),
            )
            turned = np.stack([x, y, np.full(len(turn), normal[2])], 1)
            light += ALBEDO / np.pi * area * (turned @ sun).clip(0) * (turned @ camera).clip(0)
    return light


@pytest.fixture
def observers(tmp_path) -> tuple[torchlc.Scene, torchlc.Recording]:
    """Four curves, of which the third has stamps that are 40 min early."""
    rng = np.random.default_rng(7)
    lines = ["time,flux,flux_err,curve,sun_x,sun_y,sun_z,obs_x,obs_y,obs_z"]
    places = ",".join(
        f"{one:.9f}"
        for one in (*(1.5e8 * SUN / np.linalg.norm(SUN)), *(4e7 * CAMERA / np.linalg.norm(CAMERA)))
    )
    for number, (curve, late) in enumerate(LATE_S.items()):
        seconds = 3600 * (30.0 * number + np.linspace(0, 7, ROWS))
        light = brick(seconds + late)
        flux = light / light.mean() + NOISE * rng.normal(size=ROWS)
        for second, value in zip(seconds, flux, strict=True):
            lines.append(
                f"{START + np.timedelta64(round(1000 * second), 'ms')},{value:.6f},{NOISE},{curve},{places}"
            )
    (tmp_path / "rows.csv").write_text("\n".join(lines) + "\n")
    scene = torchlc.Scene.from_toml(
        'format = "torchlc-scene/1"\nname = "brick"\n[orbit]\nvectors = "icrs"\n[attitude]\nmode = "inertial"\n'
        f'x_angle = 0.0\nspin_axis = [0, 0, 1]\nspin_rate = {1 / TURN_H}\nspin_epoch = "{START}"\n'
        '[[components]]\nname = "body"\nshape = "box"\nsize = [3.0, 1.6, 1.0]\ncentre = [0, 0, 0]\nmaterial = "white"\n'
        '[materials.white]\nmodel = "lambert"\nalbedo = 0.3\n[model]\neffects = []\n',
        tmp_path,
        "brick",
    )
    return torchlc.load(scene, tmp_path / "rows.csv")


def test_a_clock_that_is_far_off_is_named_with_its_curve_and_minutes(observers) -> None:
    """240 times what is typical of a clock: a normal prior of 10 s would have none of it. The others are right to the noise."""
    found = diagnose(*observers, effects=["time_offset", "background", "spin_rate_offset", "start_phase"])
    assert found.named == ("time_offset",) and found.odds.told > 0.9
    values = dict(zip(found.final.names, found.final.theta.tolist(), strict=True))
    off = {curve: values[f"time_offset.s[{curve}]"] for curve in LATE_S}
    errors = found.final.covariance.diagonal().sqrt()
    assert off == pytest.approx(LATE_S, abs=120.0), (off, errors)  # 1 % of light, 30 rows: some 30 s
