"""Small scenes with known answers, and what every effect must obey.

A ``still`` scene has no attitude but the frame's own: directions to the Sun and to the observer are those
in the body.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch

from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording
from torchlc.scene import Scene

AU_KM = 149_597_870.7
RANGE_KM = 1000.0

STILL = """
    [orbit]
    vectors = "icrs"
    [attitude]
    mode = "inertial"
    x_angle = 0.0
"""
PLATE = """
    [[components]]
    name = "plate"
    shape = "plate"
    size = [2.0, 3.0]
    centre = [0, 0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    material = "white"
"""


def unit(vector) -> np.ndarray:
    vector = np.asarray(vector, dtype=float)
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def tilted(axis_deg, azimuth_deg=0.0) -> np.ndarray:
    """Directions (..., 3) at angles from +Z towards the meridian of an azimuth."""
    polar, azimuth = np.broadcast_arrays(np.radians(axis_deg), np.radians(azimuth_deg))
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)


def material(name: str, n: float, r_spec: float, r_diff: float) -> str:
    return f"[materials.{name}]\nn = {n}\nr_spec = {r_spec}\nr_diff = {r_diff}\n"


def still(components: str, materials: str, model: str = "") -> Scene:
    return Scene.from_toml(
        'format = "torchlc-scene/1"\nname = "case"\n' + STILL + components + materials
        + "\n[model]\neffects = []\n[model.parameters]\nband_sun_magnitude = -26.7\n" + model,
        Path(), "case",
    )  # fmt: skip


def seen_from(
    scene: Scene, folder: Path, to_sun, to_observer, *, position=None, sun_km=AU_KM, range_km=RANGE_KM
):
    """Recording of the directions (T, 3) to Sun and observer, one row a second."""
    to_sun, to_observer, place = np.broadcast_arrays(
        *map(np.atleast_2d, (to_sun, to_observer, [0.0, 0.0, 0.0] if position is None else position))
    )
    columns = [to_sun * np.reshape(sun_km, (-1, 1)), to_observer * np.reshape(range_km, (-1, 1))]
    names = ["sun_x", "sun_y", "sun_z", "obs_x", "obs_y", "obs_z"]
    if position is not None:
        columns.append(place)
        names += ["r_x", "r_y", "r_z"]
    start = np.datetime64("2021-03-20T12:00:00.000")
    lines = [",".join(["time", "mag", "mag_err", *names])]
    for row, vectors in enumerate(np.concatenate(columns, -1)):
        stamp = start + np.timedelta64(1000 * row, "ms")
        lines.append(",".join([str(stamp), "10", "0.1", *(repr(float(x)) for x in vectors)]))
    path = folder / "case.csv"
    path.write_text("\n".join(lines) + "\n")
    return load_recording(path, scene)


def flux(scene: Scene, recording, effects=(), **values) -> np.ndarray:
    """Phi (T,) with some effects, whose parameters are given as ``name__quantity`` (of every target)."""
    model = LightCurve(scene, recording, effects=list(effects))
    theta = model.theta().detach().clone()
    for key, value in values.items():
        short = key.replace("__", ".")
        found = [i for i, name in enumerate(model.names) if name.partition("[")[0] == short]
        assert found, f"{short} is not among {model.names}"
        theta[found] = value
    return model.brightness(theta).flux.detach().numpy()


def check_contract(scene: Scene, recording, name: str) -> None:
    """Off is no effect at all; gradients are finite at off, typical and the bounds, and right; a batch is
    its rows."""
    bare = LightCurve(scene, recording, effects=[]).brightness().flux.detach()
    model = LightCurve(scene, recording, effects=[name])
    own = [i for i, key in enumerate(model.names) if key.startswith(f"{name}.")]
    quantities = {effect.full_name(q.name): q for effect in model.effects for q in effect.quantities}
    base = model.theta().detach().clone()

    def curve(theta):
        return model.brightness(theta).flux

    def at(pick):
        theta = base.clone()
        for i in own:
            value = pick(quantities[model.names[i]])
            if value is not None:
                theta[i] = value
        return theta

    off = at(lambda q: q.off)
    scale = bare.abs().max().clamp(min=1e-300)
    torch.testing.assert_close(curve(off) / scale, bare / scale, rtol=1e-12, atol=1e-12)
    points = [off, at(lambda q: q.typical), at(lambda q: q.low), at(lambda q: q.high)]
    for theta in points:
        slopes = torch.func.jacrev(curve)(theta)
        assert torch.isfinite(slopes).all(), f"{name}: gradient at {theta.tolist()}"
    theta = points[1]
    slopes = torch.func.jacrev(curve)(theta)
    for i in range(len(theta)):
        step = 1e-5 * max(1.0, abs(theta[i].item()))
        up, down = theta.clone(), theta.clone()
        up[i], down[i] = theta[i] + step, theta[i] - step
        central = (curve(up) - curve(down)) / (2 * step)
        error = (central - slopes[:, i]).abs().max()
        assert error <= 1e-4 * slopes[:, i].abs().max() + 1e-8 * scale / step, (name, model.names[i], error)
    batch = torch.stack(points)
    rows = torch.stack([curve(theta) for theta in points])
    torch.testing.assert_close(curve(batch), rows, rtol=1e-12, atol=1e-12 * scale.item())
    assert math.isfinite(rows.sum().item())
