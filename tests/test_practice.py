"""Recordings of an independent generator, by brute force: the true effect fits them and is given back."""

from __future__ import annotations

import functools
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit, fit_map
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording
from torchlc.scene import load_scene

PRACTICE = Path(__file__).parents[2] / "shared" / "practice"
CASES = (
    "control", "panel_offset", "exposure_smearing", "jitter",
    "two", "earth_shadow", "self_shadowing", "appendage",
)  # fmt: skip


@functools.cache
def refit(case: str) -> tuple[Fit, dict]:
    """The baseline with the answer's effects, and the answer."""
    folder = PRACTICE / case
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")
    answer = json.loads((folder / "answer.json").read_text())
    scene = load_scene(folder / "scene.toml")
    recording = load_recording(folder / "recording.ecsv", scene)
    model = LightCurve(scene, recording, effects=[*answer["baseline"], *answer["effects"]])
    return fit_map(Likelihood(model), starts=10 if model.geometry_free else 24), answer


def chi2_of(fit: Fit) -> float:
    """With the fitted jitter in the errors."""
    found = fit.likelihood.residuals(fit.theta)
    sigma = fit.model.noise(fit.theta).sigma(found.sigma, found.scale)
    return float((found.delta / sigma).square().sum())


def deviations(fit: Fit, truth: dict[str, float]) -> dict[str, tuple[float, float]]:
    """Distance of each parameter from the truth in standard deviations, and these, in flat coordinates."""
    parameters, best = fit.model.parameter_set, fit.modes[0]
    true = best.theta.clone()
    index = [parameters.names.index(name) for name in truth]
    true[index] = true.new_tensor(list(truth.values()))
    apart = parameters.to_flat(best.theta) - parameters.to_flat(true)
    sd = torch.sqrt(torch.diagonal(best.covariance))
    return {name: (float(apart[i] / sd[i]), float(sd[i])) for name, i in zip(truth, index, strict=True)}


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_the_truth_fits_and_is_found(case: str) -> None:
    fit, answer = refit(case)
    assert chi2_of(fit) / fit.dof == pytest.approx(1.0, abs=3 * math.sqrt(2 / fit.dof))
    effects = {
        f"{effect}.{key}": value
        for effect, values in answer["parameters"].items()
        for key, value in values.items()
        if isinstance(value, float)
    }
    # r_diff's flat coordinate holds r_spec as well: its pair is judged by r_spec and n
    materials = {
        f"{material}.{key}": values[key]
        for material, values in answer["materials"].items()
        for key in ("n", "r_spec")
    }
    for name, (apart, sd) in deviations(fit, effects | materials).items():
        held = name in effects or sd < 0.1  # a valley that bends has no standard deviation
        assert abs(apart) < 3.0 or not held, (name, apart, sd)


def test_the_appendage_found_is_the_plate_that_was_there() -> None:
    """Its normal, and area times reflectance: only Schlick's term, a tenth here, tells the two apart."""
    fit, answer = refit("appendage")
    values = dict(zip(fit.model.names, fit.theta.tolist(), strict=True))
    (plate,), surface = (
        answer["parameters"]["appendage"]["plates"],
        answer["parameters"]["appendage"]["material"],
    )
    normal = np.cross(plate["u"], plate["v"])
    lon, lat = math.radians(values["appendage.lon"]), math.radians(values["appendage.lat"])
    found = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    assert math.degrees(math.acos(abs(found @ normal) / np.linalg.norm(normal))) < 0.5
    area, r_spec, r_diff = (values[f"appendage.{key}"] for key in ("area", "r_spec", "r_diff"))
    true_area = math.prod(plate["size"])
    assert area * r_spec == pytest.approx(true_area * surface["r_spec"], rel=0.1)
    diffuse = true_area * surface["r_diff"] * (1 - surface["r_spec"])
    assert area * r_diff * (1 - r_spec) == pytest.approx(diffuse, rel=0.05)
