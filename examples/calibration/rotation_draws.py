"""Is the rotation found? Bodies that turn, drawn at random, looked for by ``torchlc rotation`` and scored.

    python examples/calibration/rotation_draws.py [RESULTS.jsonl] [--kind steady|changing|tumbling] [--first SEED] [--count 7]
    python examples/calibration/rotation_draws.py RESULTS.jsonl --summary

The light is that of examples/reference: its orbit, Sun, station, faces and law of reflection, none of which torchlc shares; the
rotation is Euler's equations integrated by scipy. Three kinds are drawn:

- steady: boxes and cylinders (half of them with three sectors of other paint) about body z, seen in three passes of a low or a
  middle orbit over one to eight days, errors of 0.03 to 0.15 mag. The search knows the shape and that the period is within a
  factor of ten.
- changing: the same bodies over eight to ten days, the period known to 3 per cent; it grows or shrinks by 0.1 to 5 ms a day.
- tumbling: boxes about no fixed axis, in the short- or the long-axis mode, seen in two passes of a middle orbit. The period of the
  long axis is known to 3 per cent, as a periodogram tells it; body, angular momentum and the other period are not.

A draw is one line of the results, and those that are there are not done again.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
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
from body import build  # noqa: E402
from circumstances import SITES, draw, draw_log  # noqa: E402
from scene_files import Tree, tle, toml  # noqa: E402
from surface import reflected  # noqa: E402

RESULTS = HERE / "rotation_draws.jsonl"
STRIPS = 720
"""Of a cylinder's side: the light of a lobe of n = 100 is then smooth to 1e-4."""
BAND_SUN = -26.7
NEAR_CHI2 = 10.0
"""Modes this near to the best in -2 ln likelihood are among the answers."""
BARS = {"pole_deg": 3.0, "period": 1e-3, "axis_deg": 5.0, "periods": 5e-3, "inertia": 0.05, "rate_sd": 3.0}
KINDS = ("steady", "changing", "tumbling")
SHADOW_KM = 6500.0
"""Radius of the cylinder behind the Earth in which nothing is seen."""


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


@dataclass(frozen=True)
class Seen:
    """The passes of an orbit: times (T,), number of each row's pass, Sun and station from the object (T, 3), km."""

    elements: list[str]
    station: str
    time: np.ndarray
    number: np.ndarray
    sun: np.ndarray
    observer: np.ndarray


def passes(rng: np.random.Generator, high: bool, count: int, span_s: float, rows: int, days: float) -> Seen:
    """Rows in which the object is lit, above 25 deg and the sky dark, in ``count`` passes within ``days`` of each other."""
    while True:
        station = str(rng.choice(list(SITES)))
        date = str(np.datetime64(f"{rng.integers(2019, 2025)}-01-01") + int(rng.integers(0, 360)))
        revolutions = draw(rng, 1.9, 2.3) if high else draw(rng, 12.6, 14.4)
        elements = tle(
            date, draw(rng, 55, 98), draw(rng, 0, 360), 0.0005, 0.0, draw(rng, 0, 360), revolutions, 71000
        )
        orbit, start = sky.Orbit(tuple(elements)), sky.seconds(date)
        starts = np.arange(start, start + days * 86400.0, 60.0 if not high else 300.0)
        moments = starts[:, None] + np.array([0.0, 0.5, 1.0]) * span_s
        position = orbit.state(moments)[0]
        site, zenith = sky.station(moments, *SITES[station])
        sun, away = sky.sun(moments), position - site
        elevation = (sky.unit(away) * zenith).sum(-1)
        dark = (sky.unit(sun) * zenith).sum(-1) < np.sin(np.radians(-10.0))
        along = (position * sky.unit(sun)).sum(-1)
        off = np.linalg.norm(position - along[..., None] * sky.unit(sun), axis=-1)
        usable = ((elevation > np.sin(np.radians(25.0))) & dark & ((along > 0) | (off > SHADOW_KM))).all(-1)
        chosen: list[float] = []
        for one in starts[usable]:
            if not chosen or one - chosen[-1] > max(18 * 3600.0, days * 86400.0 / (count + 1)):
                chosen.append(float(one))
        if len(chosen) < count:
            continue
        chosen = chosen[:count]
        time_ = np.concatenate([np.sort(one + span_s * rng.random(rows)) for one in chosen]).round(3)
        site, _ = sky.station(time_, *SITES[station])
        position = orbit.state(time_)[0]
        return Seen(
            elements,
            station,
            time_,
            np.repeat(np.arange(count), rows),
            sky.sun(time_) - position,
            site - position,
        )


