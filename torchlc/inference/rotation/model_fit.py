"""The model, with everything in it, fitted to a rotation that the light of facets suggests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchlc.geometry.orbit.earth import icrs_from_ecliptic
from torchlc.inference.likelihood import MAG_PER_LN, Likelihood
from torchlc.inference.polish import laplace, polish
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.refine import Local
from torchlc.inference.rotation.trials import MOST_DIFFUSE, MOST_LOBE, Trial, night_epochs
from torchlc.lightcurve.model import LightCurve
from torchlc.parameters import EXPONENT, FRESNEL, LOBE_REFLECTANCE, REFLECTANCE, WIDTH
from torchlc.readers import Recording
from torchlc.scene import Scene

NAMES = (
    "pole_lon", "pole_lat", "period", "phase", "period_rate", "tilt_x", "tilt_y", "tilt_z",
    "nutation", "polhode_phase", "inertia_x", "inertia_y",
)  # fmt: skip
MODEL_ERROR = 1e-4
"""Error of a phase, turns, that the model's numbers have of themselves: its curves bend within a standard deviation of most fits."""


@dataclass(frozen=True)
class Candidate:
    """A trial fitted: natural values ``theta`` (P,), numbers of the attitude with standard deviations, the unit pole (GCRS);
    ``deviance``, -2 ln of the likelihood, in which trials compare also where errors are fitted, and ``rms`` of measured rows, mag.
    ``names`` of theta's numbers and their ``covariance`` (P, P)."""

    trial: Trial
    theta: Tensor
    numbers: Mapping[str, float]
    sd: Mapping[str, float]
    chi2: float
    deviance: float
    rms: float
    pole: Tensor
    names: tuple[str, ...]
    covariance: Tensor

    @property
    def tumbling(self) -> bool:
        """Whether it is a free rotation about no axis fixed in the body."""
        return self.trial.scene.attitude.tumbles


def fitted(trial: Trial, recording: Recording) -> Candidate:
    """The model's own least squares from a trial."""
    model = LightCurve(trial.scene, recording)
    likelihood = Likelihood(model)
    parameters = model.parameter_set
    theta = parameters.start().clone()
    _materials(model, trial, theta)
    noise = model.noise(theta) if model.assembly.stage("noise") else None
    moving = model.assembly.geometry_columns
    if len(moving) < len(theta):  # the materials first, so that the attitude does not stand in for them
        settled = polish(likelihood, theta[None], noise, iterations=12, held=moving)
        theta = parameters.from_flat(settled.y[0])
    best = polish(likelihood, theta[None], noise, iterations=40)
    lowest = int(best.cost.argmin())
    natural = parameters.from_flat(best.y[lowest])
    with torch.no_grad():
        chi2 = float(likelihood.chi2(natural))
        deviance = -2 * float(likelihood.log_likelihood(natural))
        left = (model(natural) - likelihood.observed)[likelihood.measured]
        if likelihood.kind == "flux":
            left = MAG_PER_LN * left / likelihood.observed[likelihood.measured]
        rms = float(left.square().mean().sqrt())
    low, high = parameters.flat_bounds()
    covariance, _ = laplace(best.jacobian[lowest], best.y[lowest], low, high)
    spread = torch.sqrt(torch.diagonal(covariance).clamp(min=0))
    shifted = parameters.from_flat(best.y[lowest] + 1e-4 * spread)
    slope = torch.where(spread > 0, (shifted - natural) / (1e-4 * spread.clamp(min=1e-300)), 0.0)
    covariance = covariance * slope[:, None] * slope
    natural_sd = torch.sqrt(torch.diagonal(covariance).clamp(min=0)).tolist()
    numbers = dict(trial.numbers)
    sd: dict[str, float] = {}
    for name, value, width in zip(parameters.names, natural.tolist(), natural_sd, strict=True):
        short = name.removeprefix("attitude.")
        if name.startswith("attitude.") and short.partition("[")[0] in NAMES:
            numbers[short] = value
            sd[short] = width
    for key in trial.apart:
        numbers[key], sd[key] = (of[f"{key}[{trial.reference}]"] for of in (numbers, sd))
    for name, width in trial.spread.items():
        sd[name] = math.hypot(sd.get(name, 0.0), width)
    pole = pole_of(trial.scene, numbers)
    return Candidate(
        trial, natural, numbers, sd, chi2, deviance, rms, pole, tuple(parameters.names), covariance
    )


