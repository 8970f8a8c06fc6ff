"""From a noiseless curve to files: usable rows, errors, noise of several kinds, recording, answer."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from curve import Curve, Effects
from sky import Array, Mask, iso, seconds

HEADER = """# %ECSV 1.0
# ---
# datatype:
# - {name: time, datatype: string}
# - {name: mag, unit: mag, datatype: float64}
# - {name: mag_err, unit: mag, datatype: float64}
# - {name: exptime, unit: s, datatype: float64}
# - {name: station, datatype: string}
"""


def stamps(start: str, hours: float, rows: int, rng: np.random.Generator, jitter: float = 0.3) -> Array:
    """Mid-exposure times (T,), s, to the millisecond: even, then each moved by up to ``jitter`` of a step."""
    cadence = hours * 3600.0 / rows
    even = seconds(start) + (np.arange(rows) + 0.5) * cadence
    return np.round(np.sort(even + jitter * cadence * rng.uniform(-1.0, 1.0, rows)), 3)


def usable(curve: Curve) -> Mask:
    """Rows above 10 deg, in the dark (Sun below -12 deg at the station), with light at all."""
    return (curve.elevation_deg > 10.0) & (curve.sun_elevation_deg < -12.0) & (curve.flux > 0)


def errors(mag: Array, floor: float = 0.02, faint: float | None = None) -> Array:
    """Error bars (T,): ``floor`` if bright; sky noise equals it at ``faint`` (1 mag below the median)."""
    knee = np.median(mag) + 1.0 if faint is None else faint
    sky_noise = floor * 10.0 ** (0.4 * (mag - knee))
    return np.round(np.minimum(np.hypot(floor, sky_noise), 0.3), 4)


def noise(t: Array, error: Array, effects: Effects, rng: np.random.Generator) -> Array:
    """What adds to the magnitudes (T,): white noise of the quoted errors, and jitter, red_noise, outliers."""
    out = error * rng.standard_normal(len(t))
    if "jitter" in effects:
        out += effects["jitter"]["mag"] * rng.standard_normal(len(t))
    if "red_noise" in effects:
        red = effects["red_noise"]
        lag = np.abs(t[:, None] - t) / (60.0 * red["tau_min"])
        if red.get("kernel", "matern32") == "matern32":
            correlation = (1.0 + np.sqrt(3.0) * lag) * np.exp(-np.sqrt(3.0) * lag)
        else:
            correlation = np.exp(-lag)
        factor = np.linalg.cholesky(correlation + 1e-9 * np.eye(len(t)))
        out += red["mag"] * factor @ rng.standard_normal(len(t))
    if "outliers" in effects:
        bad = rng.random(len(t)) < effects["outliers"]["fraction"]
        out += bad * effects["outliers"]["width"] * rng.standard_normal(len(t))
    return out


def write_recording(
    path: Path,
    t: Array,
    mag: Array,
    error: Array,
    exptime: Array,
    station: Array,
    comments: tuple[str, ...] = (),
) -> None:
    """The recording as ECSV, in the columns of the practice set; comments become ECSV metadata."""
    lines = [HEADER]
    if comments:
        lines.append(
            "# meta: !!omap\n# - comments:\n" + "".join(f"#   - {json.dumps(c)}\n" for c in comments)
        )
    lines.append("# schema: astropy-2.0\ntime mag mag_err exptime station\n")
    lines += [
        f"{iso(row[0])} {row[1]:.4f} {row[2]:.4f} {row[3]:g} {row[4]}\n"
        for row in zip(t, mag, error, exptime, station, strict=True)
    ]
    path.write_text("".join(lines))


def read_recording(path: Path) -> tuple[Array, Array, Array, Array, Any]:
    """time (s), mag, mag_err, exptime and station of a recording as written above."""
    rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")][1:]
    t = np.array([seconds(row[0]) for row in rows])
    mag, error, exptime = np.array([[float(x) for x in row[1:4]] for row in rows]).T
    return t, mag, error, exptime, np.array([row[4] for row in rows])


def intervals(t: Array, flagged: Mask, gap_rows: int = 2) -> list[list[str]]:
    """Runs of flagged rows as [start, end] ISO pairs; runs at most ``gap_rows`` apart are joined."""
    where = np.flatnonzero(flagged)
    if where.size == 0:
        return []
    breaks = np.flatnonzero(np.diff(where) > gap_rows + 1)
    first, last = np.r_[where[0], where[breaks + 1]], np.r_[where[breaks], where[-1]]
    return [[iso(float(t[a])), iso(float(t[b]))] for a, b in zip(first, last, strict=True)]


def write_answer(path: Path, answer: Mapping[str, Any]) -> None:
    def plain(value: Any) -> Any:
        return value.item() if isinstance(value, np.generic) else value.tolist()

    path.write_text(json.dumps(answer, indent=1, default=plain) + "\n")