def light(component: Tree, materials: Tree, sun: np.ndarray, observer: np.ndarray) -> np.ndarray:
    """Light (T,) times the square of the range of one convex part, unit vectors (T, 3) in the body; ``sectors`` of a cylinder
    along body x count from y towards z."""
    total = np.zeros(len(sun))
    for face in build([{**component, "sectors": None}], STRIPS)[1]:
        material = face.material
        if face.label == "side":
            azimuth = np.degrees(np.arctan2(face.normal[2], face.normal[1])) % 360.0
            for sector in component.get("sectors", []):
                if (azimuth - sector["start"]) % 360.0 < sector["width"]:
                    material = sector["material"]
        seen = np.flatnonzero((sun @ face.normal > 0) & (observer @ face.normal > 0))
        if len(seen):
            frame = (
                np.broadcast_to(x, (len(seen), 3))
                for x in (face.normal, face.u, np.cross(face.normal, face.u))
            )
            total[seen] += face.area * reflected(materials[material], {}, *frame, sun[seen], observer[seen])
    return total


def recorded(
    rng: np.random.Generator,
    seen: Seen,
    component: Tree,
    materials: Tree,
    turned: Callable[[np.ndarray], np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Magnitudes, errors and which rows a camera sees; ``turned``: seconds to body from inertial axes (T, 3, 3)."""
    distance = np.linalg.norm(seen.observer, axis=-1)
    matrix = turned(seen.time - distance / sky.LIGHT_KM_S)
    sun, observer = (sky.apply(matrix, sky.unit(one)) for one in (seen.sun, seen.observer))
    flux = light(component, materials, sun, observer) / (1e3 * distance) ** 2
    flux *= (sky.AU_KM / np.linalg.norm(seen.sun, axis=-1)) ** 2
    kept = flux > 0
    mag = BAND_SUN - 2.5 * np.log10(np.where(kept, flux, 1e-30))
    kept &= mag < np.median(mag[kept]) + 3.5
    error = np.round(np.full(len(mag), np.exp(rng.uniform(np.log(0.03), np.log(0.15)))), 4)
    return mag + error * rng.standard_normal(len(mag)), error, kept


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


def score(truth: dict[str, Any], answer: dict[str, Any]) -> dict[str, Any]:
    """What of the truth is among the modes that fit nearly as well as the best, and whether a decided answer is wrong."""
    near = [one for one in answer["modes"] if one["above_best"] < NEAR_CHI2]
    told = [_compared(truth, one) for one in near]
    best = min(told, key=lambda one: (not one["right"], one["pole_deg"]))
    wrong = answer["decided"] and not told[0]["right"]
    return {**best, "modes": len(near), "decided": answer["decided"], "confidently_wrong": bool(wrong)}


def _compared(truth: dict[str, Any], mode: dict[str, Any]) -> dict[str, Any]:
    way = [_unit(truth["pole"]), _unit(mode["pole_icrs"])]
    pole = float(np.degrees(np.arccos(np.clip(way[0] @ way[1], -1, 1))))
    if "periods_s" not in truth:
        ratio = mode["period_s"] / truth["period_s"]
        right = pole < BARS["pole_deg"] and abs(ratio - 1) < BARS["period"] and mode["periods_s"] is None
        rate: dict[str, float] = {}
        if "period_rate_ms_per_day" in truth:
            sd = mode["period_rate_sd_ms_per_day"] or 0.0
            off = (mode["period_rate_ms_per_day"] or 0.0) - truth["period_rate_ms_per_day"]
            rate = {"rate_off_ms_per_day": off, "rate_sd_ms_per_day": sd}
            right = right and abs(off) < BARS["rate_sd"] * sd
        return {
            "right": bool(right),
            **rate,
            "pole_deg": pole,
            "period_ratio": ratio,
            "multiple": bool(abs(ratio - 1) < 0.02),
        }
    if mode["periods_s"] is None:
        return {
            "right": False,
            "pole_deg": pole,
            "period_ratio": mode["period_s"] / truth["periods_s"]["precession_long"],
        }
    ratios = {
        key: mode["periods_s"][key] / truth["periods_s"][key] for key in ("precession_long", "rotation")
    }
    inertia = max(
        abs(a / b - 1) for a, b in zip(mode["inertia_ratios"], truth["inertia_ratios"], strict=True)
    )
    right = pole < BARS["axis_deg"] and inertia < BARS["inertia"]
    right = right and all(abs(one - 1) < BARS["periods"] for one in ratios.values())
    return {
        "right": bool(right),
        "pole_deg": pole,
        "inertia": inertia,
        **{f"{key}_ratio": one for key, one in ratios.items()},
    }


def _unit(ra_dec: list[float]) -> np.ndarray:
    lon, lat = np.radians(ra_dec)
    return np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def run(kind: str, seed: int, folder: Path) -> dict[str, Any]:
    """One draw: its truth, score, verdict, processor time and memory."""
    case = {"steady": steady, "changing": lambda one: steady(one, True), "tumbling": tumbling}[kind](seed)
    scene, recording = write(case, folder)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "torchlc", "rotation", str(scene), str(recording), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    result = {"kind": kind, "seed": seed, "truth": case.truth,
              "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
              "largest_memory_gb": after.ru_maxrss / 1e6}  # fmt: skip
    if done.returncode:
        return result | {"right": False, "error": done.stderr.strip()[-300:]}
    answer = json.loads(done.stdout)
    best = answer["modes"][0]
    also = {
        "chi2": best["chi2"],
        "dof": answer["dof"],
        "verdict": answer["verdict"],
        "warnings": answer["warnings"],
    }
    return result | score(case.truth, answer) | also


def summary(results: list[dict[str, Any]]) -> str:
    """A table in Markdown, a row a kind."""
    lines = [
        "| kind | draws | right | pole or L deg, median | decided | decided and wrong | CPU s, median and most |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        some = [one for one in results if one["kind"] == kind]
        if not some:
            continue
        right = [one for one in some if one["right"]]
        cpu = [one["cpu_s"] for one in some]
        pole = np.median([one["pole_deg"] for one in right]) if right else np.nan
        lines.append(
            f"| {kind} | {len(some)} | {len(right)} | {pole:.2f} | {sum(one.get('decided', False) for one in some)} "
            f"| {sum(one.get('confidently_wrong', False) for one in some)} | {np.median(cpu):.0f}, {max(cpu):.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", nargs="?", type=Path, default=RESULTS)
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--count", type=int, default=7)
    parser.add_argument("--keep", type=Path, help="where to put the files of each draw")
    parser.add_argument("--summary", action="store_true")
    given = parser.parse_args()
    known = (
        [json.loads(line) for line in given.results.read_text().splitlines()]
        if given.results.exists()
        else []
    )
    if not given.summary:
        kinds = [given.kind] if given.kind else KINDS
        for seed in range(given.first, given.first + given.count):
            for kind in kinds:
                if any((one["kind"], one["seed"]) == (kind, seed) for one in known):
                    continue
                began = time.monotonic()
                with tempfile.TemporaryDirectory() as scratch:
                    folder = given.keep / f"{kind}{seed}" if given.keep else Path(scratch)
                    folder.mkdir(parents=True, exist_ok=True)
                    known.append(run(kind, seed, folder))
                with given.results.open("a") as file:
                    file.write(json.dumps(known[-1]) + "\n")
                print(
                    kind,
                    seed,
                    "right" if known[-1]["right"] else "not right",
                    f"{time.monotonic() - began:.0f} s",
                    flush=True,
                )
    print(summary(known))


if __name__ == "__main__":
    main()
