"""Elements and station of the paper (Table 1, as reconstructed), and scenes and recordings made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from astropy.time import Time, TimeDelta

from torchlc.readers import Recording, seconds_since
from torchlc.scene import Scene

SHARED = Path(__file__).parents[2] / "shared"

ORBIT_1 = (
    "1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993",
    "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966",
)
ORBIT_2 = (
    "1 00002U 19097A   20284.25674796 -.00000355  00000-0  00000-0 0  9994",
    "2 00002   0.4814  94.5914 0028139 151.0334 350.7694  1.00271793  2885",
)
ORBIT_3 = (
    "1 00003U 14026A   20284.37504348 -.00000027  00000-0  00000-0 0  9996",
    "2 00003  56.2287  52.2835 0020597 291.4800  68.3069  2.00569053 46908",
)
ORBIT_4 = (
    "1 00004U 18109A   20284.07190081  .00000009  00000-0  00000-0 0  9994",
    "2 00004  55.0110 174.1807 0009159 205.9132 258.7572  2.00569258 13470",
)
MOLNIYA = (  # e = 0.69: perigee passages are where interpolation is hardest
    "1 08195U 75081A   06176.33215444  .00000099  00000-0  11873-3 0   813",
    "2 08195  64.1586 279.0717 6877146 264.7651  20.2257  2.00491383225656",
)
LOW = (
    "1 28057U 03049A   06177.78615833  .00000060  00000-0  35940-4 0  1836",
    "2 28057  98.4283 247.6961 0000884  88.1964 271.9322 14.35478080140550",
)
LATITUDE, LONGITUDE, HEIGHT = 37.536, 122.05, 110.0


def scene(orbit: str, attitude: str = 'mode = "sun"', directory: Path | None = None) -> Scene:
    """A scene with the station of the paper and one plate."""
    text = f"""
format = "torchlc-scene/1"
name = "test"
[orbit]
{orbit}
[[stations]]
id = "weihai"
latitude = {LATITUDE}
longitude = {LONGITUDE}
height = {HEIGHT}
[attitude]
{attitude}
[[components]]
name = "plate"
shape = "plate"
size = [1, 1]
centre = [0, 0, 0]
u = [1, 0, 0]
v = [0, 1, 0]
material = "m"
[materials.m]
model = "lambert"
albedo = 0.5
"""
    return Scene.from_toml(text, directory)


def tle_scene(lines: tuple[str, str], attitude: str = 'mode = "sun"', directory: Path | None = None) -> Scene:
    return scene(f'tle = ["{lines[0]}", "{lines[1]}"]', attitude, directory)


def recording(start: str | Time, seconds: np.ndarray, scale: str = "utc", **columns: object) -> Recording:
    """Rows ``seconds`` after ``start``, with what else a test needs."""
    time = Time(start, scale=scale) + TimeDelta(seconds, format="sec")
    zeros = np.zeros(len(seconds), dtype=np.int64)
    fields = {
        "time": time,
        "seconds": seconds_since(time, time[0]),
        "first_time": time[0],
        "kind": "mag",
        "observed": np.zeros(len(seconds)),
        "error": None,
        "station": zeros,
        "station_ids": ("weihai",),
        "curve": zeros,
        "curve_ids": ("weihai",),
        "night": zeros,
        "night_ids": ("night",),
        "upper_limit": zeros > 0,
    }
    return Recording(**(fields | columns))


def hours(start: float, end: float, step_s: float = 30.0) -> np.ndarray:
    """Seconds after 0 h."""
    return np.arange(start * 3600.0, end * 3600.0 + 1e-6, step_s)
