"""Passes of an orbit in which an object is seen, and the light of a convex body in them, by examples/reference: its orbit, Sun,
station, faces and law of reflection, none of which torchlc shares.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "reference"))

import sky  # noqa: E402
from body import build  # noqa: E402
from circumstances import SITES, draw  # noqa: E402
from scene_files import Tree, tle  # noqa: E402
from surface import reflected  # noqa: E402

STRIPS = 720
"""Of a cylinder's side: the light of a lobe of n = 100 is then smooth to 1e-4."""
BAND_SUN = -26.7
SHADOW_KM = 6500.0
"""Radius of the cylinder behind the Earth in which nothing is seen."""


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
