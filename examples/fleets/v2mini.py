"""The recording of Starlink v2 mini, its scene, and what of its rows is dark."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from unseen import DATA

import torchlc
from torchlc.cli import scaffold
from torchlc.geometry.orbit import earth
from torchlc.readers import Recording

LOWEST_DEG = 10.0
"""Elevation below which visual estimates suffer from extinction."""
LOW_KM = 430.0
"""Between the satellites at 330 to 380 km and those at 480 to 580 km, where held-out scores are told by class."""
ERROR_MAG = 0.05
"""Of every row of the v2 mini; what rows differ by beyond it is fitted. The quoted errors, 0.02 to 0.3 mag, are a tenth of that."""
V2MINI = (
    scaffold.PRESETS["starlink-v2-mini"]
    .shape(exact=True)
    .split("[materials.chassis]")[0]
    .replace("# What it is made of", "#")
    + """
[materials.chassis]
n      = { value = 10.0, low = 1.0, high = 1e4, prior = "loguniform" }
r_spec = { value = 0.05, low = 0.0, high = 1.0 }
r_diff = { value = 0.036, low = 0.0, high = 1.0 }
[materials.arrays]
n      = { value = 45.0, low = 1.0, high = 1e4, prior = "loguniform" }
r_spec = { value = 0.5, low = 0.0, high = 1.0 }
r_diff = { value = 0.01, low = 0.0, high = 1.0 }
[model]
effects = ["sun_distance", "earth_shadow", "jitter"]
[model.parameters]
band_sun_magnitude = -26.76
zero_point = { value = 0.0, sigma = 0.02, per = "object" }
"jitter.mag" = { value = 0.2, sigma = 0.3, prior = "halfnormal" }
"""
)


def v2mini(
    folder: Path, lowest_deg: float = LOWEST_DEG
) -> tuple[torchlc.Scene, Recording, np.ndarray, dict[str, np.ndarray]]:
    """Scene and recording with the satellite of each row, which rows are flagged as lit, and what else is recorded of each."""
    with (DATA / "starlink_v2mini" / "v2mini_part.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if float(row["alt_deg_satchecker"]) > lowest_deg]
    rows.sort(key=lambda row: row["observation_time_utc"])

    def column(name: str) -> np.ndarray:
        return np.array([float(row[name]) for row in rows])

    latitude, longitude, up = (
        column(f"observer_{key}") for key in ("latitude_deg", "longitude_deg", "altitude_m")
    )
    alt, az = column("alt_deg_satchecker"), column("az_deg_satchecker")
    place = earth.station_itrs(latitude, longitude, up)
    sight = column("range_to_sat_km_satchecker")[:, None] * earth.horizontal_itrs(place, alt, az)
    height = earth.height_km(place + sight)
    places = list(zip(latitude, longitude, up, strict=True))
    ids = {one: f"s{k}" for k, one in enumerate(dict.fromkeys(places))}
    stations = "".join(
        f'[[stations]]\nid = "{key}"\nlatitude = {a}\nlongitude = {b}\nheight = {c}\n'
        for (a, b, c), key in ids.items()
    )
    scene = torchlc.Scene.from_toml(f"""
format = "torchlc-scene/1"
name = "Starlink v2 mini"
[orbit]
altaz = true
{stations}
{V2MINI}""")
    path = folder / "v2mini.csv"
    lines = ["time,mag,mag_err,station,alt,az,height,object,curve"]
    lines += [
        f"{row['observation_time_utc']},{row['apparent_magnitude']},{ERROR_MAG},"
        f"{ids[places[k]]},{alt[k]},{az[k]},{height[k]},{row['norad_cat_id']},all"
        for k, row in enumerate(rows)
    ]
    path.write_text("\n".join(lines) + "\n")
    recording = torchlc.load(scene, path)[1]
    lit = np.array([row["illuminated"] == "True" for row in rows])
    assert len(recording) == len(rows)
    recorded = {
        "height": height,
        "day": recording.time.jd - recording.time.jd[0],
        "catalogue number": column("norad_cat_id"),
        "phase angle": column("phase_angle_deg_satchecker"),
        "elevation": alt,
        "azimuth": az,
        "station's latitude": latitude,
        "range": column("range_to_sat_km_satchecker"),
    }
    return scene, recording, lit, recorded


def passes(recording: Recording) -> np.ndarray:
    """Which pass each row (T,) is of: those of one object within an hour of the clock."""
    assert recording.object is not None
    hours = np.floor(recording.seconds / 3600).astype(int)
    return np.unique(np.stack([recording.object, hours]), axis=1, return_inverse=True)[1].ravel()


def told_dark(scene: torchlc.Scene, recording: Recording, lit: np.ndarray) -> dict[str, Any]:
    """How much of the Sun the Earth hides at the place and time of each row flagged as not illuminated, and at how many of the
    others it hides all."""
    hidden = torchlc.simulate(scene, recording).columns["eclipse_fraction"]
    assert hidden is not None and recording.object is not None and recording.alt is not None
    rows = [
        {
            "object": recording.object_ids[recording.object[k]],
            "time": str(recording.time[k].isot)[:19],
            "mag": float(recording.observed[k]),
            "elevation_deg": float(recording.alt[k]),
            "hidden": float(hidden[k]),
        }
        for k in np.flatnonzero(~lit)
    ]
    wholly = np.array([row["hidden"] for row in rows]) == 1.0
    return {
        "rows": rows,
        "wholly_hidden": int(wholly.sum()),
        "others_wholly_hidden": int((hidden[lit] == 1.0).sum()),
    }