def pole_of(scene: Scene, numbers: Mapping[str, float]) -> Tensor:
    """Unit vector of the pole in GCRS."""
    lon, lat = math.radians(numbers["pole_lon"]), math.radians(numbers["pole_lat"])
    way = torch.tensor(
        [math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)], dtype=torch.float64
    )
    return torch.from_numpy(icrs_from_ecliptic()) @ way if scene.orbit.vectors == "ecliptic" else way


def sharpened(recording: Recording, rows: Rows, local: Local, one: Candidate) -> Local | None:
    """A solution with the phases and frequencies of its passes as the model has them that was fitted with a phase and a period for
    each night, and their covariance with pole and materials free. That is sharper than the light of facets, so fewer counts of turns
    are possible. None where a night holds several passes or the fit tells nothing of one."""
    index = rows.index.numpy()
    night, number = recording.night[index], rows.number.numpy()
    together = {*zip(night.tolist(), number.tolist(), strict=True)}
    if not len(together) == len(np.unique(night)) == rows.passes:
        return None
    epochs = night_epochs(recording, night, number, index)
    frequencies, phases = local.frequencies.clone(), local.phases.clone()
    slopes = one.theta.new_zeros(2 * rows.passes, len(one.theta))
    for passed in range(rows.passes):
        of = int(night[number == passed][0])
        period, phase = (
            one.names.index(f"attitude.{key}[{recording.night_ids[of]}]") for key in ("period", "phase")
        )
        away = float(rows.middle[passed]) - float(recording.seconds[epochs[of]])
        frequency = 1 / (3600 * one.theta[period])
        frequencies[passed] = frequency
        phases[passed] = one.theta[phase] / 360 + frequency * away
        slopes[passed, period] = -frequency / one.theta[period]
        slopes[rows.passes + passed, period] = away * slopes[passed, period]
        slopes[rows.passes + passed, phase] = 1 / 360
    covariance = slopes @ one.covariance @ slopes.T
    if not bool((torch.diagonal(covariance) > 0).all()):
        return None
    covariance = covariance * max(1.0, one.chi2 / max(1, len(rows.flux) - len(one.theta)))
    return replace(
        local,
        pole=one.pole,
        frequencies=frequencies,
        phases=phases,
        covariance=covariance,
        own_error=MODEL_ERROR,
    )


def _materials(model: LightCurve, trial: Trial, theta: Tensor) -> None:
    """Reflectances and exponents of a trial put among the starting values theta (P,), where the law has such."""
    body = FacetLight.of(model.assembly)
    lobes = dict(zip([name for name, lobed in zip(body.names, body.lobed, strict=True) if lobed],
                     range(sum(body.lobed)), strict=True))  # fmt: skip
    for k, free in enumerate(model.parameter_set.free):
        owner = free.origin.owner
        if free.origin.role != "materials" or owner not in body.names:
            continue
        low, high = max(free.prior.low, 0.0), free.prior.high
        lobe = lobes.get(owner)
        if free.role == REFLECTANCE:
            value, low, high = (
                float(trial.weights[body.names.index(owner)]),
                max(low, 0.01),
                min(high, MOST_DIFFUSE),
            )
        elif lobe is None:
            continue
        elif free.role in (LOBE_REFLECTANCE, FRESNEL):
            value, low, high = (
                float(trial.weights[len(body.names) + lobe]),
                max(low, 0.01),
                min(high, MOST_LOBE),
            )
        elif free.role in (EXPONENT, WIDTH):
            exponent = float(trial.exponents[lobe])
            value = exponent if free.role == EXPONENT else math.sqrt(2 / exponent)
        else:
            continue
        theta[k] = min(max(value, low), high)
