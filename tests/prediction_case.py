"""A ball, or other parts, over the observatory at Weihai, and a day to predict."""

from __future__ import annotations

import numpy as np
from astropy.time import Time

import torchlc
from tests.paper_orbits import HEIGHT, LATITUDE, LONGITUDE, LOW

STATION = f"weihai,{LATITUDE},{LONGITUDE},{HEIGHT}"
SPAN = {"start": "2006-06-27T00:00:00", "hours": 24.0}
SPHERE = """
[[components]]
name = "ball"
shape = "sphere"
radius = 0.5
centre = [0, 0, 0]
material = "white"
[materials.white]
model = "lambert"
albedo = 0.6
[model]
effects = []
[model.parameters]
band_sun_magnitude = -26.76
"""


def scene(tle=LOW, parts=SPHERE, attitude='mode = "nadir"') -> torchlc.Scene:
    return torchlc.Scene.from_toml(f"""
format = "torchlc-scene/1"
name = "object"
[orbit]
tle = ["{tle[0]}", "{tle[1]}"]
[[stations]]
id = "weihai"
latitude = {LATITUDE}
longitude = {LONGITUDE}
height = {HEIGHT}
[attitude]
{attitude}
{parts}""")


def at(sky, prediction, seconds):
    """Skyfield's times of seconds after the start of a prediction."""
    timescale, _ = sky
    return timescale.from_astropy(Time(prediction.iso(np.asarray(seconds)), format="isot", scale="utc"))
