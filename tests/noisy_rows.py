"""Recordings of a white body under every kind of noise, and the noise itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from tests.effects.cases import PLATE, still
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.outliers import Mixture
from torchlc.noise.red_noise import Matern32
from torchlc.stages.noise import Noise

FREE = '[materials.white]\nmodel = "lambert"\nalbedo = {value = 0.5, low = 0.05, high = 1.0}\n'
KNOWN = '[materials.white]\nmodel = "lambert"\nalbedo = 0.5\n'
JITTER, RED, TAU, SHARE, WIDTH = 0.07, 0.1, 0.2, 0.15, 6.0
MAG_PER_LN = 2.5 / math.log(10)
NOISE = {
    "quoted": {},
    "jitter": {"jitter": JITTER},
    "outliers": {"outliers": SHARE, "width": WIDTH},
    "jitter and outliers": {"jitter": JITTER, "outliers": SHARE, "width": WIDTH},
    "red noise": {"red": RED, "tau": TAU},
    "red noise and jitter": {"red": RED, "tau": TAU, "jitter": JITTER},
}


def noise_of(name: str, likelihood: Likelihood) -> Noise:
    values = {key: torch.tensor([value], dtype=torch.float64) for key, value in NOISE[name].items()}
    noise = Noise()
    if "jitter" in values:
        noise = noise.wider(values["jitter"])
    if "outliers" in values:
        noise = noise.with_law(Mixture(values["outliers"], values["width"]))
    if "red" in values:
        seconds = likelihood.model.assembly.context.seconds
        noise = noise.with_process(Matern32(values["red"], values["tau"], seconds))
    return noise


def recorded(
    seven, kind: str, limits: list[int], fitted: bool = False
) -> tuple[Likelihood, np.ndarray, torch.Tensor]:
    """Of rows with residuals of a few errors the likelihood, the model in the recording's unit before gains, and
    theta."""
    scene, rows = seven
    model = LightCurve(scene, rows)
    mag = model(model.theta()).detach().numpy()
    off = np.array([0.05, -0.09, 0.02, -0.06, 0.04, 0.11, -0.03])
    error = np.array([0.04, 0.08, 0.05, 0.03, 0.06, 0.05, 0.07])
    light = mag if kind == "mag" else 10 ** (-0.4 * (mag - mag.min()))
    observed = mag + off if kind == "mag" else 3.0 * light * (1 - off)
    if kind == "flux":
        error = error * light * 3.0
    upper = np.isin(np.arange(7), limits)
    recording = replace(
        rows, kind=kind, observed=observed, error=None if fitted else error, upper_limit=upper
    )
    likelihood = Likelihood(LightCurve(scene, recording))
    return likelihood, light, likelihood.model.theta().detach()


def listed(effects: str):
    return still(PLATE, KNOWN, "").to_toml().replace("effects = []", f"effects = {effects}")


def changed(refit, u):
    """A fit with other residuals over their errors (T,)."""
    return replace(refit, found=replace(refit.found, delta=u * refit.wide))
