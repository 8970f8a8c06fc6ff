"""The measured rows of recordings as passes: stretches in which a phase can be followed, with their geometry."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchlc.geometry.orbit.earth import DAY_S, LIGHT_KM_S
from torchlc.inference.likelihood import MAG_PER_LN, Likelihood
from torchlc.lightcurve.model import LightCurve
from torchlc.tensors.vectors import unit

LONGEST_GAP = 600.0
"""Seconds without a row that end a pass, if it was not much longer itself."""
GAP_SHARE = 0.3
"""A long pass may have gaps that a short one does not bridge."""
LEAST_NOISE = 0.01
"""As a share of the light: calibrated cameras do not have smaller errors."""
MEDIAN_OF_SQUARE = 0.4549
"""Median of the square of a normal number."""
RATE_A_DAY = 3e-4
"""Standard deviation of the change of a period in a day, of itself, before the data: 5 ms for 16 s."""


@dataclass(frozen=True)
class Rows:
    """Measured rows (T,): ``seconds`` at the body (light time taken off) since the recording's first row; unit
    directions in GCRS; ``flux`` times the square of the range in m2 and ``error`` of its logarithm; the number of
    each row's pass, of which ``middle`` (N,) and ``span`` (N,) are seconds. ``scaled``: a gain of its own a pass; ``noise``, in ln of the flux, of
    successive rows where errors are not given."""

    index: Tensor
    seconds: Tensor
    to_sun: Tensor
    to_observer: Tensor
    flux: Tensor
    error: Tensor
    number: Tensor
    middle: Tensor
    span: Tensor
    scaled: bool
    noise: float | None = None

    @property
    def passes(self) -> int:
        return len(self.middle)

    def of(self, one: int) -> Tensor:
        """Rows of a pass."""
        return torch.nonzero(self.number == one)[:, 0]

    @property
    def longest(self) -> int:
        """The number of the longest pass."""
        return int(self.span.argmax())

    @property
    def drift(self) -> Tensor:
        """Standard deviation (N,), before the data, of the relative difference of the frequency in each pass from that in
        the longest."""
        return RATE_A_DAY * (self.middle - self.middle[self.longest]).abs() / DAY_S


def rows_of(model: LightCurve) -> Rows:
    """The measured rows of a model's recording. Neglects the distance of the Sun: reflectances are off by 3.4 % at most."""
    likelihood = Likelihood(model)
    assembly, recording = model.assembly, model.recording
    state = assembly.track.at(0.0, 0.0, 0.0)
    index = torch.nonzero(likelihood.measured)[:, 0]
    distance = torch.linalg.vector_norm(state.observer, dim=-1).expand(len(recording))[index]
    late = 0.0 if recording.light_time_corrected else distance / LIGHT_KM_S
    seconds = state.time[index] - late
    sun = state.sun.expand(len(recording), 3)[index]
    scaled = likelihood.kind == "flux"
    observed = likelihood.observed[index]
    if scaled:
        flux, error = observed, likelihood.error[index] / observed.abs().clamp(min=1e-12)
    else:
        zero = float(model.values(model.parameter_set.start()).get("zero_point", 0.0))
        sun_magnitude = assembly.sun_magnitude.expand(len(recording))[index]
        flux = 10 ** (-0.4 * (observed - sun_magnitude - zero))
        error = likelihood.error[index] / MAG_PER_LN
    number = _passes(seconds.numpy())
    noise = None
    if likelihood.fitted_errors:
        noise = successive_noise(flux, number)
        error = torch.full_like(error, max(noise, LEAST_NOISE))
    count = int(number.max()) + 1
    each = [seconds[number == passed] for passed in range(count)]
    return Rows(
        index,
        seconds,
        unit(sun),
        unit(state.observer.expand(len(recording), 3)[index]),
        flux * (1e3 * distance) ** 2,
        error,
        number,
        torch.stack([(times.max() + times.min()) / 2 for times in each]),
        torch.stack([times.max() - times.min() for times in each]),
        scaled,
        noise,
    )


def successive_noise(flux: Tensor, number: Tensor) -> float:
    """Standard deviation of ln of the flux (T,) about the line through a row's neighbours, of the same pass ``number`` (T,):
    what no smooth light explains. The median of squares, so that a few glints do not count."""
    light = torch.log(flux.clamp(min=1e-300))
    bend = light[:-2] - 2 * light[1:-1] + light[2:]
    inside = (number[:-2] == number[2:]) & torch.isfinite(bend)
    if not bool(inside.any()):
        return LEAST_NOISE
    return float((bend[inside].square().median() / (6 * MEDIAN_OF_SQUARE)).sqrt())


def _passes(seconds: np.ndarray) -> Tensor:
    """The number of each row's pass."""
    order = np.argsort(seconds, kind="stable")
    number = np.zeros(len(seconds), dtype=int)
    current, start = 0, seconds[order[0]]
    for before, here in itertools.pairwise(order):
        gap = seconds[here] - seconds[before]
        if gap > LONGEST_GAP and gap > GAP_SHARE * (seconds[before] - start):
            current, start = current + 1, seconds[here]
        number[here] = current
    return torch.from_numpy(number)
