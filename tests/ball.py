"""A ball whose zero point alone is free, where everything is linear, and a search for what its rows lack."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import torchlc
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench

BALL = """
format = "torchlc-scene/1"
name = "ball"
[orbit]
tle = ["1 37834U 11045A   26074.51234567 -.00000155  00000-0  00000+0 0  9999",
       "2 37834   0.0213  85.4012 0002513 210.1123  30.2201  1.00271810 53325"]
[[stations]]
id = "roof"
latitude = 48.2
longitude = 16.37
height = 210.0
[attitude]
mode = "nadir"
[[components]]
name = "ball"
shape = "sphere"
radius = 1.0
centre = [0, 0, 0]
material = "paint"
[materials.paint]
model = "lambert"
albedo = 0.5
[model]
effects = []
[model.parameters]
band_sun_magnitude = -26.76
zero_point = { value = 0.0, sigma = 0.02, prior = "normal" }
"""
METAL = """model = "ashikhmin-shirley"
n = { value = 50.0, low = 1.0, high = 1000.0, prior = "loguniform" }
r_spec = { value = 0.3, low = 0.0, high = 1.0 }
r_diff = { value = 0.3, low = 0.0, high = 1.0 }"""
"""A law with a lobe, in the place of the ball's."""
ERROR = 0.02
ROWS = 120


def changed(ball, added: np.ndarray):
    scene, recording = ball
    return scene, replace(recording, observed=recording.observed + added[: len(recording.observed)])


def searched(case, *entries: str) -> Search:
    search = Search(Workbench(*case), Clock(None), 0)
    search.bench.entries = ["zero_point_drift", "zero_point_step"]
    search.null()
    at = search.visited[Hypothesis()]
    for entry in entries:
        search.extend(at, entry, None)
    return search


def grown(case, *entries: str) -> Search:
    """A search that has fitted nothing but the scene's own model with the errors as quoted, and that with one entry more after another."""
    search = Search(Workbench(*case), Clock(None), 0)
    search.bench.entries = ["zero_point_drift", "zero_point_step"]
    at = search.refit(Hypothesis(), search.posterior(Hypothesis()).model.parameter_set.start()[None])
    for entry in entries:
        at = search.extend(at, entry, None)
    return search


def stepped(ball, step: float, drift: float):
    """A step in the middle of the rows, and a drift, mag and mag/h."""
    hours = ball[1].seconds / 3600
    return changed(ball, step * (hours > hours.mean()) + drift * (hours - hours.mean()))


def even(ball, added: np.ndarray):
    """The ball's own light with ``added`` (T,), in errors of a row. Rows err by exactly one beside it, up and down in turn: what their
    squares sum to is known."""
    scene, recording = ball
    light = np.asarray(torchlc.simulate(scene, recording).to_table()["mag"])
    turn = (-1.0) ** np.arange(len(light))
    return scene, replace(recording, observed=light + ERROR * (turn + added))


def drift_and_wave(ball) -> tuple[np.ndarray, np.ndarray]:
    """A straight line and a wave of half an hour, (T,) each: of unit length, and at right angles to each other and to a constant."""
    hours = ball[1].seconds / 3600
    columns = np.stack([np.ones_like(hours), hours, np.sin(4 * np.pi * (hours - hours.mean()))], 1)
    drift, wave = np.linalg.qr(columns)[0].T[1:]
    return drift * np.sign(drift[-1]), wave
