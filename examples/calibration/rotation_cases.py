"""Bodies that turn, drawn at random, with the scene of who knows the shape and a bracket of the period."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "reference"))

import sky  # noqa: E402
from circumstances import SITES, draw, draw_log  # noqa: E402
from rotation_light import BAND_SUN, Seen, passes, recorded  # noqa: E402
from scene_files import Tree, toml  # noqa: E402


@dataclass(frozen=True)
class Case:
    """A scene as it is handed out, rows, and the truth: times of rows (s), magnitudes, errors, names of passes."""

    scene: Tree
    time: np.ndarray
    mag: np.ndarray
    error: np.ndarray
    curve: np.ndarray
    station: str
    truth: dict[str, Any]


def steady(seed: int, changing: bool = False) -> Case:
    """A body that turns about its z axis; ``changing``: at a period that grows or shrinks steadily."""
    rng = np.random.default_rng([19 if changing else 17, seed])
    high = bool(rng.random() < 0.4)
    span = draw(rng, 300, 900) if high else draw(rng, 120, 240)
    seen = passes(
        rng, high, 3, span, int(rng.integers(120, 250)), draw(rng, *((8.0, 10.0) if changing else (4.0, 8.0)))
    )
    period = span / np.exp(rng.uniform(np.log(2.5), np.log(10.0)))
    component: Tree
    materials = {"body": paint(rng)}
    if seed % 2:
        component = {"name": "body", "shape": "box", "size": [draw(rng, 0.9, 3.0) for _ in range(3)]}
    else:
        radius = draw(rng, 0.8, 1.9)
        component = {
            "name": "body", "shape": "cylinder", "radius": radius, "length": round(radius * draw(rng, 3.0, 7.0), 3),
            "axis": [1.0, 0.0, 0.0],
        }  # fmt: skip
        if seed % 4 == 2:
            materials |= {"dark": paint(rng), "bright": paint(rng)}
            component["sectors"] = [
                {"start": draw(rng, 0, 100), "width": draw(rng, 60, 120), "material": "dark"},
                {"start": draw(rng, 220, 240), "width": draw(rng, 60, 110), "material": "bright"},
            ]
    component |= {"centre": [0.0, 0.0, 0.0], "material": "body"}
    pole, phase = random_pole(rng), float(rng.random())
    rate = 0.0  # of the period, s a second
    if changing:
        rate = rng.choice([-1.0, 1.0]) * draw_log(rng, 0.1, 5.0) / 86400e3

    def turned(seconds: np.ndarray) -> np.ndarray:
        since = seconds - seen.time[0]
        turns = np.log1p(rate * since / period) / rate if rate else since / period
        turn = 2 * np.pi * (turns + phase)
        return Rotation.from_euler("z", -turn[:, None]).as_matrix() @ pole_frame(pole)

    mag, error, kept = recorded(rng, seen, component, materials, turned)
    low = period * 10 ** -rng.uniform(0.15, 0.85)
    bracket = (0.97 * period, 1.03 * period) if changing else (low, 10 * low)
    truth = {"pole": angles(pole), "period_s": period, "size": component.get("size") or [component["radius"], component["length"]],
             "sectors": len(component.get("sectors", [])), "turns_a_pass": span / period}  # fmt: skip
    scene = unknown_scene(seen, component, list(materials), bracket)
    if changing:
        truth |= {"period_rate_ms_per_day": 86400e3 * rate, "days": float(np.ptp(seen.time) / 86400)}
    return _case(scene, seen, mag, error, kept, truth)


def tumbling(seed: int) -> Case:
    """A box that turns about none of its axes; odd seeds in the long-axis mode."""
    rng = np.random.default_rng([18, seed])
    span = draw(rng, 2400, 4500)
    seen = passes(rng, True, 2, span, int(rng.integers(200, 420)), draw(rng, 1.0, 4.0))
    size = np.sort([draw(rng, 1.0, 1.6), draw(rng, 1.6, 2.1), draw(rng, 2.2, 3.0)])[::-1]
    mass = (size**2) * np.exp(0.2 * rng.standard_normal(3))
    moments = mass.sum() - mass
    moments /= moments.max()
    component = {
        "name": "body",
        "shape": "box",
        "size": [float(one) for one in size],
        "centre": [0.0, 0.0, 0.0],
        "material": "body",
    }
    materials = {"body": paint(rng)}
    pole, phase = random_pole(rng), float(rng.random())
    small, middle, _ = np.sort(moments)
    border = float(np.arcsin(np.sqrt((1 / middle - 1) / (1 / small - 1))))
    nutation = rng.uniform(border + 0.12, np.pi / 2 - 0.12) if seed % 2 else rng.uniform(0.15, border - 0.12)
    rate = 2 * np.pi * np.exp(rng.uniform(np.log(12), np.log(40))) / span
    matrix, periods = euler(moments, nutation, rate, phase, float(np.ptp(seen.time)) + 10.0)

    def turned(seconds: np.ndarray) -> np.ndarray:
        return matrix(seconds - seen.time[0] + 5.0) @ pole_frame(pole)

    mag, error, kept = recorded(rng, seen, component, materials, turned)
    truth = {"pole": angles(pole), "inertia_ratios": np.sort(moments)[:2].tolist(), "inertia_xyz": moments.tolist(),
             "nutation_deg": float(np.degrees(nutation)), "axis_mode": "long" if seed % 2 else "short",
             "periods_s": periods, "size": component["size"]}  # fmt: skip
    long = periods["precession_long"]
    scene = unknown_scene(seen, component, list(materials), (0.97 * long, 1.03 * long))
    return _case(scene, seen, mag, error, kept, truth)


def euler(
    moments: np.ndarray, nutation: float, rate: float, phase: float, until: float
) -> tuple[Callable[[np.ndarray], np.ndarray], dict[str, float]]:
    """Body from a frame whose z is the angular momentum (T, 3, 3) by Euler's equations, and the mean periods, s, counted in the
    integration; ``rate`` is the angular momentum over the largest moment."""
    order = np.argsort(moments)
    along = np.zeros(3)
    along[order[2]], along[order[0]] = np.cos(nutation), np.sin(nutation)
    start = Rotation.align_vectors(np.array([[0.0, 0.0, 1.0]]), along[None])[0]
    first = np.concatenate(
        [rate * along / moments, (Rotation.from_euler("z", 2 * np.pi * phase) * start).as_quat()]
    )

    def slope(_time: float, state: np.ndarray) -> np.ndarray:
        wx, wy, wz, x, y, z, w = state
        return np.array([
            (moments[1] - moments[2]) / moments[0] * wy * wz, (moments[2] - moments[0]) / moments[1] * wz * wx,
            (moments[0] - moments[1]) / moments[2] * wx * wy,
            (w * wx - z * wy + y * wz) / 2, (z * wx + w * wy - x * wz) / 2, (-y * wx + x * wy + w * wz) / 2,
            (-x * wx - y * wy - z * wz) / 2,
        ])  # fmt: skip

    def matrix(seconds: np.ndarray) -> np.ndarray:
        reached = solve_ivp(
            slope, (0.0, until), first, method="DOP853", rtol=1e-10, atol=1e-12, t_eval=seconds
        ).y
        return np.swapaxes(Rotation.from_quat(reached[3:].T).as_matrix(), -1, -2)

    grid = np.arange(0.0, min(until, 300 * 2 * np.pi / rate), 2 * np.pi / rate / 60)
    body = matrix(grid)

    def turns(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        angle = np.unwrap(np.arctan2(y, x)) / (2 * np.pi)
        return angle * np.sign(angle[-1] - angle[0])

    momentum = body[:, :, 2]
    about = order[2] if np.abs(momentum[:, order[2]]).min() > 1e-3 else order[0]
    across = [k for k in range(3) if k != about]
    way = turns(momentum[:, across[0]], momentum[:, across[1]])
    whole = np.arange(np.ceil(way[0]), way[-1])  # whole ways round, so that no swing is cut
    ends = np.interp(whole[[0, -1]], way, grid)
    result = {"rotation": float(np.ptp(ends) / (len(whole) - 1))}
    for name, axis in (("precession_long", order[0]), ("precession_short", order[2])):
        result[name] = float(
            np.ptp(ends) / np.ptp(np.interp(ends, grid, turns(body[:, axis, 0], body[:, axis, 1])))
        )
    return matrix, result


def unknown_scene(seen: Seen, component: Tree, names: list[str], bracket: tuple[float, float]) -> Tree:
    """The scene of who knows the shape and a bracket of the period, s."""
    low, high = (one / 3600 for one in bracket)
    free = {
        "model": "ashikhmin-shirley",
        "n": {"value": 50.0, "low": 1.0, "high": 5000.0, "prior": "loguniform"},
        "r_spec": {"value": 0.2, "low": 0.0, "high": 1.0},
        "r_diff": {"value": 0.3, "low": 0.0, "high": 1.0},
    }
    site = SITES[seen.station]
    return {
        "format": "torchlc-scene/1",
        "name": "unknown rotation",
        "orbit": {"tle": seen.elements},
        "stations": [{"id": seen.station, "latitude": site[0], "longitude": site[1], "height": site[2]}],
        "attitude": {
            "mode": "spin-pole",
            "pole": [{"value": 180.0, "low": 0.0, "high": 360.0}, {"value": 0.0, "low": -90.0, "high": 90.0}],
            "period": {"value": (low * high) ** 0.5, "low": low, "high": high},
            "phase": {"value": 180.0, "low": 0.0, "high": 360.0},
            "epoch": sky.iso(float(seen.time[0])),
        },
        "components": [component],
        "materials": {name: dict(free) for name in names},
        "model": {
            "effects": ["sun_distance"],
            "parameters": {"zero_point": 0.0, "band_sun_magnitude": BAND_SUN},
        },
    }


def _case(
    scene: Tree, seen: Seen, mag: np.ndarray, error: np.ndarray, kept: np.ndarray, truth: dict[str, Any]
) -> Case:
    names = np.array([f"pass{k + 1}" for k in seen.number])
    truth |= {
        "rows": int(kept.sum()),
        "error_mag": float(error[0]),
        "revolutions_a_day": float(seen.elements[1][52:63]),
    }
    return Case(scene, seen.time[kept], mag[kept], error[kept], names[kept], seen.station, truth)


def pole_frame(pole: np.ndarray) -> np.ndarray:
    """Rows x, y, z of a frame with z along the pole and x to the south of it."""
    y = sky.unit(np.cross([0.0, 0.0, 1.0], pole))
    return np.stack([np.cross(y, pole), y, pole])


def random_pole(rng: np.random.Generator) -> np.ndarray:
    return sky.unit(rng.standard_normal(3))


def angles(pole: np.ndarray) -> list[float]:
    return [float(np.degrees(np.arctan2(pole[1], pole[0])) % 360), float(np.degrees(np.arcsin(pole[2])))]


def paint(rng: np.random.Generator) -> Tree:
    return {"n": draw_log(rng, 15.0, 100.0), "r_spec": draw(rng, 0.08, 0.3), "r_diff": draw(rng, 0.2, 0.45)}


def write(case: Case, folder: Path) -> tuple[Path, Path]:
    """The files of a case."""
    columns = [("time", "string", ""), ("mag", "float64", "mag"), ("mag_err", "float64", "mag"),
               ("exptime", "float64", "s"), ("station", "string", ""), ("curve", "string", "")]  # fmt: skip
    lines = ["# %ECSV 1.0", "# ---", "# datatype:"]
    lines += [
        f"# - {{name: {name}, {f'unit: {unit}, ' if unit else ''}datatype: {kind}}}"
        for name, kind, unit in columns
    ]
    lines += ["# schema: astropy-2.0", " ".join(name for name, _, _ in columns)]
    lines += [
        f"{sky.iso(float(t))} {m:.4f} {e:.4f} 0.01 {case.station} {name}"
        for t, m, e, name in zip(case.time, case.mag, case.error, case.curve, strict=True)
    ]
    scene, recording = folder / "scene.toml", folder / "recording.ecsv"
    scene.write_text(toml(case.scene))
    recording.write_text("\n".join(lines) + "\n")
    return scene, recording
