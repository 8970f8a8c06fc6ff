"""Predicted magnitudes of Starlink satellites against recorded ones: do the intervals hold what they say?

    python examples/predicted_against_recorded.py

The presets starlink-v1.5 and starlink-v2-mini, with their priors and their scatter between satellites, predict the
magnitudes that observers recorded: of v1.5 on the nights, of v2 mini of the satellites, to which the presets were not
fitted. Needs ../shared/data; without it the script says so and ends.
"""

from __future__ import annotations

import csv
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import torchlc
from torchlc.cli import scaffold
from torchlc.geometry.orbit import earth
from torchlc.prediction import brightness
from torchlc.readers import Recording

DATA = Path(__file__).parents[2] / "shared" / "data"
LOWEST_DEG = 10.0
"""Elevation below which visual estimates suffer from extinction."""
LOW_SHELL_KM = 430.0
"""Between the satellites at 330 to 380 km and those at 480 to 580 km."""
DRAWS = 400


@dataclass(frozen=True)
class Held:
    """How many recorded magnitudes the intervals hold; ``median_mag`` of recorded minus predicted."""

    name: str
    rows: int
    inside_68: float
    inside_95: float
    median_mag: float

    def __str__(self) -> str:
        return (
            f"{self.name}: {self.rows} magnitudes, {self.inside_68:.1%} in the 68 % interval, "
            f"{self.inside_95:.1%} in the 95 % interval, median recorded - predicted {self.median_mag:+.2f} mag"
        )


def preset_scene(preset: str, stations: str) -> torchlc.Scene:
    """The preset's shape, attitude and materials, for a recording with altitude, azimuth and height."""
    template = scaffold.PRESETS[preset].shape(exact=True)
    return torchlc.Scene.from_toml(f"""
format = "torchlc-scene/1"
name = "{preset}"
[orbit]
altaz = true
{stations}
{template}
[model]{scaffold.ON_STATION.replace('"light_time", ', "")}
[model.parameters]
band_sun_magnitude = -26.76
zero_point = {{ value = 0.0, sigma = 0.02, prior = "normal" }}
""")


def held(name: str, scene: torchlc.Scene, recording: Recording, scatter_mag: float) -> Held:
    """What the preset's intervals at the rows of a recording hold of its magnitudes."""
    model = torchlc.LightCurve(scene, recording)
    theta, _ = brightness.drawn(model, None, DRAWS, 0)
    low95, low68, median, high68, high95 = brightness.quantiles(
        brightness.magnitudes(model, theta, scatter_mag, 0)
    )
    seen = recording.observed
    return Held(
        name,
        len(seen),
        float(np.mean((seen >= low68) & (seen <= high68))),
        float(np.mean((seen >= low95) & (seen <= high95))),
        float(np.median(seen - median)),
    )


def starlink_v15() -> Held:
    """Pomenis: every other night, the ones to which the preset was not fitted."""
    station = '[[stations]]\nid = "pomenis"\nlatitude = 32.4434\nlongitude = -110.7881\nheight = 2790.0\n'
    scene = preset_scene("starlink-v1.5", station)
    recording = torchlc.load(scene, DATA / "starlink_v15" / "recording.ecsv")[1]
    recording = recording.keep(recording.night % 2 == 1, "fitted to")
    return held("Starlink v1.5", scene, recording, scaffold.SCATTER_MAG["starlink-v1.5"])


def starlink_v2_mini(shell: str = "all") -> Held:
    """MMT-9 and visual observers: satellites of odd catalogue numbers, to which the preset was not fitted, of the "low" or
    the "high" shell or of both; rows that a position service calls lit."""
    with (DATA / "starlink_v2mini" / "v2mini_part.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["illuminated"] == "True"]

    def column(name: str) -> np.ndarray:
        return np.array([float(row[name]) for row in rows])

    latitude, longitude, station_m = (
        column(f"observer_{key}") for key in ("latitude_deg", "longitude_deg", "altitude_m")
    )
    alt, az = column("alt_deg_satchecker"), column("az_deg_satchecker")
    place = earth.station_itrs(latitude, longitude, station_m)
    sight = column("range_to_sat_km_satchecker")[:, None] * earth.horizontal_itrs(place, alt, az)
    height = earth.height_km(place + sight)
    wanted = (alt > LOWEST_DEG) & (column("norad_cat_id") % 2 == 1)
    wanted &= {"all": height > 0, "low": height < LOW_SHELL_KM, "high": height >= LOW_SHELL_KM}[shell]
    places = list(zip(latitude, longitude, station_m, strict=True))
    ids = {one: f"s{k}" for k, one in enumerate(dict.fromkeys(places))}
    stations = "".join(
        f'[[stations]]\nid = "{key}"\nlatitude = {lat}\nlongitude = {lon}\nheight = {up}\n'
        for (lat, lon, up), key in ids.items()
    )
    scene = preset_scene("starlink-v2-mini", stations)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        lines = ["time,mag,station,alt,az,height"]
        lines += [
            f"{rows[k]['observation_time_utc']},{rows[k]['apparent_magnitude']},{ids[places[k]]},{alt[k]},{az[k]},{height[k]}"
            for k in np.flatnonzero(wanted)
        ]
        path.write_text("\n".join(lines) + "\n")
        recording = torchlc.load(scene, path)[1]
    return held(f"Starlink v2 mini, {shell}", scene, recording, scaffold.SCATTER_MAG["starlink-v2-mini"])


def main() -> None:
    if not DATA.exists():
        print(f"{DATA} is not here: nothing to do")
        return
    print(starlink_v15())
    for shell in ("all", "high", "low"):
        print(starlink_v2_mini(shell))


if __name__ == "__main__":
    main()
