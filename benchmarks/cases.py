"""What the benchmarks run on: Object 1 of the paper in several guises, and a mesh."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import torchlc
from examples.paper import setting
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording

EFFECTS = ("self_shadowing", "finite_sun", "earth_shadow", "exposure_smearing")
EXPOSURE_S = 5.0
WALKERS, EPOCHS = 64, 840
MESH_FACETS, MESH_EPOCHS = 3840, 200
NIGHT = "2020-10-17T14:00:00"


def object_1(effects: Sequence[str] = (), *, epochs: int = EPOCHS, hours: float = 7.0) -> torchlc.Likelihood:
    """Box and two wings, 6 + 4 faces, all six numbers of the materials free; exposures of 5 s, errors of 0.02
    mag."""
    cadence = hours * 3600 / epochs
    curve = torchlc.simulate(
        setting.object_1(), start=NIGHT, hours=hours - cadence / 3600, cadence=cadence, noise=0.02, seed=1
    )
    scene = setting.object_1(setting.free_materials())
    recording = recording_of(curve, scene)
    exposed = replace(recording, exptime=np.full(len(recording.seconds), EXPOSURE_S))
    return torchlc.Likelihood(LightCurve(scene, exposed, effects=list(effects)))


def draws(likelihood: torchlc.Likelihood, count: int = WALKERS, seed: int = 0) -> Tensor:
    """Natural values theta (count, P) from the prior."""
    generator = torch.Generator().manual_seed(seed)
    return likelihood.model.parameter_set.sample_prior(count, generator)


def near_truth(likelihood: torchlc.Likelihood, count: int = WALKERS, seed: int = 0) -> Tensor:
    """Natural values theta (count, P): materials from the prior, offsets from one another by 0.1 of their
    units."""
    theta = draws(likelihood, count, seed)
    columns = likelihood.model.assembly.geometry_columns
    generator = torch.Generator().manual_seed(seed + 1)
    noise = torch.randn(count, len(columns), generator=generator, dtype=theta.dtype)
    theta[:, columns] = 0.1 * noise
    return theta


def many_faces(epochs: int) -> torchlc.Likelihood:
    """Object 1 and a second body with wings beside it, turned so that no normals agree: 20 faces."""
    likelihood = object_1(epochs=epochs)
    scene = likelihood.model.scene
    twins = [
        part.model_copy(
            update={
                "name": f"{part.name} 2",
                "centre": tuple(c + 20.0 for c in part.centre),
                "rotation": (10.0, 20.0, 30.0),
            }
        )
        for part in scene.components
    ]
    scene = scene.model_copy(update={"components": [*scene.components, *twins]})
    return torchlc.Likelihood(LightCurve(scene, likelihood.model.recording, effects=[]))


def torus(folder: Path, epochs: int = MESH_EPOCHS) -> tuple[torchlc.Scene, torchlc.Recording]:
    """A mesh of 3,840 triangles that shade one another, tumbling, with ``epochs`` rows over four hours; its
    file is put into ``folder``."""
    import trimesh

    ring = trimesh.creation.torus(1.0, 0.4, major_sections=60, minor_sections=32)
    assert len(ring.faces) == MESH_FACETS
    ring.export(folder / "ring.obj")
    path = folder / "scene.toml"
    path.write_text(RING.format(*setting.ORBITS[1]))
    scene, cadence = torchlc.load(path), 4 * 3600 / epochs
    curve = torchlc.simulate(scene, start=NIGHT, hours=4 - cadence / 3600, cadence=cadence, noise=0.02)
    return scene, recording_of(curve, scene)


def recording_of(curve: torchlc.SimulatedCurve, scene: torchlc.Scene) -> torchlc.Recording:
    with tempfile.TemporaryDirectory() as folder:
        return load_recording(curve.write(Path(folder) / "curve.ecsv"), scene)


RING = """
format = "torchlc-scene/1"
name = "ring"
[orbit]
tle = ["{}",
       "{}"]
[[stations]]
id = "station"
latitude = 37.536
longitude = 122.05
height = 110.0
[attitude]
mode = "inertial"
x_angle = 30.0
spin_axis = [1, 1, 0]
spin_rate = 1.0
[[components]]
name = "ring"
shape = "mesh"
file = "ring.obj"
scale = 1.0
centre = [0, 0, 0]
material = "rock"
[materials.rock]
model = "lommel-seeliger-lambert"
weight = 0.1
albedo = 0.2
[model]
effects = []
[model.parameters]
band_sun_magnitude = -26.7
"""
