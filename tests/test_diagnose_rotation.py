"""How a body turns otherwise than its scene says is named, from light that numpy and scipy made: closed forms and Euler's equations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.rotating_bodies import Circle, box, recording, scene, steady, tumbling, unit_of
from torchlc.diagnosis.run import diagnose
from torchlc.readers import load_recording
from torchlc.scene import load_scene

BODY = box(1.2, 1.9, 2.6)
POLE = (143.0, 36.0)
PERIOD_S = 61.7
TILT_DEG, TOWARDS_DEG = 6.0, 60.0
EAST_DEG, NORTH_DEG = 4.0, 3.0
NUTATION_DEG = 2.0
MOMENTS = np.array([0.6, 0.66, 1.0])
NOISE = 0.03
CANDIDATES = ["axis_tilt", "pole_offset", "nutation", "period_drift", "spin_rate_offset", "start_phase"]

Turned = Callable[[np.ndarray], np.ndarray]


def tilted(seconds: np.ndarray) -> np.ndarray:
    """The axis goes through a direction TILT_DEG from body +Z, TOWARDS_DEG + 90 from body +X: the body turned about e."""
    towards = np.radians(TOWARDS_DEG)
    turn = Rotation.from_rotvec(np.radians(TILT_DEG) * np.array([np.cos(towards), np.sin(towards), 0.0]))
    return turn.as_matrix().T @ steady(seconds, unit_of(*POLE), PERIOD_S, 0.2)


def elsewhere(seconds: np.ndarray) -> np.ndarray:
    """The pole is EAST_DEG and NORTH_DEG along the tangents of the sphere, on one great circle."""
    lon = np.radians(POLE[0])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    north = np.cross(unit_of(*POLE), east)
    way = np.radians(EAST_DEG) * east + np.radians(NORTH_DEG) * north
    far = np.linalg.norm(way)
    return steady(seconds, np.cos(far) * unit_of(*POLE) + np.sin(far) * way / far, PERIOD_S, 0.2)


def coning(seconds: np.ndarray) -> np.ndarray:
    later = seconds + 1.0  # light leaves before it is seen, and the integral begins at 0
    return tumbling(later, unit_of(*POLE), MOMENTS, 2 * np.pi / PERIOD_S, np.radians(NUTATION_DEG), 0.2)


CASES: dict[str, tuple[Turned, dict[str, float]]] = {
    "axis_tilt": (tilted, {"deg": TILT_DEG, "towards_deg": TOWARDS_DEG}),
    "pole_offset": (elsewhere, {"east": EAST_DEG, "north": NORTH_DEG}),
    "nutation": (coning, {"deg": NUTATION_DEG}),
}
"""What turns the body, and the numbers that are to be found."""
SIGMAS = 4.0
"""Bound of the numbers in their own standard deviations: by chance once in 16,000."""
LARGEST_SD = 0.25
"""Relative to the number: a wide one would be right of anything."""


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_named(name: str, tmp_path: Path) -> None:
    turned, numbers = CASES[name]
    after = 9.7 * np.arange(120)
    passes = [(0.0, after, Circle.past(30.0, 20.0, 40.0, after[-1], 19000.0))]
    text = recording(
        BODY, turned, passes, materials=(20.0, 0.2, 0.35), noise=NOISE, rng=np.random.default_rng(17)
    )
    (tmp_path / "recording.ecsv").write_text(text)
    known = scene(BODY, (PERIOD_S, PERIOD_S / 1.005, PERIOD_S * 1.005)).splitlines()
    known = [f"pole = [{POLE[0]}, {POLE[1]}]" if line.startswith("pole") else line for line in known]
    (tmp_path / "scene.toml").write_text("\n".join(known))
    nominal = load_scene(tmp_path / "scene.toml")
    result = diagnose(
        nominal, load_recording(tmp_path / "recording.ecsv", nominal), effects=CANDIDATES, budget=25.0
    )
    content = result.to_json()
    assert (content["verdict"], content["named"]) == ("missing_physics", [name])
    values = content["candidates"][0]["parameters"]
    for short, truth in numbers.items():
        spread = values[short]["sd"]
        assert spread < LARGEST_SD * truth
        assert abs(values[short]["median"] - truth) < SIGMAS * spread


NIGHTS = (0.0, 1.07, 1.93, 4.11, 7.02)
"""Days, not whole ones: nights a day apart would leave one turn more in each open."""
FEW_NIGHTS = (0.0, 4.03, 7.02)
"""Days, between which a change of the period may be taken for a turn more or fewer."""
MS_A_DAY = 2.0


@pytest.mark.long
@pytest.mark.parametrize(("nights", "open_counts"), [(NIGHTS, False), (FEW_NIGHTS, True)])
def test_a_drift_is_named_whatever_turned_between_nights(
    nights: tuple[float, ...], open_counts: bool, tmp_path: Path
) -> None:
    """Over a week the turn comes a whole turn later: the count from the scene's own numbers is wrong in every night but the first, and the
    phase starts elsewhere. Where several counts fit, the error is that of all of them, and a warning says so."""
    after = 6.1 * np.arange(50)
    passes = [
        (86400 * day, after, Circle.past(30.0 + 20 * k, 20.0 - 9 * k, 40.0, after[-1], 19000.0))
        for k, day in enumerate(nights)
    ]
    rate = MS_A_DAY / 86400e3
    text = recording(
        BODY, lambda seconds: steady(seconds, unit_of(*POLE), PERIOD_S, 0.2, rate), passes,
        materials=(20.0, 0.2, 0.35), noise=NOISE, rng=np.random.default_rng(19),
    )  # fmt: skip
    (tmp_path / "recording.ecsv").write_text(text)
    known = scene(BODY, (PERIOD_S, PERIOD_S / 1.005, PERIOD_S * 1.005)).splitlines()
    known = [f"pole = [{POLE[0]}, {POLE[1]}]" if line.startswith("pole") else line for line in known]
    (tmp_path / "scene.toml").write_text("\n".join(known))
    nominal = load_scene(tmp_path / "scene.toml")
    observed = load_recording(tmp_path / "recording.ecsv", nominal)
    effects = ["period_drift", "spin_rate_offset", "start_phase"]
    result = diagnose(nominal, observed, effects=effects, budget=25.0)
    content = result.to_json()
    assert (content["verdict"], content["named"]) == ("missing_physics", ["period_drift"])
    found = content["candidates"][0]["parameters"]["ms_per_day"]
    assert (found["sd"] > 0.01 * MS_A_DAY) is open_counts
    assert abs(found["median"] - MS_A_DAY) < SIGMAS * found["sd"]
    assert any("counts of turns" in warning for warning in result.warnings) is open_counts
